"""The single-camera expert on pictures: accuracy, states, and everything a camera or a caller can do wrong."""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.monocular import pair
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.scene import CameraCalibration
from tests.corridor import AXES, HEIGHT, WIDTH, calibration, picture
from tests.rigid_body import camera_displacement

STEP_US, DT_S = 83_333, 0.083333


def drive(mounting_deg: float, speed: list[float], rate_deg: list[float]) -> tuple[list[CameraStep], np.ndarray]:
    """Run the expert over pictures of a drive; steps and the true yaw increments [rad]."""
    camera = calibration(mounting_deg)
    odometry = MonocularOdometry(camera)
    x, y, yaw = 0.0, 0.0, -0.1
    steps = [odometry.process(picture(camera, x, y, yaw), 1_000_000, 0.0)]
    truth = [0.0]
    for k, (v, w) in enumerate(zip(speed, rate_deg, strict=True)):
        turn, distance = math.radians(w) * DT_S, v * DT_S
        dx, dy = camera_displacement(turn, distance, 0.0, 0.0)
        x, y = x + math.cos(yaw) * dx - math.sin(yaw) * dy, y + math.sin(yaw) * dx + math.cos(yaw) * dy
        yaw += turn
        steps.append(odometry.process(picture(camera, x, y, yaw, k + 1), 1_000_000 + (k + 1) * STEP_US, distance))
        truth.append(turn)
    return steps, np.array(truth)


@pytest.mark.parametrize("mounting_deg", [0.0, 55.0, 110.0, 180.0, 250.0])
def test_pictures_of_a_drive(mounting_deg: float) -> None:
    steps, truth = drive(mounting_deg, [0.0, 0.0, 4.0, 6.0, 6.0, 6.0, 5.0, 5.0], [0, 0, 0, 3, 6, 9, 6, 3])
    tracking = np.array([step.state is State.TRACKING for step in steps])
    assert tracking[4:].all()
    estimate = np.array([step.yaw_increment_rad for step in steps])
    assert np.isnan(estimate[~tracking]).all()
    error = np.degrees(estimate - truth)[tracking]
    median, largest = (0.05, 0.15) if mounting_deg in (0.0, 180.0) else (0.12, 0.35)  # a side sees one flat wall
    assert np.median(np.abs(error)) < median
    assert np.max(np.abs(error)) < largest
    for step in steps[1:]:
        assert step.matches > 100
        assert 0.0 < step.residual_px < 1.0
        assert step.flow_px >= 0.0


def test_standstill_ends_initialising() -> None:
    camera = calibration()
    odometry = MonocularOdometry(camera)
    states = [odometry.process(picture(camera, 0, 0, 0, k), (k + 1) * STEP_US, 0.0).state for k in range(12)]
    assert states[:10] == [State.INITIALISING] * 10
    assert states[10:] == [State.TRACKING] * 2


def test_same_input_same_bits() -> None:
    first, _ = drive(55.0, [6.0] * 4, [8.0] * 4)
    second, _ = drive(55.0, [6.0] * 4, [8.0] * 4)
    assert repr(first) == repr(second)


class Ride:
    """Expert on a straight drive at 6 m/s that can be disturbed."""

    def __init__(self, images: int = 5) -> None:
        self.camera = calibration()
        self.odometry = MonocularOdometry(self.camera)
        self.k = 0
        self.steps = [self.next() for _ in range(images)]
        assert self.steps[-1].state is State.TRACKING

    def image(self) -> np.ndarray:
        return picture(self.camera, 0.5 * self.k, 0.0, 0.0, self.k)

    def next(self, image: np.ndarray | None = None, skip: int = 0) -> CameraStep:
        self.k += 1 + skip
        image = self.image() if image is None else image
        step = self.odometry.process(image, self.k * STEP_US, 0.5 * (1 + skip))
        assert math.isnan(step.yaw_increment_rad) == (step.state is not State.TRACKING)
        assert math.isnan(step.yaw_std_rad) == (step.state is not State.TRACKING)
        return step


@pytest.mark.parametrize(
    "picture_of_nothing",
    [
        np.zeros((HEIGHT, WIDTH), np.uint8),
        np.full((HEIGHT, WIDTH), 255, np.uint8),
        np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8),
    ],
    ids=["black", "white", "noise"],
)
def test_lost_and_found(picture_of_nothing: np.ndarray) -> None:
    ride = Ride()
    assert ride.next(picture_of_nothing).state is State.LOST
    assert ride.next().state is State.LOST  # the pair still holds the bad image
    assert ride.next().state is State.INITIALISING
    assert ride.next().state is State.TRACKING


