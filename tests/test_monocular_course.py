"""The slow means of slip and heave: learnt from pairs, robust, and found by a side view."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mixo_env.experts.monocular.course import Course
from mixo_env.experts.monocular.motion import Motion, MotionPrior, estimate_motion
from mixo_env.geometry import rotation_from_yaw
from tests.rigid_body import camera_displacement
from tests.test_monocular_motion import AXES, street

FOCAL, DISTANCE, LEVER = 630.0, 0.8, np.array([1.0, -0.5, 1.5])
SIDE = rotation_from_yaw(math.radians(250)) @ AXES


def measured(slip_m: float, heave_m: float, std_m: float) -> Motion:
    return Motion(0.0, 0.001, 0.0, 0.0, slip_m, heave_m, std_m, std_m, np.ones(1, bool), 0.0)


def test_before_anything_was_seen_the_prior_is_the_wide_one() -> None:
    prior = Course(0.05, 0.0001).expect(MotionPrior(DISTANCE, 0.1, 0.001), 0.0)
    assert (prior.slip_mean, prior.heave_mean) == (0.0, 0.0)
    assert prior.slip_std == pytest.approx(0.05, rel=1e-4)
    assert prior.heave_std == pytest.approx(0.05, rel=1e-4)


def test_one_pair_is_combined_as_two_gaussians() -> None:
    """A pair's posterior is freed of its prior, then weighted with the mean: worked by hand."""
    course, wide = Course(0.05, 0.01), MotionPrior(DISTANCE, 0.1, 0.001)
    prior_std = wide.offset()[1][0]
    seen_m, seen_std = 0.016, 0.012  # what the images alone say
    weight = 1.0 / seen_std**2 + 1.0 / prior_std**2
    course.learn(measured(seen_m / seen_std**2 / weight, 0.0, weight**-0.5), wide, 0.0)
    variance = (seen_std / DISTANCE) ** 2 + 0.01**2
    expected = (seen_m / DISTANCE / variance) / (1.0 / variance + 1.0 / 0.05**2)
    after = course.expect(wide, 0.0)
    assert after.slip_mean == pytest.approx(expected)
    assert after.slip_std**2 == pytest.approx(0.01**2 + 1.0 / (1.0 / variance + 1.0 / 0.05**2))


def test_standstill_and_a_wild_pair_teach_nothing() -> None:
    course = Course(0.05, 0.006)
    for _ in range(30):
        prior = course.expect(MotionPrior(DISTANCE, 0.1, 0.001), 0.0)
        course.learn(measured(-0.008, 0.0, 0.003), prior, 0.0)
    learnt = course.expect(MotionPrior(DISTANCE, 0.1, 0.001), 0.0).slip_mean
    assert learnt == pytest.approx(-0.01, abs=0.002)
    course.learn(measured(0.4, 0.4, 0.003), course.expect(MotionPrior(DISTANCE, 0.1, 0.001), 0.0), 0.0)
    course.learn(measured(0.001, 0.0, 0.001), course.expect(MotionPrior(0.0, 0.1, 0.001), 0.0), 0.0)
    assert course.expect(MotionPrior(DISTANCE, 0.1, 0.001), 0.0).slip_mean == learnt


def test_a_side_view_finds_the_course() -> None:
    """A car that travels 0.6 degrees beside its heading, 40 pairs of a side camera: no worse than each pair alone."""
    rng, slip, course = np.random.default_rng(0), -0.0105, Course(0.05, 0.006)
    x, y = camera_displacement(0.0, DISTANCE, LEVER[0], LEVER[1])
    errors = []
    for _ in range(40):
        before = street(rng, 250, FOCAL, SIDE)
        after = before - [x, y + slip * DISTANCE, 0.0]
        seen = [points @ SIDE for points in (before, after)]
        ahead = (seen[0][:, 2] > 1.0) & (seen[1][:, 2] > 1.0)
        first, second = (
            points[ahead, :2] / points[ahead, 2:] + rng.normal(0.0, 0.3 / FOCAL, (int(ahead.sum()), 2))
            for points in seen
        )
        alone = MotionPrior(DISTANCE, 0.08, 0.35 / FOCAL)
        prior = course.expect(alone, 0.0)
        solved = estimate_motion(first, second, SIDE, LEVER, alone)
        assert solved is not None
        refined = estimate_motion(first, second, SIDE, LEVER, prior, solved.yaw_rad)
        assert refined is not None
        course.learn(refined, prior, 0.0)
        errors.append((solved.yaw_rad, refined.yaw_rad))
    alone_rms, refined_rms = np.sqrt(np.mean(np.square(errors[10:]), axis=0))
    assert refined_rms < 1.02 * alone_rms
    assert course.expect(MotionPrior(DISTANCE, 0.08, 0.001), 0.0).slip_mean == pytest.approx(slip, abs=0.004)


