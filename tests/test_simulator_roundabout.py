"""Roundabouts: nobody drives over the island, everybody goes around it on its right, and headings stay as they were."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from mixo_env.simulator.city.island import HEDGE_M, HEDGE_TOP_M, island
from mixo_env.simulator.city.land import FLAT, Land, land_of
from mixo_env.simulator.city.materials import KERB_M, city_materials
from mixo_env.simulator.city.mesh import normals
from mixo_env.simulator.city.roundabout import CALM_MPS, ISLAND_M, PASSING_M, REACH_M, SHARE, roundabouts_of, swerve
from mixo_env.simulator.city.streets import BLOCK_M, HALF_CITY_BLOCKS, LANE_M
from mixo_env.simulator.city.textures import Atlas
from mixo_env.simulator.config import SituationShares
from mixo_env.simulator.drive.drive import DRIVE_RATE_HZ, plan_drive
from mixo_env.simulator.drive.people import stage_people
from mixo_env.simulator.drive.routes import LEFT, RIGHT, STRAIGHT, Route, plan_route
from mixo_env.simulator.drive.targets import deal_motions
from mixo_env.simulator.drive.traffic import car_itself, scene_clock, stage_traffic

pytestmark = pytest.mark.rendering

EVERYWHERE = frozenset(
    (i, j)
    for i in range(-HALF_CITY_BLOCKS, HALF_CITY_BLOCKS + 1)
    for j in range(-HALF_CITY_BLOCKS, HALF_CITY_BLOCKS + 1)
)


def full_of_them(land: Land) -> Land:
    return replace(land, roundabouts=EVERYWHERE)


def middles(land: Land) -> np.ndarray:
    """``(n,)`` complex places of the islands on the map."""
    u, v = BLOCK_M * np.array(sorted(land.roundabouts), dtype=float).T
    x, y = land.map(u, v)
    return x + 1j * y


def room(x: np.ndarray, y: np.ndarray, yaw: np.ndarray, size_m: tuple[float, float], land: Land) -> float:
    """Least distance between a rectangle on its way and any island's edge."""
    away = (middles(land)[:, None] - (x + 1j * y)) * np.exp(-1j * yaw)
    ahead = np.maximum(np.abs(away.real) - 0.5 * size_m[0], 0.0)
    aside = np.maximum(np.abs(away.imag) - 0.5 * size_m[1], 0.0)
    return float(np.hypot(ahead, aside).min()) - ISLAND_M


def alone(move: int, land: Land = FLAT) -> tuple[Route, Route]:
    """The same way through one crossing with an island and without."""
    return tuple(plan_route(np.random.default_rng(2), [move], 8.0, place) for place in (full_of_them(land), land))  # type: ignore[return-value]


def signs(course: np.ndarray) -> list[int]:
    """Which way it turns, in order, where it turns by more than 2 degrees."""
    turns = np.sign(np.diff(course))
    parts = np.split(np.diff(course), np.flatnonzero(np.diff(turns)) + 1)
    return [int(np.sign(part.sum())) for part in parts if abs(part.sum()) > np.radians(2.0)]


def test_straight_on_is_right_left_right_and_keeps_the_heading():
    route, without = alone(STRAIGHT)
    ((first_m, last_m),) = route.rounds_m
    assert route.turns_m == ()
    inside = (first_m < route.s_m) & (route.s_m < last_m)
    assert signs(route.course_rad[inside]) == [RIGHT, LEFT, RIGHT]
    assert np.degrees(np.ptp(route.course_rad[inside])) > 25.0
    before, after = np.interp([first_m, last_m], route.s_m, route.course_rad)
    assert np.degrees(after - before) == pytest.approx(0.0, abs=2.0)  # the place in the lane goes on changing
    assert route.course_rad[-1] - route.course_rad[0] == pytest.approx(
        without.course_rad[-1] - without.course_rad[0], abs=np.radians(2.0)
    )
    assert np.hypot(route.x_m[-1] - without.x_m[-1], route.y_m[-1] - without.y_m[-1]) < 1.0


def test_left_is_three_quarters_around_and_still_a_quarter_turn():
    route, without = alone(LEFT)
    ((first_m, last_m),) = route.turns_m
    inside = (first_m - 0.1 < route.s_m) & (route.s_m < last_m + 0.1)
    assert signs(route.course_rad[inside]) == [RIGHT, LEFT, RIGHT]
    before, after = np.interp([first_m, last_m], route.s_m, route.course_rad)
    assert np.degrees(after - before) == pytest.approx(90.0, abs=0.5)
    from_middle = route.u_m + 1j * route.v_m
    nearest = BLOCK_M * (np.round(from_middle.real / BLOCK_M) + 1j * np.round(from_middle.imag / BLOCK_M))
    around = np.unwrap(np.angle((from_middle - nearest)[inside]))
    assert np.degrees(around[-1] - around[0]) > 240.0  # anticlockwise: 270 less what the lanes lie aside
    assert np.hypot(route.x_m[-1] - without.x_m[-1], route.y_m[-1] - without.y_m[-1]) < 1.0


def test_a_right_turn_is_the_ordinary_one():
    route, without = alone(RIGHT)
    assert np.array_equal(route.x_m, without.x_m)


def test_a_way_without_roundabouts_is_as_in_a_city_without():
    moves = [STRAIGHT, LEFT, STRAIGHT, RIGHT]
    for seed in range(20):
        land = land_of(seed)
        route, without = (
            plan_route(np.random.default_rng(seed), moves, 8.0, place, passing=0.3)
            for place in (land, replace(land, roundabouts=frozenset()))
        )
        if np.array_equal(route.s_m, without.s_m):
            assert np.array_equal(route.x_m, without.x_m)
            assert route.passed_m == without.passed_m
        else:
            assert room(without.x_m, without.y_m, without.course_rad, (0.1, 0.1), land) < 3.0


