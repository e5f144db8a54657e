"""Drives: possible for a car, consistent with themselves, and as varied as real ones."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.simulator.city.land import land_of
from mixo_env.simulator.config import SituationShares
from mixo_env.simulator.drive.drive import DRIVE_RATE_HZ, MARGIN_S, Drive, plan_drive
from mixo_env.simulator.drive.localisation import localise
from mixo_env.simulator.drive.targets import Motion, deal_motions

pytestmark = pytest.mark.rendering

COURSE_OFFSET_RAD = np.radians(-0.5)
SITUATIONS = ("ordinary", *SituationShares().by_name())


def drives(situation: str, count: int, seconds: float = 20.0) -> list[Drive]:
    rng = np.random.default_rng([ord(letter) for letter in situation])
    return [
        plan_drive(rng, situation, seconds, COURSE_OFFSET_RAD, motion, land_of(number))
        for number, motion in enumerate(deal_motions(rng, [situation] * count))
    ]


def within_scene(drive: Drive, seconds: float = 20.0) -> slice:
    first, last = np.searchsorted(drive.time_s, (0.0, seconds))
    return slice(int(first), int(last) + 1)


@pytest.mark.parametrize("situation", SITUATIONS)
def test_limits_of_car_and_comfort(situation):
    for drive in drives(situation, 3):
        assert drive.time_s[0] == pytest.approx(-MARGIN_S)
        assert drive.time_s[-1] == pytest.approx(20.0 + MARGIN_S)
        assert drive.speed_mps.min() >= 0.0
        assert drive.speed_mps.max() < 19.6  # as the fastest real car
        assert np.abs(drive.acceleration_mps2).max() < 2.5
        assert np.abs(np.gradient(drive.acceleration_mps2, 1.0 / DRIVE_RATE_HZ)).max() < 5.0
        assert np.abs(drive.yaw_rate_radps).max() < np.radians(45.0)
        assert np.abs(drive.yaw_rate_radps * drive.speed_mps).max() < 3.0
        assert np.abs(np.diff(drive.yaw_rate_radps)).max() * DRIVE_RATE_HZ < 1.5
        slope = np.arctan(0.06)  # of the road, on top of what the springs do
        assert np.abs(drive.pitch_rad).max() < np.radians(2.0) + slope
        assert np.abs(drive.roll_rad).max() < np.radians(2.5) + slope
        assert np.abs(drive.heave_m).max() < 0.08


@pytest.mark.parametrize("situation", ["ordinary", "tight_turn", "fast_straight"])
def test_integrating_speed_and_yaw_rate_gives_the_pose(situation):
    """The rear axle moves along heading + course offset (+ a little slip), nowhere else."""
    for drive in drives(situation, 3):
        step_s = 1.0 / DRIVE_RATE_HZ
        yaw = drive.yaw_rad[0] + np.concatenate(
            [[0.0], np.cumsum(0.5 * (drive.yaw_rate_radps[1:] + drive.yaw_rate_radps[:-1]) * step_s)]
        )
        assert np.abs(yaw - drive.yaw_rad).max() < 1e-3
        course = yaw + COURSE_OFFSET_RAD
        velocity = drive.speed_mps * np.exp(1j * course)
        moved = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * step_s)
        true = (drive.x_m + 1j * drive.y_m)[1:] - (drive.x_m[0] + 1j * drive.y_m[0])
        distance = drive.s_m[-1] - drive.s_m[0]
        assert np.abs(moved - true).max() < 0.01 * distance + 0.05  # slip, at most 0.4 degrees, is what remains
        assert np.abs(np.diff(drive.s_m) / step_s - 0.5 * (drive.speed_mps[1:] + drive.speed_mps[:-1])).max() < 1e-2


def test_a_standing_car_stands():
    for drive in drives("standing", 3) + drives("standing_cross_traffic", 3):
        inside = within_scene(drive)
        assert drive.s_m[inside][-1] - drive.s_m[inside][0] < 5.0
        still = drive.speed_mps == 0.0
        assert still[inside].mean() > 0.3
        at_rest = np.flatnonzero(still)[3 * DRIVE_RATE_HZ :]
        assert np.abs(drive.yaw_rate_radps[at_rest]).max() < 1e-9
        assert np.ptp(drive.heave_m[at_rest]) == 0.0


def test_staged_drives_show_what_they_promise():
    for drive in drives("fast_straight", 3):
        inside = within_scene(drive)
        assert drive.speed_mps[inside].mean() > 9.5
        assert np.ptp(drive.yaw_rad[inside]) < np.radians(25.0)  # no turn, but bends
    for situation in ("tight_turn", "lead_truck"):
        for drive in drives(situation, 3):
            assert np.ptp(drive.yaw_rad[within_scene(drive)]) > np.radians(75.0)
    for situation in ("ordinary", "tight_turn"):
        for drive in drives(situation, 3, seconds=4.0):  # short scenes are possible, too
            inside = within_scene(drive, 4.0)
            assert drive.s_m[inside][-1] - drive.s_m[inside][0] >= 1.0


def test_same_seed_same_drive():
    motion, land = Motion(5.0, 0.2), land_of(1)
    one, two = (plan_drive(np.random.default_rng(3), "ordinary", 10, 0.0, motion, land) for _ in range(2))
    assert np.array_equal(one.x_m, two.x_m)
    assert np.array_equal(one.roll_rad, two.roll_rad)


def test_half_of_the_ordinary_scenes_begin_or_end_in_a_turn():
    """As a cut of a longer drive does: the heading changes by a part of a quarter turn."""
    turned = [
        np.degrees(np.abs(np.diff(drive.yaw_rad[within_scene(drive)][[0, -1]])[0])) for drive in drives("ordinary", 30)
    ]
    parts = [4.0 < angle < 70.0 for angle in turned]
    assert 0.35 < np.mean(parts) < 0.8


def test_written_poses_stay_near_the_truth_and_stand_still_with_the_car():
    for situation in ("ordinary", "standing"):
        for drive in drives(situation, 3):
            localisation = localise(np.random.default_rng(2), drive, 0.03)
            time_s = np.arange(0.0, 20.0, 0.02)
            x, y, yaw = localisation.pose(time_s)
            late = np.hypot(x - drive.at("x_m", time_s - 0.03), y - drive.at("y_m", time_s - 0.03))
            assert late.max() < 0.3
            assert np.degrees(np.abs(yaw - drive.at("yaw_rad", time_s - 0.03))).max() < 0.35
            assert np.degrees(np.abs(np.diff(yaw) - np.diff(drive.at("yaw_rad", time_s - 0.03)))).max() < 0.1
            rest = np.interp(time_s - 0.1, drive.time_s, drive.speed_mps) == 0.0
            rest &= np.interp(time_s + 0.1, drive.time_s, drive.speed_mps) == 0.0
            assert np.hypot(np.diff(x), np.diff(y))[rest[1:] & rest[:-1]].max(initial=0.0) < 2e-4
