"""Bends and hills: the land as a surface, and that drives, vehicles, meshes and pictures all stand on it."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from mixo_env.geometry import rotation_from_roll_pitch_yaw
from mixo_env.simulator.city.land import EDGE_M, FLAT, land_of
from mixo_env.simulator.city.laying import FOUNDATION_M, ground_aligned, laid, levelled, parked
from mixo_env.simulator.city.mesh import GROUND, SHADE, SOLID, Surface, mesh_of, quad
from mixo_env.simulator.city.streets import BLOCK_M, HALF_ROAD_M
from mixo_env.simulator.city.vehicles import VehicleState
from mixo_env.simulator.city.world import CityPlan, World, build_world
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.drive.drive import DRIVE_RATE_HZ, MARGIN_S
from mixo_env.simulator.drive.localisation import localise
from mixo_env.simulator.drive.rig import nominal_calibration
from mixo_env.simulator.drive.scenario import plan_logs
from mixo_env.simulator.drive.scenes import camera_pose, scene_drive
from mixo_env.simulator.drive.vehicle_bus import GRAVITY_MPS2, bus_messages, draw_sensors
from mixo_env.simulator.picture.fleet import Fleet, body_motions, moving_states
from mixo_env.simulator.picture.rasterizer import DepthBuffers
from mixo_env.simulator.picture.render import CameraPose, Renderer
from mixo_env.simulator.picture.sampling import even_cells
from mixo_env.simulator.picture.views import MATERIAL, U_CONSTANT, V_CONSTANT, Textures, View

pytestmark = pytest.mark.rendering

SEEDS = range(12)
STEEP = 9
"""A land with slopes of 4 % and bends."""


def places(seed: int, count: int = 500) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-430.0, 430.0, count), rng.uniform(-430.0, 430.0, count)


@pytest.mark.parametrize("seed", SEEDS)
def test_grid_and_map_are_inverse_and_slopes_are_derivatives(seed):
    land, (u, v) = land_of(seed), places(seed)
    x, y = land.map(u, v)
    assert np.abs(np.subtract(land.grid(x, y), (u, v))).max() < 1e-5
    step = 1e-4
    dx_dv = (land.map(u, v + step)[0] - land.map(u, v - step)[0]) / (2 * step)
    dy_du = (land.map(u + step, v)[1] - land.map(u - step, v)[1]) / (2 * step)
    assert np.abs(np.subtract(land.bend(u, v), (dx_dv, dy_du))).max() < 1e-6

    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return land.height(*land.grid(x, y))

    step = 0.01
    rise = (
        (height(x + step, y) - height(x - step, y)) / (2 * step),
        (height(x, y + step) - height(x, y - step)) / (2 * step),
    )
    assert np.abs(np.subtract(land.rise(u, v), rise)).max() < 1e-4
    assert np.hypot(*land.rise(u, v)).max() < 0.06


def test_the_ground_below_points_is_what_the_single_questions_answer():
    land, (x, y) = land_of(STEEP), places(STEEP)
    u, v = land.grid(x, y)
    single = np.column_stack([land.height(u, v), *land.rise(u, v), u, v, *land.bend(u, v)])
    np.testing.assert_array_equal(land.below(np.column_stack([x, y, x])), single)


def test_a_rectangle_of_the_grid_is_a_flat_parallelogram():
    land, (u, v) = land_of(STEEP), places(1)
    wide, long = 31.0, 57.0
    corners = [
        land.points(np.stack([u + i * wide, v + j * long, np.zeros_like(u)], axis=1)) for i in (0, 1) for j in (0, 1)
    ]
    assert np.abs(corners[0] + corners[3] - corners[1] - corners[2]).max() < 1e-9


def test_headings_turn_with_the_streets_and_flat_land_changes_nothing():
    land, (u, v) = land_of(STEEP), places(2)
    heading = np.random.default_rng(0).uniform(-9.0, 9.0, len(u))
    ahead = np.subtract(land.map(u + 1e-4 * np.cos(heading), v + 1e-4 * np.sin(heading)), land.map(u, v))
    turned = land.heading(u, v, heading)
    assert np.abs(np.exp(1j * turned) - np.exp(1j * np.arctan2(ahead[1], ahead[0]))).max() < 1e-4
    assert np.abs(turned - heading).max() < 0.4
    assert np.array_equal(FLAT.heading(u, v, heading), heading)
    assert np.array_equal(FLAT.points(np.stack([u, v, u], axis=1)), np.stack([u, v, u], axis=1))


def test_lands_differ_and_stay_the_same_for_a_seed():
    (u, v) = places(3)
    heights = [land_of(seed).height(u, v) for seed in (1, 1, 2)]
    assert np.array_equal(heights[0], heights[1])
    assert not np.allclose(heights[0], heights[2])
    steepest = [np.hypot(*land_of(seed).rise(u, v)).max() for seed in range(40)]
    assert min(steepest) < 0.01
    assert max(steepest) > 0.04


# --- drives


@pytest.fixture(scope="module")
def hilly():
    """Drives of a few logs with their lands, moving ones."""
    config = SimulationConfig(scenes=12, scenes_per_log=2, seed=3, night=0.0)
    found = [
        (scene_drive(config, log, plan), land_of(log.world_seed)) for log in plan_logs(config) for plan in log.scenes
    ]
    return [pair for pair in found if np.ptp(pair[0].s_m) > 60.0]


def test_the_car_stays_on_the_ground_and_no_grade_exceeds_6_per_cent(hilly):
    steepest = 0.0
    for drive, land in hilly:
        assert drive.z_m == pytest.approx(land.height(*land.grid(drive.x_m, drive.y_m)), abs=1e-3)
        along = np.hypot(np.diff(drive.x_m), np.diff(drive.y_m))
        moving = along > 0.01
        grade = np.abs(np.diff(drive.z_m)[moving] / along[moving])
        steepest = max(steepest, grade.max())
        assert grade.max() < 0.06
    assert steepest > 0.02


def test_wheels_measure_the_way_along_the_slope(hilly):
    for drive, _ in hilly:
        along = np.sqrt(np.diff(drive.x_m) ** 2 + np.diff(drive.y_m) ** 2 + np.diff(drive.z_m) ** 2).sum()
        assert along == pytest.approx(np.ptp(drive.s_m), rel=1e-4)


def test_pitch_and_roll_follow_the_slope(hilly):
    for drive, land in hilly:
        rise_x, rise_y = land.rise(*land.grid(drive.x_m, drive.y_m))
        c, s = np.cos(drive.yaw_rad), np.sin(drive.yaw_rad)
        assert np.mean(drive.pitch_rad + np.arctan(rise_x * c + rise_y * s)) == pytest.approx(0.0, abs=0.004)
        assert np.mean(drive.roll_rad - np.arctan(rise_y * c - rise_x * s)) == pytest.approx(0.0, abs=0.004)
        # A body that only follows the slope lies in the plane that touches the ground.
        k = len(c) // 2
        body = rotation_from_roll_pitch_yaw(
            float(np.arctan(rise_y * c - rise_x * s)[k]),
            float(-np.arctan(rise_x * c + rise_y * s)[k]),
            drive.yaw_rad[k],
        )
        normal = np.array([-rise_x[k], -rise_y[k], 1.0])
        assert body[:, 2] == pytest.approx(normal / np.linalg.norm(normal), abs=2e-3)


def test_the_accelerometer_feels_the_slope_and_written_poses_do_not(hilly):
    felt = []
    for number, (drive, _) in enumerate(hilly):
        rng = np.random.default_rng(number)
        sensors = dataclasses.replace(draw_sensors(rng, 0.305), imu_tilt_mps2=np.zeros(2))
        messages = bus_messages(rng, drive, localise(rng, drive, 0.03), sensors, 0, 19_500_000)
        time_s = np.array([message["utime"] for message in messages["ms_imu"]]) / 1e6
        forward = np.array([message["linear_accel"][0] for message in messages["ms_imu"]])
        uphill = np.gradient(drive.z_m, 1.0 / DRIVE_RATE_HZ) / np.maximum(drive.speed_mps, 1.0)
        moving = drive.at("speed_mps", time_s) > 2.0
        if moving.sum() < 200:
            continue
        gravity = GRAVITY_MPS2 * np.interp(time_s, drive.time_s, uphill)
        felt.append(((forward - drive.at("acceleration_mps2", time_s))[moving].mean(), gravity[moving].mean()))
        assert {message["pos"][2] for message in messages["pose"]} == {0.0}
        assert all(message["orientation"][1:3] == [0.0, 0.0] for message in messages["pose"])
    measured, expected = np.array(felt).T
    assert measured == pytest.approx(expected, abs=0.07)
    assert np.ptp(expected) > 0.15


def test_bends_turn_routes_without_a_jump(hilly):
    for drive, _ in hilly:
        assert np.abs(np.diff(drive.route.curvature_pm)).max() < 0.008
        assert drive.time_s[0] == -MARGIN_S


# --- meshes


def test_laid_pieces_share_their_corners_and_keep_their_texture():
    land = land_of(STEEP)
    surface = Surface(0, (4.0, 3.0))
    whole = mesh_of([quad(surface, (10.0, 60.0, 0.15), (40.0, 0.0, 0.0), (0.0, -50.0, 0.0), start=(7.0, 8.0))])
    whole["texel"] = (160.0, 20.0, 7.0, -30.0, 150.0, 8.0)  # turned against the edges
    pieces = laid(whole, land)
    assert len(pieces) == 6 * 7
    seen: dict[tuple[float, float], np.ndarray] = {}
    for piece, (i, j) in itertools.product(pieces, itertools.product((0, 1), repeat=2)):
        point = piece["origin"] + i * piece["edge_u"] + j * piece["edge_v"]
        a = piece["texel"]
        texel = a[0] * i + a[1] * j + a[2], a[3] * i + a[4] * j + a[5]
        s, t = np.linalg.solve([[160.0, 20.0], [-30.0, 150.0]], np.subtract(texel, (7.0, 8.0)))
        u, v = 10.0 + 40.0 * s, 60.0 - 50.0 * t
        assert point == pytest.approx(land.points(np.array([u, v, 0.15])), abs=1e-9)
        seen.setdefault((round(u, 6), round(v, 6)), point)
    assert len(seen) == 7 * 8


def test_houses_are_level_and_reach_into_the_ground():
    land = land_of(STEEP)
    wall = mesh_of([quad(Surface(0, (2.0, 2.0)), (0.0, 40.0, 9.0), (18.0, 0.0, 0.0), (0.0, 0.0, -9.0))])
    house = levelled(wall, land, 9.0, 40.0)[0]
    middle = float(land.height(np.array(9.0), np.array(40.0)))
    assert house["origin"][2] == pytest.approx(9.0 + middle)
    assert house["edge_u"][2] == 0.0
    assert house["edge_v"] == pytest.approx([0.0, 0.0, -9.0 - FOUNDATION_M])
    assert house["texel"][4] == pytest.approx(2.0 * (9.0 + FOUNDATION_M))  # as many texels a metre as before
    for u in (0.0, 18.0):
        assert middle - FOUNDATION_M < float(land.height(np.array(u), np.array(40.0)))


@pytest.fixture(scope="module")
def world() -> World:
    """A small city on hills."""
    return build_world(5, CityPlan(half_blocks=1, variety=4, ground_side=512, land=land_of(STEEP)))


def test_every_kind_of_surface_is_there_and_nothing_floats(world):
    g, material = world.static.geometry, world.static.tag[:, MATERIAL]
    assert {GROUND, SHADE, SOLID} == set(np.unique(material))
    corners = np.stack([g[:, :3], g[:, :3] + g[:, 3:6], g[:, :3] + g[:, 6:], g[:, :3] + g[:, 3:6] + g[:, 6:]])
    above = corners[..., 2] - world.land.height(*world.land.grid(corners[..., 0], corners[..., 1]))
    inner = (np.abs(corners[..., :2]) < EDGE_M).all(axis=(0, 2))
    assert np.abs(above[:, inner & (material == GROUND)]).max() < 0.2  # roads, and pavements a kerb higher
    assert np.abs(above[:, inner & (material == SHADE)]).max() < 0.2
    inside = np.asarray(inner)
    for start, stop in itertools.pairwise(world.static.group_start.tolist()):
        if np.any(material[start:stop] != SOLID) or not np.all(inside[start:stop]):
            continue
        assert above[:, start:stop].min() < 0.25, "a thing whose lowest point is in the air"


def test_parked_and_moving_vehicles_stand_on_the_slope(world):
    u, v = 20.0, -1.75
    x, y = world.land.map(np.array(u), np.array(v))
    yaw = float(world.land.heading(np.array(u), np.array(v), np.array(0.3)))
    model = world.vehicles["sedan", 0]
    still = parked(model, world.land, u, v, 0.3)
    fleet = Fleet(world, shadows=True)
    state = VehicleState("sedan", 0, float(x), float(y), yaw, 6.0)
    states = moving_states([state], land=world.land)
    moving = fleet.placed(fleet.models([state]), states)
    count = len(model)
    assert moving.geometry[:count, :3] == pytest.approx(still["origin"], abs=1e-6)
    assert moving.geometry[:count, 3:6] == pytest.approx(still["edge_u"], abs=1e-6)
    under = ground_aligned(still[still["material"] == SHADE], world.ground_texels_per_m, world.land)
    shade = moving.tag[:count, MATERIAL] == SHADE
    assert moving.texel[:count][shade] == pytest.approx(under["texel"], abs=0.05 * world.ground_texels_per_m)
    for shadow in moving.geometry[count:]:  # of the sun, one centimetre above the road
        for i, j in itertools.product((0, 1), repeat=2):
            point = shadow[:3] + i * shadow[3:6] + j * shadow[6:]
            ground = world.land.height(*world.land.grid(point[0], point[1]))
            assert 0.0 < point[2] - float(ground) < 0.06
    _, shifts = body_motions(states, 0.5)
    later = float(world.land.height(*world.land.grid(x + 3.0 * np.cos(yaw), y + 3.0 * np.sin(yaw))))
    assert shifts[1, 2] == pytest.approx(later - float(world.land.height(np.array(u), np.array(v))), abs=0.02)


# --- pictures


@pytest.mark.parametrize("channel", ["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK"])
def test_pictures_of_the_ground_agree_with_traced_rays(world, channel):
    """Depth and texture of the road against rays that are followed down to the surface itself."""
    land, camera = world.land, nominal_calibration(channel, 320, 180)
    u, v = np.array(0.4 * BLOCK_M), np.array(-1.75)
    rise_x, rise_y = land.rise(u, v)
    yaw = float(land.heading(u, v, np.array(0.0)))
    uphill, banked = rise_x * np.cos(yaw) + rise_y * np.sin(yaw), rise_y * np.cos(yaw) - rise_x * np.sin(yaw)
    body = rotation_from_roll_pitch_yaw(float(np.arctan(banked)), float(-np.arctan(uphill)), yaw)
    position = land.points(np.array([u, v, 0.0])) + body @ camera.translation_m
    rotation = (body @ camera.rotation_ego_from_camera).T
    fx, fy, cx, cy = camera.intrinsic.take((0, 4, 2, 5)).tolist()
    view = View(np.ascontiguousarray(rotation), position, fx, fy, cx, cy, 80.0)
    buffers = DepthBuffers(np.empty((180, 320), np.float32), np.empty((180, 320), np.int32))
    textures = Textures(
        world.texels,
        world.table,
        world.detail,
        world.detail_start,
        np.zeros(4, np.uint32),
        world.ground_texels_per_m,
        5,
        3,
    )
    buffers.draw_patches((world.static,), view, textures)
    seen = buffers.seen
    checked = 0
    for row, column in itertools.product(range(5, 180, 7), range(5, 320, 9)):
        ray = rotation.T @ ((column - cx) / fx, (row - cy) / fy, 1.0)
        depth = np.arange(1.0, 60.0, 0.01)
        points = position + depth[:, None] * ray
        below = points[:, 2] < land.height(*land.grid(points[:, 0], points[:, 1]))
        if not below.any():
            continue
        first = int(np.argmax(below))
        hit_u, hit_v = (float(value) for value in land.grid(points[first, 0], points[first, 1]))
        aside = min(abs(value - BLOCK_M * round(value / BLOCK_M)) for value in (hit_u, hit_v))
        slot = seen.owner[row, column]
        if aside > HALF_ROAD_M - 0.4 or slot < 0 or seen.mark[slot, MATERIAL] != GROUND or depth[first] > 40.0:
            continue
        checked += 1
        inverse = float(seen.depth[row, column])
        plane = seen.plane[slot]
        texel = [
            (plane[k] + plane[k + 1] * column + plane[k + 2] * row) / inverse / world.ground_texels_per_m
            for k in (U_CONSTANT, V_CONSTANT)
        ]
        grazing = 1.0 + depth[first] ** 2 / 40.0  # flat pieces lie a centimetre off the surface, far rays hardly dip
        assert 1.0 / inverse == pytest.approx(depth[first], abs=0.05 * grazing)
        assert np.hypot(texel[0] - hit_u, texel[1] - hit_v) < 0.12 * grazing
    assert checked > 100


def test_the_sun_shines_on_hills_too(world):
    """Houses' shadows end at the ground, wherever that is: most walls in the sun are lit."""
    assert even_cells(world.sunlight).mean() > 60.0
    centres = (np.arange(0, 2048, 32) + 0.5) * 0.5 - 512.0
    x, y = np.meshgrid(centres, centres)
    ground = world.land.height(*world.land.grid(x, y))
    high = world.shadow_height[::32, ::32] - ground
    assert high.min() > -1.0
    assert (np.abs(high) < 0.5).mean() > 0.5


@pytest.mark.parametrize("weather", ["day", "rain", "night"])
def test_a_hill_is_rendered_in_every_weather(world, weather):
    camera = nominal_calibration("CAM_FRONT", 160, 90)
    renderer = Renderer(world, weather)
    point = world.land.points(np.array([20.0, -1.75, 0.0]))
    pose = CameraPose(camera.rotation_ego_from_camera, point + camera.translation_m)
    image = renderer.render(camera, pose, pose, noise_seed=1).image
    assert image[60:].mean() > 15.0  # the road is lit, by lamps too


def test_the_camera_rises_with_the_car(hilly):
    drive, _ = max(hilly, key=lambda pair: np.ptp(pair[0].z_m))
    camera = nominal_calibration("CAM_FRONT", 160, 90)
    heights = [
        camera_pose(drive, camera.rotation_ego_from_camera, camera.translation_m, t).position_m[2] for t in (0.0, 19.0)
    ]
    climbed = float(drive.at("z_m", 19.0) - drive.at("z_m", 0.0))
    assert heights[1] - heights[0] == pytest.approx(climbed, abs=0.25)
