"""People: how their limbs move, where and how fast they go, and that nobody is run over."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.simulator.city.land import FLAT, land_of
from mixo_env.simulator.city.materials import KERB_M
from mixo_env.simulator.city.people import LOOKS, PHASES, PersonState
from mixo_env.simulator.city.people_models import leg_angles, people_models
from mixo_env.simulator.city.streets import BLOCK_M, HALF_ROAD_M, SIDEWALK_M
from mixo_env.simulator.city.textures import Atlas
from mixo_env.simulator.drive.drive import plan_drive
from mixo_env.simulator.drive.people import Person, clash, stage_people
from mixo_env.simulator.drive.targets import Motion, deal_motions
from mixo_env.simulator.drive.traffic import Vehicle, car_itself, scene_clock, stage_traffic

pytestmark = pytest.mark.rendering

SECONDS = 12.0


def motion_of(situation: str) -> Motion:
    """What a scene of that situation does."""
    return deal_motions(np.random.default_rng(0), [situation])[0]


@pytest.fixture(scope="module")
def staged() -> list[tuple[list[Vehicle], tuple[Person, ...]]]:
    """Vehicles (the car first) and people of some scenes."""
    out = []
    for seed, situation in enumerate(("ordinary", "standing_cross_traffic", "tight_turn", "ordinary", "side_queue")):
        drive = plan_drive(np.random.default_rng([seed, 0]), situation, SECONDS, 0.0, motion_of(situation), FLAT)
        vehicles = stage_traffic(np.random.default_rng([seed, 1]), drive, SECONDS, FLAT)
        people = stage_people(np.random.default_rng([seed, 2]), drive, FLAT, SECONDS, vehicles, "day")
        out.append(([car_itself(drive, scene_clock(SECONDS)), *vehicles], people))
    return out


def test_unknown_people_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="kind of person"):
        PersonState("ghost", 0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(ConfigurationError, match="look"):
        PersonState("walker", LOOKS, 0.0, 0.0, 0.0, 0.0)


def test_whoever_stands_has_the_standing_pose_and_a_cycle_has_all_others() -> None:
    assert PersonState("walker", 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.4).pose == PHASES
    poses = [PersonState("walker", 0, 0.0, 0.0, 0.0, 0.0, 1.3, k / PHASES + 0.01).pose for k in range(PHASES)]
    assert poses == list(range(PHASES))


def test_legs_follow_the_curves_of_level_walking() -> None:
    hip, knee = np.degrees(np.array([leg_angles(phase) for phase in np.arange(0.0, 1.0, 0.01)])).T
    assert hip.max() == pytest.approx(30.0, abs=1.0)
    assert hip.min() == pytest.approx(-10.0, abs=1.0)
    assert knee.max() == pytest.approx(60.0, abs=3.0)
    assert 0.68 < 0.01 * knee.argmax() < 0.78, "most bent in the middle of the swing"
    assert knee[:60].max() < 30.0, "nearly straight while it carries"
    np.testing.assert_allclose(leg_angles(0.0), leg_angles(1.0), atol=1e-6)


@pytest.fixture(scope="module")
def models() -> dict:
    return people_models(Atlas(), np.random.default_rng(0), 0, 16.0)


def test_bodies_stand_on_the_ground_in_every_pose_and_their_feet_swing(models: dict) -> None:
    for number in range(LOOKS):
        poses = models["walker", number]
        assert len(poses) == PHASES + 1
        ahead = []
        for mesh in poses:
            corners = np.concatenate(
                [mesh["origin"], mesh["origin"] + mesh["edge_u"], mesh["origin"] + mesh["edge_v"]]
            )[:, :]
            assert -0.05 < corners[:, 2].min() < 0.03
            assert 1.4 < corners[:, 2].max() < 2.0
            low = corners[(corners[:, 2] < 0.35) & (corners[:, 2] > 0.02) & (corners[:, 1] > 0.03)]
            ahead.append(low[:, 0].mean())
        assert np.ptp(ahead) > 0.4, "the left foot goes forward and back"


def test_every_patch_of_a_body_faces_outward(models: dict) -> None:
    mesh = models["walker", 0][3][:6]  # the first bar: a thigh
    centre = (mesh["origin"] + 0.5 * (mesh["edge_u"] + mesh["edge_v"])).mean(axis=0)
    normal = np.cross(mesh["edge_v"], mesh["edge_u"])
    outward = mesh["origin"] + 0.5 * (mesh["edge_u"] + mesh["edge_v"]) - centre
    assert (np.sum(normal * outward, axis=1) > 0.0).all()


def test_people_keep_to_pavements_and_step_down_to_cross(staged: list) -> None:
    crossed = 0
    for _, people in staged:
        for person in (p for p in people if p.kind == "walker"):
            from_street = [np.abs(m - np.round(m / BLOCK_M) * BLOCK_M) for m in (person.x_m, person.y_m)]
            on_road = np.minimum(*from_street) < HALF_ROAD_M
            assert (np.maximum(*from_street) > HALF_ROAD_M).all()
            assert (person.z_m[on_road] == 0.0).all()
            assert (person.z_m <= KERB_M).all()
            crossed += on_road.any()
            on_line = [m.min() > HALF_ROAD_M and m.max() < SIDEWALK_M for m in from_street]
            assert any(on_line), "on the pavement of one street all the time"
    assert crossed > 0


def test_speeds_are_those_of_people() -> None:
    drive = plan_drive(np.random.default_rng([1, 0]), "ordinary", 4.0, 0.0, motion_of("ordinary"), FLAT)
    walking, cycling, standing, walkers = [], [], 0, 0
    for seed in range(60):
        for person in stage_people(np.random.default_rng(seed), drive, FLAT, 4.0, (), "day"):
            speed = np.hypot(np.diff(person.x_m), np.diff(person.y_m)) / np.diff(person.time_s)
            if person.kind == "cyclist":
                cycling.append(speed.max())
                continue
            walkers += 1
            standing += speed.max() == 0.0
            if speed.max() > 0.0:
                walking.append(speed.max())
    assert np.mean(walking) == pytest.approx(1.3, abs=0.03)
    assert np.std(walking) == pytest.approx(0.2, abs=0.03)
    assert standing / walkers == pytest.approx(0.2, abs=0.04)
    assert 4.0 <= min(cycling) < 4.4
    assert 5.6 < max(cycling) <= 6.0


def test_nobody_is_run_over(staged: list) -> None:
    for movers, people in staged:
        assert not any(clash(person, vehicle) for person in people for vehicle in movers)
    movers, people = staged[0]
    person = people[0]
    there = Vehicle("sedan", 0, person.time_s, person.x_m, person.y_m, np.zeros_like(person.x_m))
    assert clash(person, there)


def test_stride_and_way_go_together() -> None:
    """A foot on the ground stays there: the cycle advances with the way, not with the clock."""
    drive = plan_drive(np.random.default_rng([7, 0]), "ordinary", SECONDS, 0.0, motion_of("ordinary"), FLAT)
    for person in stage_people(np.random.default_rng(3), drive, FLAT, SECONDS, (), "day"):
        way = np.abs(person.x_m - person.x_m[0]) + np.abs(person.y_m - person.y_m[0])
        turned = person.stride - person.stride[0]
        if way[-1] > 0.0:
            np.testing.assert_allclose(turned * way[-1], way * turned[-1], atol=1e-9)
        else:
            assert (turned == 0.0).all()


def test_equal_seeds_give_equal_people_and_rain_sends_them_home() -> None:
    drive = plan_drive(np.random.default_rng([1, 0]), "ordinary", SECONDS, 0.0, motion_of("ordinary"), FLAT)
    first, again = (stage_people(np.random.default_rng(5), drive, FLAT, SECONDS, (), "day") for _ in range(2))
    assert [person.state(3.0) for person in first] == [person.state(3.0) for person in again]
    count = {
        weather: sum(
            len(stage_people(np.random.default_rng(seed), drive, FLAT, SECONDS, (), weather)) for seed in range(12)
        )
        for weather in ("day", "rain", "night")
    }
    assert count["day"] > 1.5 * count["rain"] > 1.5 * count["night"] > 0


def test_people_follow_bent_streets() -> None:
    land = land_of(9)
    drive = plan_drive(np.random.default_rng([2, 0]), "ordinary", SECONDS, 0.0, motion_of("ordinary"), land)
    walked = 0
    for person in stage_people(np.random.default_rng(4), drive, land, SECONDS, (), "day"):
        grid = np.stack(land.grid(person.x_m, person.y_m))
        across = np.ptp(grid, axis=1).argmin()  # they go along the other one
        assert np.ptp(grid[across]) < 1e-4
        moved = np.hypot(np.diff(person.x_m), np.diff(person.y_m)) > 1e-3
        if moved.any():
            heading = np.arctan2(np.diff(person.y_m), np.diff(person.x_m))
            middle = 0.5 * (person.yaw_rad[1:] + person.yaw_rad[:-1])
            assert np.abs(np.exp(1j * heading[moved]) - np.exp(1j * middle[moved])).max() < 1e-3
            walked += 1
    assert walked > 5
