"""The six-camera rig of the nuScenes car: nominal calibration, one car's true one, and the one written to disk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import rotation_from_quaternion_wxyz
from mixo_env.nuscenes.scene import CameraCalibration
from mixo_env.nuscenes.selections import ALL_CAMERAS

FloatArray = NDArray[np.float64]

FULL_WIDTH, FULL_HEIGHT = 1600, 900

# Translation x, y, z [m]; rotation w, x, y, z; focal length, cx, cy [px at 1600 x 900]: NUSCENES.md section 6.
_NOMINAL: dict[str, tuple[tuple[float, ...], tuple[float, ...], tuple[float, float, float]]] = {
    "CAM_FRONT": ((1.701, 0.016, 1.511), (0.4998, -0.5030, 0.4998, -0.4974), (1266.4, 816.3, 491.5)),
    "CAM_FRONT_LEFT": ((1.524, 0.495, 1.509), (0.6757, -0.6736, 0.2121, -0.2112), (1272.6, 826.6, 479.8)),
    "CAM_FRONT_RIGHT": ((1.551, -0.493, 1.496), (0.2060, -0.2027, 0.6825, -0.6714), (1260.8, 808.0, 495.3)),
    "CAM_BACK": ((0.028, 0.003, 1.579), (0.5038, -0.4974, -0.4942, 0.5045), (809.2, 829.2, 481.8)),
    "CAM_BACK_LEFT": ((1.036, 0.485, 1.591), (0.6924, -0.7032, -0.1165, 0.1120), (1256.7, 792.1, 492.8)),
    "CAM_BACK_RIGHT": ((1.015, -0.481, 1.562), (0.1228, -0.1324, -0.7004, 0.6905), (1259.5, 807.3, 501.2)),
}

# How one car's rig differs from the nominal one: a few cm, a degree, 1 % of focal length (NUSCENES.md section 6).
_MOUNTING_STD_RAD = np.radians(0.5)
_MOUNTING_STD_M = 0.012
_FOCAL_STD = 0.004
_CENTRE_STD = 0.006  # of the image width

# How far the written calibration may be from the true one.
MAX_ROTATION_ERROR_RAD = np.radians(0.2)
MAX_TRANSLATION_ERROR_M = 0.01
MAX_FOCAL_ERROR = 0.002


@dataclass(frozen=True)
class Rig:
    """Calibrations by channel: ``true`` forms the pictures, ``written`` goes into the tables."""

    true: dict[str, CameraCalibration]
    written: dict[str, CameraCalibration]


def nominal_calibration(channel: str, width: int, height: int) -> CameraCalibration:
    """The real calibration of NUSCENES.md section 6 at another image size.

    Pixel centres lie on whole coordinates (as in OpenCV), so the principal point scales about -0.5.
    """
    translation, quaternion, (focal, cx, cy) = _NOMINAL[channel]
    scale_x, scale_y = width / FULL_WIDTH, height / FULL_HEIGHT
    intrinsic = np.array(
        [
            [focal * scale_x, 0.0, (cx + 0.5) * scale_x - 0.5],
            [0.0, focal * scale_y, (cy + 0.5) * scale_y - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    rotation = rotation_from_quaternion_wxyz(quaternion)
    return CameraCalibration(channel, intrinsic, rotation, np.array(translation), width, height)


def draw_rig(rng: np.random.Generator, width: int, height: int) -> Rig:
    """One car's rig. All six cameras are drawn, so that the choice of channels does not change any of them."""
    true, written = {}, {}
    for channel in ALL_CAMERAS:
        true[channel] = _perturbed(
            nominal_calibration(channel, width, height),
            rotation_rad=_MOUNTING_STD_RAD * rng.standard_normal(3),
            translation_m=_MOUNTING_STD_M * rng.standard_normal(3),
            focal=_FOCAL_STD * rng.standard_normal(),
            centre_px=_CENTRE_STD * width * rng.standard_normal(2),
        )
        written[channel] = _perturbed(
            true[channel],
            rotation_rad=MAX_ROTATION_ERROR_RAD * _in_unit_ball(rng),
            translation_m=MAX_TRANSLATION_ERROR_M * _in_unit_ball(rng),
            focal=MAX_FOCAL_ERROR * rng.uniform(-1.0, 1.0),
            centre_px=np.zeros(2),
        )
    return Rig(true, written)


def _perturbed(
    camera: CameraCalibration, rotation_rad: FloatArray, translation_m: FloatArray, focal: float, centre_px: FloatArray
) -> CameraCalibration:
    """The camera turned by a rotation vector (ego axes), moved, and with another lens."""
    intrinsic = camera.intrinsic.copy()
    intrinsic[0, 0] *= 1.0 + focal
    intrinsic[1, 1] *= 1.0 + focal
    intrinsic[:2, 2] += centre_px
    turn = rotation_from_quaternion_wxyz([1.0, *(0.5 * rotation_rad)])  # exact to the third order of a small angle
    return CameraCalibration(
        camera.channel,
        intrinsic,
        turn @ camera.rotation_ego_from_camera,
        camera.translation_m + translation_m,
        camera.width,
        camera.height,
    )


def _in_unit_ball(rng: np.random.Generator) -> FloatArray:
    """A random vector ``(3,)``, evenly distributed in the unit ball."""
    direction = rng.standard_normal(3)
    return direction / np.linalg.norm(direction) * rng.uniform() ** (1.0 / 3.0)
