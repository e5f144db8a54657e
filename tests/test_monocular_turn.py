"""The expectation of the yaw rate: two Gaussians, older means wider, and a view ruled by a truck is not believed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mixo_env.experts.expert import State
from mixo_env.experts.monocular.motion import Motion, MotionPrior, estimate_motion
from mixo_env.experts.monocular.turn import Turn
from tests.test_monocular_motion import matched_pair
from tests.test_monocular_odometry import drive

PRIOR, GAP_S = MotionPrior(0.8, 0.1, 0.0005), 0.1


def turned(yaw_rad: float, std_rad: float) -> Motion:
    return Motion(yaw_rad, std_rad, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1, np.ones(60, bool), 0.0)


def test_nothing_is_expected_at_first() -> None:
    prior = Turn(0.2).expect(PRIOR, 5, GAP_S)
    assert (prior.yaw_mean_rad, prior.yaw_std_rad) == (0.0, math.inf)


def test_the_rate_is_carried_on_and_ages() -> None:
    turn = Turn(0.2)
    turn.learn(turned(0.03, 0.002), 1_000_000, GAP_S)
    soon, late = (turn.expect(PRIOR, 1_000_000 + gap, 1e-6 * gap) for gap in (50_000, 200_000))
    assert (soon.yaw_mean_rad, late.yaw_mean_rad) == pytest.approx((0.015, 0.06))
    assert soon.yaw_std_rad == pytest.approx(0.05 * math.hypot(0.02, 0.2 * 0.05))
    assert late.yaw_std_rad == pytest.approx(0.2 * math.hypot(0.02, 0.2 * 0.2))
    after_a_gap = turn.expect(PRIOR, 2_000_000, GAP_S)
    assert after_a_gap.yaw_std_rad == pytest.approx(0.1 * math.hypot(0.02, 0.2 * 1.0))


@pytest.mark.parametrize(("ratio", "low", "high"), [(0.01, 0.9, 1.05), (1.0, 0.3, 0.9), (100.0, -0.05, 0.1)])
def test_the_solution_lies_between_the_expected_and_the_seen_by_their_weights(
    ratio: float, low: float, high: float
) -> None:
    """Two Gaussians would meet at 1 / (1 + ratio^2) of the way; matches are weighed robustly, so about there."""
    first, second, rotation, lever, _, distance, _ = matched_pair(np.random.default_rng(3), "back_right", 8.0, 0.1)
    seen = MotionPrior(distance, 0.1, 0.7 / 1259.0)
    alone = estimate_motion(first, second, rotation, lever, seen)
    assert alone is not None
    std = alone.yaw_std_rad / 1.4  # without the allowance for errors that are not independent
    expected = replace(seen, yaw_mean_rad=alone.yaw_rad + 0.5 * std, yaw_std_rad=ratio * std)
    both = estimate_motion(first, second, rotation, lever, expected, alone.yaw_rad)
    assert both is not None
    assert low < (both.yaw_rad - alone.yaw_rad) / (0.5 * std) < high
    assert both.yaw_std_rad / alone.yaw_std_rad == pytest.approx(1.0 / math.hypot(1.0, 1.0 / ratio), rel=0.1)


def test_a_turn_that_no_car_can_make_is_a_lost_camera() -> None:
    """One image is turned by two degrees too much, as when a vehicle fills the view: nothing wild is reported."""
    speeds, rates = [5.0] * 10, [5.0, 5.0, 5.0, 5.0, 30.0, 5.0, 5.0, 5.0, 5.0, 5.0]
    steps, truth = drive(0.0, speeds, rates)
    states = [step.state for step in steps]
    assert states[4] is State.TRACKING
    assert states[5] is State.LOST
    assert math.isnan(steps[5].yaw_increment_rad)
    assert steps[5].two_frame_yaw_increment_rad == pytest.approx(truth[5], abs=0.01)
    assert states[-1] is State.TRACKING  # the camera comes back with the rate it had before
    error = np.degrees([step.yaw_increment_rad for step in steps] - truth)
    assert np.nanmax(np.abs(error)) < 0.35
