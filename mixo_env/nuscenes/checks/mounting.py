"""Checks of cameras: the intrinsic matrix, and where the camera sits and looks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mixo_env.geometry import wrap_angle_rad
from mixo_env.nuscenes.checks.evidence import Evidence, Finding
from mixo_env.nuscenes.scene import CameraCalibration

NOMINAL_YAW_DEG = {
    "CAM_FRONT": 0.0,
    "CAM_FRONT_LEFT": 55.0,
    "CAM_FRONT_RIGHT": -55.0,
    "CAM_BACK_LEFT": 110.0,
    "CAM_BACK_RIGHT": -110.0,
    "CAM_BACK": 180.0,
}
"""Where each camera of the nuScenes car looks: anticlockwise from straight ahead."""

YAW_TOLERANCE_DEG = 25.0
"""Less than half the angle between neighbours, far more than cars differ."""

FARTHEST_M = 10.0
WIDEST_DEG, NARROWEST_DEG = 170.0, 10.0


def calibration(evidence: Evidence) -> Iterator[Finding]:
    """Every camera is a camera, upright, and looks where its name says."""
    for camera, reel in evidence.reels.items():
        for text in calibration_problems(reel.calibration):
            yield Finding("calibration", f"{camera}: {text}")


def calibration_problems(calibration: CameraCalibration) -> list[str]:
    """What is wrong with a camera's intrinsic matrix and mounting."""
    return [*_intrinsic_problems(calibration), *_mounting_problems(calibration)]


def _intrinsic_problems(calibration: CameraCalibration) -> Iterator[str]:
    k = calibration.intrinsic
    if not np.all(np.isfinite(k)) or k[0, 0] <= 0 or k[1, 1] <= 0:
        yield "the intrinsic matrix is not finite with focal lengths > 0"
        return
    if not np.allclose(k[2], (0.0, 0.0, 1.0)) or k[1, 0] != 0.0:
        yield "the intrinsic matrix is not upper triangular with a last row of 0 0 1: transposed?"
    if not (0 < k[0, 2] < calibration.width and 0 < k[1, 2] < calibration.height):
        yield f"the principal point ({k[0, 2]:.0f}, {k[1, 2]:.0f}) lies outside the image"
        return
    view = 2.0 * np.degrees(np.arctan(0.5 * calibration.width / k[0, 0]))
    if not NARROWEST_DEG < view < WIDEST_DEG:
        yield f"a focal length of {k[0, 0]:.4g} px is a field of view of {view:.1f} deg: another image size?"
    if not 0.8 < k[0, 0] / k[1, 1] < 1.25:
        yield f"the focal lengths {k[0, 0]:.4g} and {k[1, 1]:.4g} px differ: pixels are square"


def _mounting_problems(calibration: CameraCalibration) -> Iterator[str]:
    rotation = calibration.rotation_ego_from_camera
    if np.any(np.abs(calibration.translation_m) > FARTHEST_M):
        yield f"it sits {np.abs(calibration.translation_m).max():.4g} m from the rear axle: another unit?"
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
        yield "the mounting is not a rotation"
    elif np.linalg.det(rotation) < 0:
        yield "the mounting is left-handed"
    elif rotation[2, 1] > -0.5:
        yield "the camera's y axis does not point down: quaternion not in the order w, x, y, z?"
    elif (nominal := NOMINAL_YAW_DEG.get(calibration.channel)) is not None:
        yaw = np.arctan2(rotation[1, 2], rotation[0, 2])
        if abs(np.degrees(wrap_angle_rad(yaw - np.radians(nominal)))) > YAW_TOLERANCE_DEG:
            yield f"it looks {np.degrees(yaw):.0f} deg to the left of straight ahead; {nominal:.0f} is expected"
