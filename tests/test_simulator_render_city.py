"""The city: reproducible, with free streets, and the same place in every weather."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.geometry import rotation_from_yaw
from mixo_env.simulator.city.mesh import GROUND, SHADE, PatchSet, placed
from mixo_env.simulator.city.streets import BLOCK_M, HALF_ROAD_M, LANE_M
from mixo_env.simulator.city.vehicles import COLOURS, VEHICLE_KINDS, VehicleState
from mixo_env.simulator.city.world import CityPlan, World, build_world
from mixo_env.simulator.picture.fleet import Fleet, body_motions, moving_states
from mixo_env.simulator.picture.render import Renderer
from mixo_env.simulator.picture.weather import WEATHERS
from tests.tiny_world import camera, pose

pytestmark = pytest.mark.rendering


def small_world(seed: int, **plan: Any) -> World:
    return build_world(seed, CityPlan(half_blocks=1, variety=2, ground_side=512, **plan))


@pytest.fixture(scope="module")
def city() -> World:
    return small_world(7)


@pytest.fixture(scope="module")
def empty() -> World:
    """The same city without parked cars."""
    return small_world(7, parked=0.0)


def view(world: World, weather: str, channel: str = "CAM_FRONT", **options) -> NDArray[np.uint8]:
    calibration = camera(channel, 0.25)
    at = pose(calibration, 20.0, -LANE_M, 0.0)
    return Renderer(world, weather).render(calibration, at, at, **options).image


TRAFFIC = (
    VehicleState("truck", 6, 42.0, -LANE_M, 0.0, 8.0),
    VehicleState("sedan", 3, 36.0, LANE_M, np.pi, 8.0),
    VehicleState("van", 4, 30.0, -LANE_M, 0.1, 9.0, 0.2),
)


def on_the_street(fleet: Fleet, vehicles: Sequence[VehicleState]) -> PatchSet:
    return fleet.placed(fleet.models(vehicles), moving_states(vehicles))


def arrays(world: World) -> dict[str, NDArray]:
    fields = {name: value for name, value in vars(world).items() if isinstance(value, np.ndarray)}
    return fields | {f"static.{name}": value for name, value in world.static._asdict().items()}


def test_same_seed_same_bits_other_seed_other_city(city: World) -> None:
    again, other = small_world(7), small_world(8)
    for name, value in arrays(city).items():
        assert np.array_equal(value, arrays(again)[name]), name
    assert not np.array_equal(city.sun, other.sun)
    assert not np.array_equal(city.static.geometry[:500], other.static.geometry)
    for weather in WEATHERS:
        first = view(city, weather, vehicles=TRAFFIC, noise_seed=3)
        assert np.array_equal(first, view(again, weather, vehicles=TRAFFIC, noise_seed=3))
        assert not np.array_equal(first, view(again, weather, vehicles=TRAFFIC, noise_seed=4))


def test_a_renderer_keeps_nothing_between_pictures(city: World) -> None:
    renderer, calibration = Renderer(city, "rain"), camera("CAM_FRONT", 0.25)
    at, elsewhere = pose(calibration, 20.0, -LANE_M, 0.0), pose(calibration, -30.0, LANE_M, 3.0)
    first = renderer.render(calibration, at, at, TRAFFIC, gain=1.0).image
    renderer.render(calibration, elsewhere, at, (), gain=2.0)
    assert np.array_equal(renderer.render(calibration, at, at, TRAFFIC, gain=1.0).image, first)


def test_world_survives_pickling(city: World) -> None:
    copy = pickle.loads(pickle.dumps(city))
    assert np.array_equal(view(copy, "day"), view(city, "day"))


def test_weathers_differ_as_they_should(city: World) -> None:
    day, rain, night = (view(city, name, vehicles=TRAFFIC).astype(float) for name in ("day", "rain", "night"))
    assert night.mean() < 0.7 * day.mean()
    for image in (day, rain, night):
        assert image.std() > 15.0
    # Haze flattens the distance: the band around the horizon has less contrast in rain.
    band = np.s_[90:110, 150:250]
    assert rain[band].std() < day[band].std()


def test_every_camera_sees_a_street_with_something_to_track(city: World) -> None:
    for channel in ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK_RIGHT", "CAM_BACK"):
        gray = cv2.cvtColor(view(city, "day", channel), cv2.COLOR_RGB2GRAY)
        assert len(cv2.FastFeatureDetector.create(12).detect(gray)) > 300


def corner_points(world: World) -> NDArray[np.float64]:
    g = world.static.geometry
    solid = ~np.isin(world.static.tag[:, 1], (GROUND, SHADE))
    origin, u, v = g[solid, :3], g[solid, 3:6], g[solid, 6:]
    return np.concatenate([origin, origin + u, origin + v, origin + u + v])


def test_lanes_are_free(city: World) -> None:
    points = corner_points(city)
    inside = (np.abs(points[:, :2]) < 1.05 * BLOCK_M).all(axis=1)
    low = points[inside & (points[:, 2] < 4.0)]
    offset = np.abs((low[:, :2] + 0.5 * BLOCK_M) % BLOCK_M - 0.5 * BLOCK_M).min(axis=1)
    widest = 0.5 * max(kind.width_m for kind in VEHICLE_KINDS.values())
    assert offset.min() > LANE_M + widest + 0.4


def test_parking_strips_are_empty_when_nobody_parks(city: World, empty: World) -> None:
    def on_the_road(world: World) -> int:
        points = corner_points(world)
        low = points[(points[:, 2] < 1.0) & (points[:, 2] > 0.2)]  # crowns may reach over the road
        offset = np.abs((low[:, :2] + 0.5 * BLOCK_M) % BLOCK_M - 0.5 * BLOCK_M).min(axis=1)
        return int((offset < HALF_ROAD_M - 0.3).sum())

    assert on_the_road(empty) == 0
    assert on_the_road(city) > 500


def test_blank_side_leaves_little_to_track(empty: World) -> None:
    blank = small_world(7, parked=0.0, blank_sides=[(0, 0, "south")])
    counts = []
    for world in (blank, empty):
        calibration = camera("CAM_FRONT_LEFT", 0.25)
        at = pose(calibration, 35.0, -LANE_M, 0.5)  # looks at the north side of the street y = 0
        gray = cv2.cvtColor(Renderer(world, "day").render(calibration, at, at).image, cv2.COLOR_RGB2GRAY)
        counts.append(len(cv2.FastFeatureDetector.create(12).detect(gray[: gray.shape[0] // 2])))
    assert counts[0] < 0.4 * counts[1]


@pytest.mark.parametrize("kind", VEHICLE_KINDS)
def test_vehicle_models_have_the_stated_size(city: World, kind: str) -> None:
    size = VEHICLE_KINDS[kind]
    for colour in range(COLOURS):
        model = city.vehicles[kind, colour]
        body = model[(model["material"] != SHADE) & (model["shape"] == 0)]
        points = np.concatenate([body["origin"], body["origin"] + body["edge_u"] + body["edge_v"]])
        low, high = points.min(axis=0), points.max(axis=0)
        assert high[0] - low[0] == pytest.approx(size.length_m, abs=0.02)
        assert high[1] - low[1] == pytest.approx(size.width_m + 0.4, abs=0.02)  # with mirrors
        assert high[2] == pytest.approx(size.height_m, abs=0.02)


def test_fleet_puts_models_where_their_states_say(city: World) -> None:
    patches = on_the_street(Fleet(city, shadows=False), TRAFFIC)
    for number, state in enumerate(TRAFFIC):
        part = slice(patches.group_start[number], patches.group_start[number + 1])
        mesh = placed(city.vehicles[state.kind, state.colour], state.x_m, state.y_m, state.yaw_rad)
        wanted = np.column_stack([mesh["origin"], mesh["edge_u"], mesh["edge_v"]])
        assert np.allclose(patches.geometry[part], wanted, atol=1e-9)
        assert set(patches.tag[part, 3]) == {0, number + 1}
        reach = np.linalg.norm(mesh["origin"] - patches.groups[number, :3], axis=1).max()
        assert reach <= patches.groups[number, 3] + 1e-9
        ground = mesh["material"] == SHADE
        assert np.allclose(patches.texel[part][ground, 2], city.ground_texels_per_m * mesh["origin"][ground, 0])


def test_sun_shadow_of_a_vehicle_is_its_box_projected(city: World) -> None:
    state = dataclasses.replace(TRAFFIC[0], yaw_rad=0.7)
    with_shadow = on_the_street(Fleet(city, shadows=True), [state])
    sweep = with_shadow.geometry[-3:]
    size = VEHICLE_KINDS[state.kind]
    corners = np.array([(x, y) for x in (-0.48, 0.48) for y in (-0.48, 0.48)]) * (size.length_m, size.width_m)
    corners = corners @ rotation_from_yaw(state.yaw_rad)[:2, :2].T + (state.x_m, state.y_m)
    shift = -0.85 * size.height_m * city.sun[:2] / city.sun[2]
    hull = cv2.convexHull(np.concatenate([corners, corners + shift]).astype(np.float32))
    rng = np.random.default_rng(0)
    for patch in sweep:  # all of it lies in the projected box ...
        points = patch[:2] + rng.random((50, 1)) * patch[3:5] + rng.random((50, 1)) * patch[6:8]
        assert all(cv2.pointPolygonTest(hull, (float(x), float(y)), True) > -1e-3 for x, y in points)
    # ... and with the plan itself the parallelograms cover it: the area of a rectangle swept along a line.
    plan, first, second = (abs(p[3] * p[7] - p[4] * p[6]) for p in sweep)
    assert plan + first + second == pytest.approx(cv2.contourArea(hull), rel=1e-4)


def test_body_motion_is_the_motion_of_the_state() -> None:
    state = VehicleState("suv", 1, 10.0, -4.0, 0.6, 12.0, 0.5)
    rotations, shifts = body_motions(moving_states([state]), 0.01)
    moved = rotations[1] @ (10.0, -4.0, 0.0) + shifts[1]
    assert moved[:2] == pytest.approx([10.0 + 0.12 * np.cos(0.6), -4.0 + 0.12 * np.sin(0.6)])
    assert rotations[1] == pytest.approx(rotation_from_yaw(0.005))
    assert rotations[0] == pytest.approx(np.eye(3))  # the world stands
    assert not shifts[0].any()


def test_moving_vehicle_is_smeared_and_the_street_is_not(city: World) -> None:
    weather = dataclasses.replace(WEATHERS["day"], shutter_s=0.03, shot_noise=0.0, read_noise=0.0)
    calibration = camera("CAM_FRONT", 0.25)
    at = pose(calibration, 20.0, -LANE_M, 0.0)
    standing = VehicleState("van", 4, 30.0, 0.0, 0.5 * np.pi, 0.0)
    crossing = dataclasses.replace(standing, speed_mps=14.0)
    renderer = Renderer(city, weather)
    still = renderer.render(calibration, at, at, [standing], gain=1.0).image.astype(int)
    moving = renderer.render(calibration, at, at, [crossing], gain=1.0).image.astype(int)
    changed = np.abs(still - moving).max(axis=-1) > 12
    columns = np.flatnonzero(changed.any(axis=0))
    focal, distance = calibration.intrinsic[0, 0], 30.0 - 1.0 - 20.0 - 1.7
    half = 0.5 * VEHICLE_KINDS["van"].length_m + 0.5 * 14.0 * 0.03
    assert changed.sum() > 100
    assert np.ptp(columns) <= 2.0 * half / distance * focal + 10
    # Sideways motion blurs upright edges: less contrast along the rows.
    box = np.s_[80:125, columns[0] : columns[-1]]
    assert np.abs(np.diff(moving[box], axis=1)).mean() < np.abs(np.diff(still[box], axis=1)).mean()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: CityPlan(parked=1.5), "parked is a share"),
        (lambda: CityPlan(half_blocks=9), "half_blocks"),
        (lambda: CityPlan(blank_sides=[(0, 0, "left")]), "south"),
        (lambda: VehicleState("bus", 0, 0.0, 0.0, 0.0), "unknown vehicle kind 'bus'"),
        (lambda: VehicleState("suv", COLOURS, 0.0, 0.0, 0.0), "colour"),
        (lambda: Renderer(None, "snow"), "unknown weather 'snow'"),  # pyright: ignore[reportArgumentType]
    ],
)
def test_impossible_wishes_are_refused_in_one_line(call, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)
