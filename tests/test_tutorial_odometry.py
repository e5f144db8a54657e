"""TUTORIAL: right where a textbook odometry is right, and lost or wrong where it is."""

from __future__ import annotations

import math
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from experiments.speed.drives import open_drives
from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.tutorial import TutorialConfig, TutorialOdometry, _sampson_px
from mixo_env.geometry import rotation_from_yaw
from tests.corridor import FOCAL, HEIGHT, WIDTH, calibration, picture

TURN_RAD, STEP_M, GAP_US = 0.02, 1.0, 80_000


def drive(mounting_deg: float, steps: int = 4, turn_rad: float = TURN_RAD, step_m: float = STEP_M) -> list[CameraStep]:
    """A car on an arc through the corridor."""
    camera = calibration(mounting_deg)
    odometry = TutorialOdometry(camera)
    out, x, y = [], 0.0, 0.0
    for k in range(steps):
        yaw = k * turn_rad
        out.append(odometry.process(picture(camera, x, y, yaw, noise_seed=k), (k + 1) * GAP_US, step_m))
        x, y = x + step_m * math.cos(yaw + turn_rad / 2), y + step_m * math.sin(yaw + turn_rad / 2)
    return out


@pytest.mark.parametrize("mounting_deg", [0.0, 180.0])
@pytest.mark.parametrize("turn_rad", [TURN_RAD, -TURN_RAD])
def test_the_turn_of_the_car_whichever_way_the_camera_looks(mounting_deg: float, turn_rad: float) -> None:
    first, *others = drive(mounting_deg, turn_rad=turn_rad)
    assert first.state is State.INITIALISING
    assert math.isnan(first.yaw_increment_rad)
    assert [step.state for step in others] == [State.TRACKING] * 3
    turned = np.median([step.yaw_increment_rad for step in others])
    assert turned == pytest.approx(turn_rad, abs=0.5 * TURN_RAD)


@pytest.mark.parametrize("mounting_deg", [0.0, 55.0, -110.0, 180.0])
def test_known_points_give_the_turn_of_the_car(mounting_deg: float) -> None:
    """Points before and after a known motion of the car, seen by a camera with a lever arm, without noise."""
    camera = calibration(mounting_deg)
    to_ego, lever = camera.rotation_ego_from_camera, camera.translation_m
    rng = np.random.default_rng(0)
    seen = rng.uniform([-8.0, -3.0, 6.0], [8.0, 3.0, 40.0], (200, 3))  # camera axes, before
    before = seen @ to_ego.T + lever
    after = (before - np.array([1.0, 0.02, 0.0])) @ rotation_from_yaw(0.03)  # rows times R: R^T applied
    again = (after - lever) @ to_ego
    first, second = (points[:, :2] / points[:, 2:] * FOCAL + camera.intrinsic[:2, 2] for points in (seen, again))
    motion = TutorialOdometry(camera)._motion(first, second)
    assert motion is not None
    assert motion.yaw_rad == pytest.approx(0.03, abs=1e-5)
    assert motion.inliers == 200
    second[::3] += rng.uniform(20.0, 60.0, second[::3].shape)  # a third is wrong
    motion = TutorialOdometry(camera)._motion(first, second)
    assert motion is not None
    assert motion.yaw_rad == pytest.approx(0.03, abs=1e-3)


def test_what_it_says_of_itself() -> None:
    step = drive(0.0, steps=2)[1]
    assert 0 < step.inliers <= step.matches <= 2000
    assert 0.0 < step.residual_px < TutorialConfig().threshold_px
    assert 1.0 < step.flow_px < 100.0
    assert math.isnan(step.yaw_std_rad)  # it has none, and none is invented
    assert step.two_frame_yaw_increment_rad == step.yaw_increment_rad


def test_without_texture_it_is_lost_and_then_goes_on() -> None:
    camera = calibration()
    odometry = TutorialOdometry(camera)
    seen, blank = picture(camera, 0.0, 0.0, 0.0), np.full((HEIGHT, WIDTH), 90, np.uint8)
    images = [seen, blank, seen, picture(camera, 1.0, 0.0, 0.0, noise_seed=1)]
    steps = [odometry.process(image, k, 1.0) for k, image in enumerate(images, start=1)]
    assert [s.state for s in steps] == [State.INITIALISING, State.LOST, State.LOST, State.TRACKING]
    assert (steps[1].matches, steps[1].inliers) == (0, 0)


