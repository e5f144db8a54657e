"""Absolute trajectory error (ATE): how far each pose is from the truth (docs/metrics.md, "ATE")."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixo_env.geometry import FloatArray, angle_between_quaternions_rad, wrap_angle_rad
from mixo_env.metrics.aggregate import scene_rmse
from mixo_env.metrics.pairs import IntArray, scene_offsets
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.planar import PlanarPoses


@dataclass(frozen=True)
class AbsoluteErrors:
    """Errors ``(N,)`` of N poses: |p_i - (s R q_i + t)| and the angle of R Q_i R_i^T."""

    translation_m: FloatArray
    rotation_deg: FloatArray


@dataclass(frozen=True)
class SceneAbsolute:
    """RMSE of each scene ``(scenes,)``: the ATE."""

    translation_m: FloatArray
    rotation_deg: FloatArray


def absolute_errors(truth: Trajectory, estimate: Trajectory) -> AbsoluteErrors:
    """Errors of matched SE(3) trajectories as they stand: apply an alignment to the estimate first if you want one."""
    translation_m = np.sqrt(np.sum((truth.positions_m - estimate.positions_m) ** 2, axis=1))
    rotation_rad = angle_between_quaternions_rad(truth.quaternions_wxyz, estimate.quaternions_wxyz)
    return AbsoluteErrors(translation_m, np.rad2deg(rotation_rad))


def absolute_errors_se2(truth: PlanarPoses, estimate: PlanarPoses) -> AbsoluteErrors:
    """The same for planar poses, without alignment: the fast path for recordings."""
    translation_m = np.hypot(truth.x_m - estimate.x_m, truth.y_m - estimate.y_m)
    return AbsoluteErrors(translation_m, np.rad2deg(np.abs(wrap_angle_rad(truth.yaw_rad - estimate.yaw_rad))))


def scene_absolute(errors: AbsoluteErrors, offsets: IntArray | None = None) -> SceneAbsolute:
    """ATE per scene: the RMSE over its poses.

    Args:
        errors: of all poses, scene after scene.
        offsets: ``(scenes + 1,)`` first row of each scene and the end; ``None``: one scene.
    """
    offsets = scene_offsets(len(errors.translation_m), offsets)
    return SceneAbsolute(scene_rmse(errors.translation_m, offsets), scene_rmse(errors.rotation_deg, offsets))
