"""The paper's equations: mixing increments (3), integrating yaw (4) and position (1), constant weights.

Everything works on arrays whose last axis is the experts (mixing) or time (integration) and broadcasts over the rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def softmax(logits: ArrayLike) -> FloatArray:
    """H of eq. 3 over the last axis."""
    z = np.asarray(logits, dtype=np.float64)
    e = np.exp(z - z.max(axis=-1, keepdims=True))
    return e / e.sum(axis=-1, keepdims=True)


def project_to_simplex(point: ArrayLike) -> FloatArray:
    """Euclidean projection of the last axis onto {w >= 0, sum w = 1} (Held, Wolfe and Crowder 1974)."""
    v = np.asarray(point, dtype=np.float64)
    u = -np.sort(-v, axis=-1)
    excess = np.cumsum(u, axis=-1) - 1.0
    rank = np.arange(1, v.shape[-1] + 1)
    support = np.sum(u * rank > excess, axis=-1, keepdims=True)
    threshold = np.take_along_axis(excess, support - 1, axis=-1) / support
    return np.maximum(v - threshold, 0.0)


def mix(weights: ArrayLike, increments: ArrayLike) -> FloatArray:
    """Eq. 3: the weighted sum of the experts' yaw increments [rad] over the last axis."""
    return np.sum(np.asarray(weights, dtype=np.float64) * np.asarray(increments, dtype=np.float64), axis=-1)


def dead_reckon(
    yaw_increments_rad: ArrayLike,
    distances_m: ArrayLike,
    *,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    course_offset_rad: float = 0.0,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eqs. 4 and 1 over whole scenes: poses from increments.

    t_k is the chord of a circular arc in frame k: s_k (cos(dpsi_k / 2), -sin(dpsi_k / 2)), turned by the course offset;
    in frame 0 it therefore points along psi_k - dpsi_k / 2 + course offset.

    Args:
        yaw_increments_rad: ``(..., T)`` fused increments.
        distances_m: ``(..., T)`` distances s_k.
        start: x [m], y [m], yaw [rad] of the first pose.
        course_offset_rad: direction of travel minus heading.

    Returns:
        x [m], y [m], yaw [rad, not wrapped], each ``(..., T + 1)``.
    """
    dpsi = np.asarray(yaw_increments_rad, dtype=np.float64)
    s = np.asarray(distances_m, dtype=np.float64)
    x0, y0, yaw0 = start
    first = np.zeros((*dpsi.shape[:-1], 1))
    yaw = yaw0 + np.concatenate([first, np.cumsum(dpsi, axis=-1)], axis=-1)
    course = yaw[..., 1:] - 0.5 * dpsi + course_offset_rad
    x = x0 + np.concatenate([first, np.cumsum(s * np.cos(course), axis=-1)], axis=-1)
    y = y0 + np.concatenate([first, np.cumsum(s * np.sin(course), axis=-1)], axis=-1)
    return x, y, yaw


def least_squares_weights(increments_rad: ArrayLike, truth_rad: ArrayLike) -> FloatArray:
    """Constant weights ``(N,)`` minimising the RMSE of the mixed increment: LINEAR (unconstrained, PAPER.md).

    Args:
        increments_rad: ``(T, N)``, finite (lost experts already substituted).
        truth_rad: ``(T,)`` true increments.
    """
    a = np.asarray(increments_rad, dtype=np.float64)
    return np.linalg.lstsq(a, np.asarray(truth_rad, dtype=np.float64), rcond=None)[0].astype(np.float64, copy=False)
