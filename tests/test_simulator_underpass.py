"""Underpasses: how dark it is inside, what is dark, and that the exposure lags behind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixo_env.simulator.city.blocks import FRONT_M, SidePlan
from mixo_env.simulator.city.streets import BLOCK_M, SIDEWALK_M
from mixo_env.simulator.city.underpass import CLEARANCE_M, light_at, sky_share, underpass_at
from mixo_env.simulator.city.vehicles import VehicleState
from mixo_env.simulator.city.world import CityPlan, World, build_world
from mixo_env.simulator.picture.fleet import Fleet, moving_states
from mixo_env.simulator.picture.render import Renderer
from mixo_env.simulator.picture.weather import weather_named
from tests.tiny_world import camera, pose

pytestmark = pytest.mark.rendering


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(3, CityPlan(half_blocks=1, variety=4, ground_side=512, underpasses=1.0))


def test_light_inside_is_the_view_factor_of_both_ends() -> None:
    # 4.6 m inside a portal of 4.6 m: (1 - cos 45 deg) / 2 = .1464; the other end, 23 m away, adds .0097, walls .03.
    assert sky_share(np.array([CLEARANCE_M]), 6.0 * CLEARANCE_M)[0] == pytest.approx(0.1464 + 0.0097 + 0.03, abs=2e-4)
    inside = sky_share(np.linspace(0.0, 20.0, 21), 20.0)
    np.testing.assert_allclose(inside, inside[::-1])
    assert (np.diff(inside[:11]) < 0.0).all()
    assert sky_share(np.array([-1.0, 21.0]), 20.0).tolist() == [1.0, 1.0]


def test_places_do_not_depend_on_the_size_of_the_city_and_have_their_share() -> None:
    places = [
        underpass_at(5, axis, street, block, 0.06) for axis in (0, 1) for street in range(40) for block in range(40)
    ]
    assert sum(place is not None for place in places) / len(places) == pytest.approx(0.06, abs=0.015)
    found = underpass_at(5, 1, 2, -3, 1.0)
    assert found is not None
    assert (found.x_m, found.y_m) == pytest.approx((2 * BLOCK_M, -2.5 * BLOCK_M))


def test_vehicles_below_the_bridge_are_as_dark_as_the_road(world: World) -> None:
    axis, x, y, length = world.underpasses[0]
    assert light_at(world.underpasses, x, y) == pytest.approx(sky_share(np.array([0.5 * length]), length)[0])
    outside = (x + length, y) if axis == 0 else (x, y + length)
    assert light_at(world.underpasses, *outside) == 1.0
    states = [VehicleState("van", 0, *place, 0.0) for place in ((x, y), outside)]
    fleet = Fleet(world, shadows=False)
    looks = []
    for state in states:
        placed = fleet.placed(fleet.models([state]), moving_states([state], (), world.underpasses))
        looks.append(placed.look[0, :3])
    np.testing.assert_allclose(looks[0], looks[1] * light_at(world.underpasses, x, y), rtol=1e-5)


def test_nothing_stands_in_the_way_of_the_bridge() -> None:
    plan = SidePlan(underpass_m=20.0)
    assert plan.blocked(0.5 * FRONT_M + 10.5, 1.0)
    assert not plan.blocked(0.5 * FRONT_M + 11.5, 1.0)
    assert not SidePlan().blocked(0.5 * FRONT_M, 5.0)


def test_nothing_comes_out_of_the_walls_of_the_bridge(world: World) -> None:
    g = world.static.geometry
    centre = g[:, :3] + 0.5 * g[:, 3:6] + 0.5 * g[:, 6:]
    for axis, x, y, length in world.underpasses.tolist():
        along, across = (centre[:, :2] - (x, y)).T if axis == 0.0 else (centre[:, 1::-1] - (y, x)).T
        inside = (np.abs(along) < 0.5 * length - 1.0) & (np.abs(across) < SIDEWALK_M - 0.4)
        inside &= (centre[:, 2] > 0.5) & (centre[:, 2] < CLEARANCE_M - 0.1)
        assert not inside.any()


def test_pictures_are_too_dark_going_in_and_too_bright_coming_out(world: World) -> None:
    bridge = next(b for b in world.underpasses if b[0] == 0.0 and b[2] == 0.0)
    free = replace(weather_named("day"), largest_gain=30.0)  # so that only the lag limits the exposure
    renderer, calibration = Renderer(world, free), camera("CAM_FRONT_LEFT", 0.2)
    start, end = bridge[1] - 0.5 * bridge[3] - 12.0, bridge[1] + 0.5 * bridge[3] + 12.0
    used, wanted, gain = [], [], None
    for x in np.arange(start, end, 0.65):  # 8 m/s at 12 images a second
        at = pose(calibration, float(x), -1.75, 0.0)
        wanted.append(renderer.render(calibration, at, at, next_s=1e9).gain)  # where the control would settle
        gain = wanted[-1] if gain is None else gain
        used.append(gain)
        gain = renderer.render(calibration, at, at, gain=gain).gain
    ratio = np.array(used) / np.array(wanted)
    darkest = int(np.argmax(wanted))
    assert max(wanted) > 1.5 * wanted[0]
    assert ratio[: darkest + 1].min() < 0.85, "too dark going in"
    assert ratio[darkest:].max() > 1.15, "too bright coming out"
