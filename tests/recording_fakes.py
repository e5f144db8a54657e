"""Small scenes with tiny pictures, and experts simple enough to check by hand, for tests of recording."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import cv2
import numpy as np
import simplejpeg

from mixo_env.errors import DatasetError
from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.inertial import InertialEstimate
from mixo_env.nuscenes.scene import CameraCalibration, CameraReel, CanBus, ExactPoses, Scene, Signal
from mixo_env.nuscenes.selections import CAMERA_OFFSET_US, CAMERAS, LIDAR_PERIOD_US
from mixo_env.recordings.steps import Experts
from tests.nuscenes_fixture import SceneTruth

START_US = 1_600_000_000_000_000
SPEED_MPS, YAW_RATE_RADPS = 6.0, 0.25
CELLS = np.cumsum([0, 2, 2, 1, 2, 2, 1, 2, 2, 1, 2, 2])
DROPPED = {("CAM_BACK", 4), ("CAM_FRONT", 7)}


def write_picture(path: Path, level: float) -> None:
    """A grey JPEG of one level."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(simplejpeg.encode_jpeg(np.full((9, 16, 1), level, np.uint8), colorspace="GRAY"))


def drive(timestamp_us: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y, yaw on a circle at constant speed."""
    t = 1e-6 * (timestamp_us - START_US)
    yaw, radius = 3.0 + YAW_RATE_RADPS * t, SPEED_MPS / YAW_RATE_RADPS
    return 100.0 + radius * np.sin(yaw), 50.0 - radius * np.cos(yaw), yaw


def make_scene(folder: Path, name: str = "scene-2001", log: str = "log-0", conditions=("day",), seed: int = 0) -> Scene:
    """Twelve firing rounds with two dropped frames; picture levels are random, one in five is dark."""
    rng = np.random.default_rng([seed, len(name), int(name[-2:])])
    cameras = {}
    for camera in CAMERAS:
        kept = np.array([k for k in range(len(CELLS)) if (camera, k) not in DROPPED])
        stamps = (
            START_US + CELLS[kept] * LIDAR_PERIOD_US + CAMERA_OFFSET_US[camera] + rng.integers(-200, 200, len(kept))
        )
        paths = tuple(folder / name / camera / f"{stamp}.jpg" for stamp in stamps)
        for path in paths:
            write_picture(path, 10 if rng.uniform() < 0.2 else rng.integers(60, 250))
        x, y, yaw = drive(stamps)
        mounting = CameraCalibration(camera, np.eye(3), np.eye(3), np.zeros(3), 16, 9)
        wrapped = np.arctan2(np.sin(yaw), np.cos(yaw))
        cameras[camera] = CameraReel(mounting, stamps, paths, kept % 6 == 0, x, y, wrapped)
    times = np.arange(START_US - 100_000, START_US + 1_200_000, 10_000)
    wheels = Signal(times, np.full((len(times), 4), SPEED_MPS / 0.305) + 0.01 * rng.standard_normal((len(times), 4)))
    gyro = Signal(times + 3_000, YAW_RATE_RADPS + 0.01 * rng.standard_normal(len(times)))
    dense = np.arange(START_US - 50_000, START_US + 1_000_000, 1_000)
    return Scene(
        name, "", log, "n099", "city", conditions, cameras, CanBus(wheels, gyro, consumer_yaw_rate_radps=gyro),
        ExactPoses(dense, *drive(dense)),
    )  # fmt: skip


@dataclass
class FakeDataset:
    """Scenes in memory."""

    scenes: dict[str, Scene]
    version: str = "v1.0-fake"
    broken: dict[str, str] = field(default_factory=dict)

    @property
    def scene_names(self) -> tuple[str, ...]:
        return tuple(self.scenes)

    def load(self, name: str, cameras: tuple[str, ...]) -> Scene:
        if name in self.broken:
            raise DatasetError(self.broken[name])
        scene = self.scenes[name]
        return replace(scene, cameras={camera: scene.cameras[camera] for camera in cameras})


class FakeCamera:
    """The increment is the change of the mean grey level plus a thousandth of the distance; dark means LOST."""

    halvings = 0

    def __init__(self, calibration: CameraCalibration) -> None:
        self.previous = math.nan

    def process(self, image: np.ndarray, timestamp_us: int, distance_m: float) -> CameraStep:
        level, previous = float(image.mean()), self.previous
        self.previous = level
        if math.isnan(previous):
            return CameraStep(State.INITIALISING, math.nan, math.nan, 0, 0, math.nan, math.nan, math.nan)
        yaw = 1e-3 * (level - previous) + 1e-3 * distance_m
        state = State.LOST if level < 30 else State.TRACKING
        own = yaw if state == State.TRACKING else math.nan
        return CameraStep(state, own, 0.1 * own, int(level), int(level / 2), 0.5, abs(level - previous), 2 * yaw)


class FakeInertial:
    """Every message moves the car on by 10 ms of its value; between messages nothing happens."""

    def __init__(self, can_bus: CanBus, grade: str) -> None:
        gyro = {
            "INERTIAL": can_bus.imu_yaw_rate_radps,
            "INERTIAL_POSE": can_bus.pose_yaw_rate_radps,
            "INERTIAL_CONSUMER": can_bus.consumer_yaw_rate_radps,
        }[grade]
        if gyro is None or can_bus.wheel_speed_radps is None:
            raise DatasetError(f"{grade} needs its messages")
        self.gyro, self.wheels = gyro, can_bus.wheel_speed_radps

    def at(self, timestamps_us: np.ndarray) -> InertialEstimate:
        assert np.all(np.diff(timestamps_us) > 0)
        speed = 0.305 * self.wheels.value.mean(axis=1)
        seen = np.searchsorted(self.wheels.timestamp_us, timestamps_us, side="right")
        turned = np.searchsorted(self.gyro.timestamp_us, timestamps_us, side="right")
        return InertialEstimate(
            distance_m=np.concatenate([[0.0], np.cumsum(0.01 * speed)])[seen],
            speed_mps=speed[seen - 1],
            yaw_rad=np.concatenate([[0.0], np.cumsum(0.01 * self.gyro.value)])[turned],
            yaw_rate_radps=self.gyro.value[turned - 1],
            yaw_variance_rad2=1e-8 * turned,
        )


FAKES = Experts(FakeCamera, FakeInertial)


def write_sliding_texture(root: Path, truth: dict[str, SceneTruth]) -> None:
    """Pictures for a folder of ``write_nuscenes``: every camera sees one texture that slides to the right."""
    noise = np.random.default_rng(0).integers(0, 256, (60, 120), np.uint8)
    texture = cv2.resize(noise, (2400, 900), interpolation=cv2.INTER_CUBIC)
    for scene in truth.values():
        for camera in scene.cameras.values():
            for i, name in enumerate(camera.filenames):
                picture = np.ascontiguousarray(texture[:, 400 - 10 * i : 2000 - 10 * i, None])
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                (root / name).write_bytes(simplejpeg.encode_jpeg(picture, quality=70, colorspace="GRAY"))


def with_another_future(scene: Scene, t_us: int) -> Scene:
    """The scene with every image and every CAN message after ``t_us`` changed, and the last two messages gone."""
    cameras = {}
    for camera, reel in scene.cameras.items():
        paths = list(reel.image_paths)
        for i in np.flatnonzero(reel.timestamp_us > t_us):
            picture = simplejpeg.decode_jpeg(paths[i].read_bytes(), colorspace="GRAY")
            paths[i] = paths[i].with_suffix(".other.jpg")
            flipped = np.ascontiguousarray(255 - picture[::-1])
            paths[i].write_bytes(simplejpeg.encode_jpeg(flipped, colorspace="GRAY"))
        cameras[camera] = replace(reel, image_paths=tuple(paths))
    assert scene.can_bus is not None
    can_bus = CanBus(*(_with_another_future(getattr(scene.can_bus, field.name), t_us) for field in fields(CanBus)))
    return replace(scene, cameras=cameras, can_bus=can_bus)


def _with_another_future(signal: Signal | None, t_us: int) -> Signal | None:
    if signal is None:
        return None
    later = signal.timestamp_us > t_us
    value = signal.value.copy()
    value[later] = 1.5 * value[later] + 0.3
    keep = ~later
    keep[:-2] = True
    return Signal(signal.timestamp_us[keep], value[keep])
