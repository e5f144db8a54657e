"""Everything that can go wrong in a long run of the single-camera expert, in random order and with both presets."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.monocular.config import PRESETS, MonocularConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.scene import CameraCalibration
from tests.corridor import HEIGHT, WIDTH, calibration, picture

Image = NDArray[np.uint8]

STEP_US, STEP_M, PICTURES = 83_333, 0.4, 24
SMALL = {"fast": replace(PRESETS["fast"], features=500), "paper": replace(PRESETS["paper"], features=1500, levels=6)}
"""The presets with fewer features, as suits pictures of half the size."""


@cache
def camera() -> CameraCalibration:
    """Camera of the corridor at half its size."""
    full = calibration()
    intrinsic = full.intrinsic / 2.0
    intrinsic[:2, 2] -= 0.25
    intrinsic[2, 2] = 1.0
    return replace(full, intrinsic=intrinsic, width=WIDTH // 2, height=HEIGHT // 2)


@cache
def street() -> tuple[Image, ...]:
    """Pictures along a straight drive, ``STEP_M`` apart."""
    return tuple(
        np.asarray(cv2.resize(picture(calibration(), STEP_M * k, 0.0, 0.0, k), None, fx=0.5, fy=0.5,
                              interpolation=cv2.INTER_AREA), np.uint8)
        for k in range(PICTURES)
    )  # fmt: skip


class Shuttle:
    """Drives up and down the street for ever; what a test does to an image or a message is up to the test."""

    def __init__(self, config: MonocularConfig) -> None:
        self.odometry = MonocularOdometry(camera(), config)
        self.config = config
        self.place, self.direction, self.timestamp_us = 0, 1, 1_600_000_000_000_000
        self.pending_m, self.pending_us = 0.0, 0

    def drive(self) -> Image:
        """The next image, which the expert may or may not be shown."""
        if not 0 <= self.place + self.direction < PICTURES:
            self.direction = -self.direction
        self.place += self.direction
        self.timestamp_us += STEP_US
        self.pending_us += STEP_US
        self.pending_m += STEP_M * self.direction
        return street()[self.place]

    def show(self, image: Image, scale: float = 1.0) -> CameraStep:
        """Show an image of the present place and check everything that must always hold."""
        step = self.odometry.process(image, self.timestamp_us, scale * self.pending_m)
        tracking = step.state is State.TRACKING
        assert math.isfinite(step.yaw_increment_rad) == math.isfinite(step.yaw_std_rad) == tracking
        if tracking:
            limit = self.config.max_curvature_radpm * abs(scale * self.pending_m) + self.config.standing_yaw_rad
            assert abs(step.yaw_increment_rad) <= 1.2 * limit
            assert 0.0 < step.yaw_std_rad <= self.config.max_yaw_std_rad
            assert step.matches >= self.config.min_matches
            assert math.isfinite(step.residual_px)
        assert step.state in (State.INITIALISING, State.TRACKING, State.LOST)
        assert 0 <= step.inliers <= step.matches
        assert step.matches == 0 or step.flow_px >= 0.0
        self.pending_m, self.pending_us = 0.0, 0
        return step


def _half_covered(image: Image, rng: np.random.Generator) -> Image:
    covered = image.copy()
    covered[:, : int(rng.integers(1, image.shape[1]))] = 0
    return covered


def _flickering(image: Image, rng: np.random.Generator) -> Image:
    return np.clip(image * rng.uniform(0.2, 2.0), 0, 255).astype(np.uint8)


def _snowing(image: Image, rng: np.random.Generator) -> Image:
    return np.where(rng.random(image.shape) < 0.2, np.uint8(255), image)


WORLD: dict[str, Callable[[Image, np.random.Generator], Image]] = {
    "black": lambda image, rng: np.zeros_like(image),
    "constant": lambda image, rng: np.full_like(image, rng.integers(256)),
    "noise": lambda image, rng: rng.integers(0, 256, image.shape, dtype=np.uint8),
    "upside down": lambda image, rng: np.ascontiguousarray(image[::-1, ::-1]),
    "another place": lambda image, rng: street()[rng.integers(PICTURES)],
    "half covered": _half_covered,
    "flickering": _flickering,
    "snowing": _snowing,
}
"""What the world does to an image: LOST is fine, an error is not."""

MISUSE: dict[str, Callable[[Image], object]] = {
    "16 bit": lambda image: image.astype(np.uint16),
    "colour": lambda image: np.stack([image] * 3, axis=-1),
    "another size": lambda image: np.ascontiguousarray(image[:, :-2]),
    "no image": lambda image: None,
}
"""What a caller does wrong: an error, after which the run goes on."""


def long_run(seed: int, config: MonocularConfig, images: int) -> list[CameraStep]:
    """Three images in four are as they should be, the others suffer a fault of random kind and length."""
    rng = np.random.default_rng(seed)
    shuttle, steps = Shuttle(config), []
    while len(steps) < images:
        image = shuttle.drive()
        fault = rng.choice(["none"] * 45 + list(WORLD) + ["misuse", "repeated", "frozen", "dropped", "jump", "wheels"])
        if fault == "misuse":
            with pytest.raises(DatasetError):
                shuttle.odometry.process(MISUSE[rng.choice(list(MISUSE))](image), shuttle.timestamp_us, 0.0)  # type: ignore[arg-type]
            with pytest.raises(DatasetError):
                shuttle.odometry.process(image, shuttle.timestamp_us, math.nan)
            steps.append(shuttle.show(image))
        elif fault == "repeated":
            steps.append(shuttle.show(image))
            for too_late_us in (0, 1, 10_000_000):
                with pytest.raises(DatasetError, match="must increase"):
                    shuttle.odometry.process(image, shuttle.timestamp_us - too_late_us, 0.1)
        elif fault == "frozen":
            steps.append(shuttle.show(image))
            for _ in range(rng.integers(1, 13)):
                shuttle.drive()
                steps.append(shuttle.show(image))
                assert steps[-1].state is State.LOST
        elif fault == "dropped":
            for _ in range(rng.integers(1, 13)):
                shuttle.drive()
        elif fault == "jump":
            shuttle.timestamp_us += int(rng.integers(1, 3_600_000_000))
            steps.append(shuttle.show(image))
        elif fault == "wheels":
            steps.append(shuttle.show(image, scale=rng.uniform(-3.0, 3.0)))
        else:
            steps.append(shuttle.show(WORLD[fault](image, rng) if fault in WORLD else image))
    for _ in range(6):
        steps.append(shuttle.show(shuttle.drive()))
    assert steps[-1].state is State.TRACKING
    return steps


@pytest.mark.parametrize(("preset", "seed", "images"), [("fast", 0, 250), ("fast", 1, 250), ("paper", 2, 60)])
def test_long_run_of_random_faults(preset: str, seed: int, images: int) -> None:
    steps = long_run(seed, SMALL[preset], images)
    states = [step.state for step in steps]
    assert states.count(State.TRACKING) > 0.3 * len(states)
    assert states.count(State.LOST) > 0.1 * len(states)


def test_a_long_run_is_deterministic() -> None:
    assert repr(long_run(3, SMALL["fast"], 60)) == repr(long_run(3, SMALL["fast"], 60))


@pytest.mark.parametrize("preset", SMALL)
@pytest.mark.parametrize("fault", ["black", "constant", "noise", "upside down"])
def test_both_presets_are_lost_and_find_again(preset: str, fault: str) -> None:
    shuttle = Shuttle(SMALL[preset])
    assert [shuttle.show(shuttle.drive()).state for _ in range(4)][-1] is State.TRACKING
    assert shuttle.show(WORLD[fault](shuttle.drive(), np.random.default_rng(0))).state is State.LOST
    states = [shuttle.show(shuttle.drive()).state for _ in range(4)]
    assert states[0] is State.LOST  # the pair still holds the bad image
    assert states[-1] is State.TRACKING


@pytest.mark.parametrize("preset", SMALL)
@pytest.mark.parametrize("misuse", MISUSE)
def test_misuse_in_the_middle_of_a_run_changes_nothing(preset: str, misuse: str) -> None:
    """The message is one line, and the next image goes on as if nothing had happened."""
    plain, disturbed = Shuttle(SMALL[preset]), Shuttle(SMALL[preset])
    states = []
    for k in range(5):
        step, image = plain.show(plain.drive()), disturbed.drive()
        if k == 3:
            with pytest.raises(DatasetError, match=r"^CAM_TEST: image must be [^\n]*$"):
                disturbed.odometry.process(MISUSE[misuse](image), disturbed.timestamp_us, 0.0)  # type: ignore[arg-type]
        assert repr(disturbed.show(image)) == repr(step)
        states.append(step.state)
    assert states[-1] is State.TRACKING


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("height", "width"), [(1, 1), (40, 60), (70, 90)])
def test_tiny_images_of_both_presets(preset: str, height: int, width: int) -> None:
    odometry = MonocularOdometry(calibration(width=width, height=height), PRESETS[preset])
    rng = np.random.default_rng(0)
    for k in range(3):
        step = odometry.process(rng.integers(0, 256, (height, width), dtype=np.uint8), k + 1, 0.3)
        assert step.state is not State.TRACKING
