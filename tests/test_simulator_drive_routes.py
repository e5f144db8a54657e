"""Routes: smooth, inside the city, in the right lane, clear of houses, kerbs and parked cars."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.simulator.city.land import FLAT, Land, land_of
from mixo_env.simulator.city.streets import BLOCK_M, HALF_CITY_BLOCKS, HALF_ROAD_M, LANE_M, SIDEWALK_M
from mixo_env.simulator.drive.routes import LEFT, MAX_OFFSET_M, PASSING_M, RIGHT, STEP_M, STRAIGHT, Route, plan_route
from mixo_env.simulator.drive.traffic import CAR_WIDTH_M, REAR_AXLE_TO_FRONT_M, REAR_AXLE_TO_REAR_M

pytestmark = pytest.mark.rendering


def routes(count: int = 40, land: Land | None = None) -> list[Route]:
    """Routes on as many lands, or on one."""
    rng = np.random.default_rng(5)
    return [
        plan_route(
            rng,
            [int(move) for move in rng.choice([LEFT, STRAIGHT, RIGHT], 6)],
            8.0,
            land_of(number) if land is None else land,
            tight=bool(number % 2),
            passing=(number % 4) / 3.0,
        )
        for number in range(count)
    ]


def grid_course(route: Route) -> np.ndarray:
    """Direction on the street grid."""
    return np.unwrap(np.arctan2(np.gradient(route.v_m), np.gradient(route.u_m)))


def from_centre_line(position: np.ndarray) -> np.ndarray:
    return np.abs(position - BLOCK_M * np.round(position / BLOCK_M))


@pytest.mark.parametrize("moves", [[STRAIGHT] * 7, [LEFT] * 6, [RIGHT] * 6, [LEFT, RIGHT] * 3])
def test_turns_are_exactly_quarters(moves):
    route = plan_route(np.random.default_rng(1), moves, 9.0, FLAT)
    assert len(route.turns_m) == sum(move != STRAIGHT for move in moves)
    assert len(route.stops_m) == len(moves)
    straight = np.ones(len(route.s_m), dtype=bool)
    for first, last in route.turns_m:
        straight &= (route.s_m < first - 0.5) | (route.s_m > last + 0.5)
    quarters = route.course_rad[straight] / (0.5 * np.pi)
    assert np.abs(quarters - np.round(quarters)).max() < 0.12  # lane keeping: a few degrees
    before, after = (np.round(route.course_rad[k] / (0.5 * np.pi)) for k in (0, -1))
    assert after - before == sum(moves)


def test_position_course_and_curvature_belong_together():
    for route in routes(10):
        assert np.allclose(np.diff(route.s_m), STEP_M)
        dx, dy = np.diff(route.x_m), np.diff(route.y_m)
        assert np.allclose(np.sqrt(dx**2 + dy**2 + np.diff(route.z_m) ** 2), STEP_M, atol=1e-4)
        chord = np.unwrap(np.arctan2(dy, dx))
        middle = 0.5 * (route.course_rad[1:] + route.course_rad[:-1])
        assert np.abs(np.exp(1j * (chord - middle)) - 1.0).max() < 1e-3
        course_from_curvature = np.cumsum(0.5 * (route.curvature_pm[1:] + route.curvature_pm[:-1])) * STEP_M
        assert np.abs(course_from_curvature - (route.course_rad[1:] - route.course_rad[0])).max() < 2e-3


def test_curvature_is_bounded_and_never_jumps():
    for route in routes():
        assert np.abs(route.curvature_pm).max() < 0.22  # radius 4.5 m
        assert np.abs(np.diff(route.curvature_pm)).max() < 0.008  # full lock takes more than 2 m


def test_routes_stay_in_their_lane_inside_the_city():
    limit = (HALF_CITY_BLOCKS - 0.7) * BLOCK_M
    for route in routes():
        assert max(np.abs(route.u_m).max(), np.abs(route.v_m).max()) < limit + 1.0
        straight = np.ones(len(route.s_m), dtype=bool)
        for first, last in (*route.turns_m, *route.rounds_m):
            straight &= (route.s_m < first) | (route.s_m > last)
        x, y, course = route.u_m[straight], route.v_m[straight], grid_course(route)[straight]
        eastwest = np.abs(np.cos(course)) > 0.9
        aside = np.where(eastwest, y, x)
        to_left = np.where(eastwest, np.sign(np.cos(course)), -np.sign(np.sin(course)))
        offset = to_left * (aside - BLOCK_M * np.round(aside / BLOCK_M)) + LANE_M  # 0 in the middle of the right lane
        passed = np.zeros(len(offset), dtype=bool)
        for passed_m in route.passed_m:
            distance_m = np.abs(route.s_m[straight] - passed_m)
            assert offset[distance_m < 3.0] == pytest.approx(PASSING_M, abs=0.25)
            passed |= distance_m < 24.0
        assert np.abs(offset[~passed]).max() < MAX_OFFSET_M + 0.25


def test_the_car_clears_kerbs_houses_and_parked_cars():
    outline = [
        (ahead, side * 0.5 * CAR_WIDTH_M)
        for ahead in np.linspace(-REAR_AXLE_TO_REAR_M, REAR_AXLE_TO_FRONT_M, 7)
        for side in (-1, 1)
    ]
    for number, route in enumerate(routes()):
        cosine, sine = np.cos(route.course_rad), np.sin(route.course_rad)
        for ahead, aside in outline:
            x, y = route.x_m + ahead * cosine - aside * sine, route.y_m + ahead * sine + aside * cosine
            u, v = (from_centre_line(way) for way in land_of(number).grid(x, y))
            kerb = np.hypot(np.maximum(HALF_ROAD_M - u, 0.0), np.maximum(HALF_ROAD_M - v, 0.0))
            assert kerb.min() > 1.0
            assert np.hypot(np.maximum(SIDEWALK_M - u, 0.0), np.maximum(SIDEWALK_M - v, 0.0)).min() > 4.0
            for along, across in ((u, v), (v, u)):
                beside_parked = (along > SIDEWALK_M + 3.0) & (across < SIDEWALK_M)
                assert across[beside_parked].max(initial=0.0) < 4.5  # a parked van begins there


def test_vehicles_in_the_way_stand_between_the_turns():
    passing = [route for route in routes() if route.passed_m]
    assert max(len(route.passed_m) for route in passing) == 5  # every block but the first
    for route in passing:
        for passed_m in route.passed_m:
            assert all(passed_m + 20.0 < first or last < passed_m - 20.0 for first, last in route.turns_m)
            course = np.interp(passed_m, route.s_m, grid_course(route))
            assert np.sin(2.0 * course) == pytest.approx(0.0, abs=2e-3)  # the car passes straight along the street
            assert (
                max(from_centre_line(np.concatenate(route.on_grid(np.array([passed_m]))))) > 0.5 * BLOCK_M - 6.0
            )  # in the middle of a block


def test_routes_continue_straight_beyond_their_ends():
    route = routes(1)[0]
    x, y, course = route.at(np.array([-10.0, route.s_m[-1] + 10.0]))
    assert np.hypot(x[0] - route.x_m[0], y[0] - route.y_m[0]) == pytest.approx(10.0)
    assert np.hypot(x[1] - route.x_m[-1], y[1] - route.y_m[-1]) == pytest.approx(10.0)
    assert course.tolist() == [route.course_rad[0], route.course_rad[-1]]


def test_a_route_that_cannot_fit_is_refused():
    with pytest.raises(ValueError, match="does not fit"):
        plan_route(np.random.default_rng(0), [STRAIGHT] * 12, 8.0, FLAT)
