"""The expectation of the yaw rate: two Gaussians, older means wider, and a view ruled by a truck is not believed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.monocular.motion import Motion, MotionPrior, estimate_motion
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.experts.monocular.pair import Pair, PairSolver
from mixo_env.experts.monocular.turn import Turn
from mixo_env.geometry import rotation_from_yaw
from tests.corridor import FOCAL, HEIGHT, WIDTH, calibration
from tests.rigid_body import camera_displacement
from tests.test_monocular_motion import matched_pair, street
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


class TruckAhead:
    """Straight drive at 5 m/s, and a truck that turns off ahead; from then on it moves as if the car turned instead.

    Takes the place of the solver of pairs; points of a truck are as true to one motion as those of a street.

    Args:
        seed: of the points.
        pairs: per pair of images: time between them [s], points of the street, turn that the truck feigns [deg/s]
            (``None`` without a truck).
    """

    TRUCK_POINTS = 200

    def __init__(self, seed: int, pairs: Sequence[tuple[float, int, float | None]]) -> None:
        self._rng, self._pairs, self._next = np.random.default_rng(seed), pairs, iter(pairs)

    def drive(self, monkeypatch: pytest.MonkeyPatch) -> list[CameraStep]:
        """Show all pairs to the expert: one step each."""
        monkeypatch.setattr(PairSolver, "frame", lambda solver, image: image)
        monkeypatch.setattr(PairSolver, "compare", self._compare)
        odometry, image, timestamp_us, steps = (
            MonocularOdometry(calibration()),
            np.zeros((HEIGHT, WIDTH), np.uint8),
            0,
            [],
        )
        odometry.process(image, timestamp_us, 0.0)
        for k, (gap_s, _, _) in enumerate(self._pairs):
            timestamp_us += round(1e6 * gap_s)
            steps.append(odometry.process(np.full_like(image, k + 1), timestamp_us, 5.0 * gap_s))
        return steps

    def _compare(self, _first: object, _second: object, gap_s: float, distance_m: float) -> Pair:
        _, street_points, feigned_degps = next(self._next)
        camera = MonocularOdometry(calibration()).camera
        parts = [(0.0, street(self._rng, street_points, FOCAL, camera.rotation))]
        if feigned_degps is not None:
            body = self._rng.uniform([8.0, -6.0, -1.0], [14.0, -1.0, 2.0], (self.TRUCK_POINTS, 3))
            parts.append((math.radians(feigned_degps) * gap_s, body))
        moved = []
        for yaw, points in parts:
            x, y = camera_displacement(yaw, distance_m, *camera.position_m[:2])
            moved.append((points - [x, y, 0.0]) @ rotation_from_yaw(yaw))
        seen = [points @ camera.rotation for points in (np.vstack([points for _, points in parts]), np.vstack(moved))]
        ahead = (seen[0][:, 2] > 1.0) & (seen[1][:, 2] > 1.0)
        first, second = (
            points[ahead, :2] / points[ahead, 2:] + self._rng.normal(0.0, 0.3 / FOCAL, (int(ahead.sum()), 2))
            for points in seen
        )
        prior = MotionPrior(distance_m, 0.3 * distance_m + 0.005, 0.35 / FOCAL)
        motion = estimate_motion(first, second, camera.rotation, camera.position_m, prior)
        corner = np.arange(len(first))[:, None] + [0, 10_000]  # none is seen in three images
        return Pair(len(first), 5.0, first, second, corner, prior, motion)


@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_expectation_does_not_confirm_itself(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a dropped frame hardly anything but the truck is seen; then it has less than half of the matches for long.

    The pairs alone are right again at once, but solved about the turn of the truck they would all confirm it.
    """
    quiet, wild = [(0.1, 240, None)] * 6, [(0.2, 50, 8.0)]
    steps = TruckAhead(seed, quiet + wild + [(0.1, 240, 8.5 + 0.5 * k) for k in range(15)]).drive(monkeypatch)
    alone = np.degrees([step.two_frame_yaw_increment_rad for step in steps])
    assert alone[6] == pytest.approx(1.6, abs=0.2)
    assert np.max(np.abs(np.delete(alone, 6))) < 0.1
    assert State.LOST in [step.state for step in steps[7:9]]
    assert all(step.state is State.TRACKING for step in steps[12:])
    assert np.max(np.abs(np.degrees([step.yaw_increment_rad for step in steps[12:]]))) < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_one_pair_ruled_by_a_truck_is_bridged(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    ruled = (0.1, 130, 12.0)
    steps = TruckAhead(seed, ([(0.1, 240, None)] * 4 + [ruled]) * 3 + [(0.1, 240, None)]).drive(monkeypatch)
    alone = np.degrees([step.two_frame_yaw_increment_rad for step in steps])
    assert alone[4::5] == pytest.approx(1.2, abs=0.2)
    assert all(step.state is State.TRACKING for step in steps[1:])
    assert np.max(np.abs(np.degrees([step.yaw_increment_rad for step in steps[1:]]))) < 0.1
