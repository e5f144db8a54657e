"""Trajectories of other programs as experts: yaw increments over the steps, and nothing that the file does not hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import TrajectoryError
from mixo_env.geometry import conjugate_quaternion_wxyz, multiply_quaternions_wxyz, yaw_from_quaternion_wxyz
from mixo_env.trajectory import Trajectory

FloatArray = NDArray[np.float64]

MAXIMUM_GAP_S = 0.6
"""Poses further apart are not interpolated: two key frames (0.5 s) are bridged, a stretch of lost tracking is not."""


def imported_increments(trajectory: Trajectory, timestamps_us: NDArray[np.int64]) -> FloatArray:
    """Yaw increments of a trajectory over the steps of a scene.

    Yaw is summed up from the turns between neighbouring poses, each about the vehicle's own up axis: the frame of the
    file may be tilted as it likes. It is interpolated between the two poses around each closing time; where the times
    differ from the trajectory's own, the later pose therefore lies after t_k. Files are data: what their program saw
    when is not known.

    Args:
        trajectory: with times in Unix seconds.
        timestamps_us: ``(rows,)`` closing times t_k.

    Returns:
        ``(rows,)`` rad; NaN in row 0, before the first and after the last pose, and across gaps over
        ``MAXIMUM_GAP_S``.

    Raises:
        TrajectoryError: if the trajectory has no times, or none within the scene.
    """
    if trajectory.timestamps_s is None:
        raise TrajectoryError("expected a time for each pose, got none: write TUM, or KITTI with a file of times")
    # Whole microseconds like the recording's own times, then relative to t_0: 1.5e9 s leaves no digits to interpolate.
    known = np.rint(1e6 * trajectory.timestamps_s).astype(np.int64) - timestamps_us[0]
    at = timestamps_us - timestamps_us[0]
    if known[-1] < at[0] or known[0] > at[-1]:
        raise TrajectoryError(
            f"expected Unix seconds between {1e-6 * timestamps_us[0]:.3f} and {1e-6 * timestamps_us[-1]:.3f}, "
            f"got {trajectory.timestamps_s[0]:.3f} to {trajectory.timestamps_s[-1]:.3f}: no pose lies in the scene"
        )
    yaw = np.interp(at, known, _yaw_rad(trajectory), left=np.nan, right=np.nan)
    before = np.clip(np.searchsorted(known, at, side="right") - 1, 0, len(known) - 1)
    after = np.clip(np.searchsorted(known, at, side="left"), 0, len(known) - 1)
    yaw[known[after] - known[before] > 1e6 * MAXIMUM_GAP_S] = np.nan
    return np.concatenate([[np.nan], np.diff(yaw)])


def _yaw_rad(trajectory: Trajectory) -> FloatArray:
    """Sum ``(N,)`` of the local turns: yaw of R_i^T R_j for neighbouring poses, free of the file's own frame."""
    q = trajectory.quaternions_wxyz
    turn = multiply_quaternions_wxyz(conjugate_quaternion_wxyz(q[:-1]), q[1:])
    if trajectory.camera_axes:  # forward z, left -x, up -y
        turn = turn[:, [0, 3, 1, 2]] * np.array([1.0, 1.0, -1.0, -1.0])
    return np.concatenate([[0.0], np.cumsum(yaw_from_quaternion_wxyz(turn))])
