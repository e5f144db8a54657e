"""One camera as the motion solver sees it: checked calibration, working resolution, pixels to the image plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.scene import CameraCalibration

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class MountedCamera:
    """Calibration reduced to what odometry needs.

    Attributes:
        channel: name for messages.
        full_shape: ``(height, width)`` of the calibrated image.
        working_shape: ``(height, width)`` after ``halvings`` halvings.
        halvings: how often the image is halved before work starts.
        focal_px: ``(2,)`` fx, fy of the full image.
        skew_px: K[0, 1] of the full image.
        centre_px: ``(2,)`` cx, cy of the full image.
        rotation: ``(3, 3)`` ego from camera.
        position_m: ``(3,)`` camera in the ego frame (the rear axle on the ground is its origin).
    """

    channel: str
    full_shape: tuple[int, int]
    working_shape: tuple[int, int]
    halvings: int
    focal_px: FloatArray
    skew_px: float
    centre_px: FloatArray
    rotation: FloatArray
    position_m: FloatArray

    @property
    def pixel_size(self) -> float:
        """Size of one working pixel on the image plane at unit focal length (an angle near the axis) [rad]."""
        return float(2**self.halvings / np.mean(self.focal_px))

    def shrink(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image at working resolution, as an array of its own; one that has it already is copied."""
        if image.shape == self.working_shape:
            return image.copy()
        height, width = self.working_shape
        factor = 2**self.halvings
        cut = image[: height * factor, : width * factor]
        return np.asarray(cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def plane(self, working_px: NDArray[np.floating]) -> FloatArray:
        """Image-plane coordinates ``(n, 2)`` (x right, y down, unit focal length) of working pixels ``(n, 2)``."""
        scale = 2.0**self.halvings
        full = (np.asarray(working_px, dtype=np.float64) + 0.5) * scale - 0.5
        y = (full[:, 1] - self.centre_px[1]) / self.focal_px[1]
        x = (full[:, 0] - self.centre_px[0] - self.skew_px * y) / self.focal_px[0]
        return np.stack([x, y], axis=1)


def mount(calibration: CameraCalibration, max_pixels: int | None) -> MountedCamera:
    """Check a calibration and fix the working resolution.

    Args:
        calibration: of the camera, as the tables give it.
        max_pixels: halve until the image has at most so many pixels; ``None`` never halves.

    Raises:
        DatasetError: intrinsics missing or not a pinhole matrix, extrinsics not a right-handed rotation, no image size.
    """
    name = calibration.channel
    intrinsic = np.asarray(calibration.intrinsic, dtype=np.float64)
    if intrinsic.shape != (3, 3):
        raise DatasetError(
            f"{name}: intrinsics must be a 3 x 3 matrix, got shape {intrinsic.shape}: see calibrated_sensor.json"
        )
    focal = np.array([intrinsic[0, 0], intrinsic[1, 1]])
    if not np.isfinite(intrinsic).all() or (focal <= 0.0).any() or not np.allclose(intrinsic[2], [0.0, 0.0, 1.0]):
        raise DatasetError(
            f"{name}: intrinsics must be finite with positive focal lengths and last row 0 0 1, "
            f"got {intrinsic.tolist()}: check calibrated_sensor.json"
        )
    rotation = np.asarray(calibration.rotation_ego_from_camera, dtype=np.float64)
    if (
        rotation.shape != (3, 3)
        or not np.isfinite(rotation).all()
        or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
    ):
        raise DatasetError(
            f"{name}: rotation_ego_from_camera must be an orthonormal 3 x 3 matrix: check calibrated_sensor.json"
        )
    if np.linalg.det(rotation) < 0.0:
        raise DatasetError(
            f"{name}: rotation_ego_from_camera is left-handed: camera axes must be x right, y down, z forward"
        )
    position = np.asarray(calibration.translation_m, dtype=np.float64)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise DatasetError(
            f"{name}: translation_m must be 3 finite numbers, got {position.tolist()}: see calibrated_sensor.json"
        )
    height, width = int(calibration.height), int(calibration.width)
    if height <= 0 or width <= 0:
        raise DatasetError(f"{name}: image size must be positive, got {width} x {height}: check sample_data.json")
    halvings, working = 0, (height, width)
    while max_pixels is not None and working[0] * working[1] > max_pixels:
        halvings, working = halvings + 1, (working[0] // 2, working[1] // 2)
    return MountedCamera(
        name,
        (height, width),
        working,
        halvings,
        focal,
        float(intrinsic[0, 1]),
        intrinsic[:2, 2].copy(),
        rotation.copy(),
        position.copy(),
    )


def check_input(
    camera: MountedCamera, image: NDArray[np.uint8], timestamp_us: int, last_us: int | None, distance_m: float
) -> None:
    """Check what an odometry of ``camera`` is given.

    Args:
        camera: checked.
        image: must be ``(height, width)`` grey uint8, of the calibrated or the working size.
        timestamp_us: must be later than ``last_us``.
        last_us: of the image before; ``None`` for the first.
        distance_m: since then; must be finite.

    Raises:
        DatasetError: for anything else.
    """
    name = camera.channel
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 2:
        kind = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise DatasetError(f"{name}: image must be grey uint8 (height, width), got {kind}: convert it first")
    if image.shape not in (camera.full_shape, camera.working_shape):
        raise DatasetError(
            f"{name}: image must be {camera.full_shape[1]} x {camera.full_shape[0]} as calibrated, "
            f"got {image.shape[1]} x {image.shape[0]}: one calibration fits one image size"
        )
    if last_us is not None and timestamp_us <= last_us:
        raise DatasetError(f"{name}: image times must increase, got {timestamp_us} after {last_us}: sort them")
    if not math.isfinite(distance_m):
        raise DatasetError(f"{name}: distance must be finite, got {distance_m} m: check the wheel speeds")
