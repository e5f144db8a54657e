"""Joint odometry with rigs and cameras as they come: one alone, of different sizes, black, full of outliers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from mixo_env.experts.expert import State
from mixo_env.experts.joint.headings import lean
from mixo_env.experts.joint.layout import Layout, Moment, lay_out
from mixo_env.experts.joint.odometry import JointOdometry
from mixo_env.experts.joint.sight import Change, Sight, Told
from mixo_env.experts.monocular.motion import MotionPrior, estimate_motion
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.recordings.joint import Watched
from tests.corridor import HEIGHT, WIDTH, calibration
from tests.joint_rig import PLACES, RIGS, STEP_US, drive, look, mounted, play, rig

PAPER = RIGS["the paper's"]
STEPS = 40


@pytest.mark.parametrize("name", PLACES)
def test_one_camera_alone_equals_it_within_its_standard_deviation(name: str) -> None:
    camera, difference, std = mounted(name), [], []
    odometry = JointOdometry(rig((name,)))
    for time_us, sights, _ in drive(21, (name,), STEPS):
        step = odometry.process(time_us, sights)
        if step.state is not State.TRACKING:
            continue
        seen = sights[name]
        prior = MotionPrior(seen.distance_m, 0.1, seen.noise, slip_std=0.006, heave_std=0.006)
        motion = estimate_motion(seen.first, seen.second, camera.rotation, camera.position_m, prior)
        assert motion is not None
        difference.append(step.yaw_increment_rad - motion.yaw_rad)
        std.append(motion.yaw_std_rad)
    assert len(std) == STEPS - 1
    assert np.mean(np.abs(difference) < std) > 0.68
    assert abs(sum(difference)) < 1.96 * np.sqrt(np.sum(np.square(std)))


def test_the_share_of_outliers_is_told_of_every_camera() -> None:
    wrong = {"front": 0.0, "front_left": 0.2, "back": 0.4, "back_right": 0.1}
    rng = np.random.default_rng(22)
    odometry, told = JointOdometry(rig(PAPER)), []
    for time_us, sights, _ in drive(22, PAPER, STEPS, outliers=0.0, movers=False):
        spoilt = {}
        for name, seen in sights.items():
            second = seen.second.copy()
            bad = rng.random(len(second)) < wrong[name]
            second[bad] += rng.normal(0.0, 0.1, (int(bad.sum()), 2))
            spoilt[name] = replace(seen, second=second)
        told.append(odometry.process(time_us, spoilt).outlier_share)
    for name, share in wrong.items():
        assert np.mean([step[name] for step in told[1:]]) == pytest.approx(share, abs=0.06)


def test_images_of_different_sizes_are_one_rig() -> None:
    """A camera of half the pixels and half the focal length sees the same with twice the noise."""
    small = mounted("front_left")
    half = replace(
        small,
        full_shape=(450, 800),
        working_shape=(225, 400),
        halvings=1,
        focal_px=small.focal_px / 2.0,
        centre_px=small.centre_px / 2.0,
    )

    def coarser(seen: Sight) -> Sight:
        rng = np.random.default_rng(seen.end_us)
        noise = rng.normal(0.0, np.sqrt(3.0) * seen.noise, seen.first.shape)
        return replace(seen, second=seen.second + noise, noise=2.0 * seen.noise)

    steps = [
        (t, {n: coarser(s) if n == "front_left" else s for n, s in seen.items()}, y)
        for t, seen, y in drive(23, PAPER, STEPS)
    ]
    said, error = play(rig(PAPER) | {"front_left": half}, iter(steps))
    _, alike = play(rig(PAPER), drive(23, PAPER, STEPS))
    assert [step.state for step in said[2:]] == [State.TRACKING] * (STEPS - 1)
    assert "front_left" in said[-1].outlier_share
    assert np.nanstd(error) < 1.3 * np.nanstd(alike)
    assert all(step.residual_px < 1.0 for step in said[2:])


def test_black_pictures_have_no_say() -> None:
    watched = Watched(MonocularOdometry(calibration()), 300)
    black = np.zeros((HEIGHT, WIDTH), np.uint8)
    steps = list(drive(24, PAPER, 8))
    odometry, without = JointOdometry(rig(PAPER)), JointOdometry(rig(PAPER))
    for k, (time_us, sights, _) in enumerate(steps):
        watched.process(black, k * STEP_US, 0.0)
        dark = watched.sights.get(k * STEP_US)
        rest = {name: seen for name, seen in sights.items() if name != "back"}
        if dark is not None:
            assert dark.matches == 0
            sights = rest | {"back": replace(dark, start_us=time_us - STEP_US, end_us=time_us)}
        np.testing.assert_equal(odometry.process(time_us, sights), without.process(time_us, rest))


def test_three_images_steady_the_increments_and_a_captured_camera_is_not_believed() -> None:
    """Changes known to .002 deg take noise off of the increments; one that is .5 deg wrong does not matter."""
    rng = np.random.default_rng(25)

    def told(*, wrong: bool) -> Iterator[tuple[int, dict[str, Sight], float]]:
        before: dict[str, Sight] = {}
        for k, (time_us, sights, yaw) in enumerate(drive(25, PAPER, STEPS, rate_deg=0.0)):
            seen = {}
            for name, now in sights.items():
                if name in before:
                    change = rng.normal(0.0, 3e-5) + (0.009 * (-1) ** k if wrong and name == "front" else 0.0)
                    now = replace(now, change=Change(before[name].start_us, change, 3e-5))
                seen[name] = before[name] = now
            yield time_us, seen, yaw

    plain = np.nanstd(play(rig(PAPER), drive(25, PAPER, STEPS, rate_deg=0.0))[1])
    steadied = np.nanstd(play(rig(PAPER), told(wrong=False))[1])
    fooled = np.nanstd(play(rig(PAPER), told(wrong=True))[1])
    assert steadied < 0.75 * plain
    assert fooled < 1.2 * steadied


def test_a_sure_camera_that_is_captured_is_outvoted_by_the_others() -> None:
    """The car all but stands; for a second a vehicle fills one view, and three others contradict the turn it tells."""
    rng = np.random.default_rng(26)
    steps = []
    for k, (time_us, sights, yaw) in enumerate(drive(26, PAPER, STEPS, speed=0.3, rate_deg=0.0, movers=False)):
        if 20 < k <= 32:
            seen = sights["back"]
            motion = (yaw + 0.004, seen.distance_m, 0.0, 0.0)
            sure = look(rng, "back", (seen.start_us, seen.end_us), motion, points=1500, outliers=0.0, movers=False)
            sights["back"] = sure
        steps.append((time_us, sights, yaw))
    said, error = play(rig(PAPER), iter(steps))
    assert abs(np.rad2deg(np.nansum(error))) < 0.1
    assert all("back" not in step.outlier_share for step in said[21:33])


def test_a_camera_that_has_contradicted_the_rig_is_doubted_for_a_second() -> None:
    """A vehicle is caught turning by .23 deg a step; slowing down to .07, which alone would pass, it stays caught."""
    rng = np.random.default_rng(27)
    steps = []
    for k, (time_us, sights, yaw) in enumerate(drive(27, PAPER, 44, speed=0.3, rate_deg=0.0, movers=False)):
        if k > 20:
            seen, lie = sights["back"], 0.004 if k <= 26 else 0.0012
            motion = (yaw + lie, seen.distance_m, 0.0, 0.0)
            times_us = seen.start_us, seen.end_us
            sights["back"] = look(rng, "back", times_us, motion, points=600, outliers=0.0, movers=False)
        steps.append((time_us, sights, yaw))
    said, error = play(rig(PAPER), iter(steps))
    assert abs(np.rad2deg(np.nansum(error))) < 0.1
    assert np.mean(["back" in step.outlier_share for step in said[21:]]) < 0.25


@pytest.mark.parametrize(("speed", "heard"), [(3.0, False), (0.5, False), (0.0, True)])
def test_a_picture_that_repeats_itself_has_no_say_unless_the_car_stands(speed: float, heard: bool) -> None:
    steps = list(drive(28, PAPER, 6, speed=speed, rate_deg=0.0))
    for _, sights, _ in steps[1:]:
        sights["back"] = replace(sights["back"], second=sights["back"].first.copy())
    said, _ = play(rig(PAPER), iter(steps))
    assert ("back" in said[-1].outlier_share) is heard
    assert "front" in said[-1].outlier_share


def test_the_layout_of_some_cameras_is_that_of_them_alone() -> None:
    time_us, sights, _ = list(drive(29, PAPER, 3))[-1]
    some = PAPER[1], PAPER[3]

    def laid_out(names: tuple[str, ...]) -> Layout:
        used = {name: sights[name] for name in names}
        return lay_out(rig(PAPER), Moment((-0.083, 0.0, 0.083), time_us - STEP_US, used))

    for part, alone in zip(laid_out(PAPER).of([1, 3]), laid_out(some), strict=True):
        np.testing.assert_array_equal(part, alone)


def test_the_rig_meets_cameras_that_agree_half_way_and_hardly_hears_one_that_is_captured() -> None:
    std = np.full(4, 2e-4)
    assert lean(np.zeros(0), np.zeros(0), 3.0) == (0.0, 1.0)
    alike, share = lean(np.full(4, 1e-4), std, 3.0)
    assert 0.45e-4 < alike < 0.6e-4
    assert 0.4 < share < 0.5
    captured, _ = lean(np.array([4e-3, 0.0, 0.0, 0.0]), std, 3.0)
    assert 0.0 < captured < 0.02 * 4e-3


def test_what_the_cameras_report_takes_noise_off_the_increments() -> None:
    rng = np.random.default_rng(26)

    def reported() -> Iterator[tuple[int, dict[str, Sight], float]]:
        for time_us, sights, yaw in drive(26, PAPER, STEPS, rate_deg=0.0):
            yield time_us, {n: replace(s, told=Told(rng.normal(0.0, 5e-5), 5e-5)) for n, s in sights.items()}, yaw

    plain = np.nanstd(play(rig(PAPER), drive(26, PAPER, STEPS, rate_deg=0.0))[1])
    assert np.nanstd(play(rig(PAPER), reported())[1]) < 0.75 * plain
