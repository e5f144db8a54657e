"""What odometry needs of one nuScenes scene, as plain arrays.

A real folder and a simulated one become the same :class:`Scene`. Times stay integer Unix microseconds; positions are
metres on the log's map; yaw is anticlockwise positive. Each image carries the ego pose of its own instant.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import SupportsIndex, overload

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class CameraCalibration:
    """Pinhole camera (images are undistorted) and its mounting on the car.

    Attributes:
        channel: nuScenes channel, e.g. ``"CAM_FRONT"``.
        intrinsic: ``(3, 3)`` pixel matrix K at ``width`` x ``height``.
        rotation_ego_from_camera: ``(3, 3)``; camera axes x right, y down, z forward; ego axes x forward, y left, z up.
        translation_m: ``(3,)`` camera centre in the ego frame (origin: rear-axle centre on the ground).
        width: image width in pixels.
        height: image height in pixels.
    """

    channel: str
    intrinsic: FloatArray
    rotation_ego_from_camera: FloatArray
    translation_m: FloatArray
    width: int
    height: int


class ImagePaths(Sequence[Path]):
    """Absolute paths of images, made when asked for: a data set names 800,000 files, and few of them are opened.

    Args:
        root: folder of the data set.
        names: relative to it.
    """

    def __init__(self, root: Path, names: Sequence[str]) -> None:
        self._root, self._names = root, tuple(names)

    def __len__(self) -> int:
        """Number of images."""
        return len(self._names)

    @overload
    def __getitem__(self, key: SupportsIndex) -> Path: ...
    @overload
    def __getitem__(self, key: slice) -> ImagePaths: ...
    def __getitem__(self, key: SupportsIndex | slice) -> Path | ImagePaths:
        """One path, or those of a slice."""
        if isinstance(key, slice):
            return ImagePaths(self._root, self._names[key])
        return self._root / self._names[key]

    def __eq__(self, other: object) -> bool:
        """The same paths in the same order."""
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]

    def texts(self) -> Iterator[str]:
        """The paths as text."""
        folder = f"{self._root}{os.sep}"
        return (folder + name for name in self._names)


@dataclass(frozen=True)
class CameraReel:
    """All images of one camera in one scene in time order, key frames and sweeps alike, with their ego poses.

    Attributes:
        calibration: of this camera in this scene.
        timestamp_us: ``(n,)`` exposure time.
        image_paths: ``n`` absolute paths.
        is_keyframe: ``(n,)`` bool.
        x_m, y_m, yaw_rad: ``(n,)`` ego pose (rear axle, map frame) at each image's own time; yaw not unwrapped.
    """

    calibration: CameraCalibration
    timestamp_us: IntArray
    image_paths: Sequence[Path]
    is_keyframe: NDArray[np.bool_]
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray

    def image_files(self) -> list[str]:
        """``image_paths`` as text, for what looks at all of them."""
        paths = self.image_paths
        return list(paths.texts() if isinstance(paths, ImagePaths) else map(os.fspath, paths))


@dataclass(frozen=True)
class Signal:
    """One CAN quantity over time: ``(n,)`` times and ``(n,)`` or ``(n, c)`` values in SI units."""

    timestamp_us: IntArray
    value: FloatArray


@dataclass(frozen=True)
class CanBus:
    """CAN bus of one scene in SI units; ``None`` where the message is missing.

    Attributes:
        wheel_speed_radps: ``zoe_veh_info``; ``(n, 4)`` FL, FR, RL, RR angular speed; stamped on arrival.
        imu_yaw_rate_radps: ``ms_imu.rotation_rate[2]``.
        pose_speed_mps: ``pose.vel[0]`` (shares the estimator of the ground truth: only for the paper's setting).
        pose_yaw_rate_radps: ``pose.rotation_rate[2]``.
        monitor_yaw_rate_radps: ``vehicle_monitor.yaw_rate`` converted from deg/s; 2 Hz, biased on real data.
        monitor_speed_mps: ``vehicle_monitor.vehicle_speed`` converted from km/h.
        steering_wheel_rad: ``steeranglefeedback``; the steering wheel, positive left.
        consumer_yaw_rate_radps: a production-grade gyro (only simulated folders have one).
    """

    wheel_speed_radps: Signal | None = None
    imu_yaw_rate_radps: Signal | None = None
    pose_speed_mps: Signal | None = None
    pose_yaw_rate_radps: Signal | None = None
    monitor_yaw_rate_radps: Signal | None = None
    monitor_speed_mps: Signal | None = None
    steering_wheel_rad: Signal | None = None
    consumer_yaw_rate_radps: Signal | None = None


@dataclass(frozen=True)
class ExactPoses:
    """Noise-free truth that only a simulator has: dense poses of the rear axle, kept apart from the tables."""

    timestamp_us: IntArray
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray


@dataclass(frozen=True)
class Scene:
    """One scene: about 20 s of one drive.

    Attributes:
        name: e.g. ``"scene-0061"``.
        description: free text of the table; the source of ``conditions``.
        log: ``logfile`` of the drive, e.g. ``"n015-2018-07-24-11-22-45+0800"``: the unit of folds and bootstrap.
        vehicle: e.g. ``"n015"``.
        location: e.g. ``"singapore-onenorth"``.
        conditions: subset of ``{"day", "night", "rain"}``, always with one of day and night.
        cameras: by channel.
        can_bus: ``None`` when the scene has none.
        exact: only from a simulator.
    """

    name: str
    description: str
    log: str
    vehicle: str
    location: str
    conditions: tuple[str, ...]
    cameras: dict[str, CameraReel]
    can_bus: CanBus | None
    exact: ExactPoses | None = None