def test_black_from_the_start() -> None:
    odometry = MonocularOdometry(calibration())
    for k in range(30):
        step = odometry.process(np.zeros((HEIGHT, WIDTH), np.uint8), k + 1, 0.0)
        assert step.state is not State.TRACKING
        assert step.matches == 0


def test_frozen_camera_is_lost_not_straight_ahead() -> None:
    ride = Ride()
    frozen = ride.image()
    for _ in range(12):
        assert ride.next(frozen).state is State.LOST
    assert [ride.next().state for _ in range(3)] == [State.LOST, State.INITIALISING, State.TRACKING]


def test_dropped_frames() -> None:
    ride = Ride()
    assert ride.next(skip=1).state is State.TRACKING  # one frame missing is bridged
    assert ride.next(skip=12).state is State.LOST  # a second is not
    assert ride.next().state is State.INITIALISING


@pytest.mark.parametrize(("height", "width"), [(1, 1), (8, 8), (40, 60), (64, 64), (70, 90)])
def test_tiny_images(height: int, width: int) -> None:
    odometry = MonocularOdometry(calibration(width=width, height=height))
    rng = np.random.default_rng(0)
    for k in range(4):
        step = odometry.process(rng.integers(0, 256, (height, width), dtype=np.uint8), k + 1, 0.3)
        assert step.state is not State.TRACKING


@pytest.mark.parametrize(
    ("image", "word"),
    [
        (np.zeros((HEIGHT, WIDTH), np.uint16), "uint16"),
        (np.zeros((HEIGHT, WIDTH, 3), np.uint8), "grey"),
        (np.zeros((HEIGHT, WIDTH + 2), np.uint8), "as calibrated"),
        (None, "NoneType"),
    ],
)
def test_wrong_image_is_one_clear_line(image: np.ndarray, word: str) -> None:
    odometry = MonocularOdometry(calibration())
    with pytest.raises(DatasetError, match=word) as caught:
        odometry.process(image, 1, 0.0)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("timestamp_us", [5, 4])
def test_time_must_increase(timestamp_us: int) -> None:
    odometry = MonocularOdometry(calibration())
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    odometry.process(image, 5, 0.0)
    with pytest.raises(DatasetError, match="must increase"):
        odometry.process(image, timestamp_us, 0.0)


@pytest.mark.parametrize("distance_m", [math.nan, math.inf])
def test_distance_must_be_finite(distance_m: float) -> None:
    odometry = MonocularOdometry(calibration())
    with pytest.raises(DatasetError, match="finite"):
        odometry.process(np.zeros((HEIGHT, WIDTH), np.uint8), 1, distance_m)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"intrinsic": np.empty((0, 0))}, "intrinsics"),
        ({"intrinsic": np.full((3, 3), np.nan)}, "finite"),
        ({"rotation_ego_from_camera": -AXES}, "left-handed"),
        ({"rotation_ego_from_camera": 2.0 * AXES}, "orthonormal"),
        ({"translation_m": np.array([0.0, np.nan, 0.0])}, "translation"),
        ({"width": 0}, "size"),
    ],
)
def test_wrong_calibration_is_one_clear_line(changes: dict[str, object], word: str) -> None:
    with pytest.raises(DatasetError, match=word):
        MonocularOdometry(calibration(**changes))  # type: ignore[arg-type]


def test_settings_are_checked() -> None:
    with pytest.raises(ConfigurationError, match="did you mean 'fast'"):
        MonocularConfig.preset("fats")
    with pytest.raises(ConfigurationError, match="features"):
        MonocularConfig(features=0)
    with pytest.raises(ConfigurationError, match="scale_factor"):
        MonocularConfig(scale_factor=1.0)
    assert MonocularConfig.preset("fast") == MonocularConfig()


def kitti() -> tuple[CameraCalibration, list[np.ndarray], np.ndarray, np.ndarray]:
    """51 real images, distances with 2 % noise, true yaw increments [rad]."""
    folder = Path(os.environ["MIXO_REAL_DATA"]) / "kitti_06"
    intrinsic = np.array((folder / "calib.txt").read_text().splitlines()[0].split(), float).reshape(3, 4)[:, :3]
    pose = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted((folder / "image_0").glob("*.png"))]
    height, width = images[0].shape
    camera = CameraCalibration("CAM_FRONT", intrinsic, AXES, np.array([1.1, 0.0, 1.65]), width, height)
    chord = np.linalg.norm(np.diff(pose[:, :, 3], axis=0), axis=1)
    distance = chord * (1.0 + 0.02 * np.random.default_rng(0).standard_normal(len(chord)))
    turn = np.array([a[:, :3].T @ b[:, :3] for a, b in itertools.pairwise(pose)])
    return camera, images, distance, -np.arctan2(turn[:, 0, 2], turn[:, 2, 2])


@pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="MIXO_REAL_DATA is not set")
def test_real_road(capsys: pytest.CaptureFixture[str]) -> None:
    camera, images, distance, truth = kitti()
    odometry = MonocularOdometry(camera)
    odometry.process(images[0], 1, 0.0)
    steps = [
        odometry.process(image, 1 + 103_650 * (k + 1), s)
        for k, (image, s) in enumerate(zip(images[1:], distance, strict=True))
    ]
    assert State.LOST not in [step.state for step in steps]
    tracking = np.array([step.state is State.TRACKING for step in steps])
    assert tracking[2:].all()
    error = np.degrees(np.array([step.yaw_increment_rad for step in steps]) - truth)[tracking]
    still = np.degrees(truth)[tracking]
    rms, rms_still = (float(np.sqrt(np.mean(np.square(e)))) for e in (error, still))
    with capsys.disabled():
        print(
            f"\n51 real images: yaw increment error median {np.median(np.abs(error)):.4f} deg, RMS {rms:.4f} deg, "
            f"accumulated {error.sum():+.3f} deg, skill against zero yaw {1.0 - rms / rms_still:+.3f}"
        )
    assert np.median(np.abs(error)) < 0.02
    assert rms < rms_still


@pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="MIXO_REAL_DATA is not set")
def test_real_road_at_two_images_a_second() -> None:
    """With the corners of images that follow closely one step was wrong by -.70 deg, its increment by -.25."""
    camera, images, distance, truth = kitti()
    errors = []
    for first in range(11, 16):  # the truth of earlier frames is interpolated
        odometry = MonocularOdometry(camera)
        odometry.process(images[first], 1, 0.0)
        for a, b in itertools.pairwise(range(first, len(images), 5)):
            step = odometry.process(images[b], 1 + 103_650 * (b - first), distance[a:b].sum())
            yaws = np.array([step.yaw_increment_rad, step.two_frame_yaw_increment_rad])
            errors.append(np.degrees(yaws - truth[a:b].sum()))
    assert np.nanmax(np.abs(errors)) < 0.15
    assert np.sqrt(np.nanmean(np.square(errors))) < 0.03


def test_images_that_are_far_apart_get_more_corners_and_those_around_them_do_not() -> None:
    rng = np.random.default_rng(5)
    image = np.asarray(cv2.GaussianBlur(rng.integers(0, 255, (300, 400), np.uint8), (0, 0), 1.0), np.uint8)
    solver = MonocularOdometry(calibration(0.0), MonocularConfig(features=300, features_apart=900))._solver
    first, second = solver.frame(image), solver.frame(image)
    assert len(first.position_px) <= 330
    near, far, again = (solver.compare(first, second, gap_s, 0.0).matches for gap_s in (0.25, 0.5, 0.25))
    assert near == again <= 330
    assert far >= 2 * near


def test_what_two_images_say_does_not_depend_on_how_long_ago_the_one_before_them_was() -> None:
    camera = calibration(0.0)
    steps = []
    for gap_us in (83_333, 500_000):
        odometry = MonocularOdometry(camera)
        odometry.process(picture(camera, 0.0, 0.0, 0.0), 1_000_000, 0.0)
        odometry.process(picture(camera, 0.4, 0.0, 0.004, 1), 1_000_000 + gap_us, 0.4)
        step = odometry.process(picture(camera, 0.8, 0.0, 0.008, 2), 1_083_333 + gap_us, 0.4)
        steps.append(step.two_frame_yaw_increment_rad)
    assert np.isfinite(steps).all()
    assert steps[0] == steps[1]


def test_the_residual_is_reported_in_pixels_of_the_full_image(monkeypatch: pytest.MonkeyPatch) -> None:
    """Motions come on the image plane (unit focal length); what is recorded is that times the focal length."""
    camera = calibration(0.0)
    solve = pair.estimate_motion

    def with_known_residual(*arguments: Any) -> Any:
        found = solve(*arguments)
        return None if found is None else replace(found, residual=0.001)

    monkeypatch.setattr(pair, "estimate_motion", with_known_residual)
    odometry = MonocularOdometry(camera)
    odometry.process(picture(camera, 0.0, 0.0, 0.0), 1_000_000, 0.0)
    step = odometry.process(picture(camera, 0.4, 0.0, 0.0, 1), 1_083_333, 0.4)
    focal = 0.5 * (camera.intrinsic[0, 0] + camera.intrinsic[1, 1])
    assert step.residual_px == pytest.approx(0.001 * focal)
