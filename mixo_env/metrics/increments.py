"""Errors of single steps: yaw-increment and yaw-rate RMSE, and the skill over trivial predictions.

On a straight road predicting no turn at all is already good, so an RMSE alone says little (docs/metrics.md, "Skill").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixo_env.geometry import FloatArray, wrap_angle_rad
from mixo_env.metrics.pairs import IntArray, scene_offsets


@dataclass(frozen=True)
class IncrementScore:
    """Over all steps of all scenes.

    Attributes:
        yaw_increment_rmse_deg: RMSE of the yaw increments [deg].
        yaw_rate_rmse_deg_per_s: RMSE of increment / dt [deg/s].
        skill_zero: 1 - RMS^2 / RMS_0^2 against predicting zero yaw; 1 perfect, 0 no better, negative worse.
        skill_constant_rate: the same against the best constant: each scene's own mean yaw rate, known in hindsight.
        skill_previous_rate: the same against the true rate of the step before (constant turn-rate motion model).
    """

    yaw_increment_rmse_deg: float
    yaw_rate_rmse_deg_per_s: float
    skill_zero: float
    skill_constant_rate: float
    skill_previous_rate: float


def increments(yaw_rad: FloatArray, offsets: IntArray | None = None) -> tuple[FloatArray, IntArray]:
    """Wrapped yaw increments of every step and the offsets ``(scenes + 1,)`` of the scenes among them.

    Args:
        yaw_rad: ``(N,)`` yaw of poses, unwrapped or not.
        offsets: first row of each scene and the end; ``None``: one scene. Every scene needs at least one pose.
    """
    offsets = scene_offsets(len(yaw_rad), offsets)
    inside = np.ones(max(len(yaw_rad) - 1, 0), dtype=bool)
    inside[offsets[1:-1] - 1] = False
    return wrap_angle_rad(np.diff(yaw_rad))[inside], offsets - np.arange(len(offsets))


def increment_score(
    truth_increment_rad: FloatArray,
    increment_rad: FloatArray,
    dt_s: FloatArray,
    offsets: IntArray | None = None,
) -> IncrementScore:
    """Score yaw increments ``(M,)`` of M steps.

    Args:
        truth_increment_rad: ground truth.
        increment_rad: estimate.
        dt_s: length of each step, above 0.
        offsets: ``(scenes + 1,)`` first step of each scene and the end; ``None``: one scene.
    """
    offsets = scene_offsets(len(truth_increment_rad), offsets)
    error = wrap_angle_rad(truth_increment_rad - increment_rad)
    scene = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    turned = np.bincount(scene, weights=truth_increment_rad, minlength=len(offsets) - 1)
    lasted = np.bincount(scene, weights=dt_s, minlength=len(offsets) - 1)
    constant = (turned / np.where(lasted > 0.0, lasted, 1.0))[scene] * dt_s
    has_previous = np.ones(len(error), dtype=bool)
    has_previous[offsets[:-1][np.diff(offsets) > 0]] = False
    later = np.flatnonzero(has_previous)
    previous = truth_increment_rad[later - 1] / dt_s[later - 1] * dt_s[later]
    return IncrementScore(
        yaw_increment_rmse_deg=float(np.rad2deg(_rms(error))),
        yaw_rate_rmse_deg_per_s=float(np.rad2deg(_rms(error / dt_s))),
        skill_zero=skill(error, truth_increment_rad),
        skill_constant_rate=skill(error, truth_increment_rad - constant),
        skill_previous_rate=skill(error[later], truth_increment_rad[later] - previous),
    )


def skill(error: FloatArray, reference_error: FloatArray) -> float:
    """1 - RMS^2 / RMS_0^2 of errors ``(M,)`` against those of a trivial prediction; NaN when that one is perfect."""
    reference = float(np.sum(np.square(reference_error)))
    return 1.0 - float(np.sum(np.square(error))) / reference if reference > 0.0 else float("nan")


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
