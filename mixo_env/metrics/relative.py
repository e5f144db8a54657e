"""Relative trajectory error (RTE): how far the motion over a piece of path is off (docs/metrics.md, "RTE").

With A_i = R_i Q_i^T, truth (R, p) and estimate (Q, q), the error motion of a piece from i to j has

    translation |(p_j - p_i) - s A_i (q_j - q_i)|     and     rotation angle(A_i A_j^T),

which equals (G_i^-1 G_j)^-1 (E_i^-1 E_j) without any 4x4 product (METRICS section 4). Each piece is aligned by its
first pose, so of an alignment only the scale s matters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mixo_env.compiled import compiled_once
from mixo_env.geometry import (
    FloatArray,
    conjugate_quaternion_wxyz,
    multiply_quaternions_wxyz,
    wrap_angle_rad,
)
from mixo_env.metrics.pairs import IntArray, PairRule, Pairs, find_pairs, path_length
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.planar import PlanarPoses

_COMPILE_ABOVE = 50_000
"""Pieces from which compiling (or loading) the arithmetic is cheaper than interpreting it: about half a second."""

_CHUNK = 16_384
"""Planar pieces worked on at a time: their temporaries stay in the processor's cache."""


@dataclass(frozen=True)
class RelativeSamples:
    """Relative errors of M pieces, in the order of the pairs.

    Attributes:
        length_m: ``(M,)`` nominal length L.
        scene: ``(M,)`` scene index.
        start, end: ``(M,)`` rows of the two poses.
        translation_m, rotation_deg: ``(M,)`` errors.
        translation_percent, rotation_deg_per_m: ``(M,)`` the same over the length of the piece.
        lengths_m: the lengths that were asked for, also those without a piece.
    """

    length_m: FloatArray
    scene: IntArray
    start: IntArray
    end: IntArray
    translation_m: FloatArray
    rotation_deg: FloatArray
    translation_percent: FloatArray
    rotation_deg_per_m: FloatArray
    lengths_m: tuple[float, ...]


def relative_errors(
    truth: Trajectory,
    estimate: Trajectory,
    pairs: Pairs,
    *,
    scale: float | FloatArray = 1.0,
    end_length: Literal["nominal", "actual"] = "nominal",
) -> RelativeSamples:
    """Errors of matched SE(3) trajectories over ``pairs``.

    Args:
        truth: ``N`` poses, several scenes one after another if the pairs say so.
        estimate: the matching ``N`` poses.
        pairs: from :func:`mixo_env.metrics.pairs.find_pairs` or ``find_kitti_pairs`` on the path of ``truth``.
        scale: s of a sim3 alignment, one number or ``(scenes,)``.
        end_length: divide by the nominal or by the actual path length.
    """
    difference = multiply_quaternions_wxyz(truth.quaternions_wxyz, conjugate_quaternion_wxyz(estimate.quaternions_wxyz))
    scaled_m = estimate.positions_m * _per_row(scale, pairs, len(truth))
    translation_m, rotation_rad = np.empty(len(pairs.start)), np.empty(len(pairs.start))
    measure = compiled_once(_measure) if len(pairs.start) > _COMPILE_ABOVE else _measure
    measure(truth.positions_m, scaled_m, difference, pairs.start, pairs.end, translation_m, rotation_rad)
    return _samples(pairs, translation_m, np.rad2deg(rotation_rad), end_length)


def relative_errors_se2(
    truth: PlanarPoses,
    estimate: PlanarPoses,
    pairs: Pairs,
    *,
    scale: float | FloatArray = 1.0,
    end_length: Literal["nominal", "actual"] = "nominal",
) -> RelativeSamples:
    """The same for planar poses: the fast path for recordings. Yaw may be unwrapped or not.

    Pairs depend on the truth alone: find them once and reuse them for every method.
    """
    true_m = truth.x_m + 1j * truth.y_m
    estimate_m = (estimate.x_m + 1j * estimate.y_m) * _per_row(scale, pairs, len(truth))[..., 0]
    yaw_error = truth.yaw_rad - estimate.yaw_rad
    turn = np.exp(1j * yaw_error)
    translation_m, rotation_rad = np.empty(len(pairs.start)), np.empty(len(pairs.start))
    for chunk in _chunks(len(pairs.start)):
        i, j = pairs.start[chunk], pairs.end[chunk]
        translation_m[chunk] = np.abs(
            true_m.take(j) - true_m.take(i) - turn.take(i) * (estimate_m.take(j) - estimate_m.take(i))
        )
        rotation_rad[chunk] = np.abs(wrap_angle_rad(yaw_error.take(j) - yaw_error.take(i)))
    return _samples(pairs, translation_m, np.rad2deg(rotation_rad), end_length)