def ways(count: int) -> Iterator[tuple[Route, Land]]:
    rng = np.random.default_rng(7)
    for number in range(count):
        land = full_of_them(land_of(number))
        moves = [int(move) for move in rng.choice([LEFT, STRAIGHT, RIGHT], 6)]
        yield plan_route(rng, moves, 8.0, land, tight=bool(number % 2), passing=(number % 4) / 3.0), land


def test_routes_around_islands_are_possible_for_a_car():
    for route, _ in ways(30):
        assert np.abs(route.curvature_pm).max() < 0.24  # radius 4.2 m
        assert np.abs(np.diff(route.curvature_pm)).max() < 0.01


def test_the_car_never_drives_over_an_island():
    size_m = car_itself(a_drive("ordinary", 0)[0], scene_clock(20.0)).size_m
    for route, land in ways(30):
        ahead_m = 1.4
        x = route.x_m + ahead_m * np.cos(route.course_rad)
        y = route.y_m + ahead_m * np.sin(route.course_rad)
        assert room(x, y, route.course_rad, size_m, land) > 0.6


def a_drive(situation: str, seed: int):
    rng = np.random.default_rng([seed, *situation.encode()])
    land = full_of_them(land_of(seed))
    return plan_drive(rng, situation, 20.0, -0.008, deal_motions(rng, [situation])[0], land), rng, land


@pytest.mark.parametrize("situation", ["ordinary", *SituationShares().by_name()])
def test_nobody_drives_over_an_island(situation):
    met = 0
    for seed in range(3):
        drive, rng, land = a_drive(situation, seed)
        vehicles = stage_traffic(rng, drive, 20.0, land)
        for vehicle in (car_itself(drive, scene_clock(20.0)), *vehicles):
            away_m = room(vehicle.x_m, vehicle.y_m, vehicle.yaw_rad, vehicle.size_m, land)
            assert away_m > 0.1, vehicle.kind
            met += away_m < 4.0
        for person in stage_people(rng, drive, land, 20.0, vehicles, "day"):
            assert room(person.x_m, person.y_m, person.yaw_rad, (0.6, 0.6), land) > 0.6
    assert met > 3


def test_other_vehicles_point_where_they_go_and_take_it_slowly():
    for seed in range(3):
        drive, rng, land = a_drive("oncoming_platoon", seed)
        own = drive.route
        for vehicle in stage_traffic(rng, drive, 20.0, land):
            moved = np.gradient(vehicle.x_m + 1j * vehicle.y_m, vehicle.time_s)
            local = moved * np.exp(-1j * vehicle.yaw_rad)
            assert np.abs(local.imag).max() < 0.8
            follows = np.hypot(own.x_m - vehicle.x_m[0], own.y_m - vehicle.y_m[0]).min() < 1.0
            if not follows:
                assert local.real.max() < 1.25 * CALM_MPS  # its swing, and the longer way
                assert np.abs(np.gradient(vehicle.yaw_rad, vehicle.time_s) * local.real).max() < 2.5


def test_lateral_acceleration_is_that_of_other_curves():
    for seed in range(4):
        drive, _, _ = a_drive("ordinary", seed)
        assert np.abs(drive.yaw_rate_radps * drive.speed_mps).max() < 3.0
        assert np.abs(np.diff(drive.yaw_rate_radps)).max() * DRIVE_RATE_HZ < 1.5


def test_the_swerve_and_its_slope_belong_together():
    way = np.linspace(-20.0, 20.0, 4001)
    aside_m, slope = swerve(way)
    assert aside_m.max() == pytest.approx(PASSING_M - LANE_M)
    assert aside_m[np.abs(way) >= REACH_M].max() == 0.0
    assert np.gradient(aside_m, way) == pytest.approx(slope, abs=1e-3)


def test_cities_have_their_share_and_the_same_ones_again():
    assert roundabouts_of(4) == roundabouts_of(4)
    assert land_of(4).roundabouts == roundabouts_of(4) != roundabouts_of(5)
    count = np.mean([len(roundabouts_of(seed)) for seed in range(300)])
    assert count / len(EVERYWHERE) == pytest.approx(SHARE, rel=0.1)
    assert set().union(*(roundabouts_of(seed) for seed in range(300))) == EVERYWHERE


def test_the_island_is_closed_and_round():
    rng = np.random.default_rng(0)
    mesh = island(city_materials(Atlas(), rng, 0, 1.0, 1, 1.0))
    area = np.linalg.norm(np.cross(mesh["edge_u"], mesh["edge_v"]), axis=1)
    normal, height = normals(mesh), mesh["origin"][:, 2]
    polygon = 8.0 * np.sin(np.pi / 8.0)  # area of a regular 16-gon of radius 1
    for top_m, radius_m in ((KERB_M, ISLAND_M), (HEDGE_TOP_M, HEDGE_M)):
        level = (normal[:, 2] > 0.99) & (height == top_m)
        assert area[level].sum() == pytest.approx(polygon * radius_m**2)
        for s, t in ((0, 0), (1, 0), (0, 1), (1, 1), (0.5, 0.5)):
            corner = (mesh["origin"] + s * mesh["edge_u"] + t * mesh["edge_v"])[level, :2]
            assert np.hypot(*corner.T).max() < radius_m + 1e-9
    upright = np.abs(normal[:, 2]) < 1e-9
    middle = mesh["origin"] + 0.5 * (mesh["edge_u"] + mesh["edge_v"])
    assert (np.sum(normal * middle, axis=1)[upright] > 0.0).all()  # seen from outside
    assert normal[~upright, 2] == pytest.approx(1.0)
