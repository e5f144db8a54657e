"""Trajectories of other programs as experts: yaw increments over the steps, and nothing that the files do not hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import TrajectoryError
from mixo_env.experts.expert import State
from mixo_env.geometry import conjugate_quaternion_wxyz, multiply_quaternions_wxyz, yaw_from_quaternion_wxyz
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.axes import in_vehicle_axes

FloatArray = NDArray[np.float64]

MAXIMUM_GAP_S = 0.6
"""Poses further apart are not interpolated: two key frames (0.5 s) are bridged, a stretch of lost tracking is not."""


@dataclass(frozen=True)
class Quality:
    """What a program says about its poses, ``(poses,)`` each; NaN where it says nothing.

    Attributes:
        matches: features matched.
        confidence: in whatever sense.
        yaw_std_rad: standard deviation of the turn since the pose before.
        lost: bool, the pose is no estimate.
    """

    matches: FloatArray
    confidence: FloatArray
    yaw_std_rad: FloatArray
    lost: NDArray[np.bool_]


def imported_increments(
    trajectory: Trajectory,
    timestamps_us: NDArray[np.int64],
    maximum_gap_s: float = MAXIMUM_GAP_S,
    lost: NDArray[np.bool_] | None = None,
    *,
    live: bool = False,
) -> FloatArray:
    """Yaw increments of a trajectory over the steps of a scene.

    Yaw is summed up from the turns between neighbouring poses, each about the vehicle's own up axis: the frame of the
    file may be tilted as it likes. It is interpolated between the two poses around each closing time; where the times
    differ from the trajectory's own, the later pose therefore lies after t_k. Files are data: what their program saw
    when is not known.

    Poses that a program gave ``live``, with each image, may be used causally instead: yaw goes on from the last pose up
    to t_k by the rate between it and the one before. Where that pose is lost, nothing is known; what the rate held
    wrongly is made up for in the next step.

    Args:
        trajectory: with times in seconds.
        timestamps_us: ``(rows,)`` closing times t_k.
        maximum_gap_s: poses further apart are not interpolated.
        lost: ``(poses,)`` those that are no estimates; as if they were not there.
        live: no pose after t_k has a part in what is known at t_k.

    Returns:
        ``(rows,)`` rad; NaN in row 0, before the first and after the last pose, and across gaps.

    Raises:
        TrajectoryError: if the trajectory has no times, or none within the scene.
    """
    if trajectory.timestamps_s is None:
        raise TrajectoryError("expected a time for each pose, got none: write TUM, or KITTI with a file of times")
    if live:
        return _live_increments(trajectory, timestamps_us, maximum_gap_s, lost)
    if lost is not None and lost.any():
        trajectory = trajectory[~lost]
        if len(trajectory) < 2:
            return np.full(len(timestamps_us), np.nan)
    known, at = _clock(trajectory, timestamps_us)
    _check_overlap(trajectory, timestamps_us)
    yaw = np.interp(at, known, local_yaw_rad(trajectory), left=np.nan, right=np.nan)
    before = np.clip(np.searchsorted(known, at, side="right") - 1, 0, len(known) - 1)
    after = np.clip(np.searchsorted(known, at, side="left"), 0, len(known) - 1)
    yaw[known[after] - known[before] > 1e6 * maximum_gap_s] = np.nan
    return np.concatenate([[np.nan], np.diff(yaw)])


def _live_increments(
    trajectory: Trajectory, timestamps_us: NDArray[np.int64], maximum_gap_s: float, lost: NDArray[np.bool_] | None
) -> FloatArray:
    """:func:`imported_increments` from the poses up to each t_k alone."""
    _check_overlap(trajectory, timestamps_us)
    known, at = _clock(trajectory, timestamps_us)
    good = np.ones(len(known), np.bool_) if lost is None else ~lost
    told, yaw = np.flatnonzero(good), np.full(len(known), np.nan)
    rate = yaw.copy()
    if len(told) > 1:
        yaw[told] = local_yaw_rad(trajectory[good])
        gap = np.diff(known[told])
        near = gap <= 1e6 * maximum_gap_s
        rate[told[1:]] = np.where(near, np.diff(yaw[told]) / np.maximum(gap, 1), np.nan)
    last = np.searchsorted(known, at, side="right") - 1
    age = at - known[np.maximum(last, 0)]
    there = (last >= 0) & (age <= 1e6 * maximum_gap_s)
    at_close = np.where(there, yaw[last] + rate[last] * age, np.nan)
    return np.concatenate([[np.nan], np.diff(at_close)])


def _check_overlap(trajectory: Trajectory, timestamps_us: NDArray[np.int64]) -> None:
    """Raise :class:`TrajectoryError` where no pose lies in the scene."""
    known, at = _clock(trajectory, timestamps_us)
    if known[-1] < at[0] or known[0] > at[-1]:
        first_s, last_s = _times_s(trajectory)[[0, -1]]
        raise TrajectoryError(
            f"expected Unix seconds between {1e-6 * timestamps_us[0]:.3f} and {1e-6 * timestamps_us[-1]:.3f}, "
            f"got {first_s:.3f} to {last_s:.3f}: no pose lies in the scene"
        )


def imported_columns(
    trajectory: Trajectory,
    timestamps_us: NDArray[np.int64],
    quality: Quality | None = None,
    maximum_gap_s: float = MAXIMUM_GAP_S,
    *,
    live: bool = False,
) -> dict[str, NDArray[Any]]:
    """All columns of an imported expert over one scene, without its name.

    A step is LOST where its increment is missing, the first row where no pose is near. Counts and confidence of a step
    are those of the last pose until it closes; variances add up over the poses in it. ``live``: as for increments.

    Raises:
        TrajectoryError: as :func:`imported_increments`.
    """
    lost = None if quality is None else quality.lost
    increments = imported_increments(trajectory, timestamps_us, maximum_gap_s, lost, live=live)
    columns = lost_columns(len(timestamps_us))
    tracking = np.isfinite(increments)
    known, at = _clock(trajectory, timestamps_us)
    good = np.ones(len(known), np.bool_) if lost is None else ~lost
    seen = known <= at[0] if live else np.ones_like(good)
    tracking[0] = bool(np.any(good & seen & (np.abs(known - at[0]) <= 1e6 * maximum_gap_s)))
    columns["state"][tracking] = State.TRACKING
    columns["yaw_increment_rad"] = increments.astype(np.float32)
    if quality is None:
        return columns
    last = np.clip(np.searchsorted(known, at, side="right") - 1, 0, None)
    for name in ("matches", "confidence"):
        columns[name] = np.where(tracking, getattr(quality, name)[last], np.nan).astype(np.float32)
    variance = np.cumsum(np.nan_to_num(quality.yaw_std_rad) ** 2)
    variance = variance[last] if live else np.interp(at, known, variance)
    std = np.sqrt(np.maximum(np.diff(variance, prepend=np.nan), 0.0))
    columns["yaw_std_rad"] = np.where(np.isfinite(increments) & (std > 0.0), std, np.nan).astype(np.float32)
    return columns


def lost_columns(rows: int) -> dict[str, NDArray[Any]]:
    """Columns of an expert that says nothing in a scene."""
    nothing = {name: np.full(rows, np.nan, np.float32) for name in _MEASURED}
    return {"state": np.full(rows, State.LOST, np.int8), **nothing}


_MEASURED = ("yaw_increment_rad", "yaw_std_rad", "matches", "confidence")


def local_yaw_rad(trajectory: Trajectory) -> FloatArray:
    """Sum ``(N,)`` of the local turns: yaw of R_i^T R_j for neighbouring poses, free of the file's own frame."""
    q = in_vehicle_axes(trajectory).quaternions_wxyz
    turn = multiply_quaternions_wxyz(conjugate_quaternion_wxyz(q[:-1]), q[1:])
    return np.concatenate([[0.0], np.cumsum(yaw_from_quaternion_wxyz(turn))])


def _times_s(trajectory: Trajectory) -> FloatArray:
    assert trajectory.timestamps_s is not None
    return trajectory.timestamps_s


def _clock(trajectory: Trajectory, timestamps_us: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Times of the poses and of the steps [us] since t_0.

    Whole microseconds like the recording's own times, then relative to t_0: 1.5e9 s leaves no digits to interpolate.
    """
    known = np.rint(1e6 * _times_s(trajectory)).astype(np.int64) - timestamps_us[0]
    return known, timestamps_us - timestamps_us[0]
