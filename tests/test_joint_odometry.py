"""Joint odometry on known points: accuracy, honest standard deviation, cameras that fail, and what never enters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.experts.expert import State
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.joint.knots import window_weights
from mixo_env.experts.joint.odometry import JointOdometry
from mixo_env.experts.joint.sight import Sight
from tests.joint_rig import RIGS, STEP_US, drive, look, mounted, play, rig

PAPER = RIGS["the paper's"]
STEPS = 40


def deg(radians: np.ndarray) -> float:
    """Root mean square in degrees of what is there."""
    return float(np.rad2deg(np.sqrt(np.nanmean(radians**2))))


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize(("speed", "rate"), [(10.0, 10.0), (5.0, 25.0), (0.0, 0.0)])
def test_error_and_standard_deviation_are_bounded(name: str, speed: float, rate: float) -> None:
    steps, error = play(rig(RIGS[name]), drive(1, RIGS[name], STEPS, speed=speed, rate_deg=rate))
    assert [step.state for step in steps[2:]] == [State.TRACKING] * (STEPS - 1)
    assert deg(error) < 0.04
    assert abs(np.rad2deg(np.nansum(error))) < 0.35
    std = np.array([step.yaw_std_rad for step in steps])
    assert np.nanmean(np.abs(error) < 2.0 * std) > 0.85
    assert np.nanmedian(np.rad2deg(std)) < 0.06


def test_stagger_is_handled_not_ignored() -> None:
    """Swinging 3 deg/s^2, cameras a fifth of a step apart would err by a hundredth of a degree each way."""
    exact: Any = {"outliers": 0.0, "movers": False}
    _, error = play(rig(PAPER), drive(2, PAPER, STEPS, rate_deg=30.0, **exact))
    late = [
        (t, {n: replace(s, start_us=t - STEP_US, end_us=t) for n, s in seen.items()}, y)
        for t, seen, y in drive(2, PAPER, STEPS, rate_deg=30.0, **exact)
    ]
    _, ignored = play(rig(PAPER), iter(late))
    assert deg(error) < 0.6 * deg(ignored)


def test_more_cameras_know_more() -> None:
    alone = play(rig(("back_right",)), drive(3, ("back_right",), STEPS))[1]
    assert deg(play(rig(PAPER), drive(3, PAPER, STEPS))[1]) < 0.5 * deg(alone)


def test_window_is_the_integral_of_the_polygon() -> None:
    knots = (-0.1, 0.0, 0.08)
    for start, end in [(-0.13, -0.02), (-0.05, 0.05), (0.01, 0.08), (-0.1, 0.08)]:
        time = np.linspace(start, end, 200_001)
        for k, unit in enumerate(np.eye(3)):
            slope = unit[0] + (unit[1] - unit[0]) * (time - knots[0]) / 0.1  # before the first knot its line goes on
            value = np.where(time < 0.0, slope, np.interp(time, knots, unit))
            assert window_weights(start, end, knots)[k] == pytest.approx(np.trapezoid(value, time), abs=1e-6)


@pytest.mark.parametrize("kind", ["captured", "frozen", "absent"])
def test_one_bad_camera_costs_little(kind: str) -> None:
    """Captured: all of the view turns by .23 deg a step more than the car. Frozen: nothing moves although it does."""

    def spoilt() -> Iterator[tuple[int, dict[str, Sight], float]]:
        rng = np.random.default_rng(9)
        for time_us, sights, yaw in drive(4, PAPER, STEPS):
            if "front_left" in sights:
                seen = sights["front_left"]
                if kind == "captured":
                    motion = (yaw + 0.004, seen.distance_m, 0.0, 0.0)
                    seen = look(rng, "front_left", (seen.start_us, seen.end_us), motion)
                sights["front_left"] = replace(seen, second=seen.first) if kind == "frozen" else seen
                if kind == "absent":
                    del sights["front_left"]
            yield time_us, sights, yaw

    remaining = tuple(name for name in PAPER if name != "front_left")
    three = play(
        rig(remaining),
        ((t, {n: s for n, s in seen.items() if n in remaining}, y) for t, seen, y in drive(4, PAPER, STEPS)),
    )[1]
    steps, error = play(rig(PAPER), spoilt())
    assert deg(error) < (1.4 if kind == "captured" else 1.001) * deg(three) + 1e-9
    assert steps[-1].state is State.TRACKING
    if kind != "captured":
        assert "front_left" not in steps[-1].outlier_share


@pytest.mark.parametrize("wrong", ["front", "front_left", "back", "back_right"])
def test_wrong_mounting_is_noticed_named_and_left_out(wrong: str) -> None:
    cameras = rig(PAPER) | {wrong: mounted(wrong, written_yaw_deg=2.0)}
    steps, error = play(cameras, drive(5, PAPER, 90))
    assert steps[-1].misplaced == (wrong,)
    assert wrong not in steps[-1].outlier_share
    assert deg(error[60:]) < 0.04


def test_right_mountings_are_not_suspected() -> None:
    steps, _ = play({name: mounted(name, written_yaw_deg=0.2) for name in PAPER}, drive(6, PAPER, 90))
    assert steps[-1].misplaced == ()


def test_states_without_matches_and_after() -> None:
    steps = []
    for k, (time_us, sights, yaw) in enumerate(drive(7, PAPER, 20)):
        steps.append((time_us, {} if 8 <= k < 11 else sights, yaw))
    said, _ = play(rig(PAPER), iter(steps))
    start, track, lost = State.INITIALISING, State.TRACKING, State.LOST
    assert [step.state for step in said] == [start] * 2 + [track] * 6 + [lost] * 3 + [start] + [track] * 9
    assert all(math.isfinite(step.yaw_increment_rad) == (step.state is track) for step in said)
    assert said[9].matches == said[9].inliers == 0
    assert np.isnan([said[9].residual_px, said[9].two_frame_yaw_increment_rad]).all()


def test_cameras_come_and_go() -> None:
    steps = []
    for k, (time_us, sights, yaw) in enumerate(drive(8, PAPER, STEPS)):
        steps.append((time_us, {name: s for j, (name, s) in enumerate(sights.items()) if j != (k // 4) % 5}, yaw))
    said, error = play(rig(PAPER), iter(steps))
    assert said[-1].state is State.TRACKING
    assert deg(error) < 0.04


def test_noise_alone_is_no_motion() -> None:
    rng = np.random.default_rng(0)
    steps = []
    for time_us, sights, yaw in drive(10, PAPER, 6):
        steps.append(
            (time_us, {n: replace(s, second=rng.uniform(-0.6, 0.6, s.first.shape)) for n, s in sights.items()}, yaw)
        )
    assert all(step.state is not State.TRACKING for step in play(rig(PAPER), iter(steps))[0])


def test_two_frames_have_no_memory() -> None:
    said, _ = play(rig(PAPER), drive(11, PAPER, 10))
    steps = list(drive(11, PAPER, 10))
    fresh = JointOdometry(rig(PAPER))
    fresh.process(steps[8][0], {})
    again = fresh.process(*steps[9][:2])
    assert again.two_frame_yaw_increment_rad == said[9].two_frame_yaw_increment_rad
    assert abs(np.rad2deg(again.two_frame_yaw_increment_rad - steps[9][2])) < 0.2


def test_the_past_decides_and_the_same_input_gives_the_same_bits() -> None:
    steps = list(drive(12, PAPER, 12))
    other = [*steps[:9], *(list(drive(13, PAPER, 12))[9:])]
    first, second = (play(rig(PAPER), iter(given))[0] for given in (steps, other))
    assert [s.yaw_increment_rad for s in first[2:9]] == [s.yaw_increment_rad for s in second[2:9]]
    assert first[9].yaw_increment_rad != second[9].yaw_increment_rad


def test_bad_input_is_refused() -> None:
    _, (time_us, sights, _) = itertools.islice(drive(14, PAPER, 1), 2)
    seen = sights["front"]
    for bad in (
        {"roof": seen},
        {"front": replace(seen, end_us=time_us + 1)},
        {"front": replace(seen, start_us=seen.end_us)},
        {"front": replace(seen, distance_m=math.nan)},
    ):
        with pytest.raises(DatasetError):
            JointOdometry(rig(PAPER)).process(time_us, bad)
    odometry = JointOdometry(rig(PAPER))
    odometry.process(time_us, {})
    with pytest.raises(DatasetError, match="increase"):
        odometry.process(time_us, {})
    with pytest.raises(DatasetError, match="at least one"):
        JointOdometry({})
    with pytest.raises(ConfigurationError, match="freedom"):
        JointConfig(freedom=0.0)