def relative_samples_se2(
    truth: PlanarPoses,
    estimate: PlanarPoses,
    rule: PairRule | None = None,
    offsets: IntArray | None = None,
) -> RelativeSamples:
    """Pairs and errors of planar poses in one call (one method only; otherwise reuse the pairs).

    Args:
        truth: ``N`` poses.
        estimate: the matching ``N`` poses.
        rule: lengths and acceptance; ``None``: the headline's.
        offsets: ``(scenes + 1,)`` first row of each scene and the end; ``None``: one scene.
    """
    rule = rule or PairRule()
    distance_m = path_length(np.stack([truth.x_m, truth.y_m], axis=-1), offsets)
    pairs = find_pairs(distance_m, rule, offsets)
    return relative_errors_se2(truth, estimate, pairs, end_length=rule.end_length)


def _measure(
    truth_m: FloatArray,
    estimate_m: FloatArray,
    difference: FloatArray,
    start: IntArray,
    end: IntArray,
    translation_m: FloatArray,
    rotation_rad: FloatArray,
) -> None:
    """Write the errors of every piece. Plain Python that numba can compile: one source for both speeds.

    Args:
        truth_m: ``(N, 3)`` positions.
        estimate_m: ``(N, 3)`` positions, already scaled.
        difference: ``(N, 4)`` quaternions of A_i.
        start: ``(M,)`` first row of each piece.
        end: ``(M,)`` last row of each piece.
        translation_m: ``(M,)`` written here.
        rotation_rad: ``(M,)`` written here.
    """
    for k in range(len(start)):
        i, j = start[k], end[k]
        w, x, y, z = difference[i, 0], difference[i, 1], difference[i, 2], difference[i, 3]
        mx = estimate_m[j, 0] - estimate_m[i, 0]
        my = estimate_m[j, 1] - estimate_m[i, 1]
        mz = estimate_m[j, 2] - estimate_m[i, 2]
        # A_i m = m + w c + u x c with u = (x, y, z) and c = 2 u x m
        cx, cy, cz = 2.0 * (y * mz - z * my), 2.0 * (z * mx - x * mz), 2.0 * (x * my - y * mx)
        ex = truth_m[j, 0] - truth_m[i, 0] - (mx + w * cx + y * cz - z * cy)
        ey = truth_m[j, 1] - truth_m[i, 1] - (my + w * cy + z * cx - x * cz)
        ez = truth_m[j, 2] - truth_m[i, 2] - (mz + w * cz + x * cy - y * cx)
        translation_m[k] = math.sqrt(ex * ex + ey * ey + ez * ez)
        # The chord form of geometry.angle_between_quaternions_rad; q and -q are the same rotation.
        w2, x2, y2, z2 = difference[j, 0], difference[j, 1], difference[j, 2], difference[j, 3]
        chord = (w - w2) ** 2 + (x - x2) ** 2 + (y - y2) ** 2 + (z - z2) ** 2
        if chord > 2.0:
            chord = (w + w2) ** 2 + (x + x2) ** 2 + (y + y2) ** 2 + (z + z2) ** 2
        rotation_rad[k] = 4.0 * math.asin(0.5 * math.sqrt(chord))


def _per_row(scale: float | FloatArray, pairs: Pairs, rows: int) -> FloatArray:
    """``(rows, 1)`` or ``(1, 1)`` factors from one scale or one per scene."""
    scales = np.atleast_1d(np.asarray(scale, dtype=np.float64))
    return scales[:, None] if len(scales) == 1 else np.repeat(scales, np.diff(pairs.offsets))[:, None]


def _chunks(count: int) -> list[slice]:
    return [slice(first, first + _CHUNK) for first in range(0, count, _CHUNK)]


def _samples(
    pairs: Pairs, translation_m: FloatArray, rotation_deg: FloatArray, end_length: Literal["nominal", "actual"]
) -> RelativeSamples:
    divisor_m = pairs.length_m if end_length == "nominal" else pairs.path_m
    return RelativeSamples(
        length_m=pairs.length_m,
        scene=pairs.scene,
        start=pairs.start,
        end=pairs.end,
        translation_m=translation_m,
        rotation_deg=rotation_deg,
        translation_percent=100.0 * translation_m / divisor_m,
        rotation_deg_per_m=rotation_deg / divisor_m,
        lengths_m=pairs.lengths_m,
    )
