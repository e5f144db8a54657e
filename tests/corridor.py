"""Pictures of a textured street canyon by exact ray casting: a tiny world for tests of the odometry."""

from __future__ import annotations

import math

import cv2
import numpy as np

from mixo_env.geometry import rotation_from_yaw
from mixo_env.nuscenes.scene import CameraCalibration

AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
WIDTH, HEIGHT, FOCAL = 640, 360, 500.0
_HALF_WIDTH_M, _CAMERA_HEIGHT_M, _ROOF_M, _TEXEL_M = 9.0, 1.5, 14.0, 0.03


def _texture(seed: int, size: int = 1024) -> np.ndarray:
    rng = np.random.default_rng(seed)
    total = np.zeros((size, size), np.float32)
    for octave in range(8):
        cells = size >> octave
        noise = rng.standard_normal((cells, cells)).astype(np.float32)
        total += cv2.resize(noise, (size, size), interpolation=cv2.INTER_NEAREST) * 10.0
    return np.clip(120 + total, 0, 255)


_TEXTURES = [_texture(seed) for seed in range(3)]


def calibration(
    mounting_deg: float = 0.0, lever_m: tuple[float, float] = (1.5, 0.3), **changes: object
) -> CameraCalibration:
    """Camera of the corridor."""
    values = {
        "channel": "CAM_TEST",
        "intrinsic": np.array([[FOCAL, 0.0, WIDTH / 2 - 0.5], [0.0, FOCAL, HEIGHT / 2 - 0.5], [0.0, 0.0, 1.0]]),
        "rotation_ego_from_camera": rotation_from_yaw(math.radians(mounting_deg)) @ AXES,
        "translation_m": np.array([*lever_m, _CAMERA_HEIGHT_M]),
        "width": WIDTH,
        "height": HEIGHT,
    }
    return CameraCalibration(**(values | changes))  # type: ignore[arg-type]


def picture(camera: CameraCalibration, x_m: float, y_m: float, yaw_rad: float, noise_seed: int = 0) -> np.ndarray:
    """Grey image ``(HEIGHT, WIDTH)`` of the canyon along x, seen from the ego pose."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    k = camera.intrinsic
    ray = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u, float)], -1)
    turn = rotation_from_yaw(yaw_rad)
    ray = ray @ (turn @ camera.rotation_ego_from_camera).T
    origin = np.array([x_m, y_m, 0.0]) + turn @ camera.translation_m
    with np.errstate(divide="ignore"):
        side = (np.where(ray[..., 1] > 0, _HALF_WIDTH_M, -_HALF_WIDTH_M) - origin[1]) / ray[..., 1]
        level = (np.where(ray[..., 2] > 0, _ROOF_M, 0.0) - origin[2]) / ray[..., 2]
    wall = side < level
    point = origin + ray * np.minimum(np.where(wall, side, level), 500.0)[..., None]
    across = np.where(wall, point[..., 2], point[..., 1])
    which = np.where(wall, np.where(ray[..., 1] > 0, 0, 1), 2)
    image = np.zeros((HEIGHT, WIDTH), np.float32)
    for index, texture in enumerate(_TEXTURES):
        looked_up = cv2.remap(
            texture,
            (point[..., 0] / _TEXEL_M % 1024).astype(np.float32),
            (across / _TEXEL_M % 1024).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        )
        image[which == index] = looked_up[which == index]
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    image += np.random.default_rng(noise_seed).normal(0.0, 1.5, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)
