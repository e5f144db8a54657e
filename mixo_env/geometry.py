"""Angles, quaternions and rigid motions: the one place for every conversion.

Conventions: angles in radians, yaw anticlockwise positive (a left turn is positive), quaternions in the order
w, x, y, z as nuScenes writes them, rotation matrices map the second-named frame into the first
(``rotation_ego_from_camera``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def wrap_angle_rad(angle_rad: ArrayLike) -> FloatArray:
    """Angle(s) wrapped to (-pi, pi]."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def yaw_from_quaternion_wxyz(quaternion: ArrayLike) -> FloatArray:
    """Yaw of unit quaternion(s) ``(..., 4)`` in the order w, x, y, z, in (-pi, pi] (NUSCENES.md section 5)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, dtype=np.float64), -1, 0)
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quaternion_wxyz_from_yaw(yaw_rad: ArrayLike) -> FloatArray:
    """Unit quaternion(s) ``(..., 4)`` of a rotation by ``yaw_rad`` about z."""
    half = 0.5 * np.asarray(yaw_rad, dtype=np.float64)
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def rotation_from_quaternion_wxyz(quaternion: ArrayLike) -> FloatArray:
    """Rotation matrix ``(..., 3, 3)`` of quaternion(s) ``(..., 4)``; the quaternion is normalised first."""
    q = np.asarray(quaternion, dtype=np.float64)
    w, x, y, z = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_wxyz_from_rotation(rotation: ArrayLike) -> FloatArray:
    """Unit quaternion ``(4,)`` with w >= 0 of one rotation matrix ``(3, 3)``.

    The eigenvector form of Bar-Itzhack (2000) is used: it has no special cases and averages out rounding errors.
    """
    m = np.asarray(rotation, dtype=np.float64)
    k = np.array(
        [
            [m[0, 0] - m[1, 1] - m[2, 2], 0.0, 0.0, 0.0],
            [m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0.0, 0.0],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1], 0.0],
            [m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m[0, 0] + m[1, 1] + m[2, 2]],
        ]
    )
    x, y, z, w = np.linalg.eigh(k / 3.0, UPLO="L")[1][:, -1]
    q = np.array([w, x, y, z])
    return q if w >= 0.0 else -q


def rotation_from_yaw(yaw_rad: ArrayLike) -> FloatArray:
    """Rotation matrix ``(..., 3, 3)`` by ``yaw_rad`` about z: R_z of eq. 1."""
    yaw = np.asarray(yaw_rad, dtype=np.float64)
    c, s, zero, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
    rows = [[c, -s, zero], [s, c, zero], [zero, zero, one]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
