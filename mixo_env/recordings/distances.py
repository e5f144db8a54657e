"""Distance of recordings made from trajectories: wheel speeds from files, the path of an expert, or the truth's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import TrajectoryError
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.text import read_numbers

FloatArray = NDArray[np.float64]


def path_distances_m(trajectory: Trajectory, timestamps_us: NDArray[np.int64], maximum_gap_s: float) -> FloatArray:
    """Distance ``(rows,)`` [m] over every step along the path of a trajectory, never negative.

    Args:
        trajectory: with times in seconds; its scale is taken as it is (the cross-validation fits one).
        timestamps_us: ``(rows,)`` closing times.
        maximum_gap_s: poses further apart are not interpolated.

    Returns:
        NaN in row 0 and where no pose is near.
    """
    assert trajectory.timestamps_s is not None
    known = np.rint(1e6 * trajectory.timestamps_s).astype(np.int64) - timestamps_us[0]
    at = timestamps_us - timestamps_us[0]
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(trajectory.positions_m, axis=0), axis=1))])
    along = np.interp(at, known, path, left=np.nan, right=np.nan)
    before = np.clip(np.searchsorted(known, at, side="right") - 1, 0, len(known) - 1)
    after = np.clip(np.searchsorted(known, at, side="left"), 0, len(known) - 1)
    along[known[after] - known[before] > 1e6 * maximum_gap_s] = np.nan
    return np.concatenate([[np.nan], np.diff(along)])


def wheel_distances_m(path: Path, timestamps_us: NDArray[np.int64], maximum_gap_s: float) -> FloatArray:
    """Distance ``(rows,)`` [m] over every step from a file of wheel speeds.

    Args:
        path: lines of ``time speed`` [s, m/s], or of the speed alone where there is one line a pose of the truth.
        timestamps_us: ``(rows,)`` closing times.
        maximum_gap_s: speeds further apart are not interpolated.

    Returns:
        NaN in row 0 and where no speed is near.

    Raises:
        TrajectoryError: when the file holds something else.
    """
    table = read_numbers(path)
    columns = table.values.shape[1]
    at_s = 1e-6 * (timestamps_us - timestamps_us[0])
    if columns == 1 and len(table.values) == len(at_s):
        known_s, speed = at_s, table.values[:, 0]
    elif columns == 2:
        known_s, speed = table.values[:, 0] - 1e-6 * timestamps_us[0], table.values[:, 1]
    else:
        raise TrajectoryError(
            f"{path}: expected `time speed` a line (s, m/s), or one speed for each of the {len(at_s)} poses of the "
            f"truth, got {len(table.values)} lines of {columns} columns"
        )
    back = np.flatnonzero(np.diff(known_s) <= 0.0)
    if len(back):
        raise table.error(int(back[0]) + 1, "expected increasing times; sort the lines and drop duplicates")
    fast = np.flatnonzero(np.abs(speed) > 150.0)
    if len(fast):
        raise table.error(int(fast[0]), f"expected a speed in m/s, got {speed[fast[0]]:g}")
    dt = np.diff(known_s)
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * dt)])
    along = np.interp(at_s, known_s, travelled)
    near = (at_s >= known_s[0] - maximum_gap_s) & (at_s <= known_s[-1] + maximum_gap_s)
    along[~near] = np.nan
    return np.concatenate([[np.nan], np.diff(along)])


def filled_m(distance_m: FloatArray, dt_s: FloatArray) -> FloatArray | None:
    """Distances ``(rows,)`` with the last known speed where one is missing; ``None`` where none is known at all.

    Before the first known speed that one stands in.
    """
    speed = distance_m[1:] / dt_s[1:]
    known = np.flatnonzero(np.isfinite(speed))
    if not len(known):
        return None
    held = np.maximum.accumulate(np.where(np.isfinite(speed), np.arange(len(speed)), -1))
    held[held < 0] = known[0]
    return np.concatenate([[np.nan], speed[held] * dt_s[1:]])
