"""Alignment of an estimate to the truth: p ~ s R q + t (docs/metrics.md, "Alignment").

Least squares on positions after S. Umeyama, "Least-squares estimation of transformation parameters between two point
patterns", IEEE T-PAMI 13(4), 1991, on all poses or on the first n.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixo_env.errors import ConfigurationError, TrajectoryError, unknown
from mixo_env.geometry import (
    FloatArray,
    conjugate_quaternion_wxyz,
    multiply_quaternions_wxyz,
    quaternion_wxyz_from_rotation,
    rotation_from_quaternion_wxyz,
    rotation_from_yaw,
)
from mixo_env.trajectory import Trajectory

ALIGNMENTS = ("none", "posyaw", "se3", "sim3")

_LEAST_SPREAD_M = 0.05
"""RMS distance of true positions from their mean below which they stand: satellite positions jitter by some cm."""
_LEAST_RATIO = 1e-6
"""Below this share of the true spread an estimate stands too: its scale would be the size of its rounding."""
_LARGEST_M = 1e12
_DEGENERATE = 1e-12
"""Below this share of the largest singular value a direction of the correlation counts as empty."""


@dataclass(frozen=True)
class Alignment:
    """p ~ scale * rotation @ q + translation_m; the default changes nothing."""

    scale: float = 1.0
    rotation: FloatArray | None = None
    translation_m: FloatArray | None = None

    def apply(self, estimate: Trajectory) -> Trajectory:
        """The estimate in the frame, and with the scale, of the truth."""
        if self.rotation is None or self.translation_m is None:
            return estimate
        return Trajectory(
            self.scale * estimate.positions_m @ self.rotation.T + self.translation_m,
            multiply_quaternions_wxyz(quaternion_wxyz_from_rotation(self.rotation), estimate.quaternions_wxyz),
            estimate.timestamps_s,
            estimate.camera_axes,
            estimate.counted,
        )


class NoScaleError(TrajectoryError):
    """A scale was asked for, but truth or estimate stands."""


def align(truth: Trajectory, estimate: Trajectory, method: str = "none", first: int | None = None) -> Alignment:
    """Find the alignment of matched trajectories.

    Args:
        truth: ``N`` poses.
        estimate: the matching ``N`` poses.
        method: ``"none"``; ``"posyaw"`` (translation and a turn about z); ``"se3"``; ``"sim3"`` (with scale).
        first: use the first n poses only; ``None``: all. With one pose ``"se3"`` and ``"posyaw"`` use its orientation.

    Raises:
        ConfigurationError: for an unknown method or a number of poses it cannot use.
        NoScaleError: when sim3 is asked of a truth or an estimate that stands.
        TrajectoryError: when positions are out of range.
    """
    if method not in ALIGNMENTS:
        raise ConfigurationError(unknown("alignment", method, ALIGNMENTS))
    least = 2 if method == "sim3" else 1
    if first is not None and not least <= first <= len(truth):
        raise ConfigurationError(
            f"{method} aligns on {least} to {len(truth)} poses here, got {first}; leave it out to use all"
        )
    if method == "none":
        return Alignment()
    for name, poses in (("truth", truth), ("estimate", estimate)):  # the SVD of infinity never ends
        if not np.abs(poses.positions_m).max() <= _LARGEST_M:
            raise TrajectoryError(f"expected finite coordinates up to {_LARGEST_M:g} m, the {name} holds larger ones")
    if first == 1:
        return _align_first_pose(truth, estimate, yaw_only=method == "posyaw")
    p, q = truth.positions_m[:first], estimate.positions_m[:first]
    p_mean, q_mean = p.mean(axis=0), q.mean(axis=0)
    p, q = p - p_mean, q - q_mean
    scale = 1.0
    if method == "posyaw":
        rotation = _best_yaw(p.T @ q)
    else:
        u, d, vt = np.linalg.svd(p.T @ q / len(p))
        sign = np.array([1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]).round()
        rotation = _shortest_turn(u[:, 0], vt[0], d) if d[1] <= _DEGENERATE * d[0] else u * sign @ vt
        if method == "sim3":
            scale = float(d @ sign / _spread(p, q) ** 2)
    return Alignment(scale, rotation, p_mean - scale * rotation @ q_mean)


def align_one_of_many(
    truth: Trajectory, estimate: Trajectory, method: str, first: int | None = None
) -> tuple[Alignment, bool]:
    """As :func:`align`, but a scene that stands is aligned by se3: it must not keep all others from being scored.

    Returns:
        The alignment, and whether it fell back so: whoever prints the score says it.
    """
    try:
        return align(truth, estimate, method, first), False
    except NoScaleError:
        return align(truth, estimate, "se3", first), True


def _spread(p: FloatArray, q: FloatArray) -> float:
    """RMS distance of the estimate's positions ``q`` ``(n, 3)`` from their mean 0, if those and the truth's move."""
    true, own = (float(np.sqrt(np.mean(np.sum(x * x, axis=1)))) for x in (p, q))
    for name, spread, least in (("a truth", true, _LEAST_SPREAD_M), ("an estimate", own, _LEAST_RATIO * true)):
        if spread < least:
            raise NoScaleError(
                f"sim3 needs {name} that moves, its {len(p)} positions lie within {spread:.2g} m (RMS) of one place; "
                "use se3 or none"
            )
    return own


def _best_yaw(correlation: FloatArray) -> FloatArray:
    """The turn about z that maximises ``trace(R^T correlation)``."""
    c = correlation
    return rotation_from_yaw(np.arctan2(c[1, 0] - c[0, 1], c[0, 0] + c[1, 1]))


def _align_first_pose(truth: Trajectory, estimate: Trajectory, *, yaw_only: bool) -> Alignment:
    difference = multiply_quaternions_wxyz(
        truth.quaternions_wxyz[0], conjugate_quaternion_wxyz(estimate.quaternions_wxyz[0])
    )
    rotation = rotation_from_quaternion_wxyz(difference)
    if yaw_only:
        rotation = _best_yaw(rotation)
    return Alignment(1.0, rotation, truth.positions_m[0] - rotation @ estimate.positions_m[0])


def _shortest_turn(to: FloatArray, from_: FloatArray, singular_values: FloatArray) -> FloatArray:
    """For an exactly straight path every turn about it fits equally well: take the one that turns least.

    Without any movement (all singular values 0) nothing is known about the rotation, so it stays the identity.
    """
    if singular_values[0] == 0.0:
        return np.eye(3)
    cosine = float(to @ from_)
    if cosine < -1.0 + 1e-12:  # opposite directions: half a turn about any axis across
        axis = np.linalg.svd(from_[None])[2][1]
        return 2.0 * np.outer(axis, axis) - np.eye(3)
    cross = np.cross(from_, to)
    skew = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    return np.eye(3) + skew + skew @ skew / (1.0 + cosine)