def test_images_of_another_place_are_lost() -> None:
    rng = np.random.default_rng(0)
    odometry = TutorialOdometry(calibration())
    small = [rng.integers(0, 255, (HEIGHT // 4, WIDTH // 4), np.uint8) for _ in range(2)]
    images = [np.asarray(cv2.resize(image, (WIDTH, HEIGHT)), np.uint8) for image in small]
    steps = [odometry.process(image, k, 1.0) for k, image in enumerate(images, start=1)]
    assert steps[1].state is State.LOST


def test_a_standing_car_gets_nothing_or_noise_without_a_warning() -> None:
    """No parallax leaves the essential matrix undetermined; a textbook odometry does not notice."""
    camera = calibration()
    odometry = TutorialOdometry(camera)
    steps = [odometry.process(picture(camera, 0.0, 0.0, 0.0, noise_seed=k), k, 0.0) for k in range(1, 8)]
    for step in steps[1:]:
        assert step.state in (State.TRACKING, State.LOST)
        assert math.isfinite(step.yaw_increment_rad) == (step.state is State.TRACKING)


def test_same_bits_whatever_came_before_and_whatever_the_state_of_opencv() -> None:
    camera = calibration()
    images = [picture(camera, float(k), 0.0, 0.0, noise_seed=k) for k in range(3)]
    long, short = TutorialOdometry(camera), TutorialOdometry(camera)
    first = [long.process(image, k, 1.0) for k, image in enumerate(images, start=1)][-1]
    cv2.setRNGSeed(12345)
    cv2.randu(np.zeros((4, 4)), np.zeros(1), np.ones(1))
    again = [short.process(image, k, 1.0) for k, image in enumerate(images[1:], start=1)][-1]
    assert first == again


def test_the_distance_is_not_used() -> None:
    near = drive(0.0, steps=2)[1]
    camera = calibration()
    odometry = TutorialOdometry(camera)
    odometry.process(picture(camera, 0.0, 0.0, 0.0, noise_seed=0), GAP_US, 0.0)
    x, y = STEP_M * math.cos(TURN_RAD / 2), STEP_M * math.sin(TURN_RAD / 2)
    far = odometry.process(picture(camera, x, y, TURN_RAD, noise_seed=1), 2 * GAP_US, 50.0)
    assert near == far


def test_no_later_image_changes_a_step() -> None:
    camera = calibration()
    images = [picture(camera, float(k), 0.0, 0.0, noise_seed=k) for k in range(3)]
    other = [*images[:2], np.zeros_like(images[2])]
    runs = []
    for shown in (images, other):
        odometry = TutorialOdometry(camera)
        runs.append([odometry.process(image, k, 1.0) for k, image in enumerate(shown, start=1)])
    assert runs[0][1] == runs[1][1]
    assert runs[0][2] != runs[1][2]


def test_sampson_distance_of_a_sideways_camera() -> None:
    """Sideways motion: epipolar lines are the image rows, so a match off by d rows is off by d / sqrt(2)."""
    essential = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    first, second = np.array([[10.0, 20.0], [3.0, 4.0]]), np.array([[15.0, 20.0], [8.0, 6.0]])
    np.testing.assert_allclose(_sampson_px(essential, np.eye(3), first, second), [0.0, math.sqrt(2.0)], atol=1e-12)


def test_bad_input() -> None:
    odometry = TutorialOdometry(calibration())
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    odometry.process(image, 5, 0.0)
    for wrong, time_us, metres, match in (
        (image.astype(np.float32), 6, 0.0, "grey uint8"),
        (image[:-1], 6, 0.0, "as calibrated"),
        (image, 5, 0.0, "must increase"),
        (image, 6, math.nan, "must be finite"),
    ):
        with pytest.raises(DatasetError, match=match):
            odometry.process(wrong, time_us, metres)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "values", [{"features": 0}, {"ratio": 1.0}, {"confidence": 1.5}, {"min_matches": 4}, {"min_inliers": 4}]
)
def test_settings_out_of_range(values: dict[str, float]) -> None:
    with pytest.raises(ConfigurationError):
        TutorialConfig(**values)  # type: ignore[arg-type]


@pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="MIXO_REAL_DATA is not set")
def test_real_images_give_right_turns_with_gross_errors_among_them() -> None:
    """51 images of KITTI 06: the median is that of a working odometry, the worst steps are flips of the five points."""
    (kitti,) = open_drives(Path(os.environ["MIXO_REAL_DATA"]) / "kitti_06", (), ())
    odometry = TutorialOdometry(kitti.calibration)
    steps = [
        odometry.process(kitti.read(path), int(stamp), 1.0)
        for path, stamp in zip(kitti.image_paths, kitti.timestamp_us, strict=True)
    ]
    assert {step.state for step in steps[1:]} == {State.TRACKING}
    error = np.degrees(np.array([step.yaw_increment_rad for step in steps[1:]]) - kitti.turn_rad)
    assert np.median(np.abs(error)) < 0.15
    assert np.sqrt(np.mean(error**2)) > 5 * np.median(np.abs(error))