def test_a_turn_widens_the_slip_and_teaches_less() -> None:
    """Tyres under side force roll at an angle of 0.006 rad per m/s^2 to the way; heave does not care."""
    wide = MotionPrior(DISTANCE, 0.1, 0.001)
    course = Course(0.05, 0.006)
    straight, turning = course.expect(wide, 0.0), course.expect(wide, -2.0)
    assert turning.slip_std == pytest.approx(math.hypot(straight.slip_std, 0.012))
    assert turning.heave_std == straight.heave_std
    taught = []
    for sideways in (0.0, 2.0):
        course = Course(0.05, 0.006)
        course.learn(measured(-0.008, 0.0, 0.003), course.expect(wide, sideways), sideways)
        taught.append(course.expect(wide, 0.0))
    assert 0.0 > taught[1].slip_mean > taught[0].slip_mean
    assert taught[1].heave_std == taught[0].heave_std


def test_what_a_turn_has_taught_is_soon_forgotten_on_the_straight() -> None:
    """Two seconds of a turn in which every pair errs by the same 20 mrad, then one second of straight road."""
    way, course, std = 0.35, Course(0.05, 0.006), 0.004
    for k in range(36):
        sideways, slip = (1.3, 0.02) if k < 24 else (0.0, 0.0)
        prior = course.expect(MotionPrior(way, 0.1, 0.001), sideways)
        mean, prior_std = prior.offset()[0][0], prior.offset()[1][0]
        weight = 1.0 / std**2 + 1.0 / prior_std**2
        solved = (slip * way / std**2 + mean / prior_std**2) / weight
        course.learn(measured(float(solved), 0.0, float(weight**-0.5)), prior, sideways)
    assert abs(course.expect(MotionPrior(way, 0.1, 0.001), 0.0).slip_mean) < 0.006  # .010 if pairs erred independently


@pytest.mark.parametrize("distance", [DISTANCE, -DISTANCE])
def test_shares_keep_their_sign_in_reverse(distance: float) -> None:
    """Slip and heave are shares of the way: a car in reverse slips the other way and its camera sinks where it rose."""
    course = Course(0.05, 0.006)
    slip, heave = -0.012, 0.02
    for _ in range(60):
        prior = course.expect(MotionPrior(distance, 0.1, 0.001), 0.0)
        course.learn(measured(slip * distance, heave * distance, 0.002), prior, 0.0)
    learnt = course.expect(MotionPrior(DISTANCE, 0.1, 0.001), 0.0)
    assert learnt.slip_mean == pytest.approx(slip, abs=0.001)
    assert learnt.heave_mean == pytest.approx(heave, abs=0.001)
    expected_m, _ = course.expect(MotionPrior(-DISTANCE, 0.1, 0.001), 0.0).offset()
    assert expected_m == pytest.approx([-slip * DISTANCE, -heave * DISTANCE], abs=0.001)


@pytest.mark.parametrize("distance", [DISTANCE, -DISTANCE])
def test_a_side_view_finds_slip_and_heave_forwards_and_in_reverse(distance: float) -> None:
    """Points seen while the camera slips and rises by known shares: solved and learnt with their signs."""
    rng, slip, heave, course = np.random.default_rng(3), -0.02, 0.03, Course(0.05, 0.006)
    for _ in range(25):
        before = street(rng, 250, FOCAL, SIDE)
        after = before - [distance, slip * distance, heave * distance]
        seen = [points @ SIDE for points in (before, after)]
        ahead = (seen[0][:, 2] > 1.0) & (seen[1][:, 2] > 1.0)
        first, second = (points[ahead, :2] / points[ahead, 2:] for points in seen)
        prior = course.expect(MotionPrior(distance, 0.08, 0.05 / FOCAL), 0.0)
        solved = estimate_motion(first, second, SIDE, LEVER, prior)
        assert solved is not None
        course.learn(solved, prior, 0.0)
    learnt = course.expect(MotionPrior(distance, 0.08, 0.001), 0.0)
    assert learnt.heave_mean == pytest.approx(heave, abs=0.006)
    assert learnt.slip_mean == pytest.approx(slip, abs=0.006)
