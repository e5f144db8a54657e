"""Angles, quaternions and rigid motions: the one place for every conversion.

Conventions: angles in radians, yaw anticlockwise positive (a left turn is positive), quaternions in the order
w, x, y, z as nuScenes writes them, rotation matrices map the second-named frame into the first
(``rotation_ego_from_camera``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation: 1 / Phi^-1(3/4)."""


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
    """Unit quaternion(s) ``(..., 4)`` with w >= 0 of rotation matrices ``(..., 3, 3)``.

    The eigenvector form of Bar-Itzhack (2000) is used: it has no special cases, and of a rounded matrix it gives the
    nearest rotation.
    """
    m = np.asarray(rotation, dtype=np.float64)
    k = np.zeros((*m.shape[:-2], 4, 4))
    k[..., 0, 0] = m[..., 0, 0] - m[..., 1, 1] - m[..., 2, 2]
    k[..., 1, 1] = m[..., 1, 1] - m[..., 0, 0] - m[..., 2, 2]
    k[..., 2, 2] = m[..., 2, 2] - m[..., 0, 0] - m[..., 1, 1]
    k[..., 3, 3] = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    k[..., 1, 0] = m[..., 0, 1] + m[..., 1, 0]
    k[..., 2, 0] = m[..., 0, 2] + m[..., 2, 0]
    k[..., 2, 1] = m[..., 1, 2] + m[..., 2, 1]
    k[..., 3, 0] = m[..., 2, 1] - m[..., 1, 2]
    k[..., 3, 1] = m[..., 0, 2] - m[..., 2, 0]
    k[..., 3, 2] = m[..., 1, 0] - m[..., 0, 1]
    x, y, z, w = np.moveaxis(np.linalg.eigh(k / 3.0, UPLO="L")[1][..., -1], -1, 0)
    q = np.stack([w, x, y, z], axis=-1)
    return np.where(w[..., None] >= 0.0, q, -q)


def multiply_quaternions_wxyz(left: ArrayLike, right: ArrayLike) -> FloatArray:
    """Product(s) ``(..., 4)``: the rotation ``right`` followed by ``left``."""
    w1, x1, y1, z1 = np.moveaxis(np.asarray(left, dtype=np.float64), -1, 0)
    w2, x2, y2, z2 = np.moveaxis(np.asarray(right, dtype=np.float64), -1, 0)
    return np.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ],
        axis=-1,
    )


def conjugate_quaternion_wxyz(quaternion: ArrayLike) -> FloatArray:
    """Inverse rotation(s) ``(..., 4)`` of unit quaternion(s)."""
    return np.asarray(quaternion, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def angle_between_quaternions_rad(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Angle(s) in [0, pi] of the rotation from ``first`` to ``second``, unit quaternions ``(..., 4)``.

    The chord form keeps all digits: arccos of the trace loses those below 1e-8 rad. A quaternion and its negative
    are the same rotation, so the nearer of the two counts.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    chord_squared = np.asarray(np.sum((a - b) ** 2, axis=-1))
    far = chord_squared > 2.0
    if far.any():
        chord_squared[far] = np.sum((a + b) ** 2, axis=-1)[far]
    return 4.0 * np.arcsin(0.5 * np.sqrt(chord_squared))


def rotation_from_yaw(yaw_rad: ArrayLike) -> FloatArray:
    """Rotation matrix ``(..., 3, 3)`` by ``yaw_rad`` about z: R_z of eq. 1."""
    yaw = np.asarray(yaw_rad, dtype=np.float64)
    c, s, zero, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
    rows = [[c, -s, zero], [s, c, zero], [zero, zero, one]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotation_from_roll_pitch_yaw(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> FloatArray:
    """Rotation matrix ``(..., 3, 3)`` R_z(yaw) R_y(pitch) R_x(roll): map from body, roll about x first."""
    roll, pitch, yaw = (np.asarray(angle, dtype=np.float64) for angle in (roll_rad, pitch_rad, yaw_rad))
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_wxyz_from_roll_pitch_yaw(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> FloatArray:
    """Unit quaternion(s) ``(..., 4)`` of the same rotation, by the product of half angles."""
    roll, pitch, yaw = (np.asarray(angle, dtype=np.float64) for angle in (roll_rad, pitch_rad, yaw_rad))
    cr, sr, cp, sp = np.cos(roll / 2), np.sin(roll / 2), np.cos(pitch / 2), np.sin(pitch / 2)
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    parts = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    return np.stack(parts, axis=-1)
