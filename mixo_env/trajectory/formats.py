"""TUM, KITTI and EuRoC trajectory files.

==========  ================================================  =========================================
format      one line                                          times
==========  ================================================  =========================================
``tum``     ``t x y z qx qy qz qw`` (blanks)                  seconds
``kitti``   12 numbers, the 3x4 matrix row by row             none, a leading 13th column, or a file
``euroc``   ``t, x, y, z, qw, qx, qy, qz, ...`` (commas)      integer nanoseconds
==========  ================================================  =========================================

The stamped files of the rpg layout are TUM files.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mixo_env.errors import ConfigurationError, TrajectoryError
from mixo_env.files import write_text
from mixo_env.geometry import FloatArray
from mixo_env.trajectory.poses import Trajectory
from mixo_env.trajectory.text import NumberTable, read_numbers

_LEAST_POSES = 2
_QUATERNION_TOLERANCE = 5e-3
"""Four printed decimals put the length of a quaternion off by up to 2e-4."""
_ROTATION_TOLERANCE = 1e-2
_LATEST_S = 1e11
"""The year 5138: larger stamps are not seconds."""
_SHORTEST_STEP_NS = 1e3


def read_trajectory(path: Path, times: Path | None = None) -> Trajectory:
    """Read a trajectory file; its format is told from the number of columns.

    Args:
        path: the file.
        times: for KITTI files, a file with one time in seconds a line.

    Raises:
        TrajectoryError: with file and line, when the file cannot be read as that format.
        ConfigurationError: when times are given for a file that holds its own.
    """
    table = read_numbers(path)
    columns = table.values.shape[1]
    if columns not in (8, 12, 13) and columns < 14:
        raise table.error(
            0, f"expected 8 columns (TUM, EuRoC), 12 or 13 (KITTI) or 14 and more (EuRoC with states), got {columns}"
        )
    if len(table.values) < _LEAST_POSES:
        raise table.error(0, f"expected at least {_LEAST_POSES} poses, got this one only; a path needs more")
    if columns in (12, 13):
        return _kitti(table, times)
    if times is not None:
        raise ConfigurationError(f"{path} holds its own times: leave out {times}")
    # TUM and EuRoC have 8 columns both; EuRoC files are named .csv, and most have 17.
    return _euroc(table) if columns > 8 or path.suffix.lower() == ".csv" else _tum(table)


def tum_text(trajectory: Trajectory) -> str:
    """A TUM file's content; numbers are written so that reading gives the same bits. It needs times.

    Raises:
        TrajectoryError: when the trajectory has no times.
    """
    if trajectory.timestamps_s is None:
        raise TrajectoryError("a TUM file needs a time for each pose, this trajectory has none; write KITTI")
    quaternions_xyzw = np.roll(trajectory.quaternions_wxyz, -1, axis=1)
    return _text(np.column_stack([trajectory.timestamps_s, trajectory.positions_m, quaternions_xyzw]))


def kitti_text(trajectory: Trajectory) -> str:
    """A KITTI file's content, 12 numbers a line; times are not kept."""
    return _text(trajectory.matrices()[:, :3, :].reshape(-1, 12))


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a TUM file at once or not at all."""
    write_text(path, tum_text(trajectory))


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Write a KITTI file at once or not at all."""
    write_text(path, kitti_text(trajectory))


def _text(rows: FloatArray) -> str:
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


def _tum(table: NumberTable) -> Trajectory:
    values = table.values
    return Trajectory(
        values[:, 1:4].copy(), _unit(table, np.roll(values[:, 4:8], 1, axis=1)), _seconds(table, values[:, 0])
    )


def _euroc(table: NumberTable) -> Trajectory:
    values = table.values
    step = float(np.median(np.abs(np.diff(values[:, 0]))))
    if step < _SHORTEST_STEP_NS:
        raise table.error(
            0, f"expected EuRoC stamps in nanoseconds, got steps of {step:g}, which look like seconds; write TUM"
        )
    _increasing(table, values[:, 0])
    return Trajectory(values[:, 1:4].copy(), _unit(table, values[:, 4:8]), values[:, 0] / 1e9)


def _kitti(table: NumberTable, times: Path | None) -> Trajectory:
    values, timestamps_s = table.values, None
    if values.shape[1] == 13:
        if times is not None:
            raise ConfigurationError(f"{table.path} holds its own times (13 columns): leave out {times}")
        timestamps_s = _seconds(table, values[:, 0])
        values = values[:, 1:]
    elif times is not None:
        timestamps_s = _read_times(times, table)
    matrices = values.reshape(-1, 3, 4)
    rotation = matrices[:, :, :3]
    skewed = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > _ROTATION_TOLERANCE
    bad = np.flatnonzero(skewed | (np.linalg.det(rotation) < 0.0))
    if len(bad):
        raise table.error(
            bad[0], "expected a rotation in columns 1-3, 5-7 and 9-11, its rows are not orthonormal or mirror"
        )
    return Trajectory.from_matrices(matrices, timestamps_s, camera_axes=True)


def _read_times(path: Path, poses: NumberTable) -> FloatArray:
    table = read_numbers(path)
    if table.values.shape[1] != 1:
        raise table.error(0, f"expected one time in seconds a line, got {table.values.shape[1]} columns")
    if len(table.values) != len(poses.values):
        raise TrajectoryError(
            f"{path}: expected {len(poses.values)} times, one per pose of {poses.path}, got {len(table.values)}"
        )
    return _seconds(table, table.values[:, 0])


def _unit(table: NumberTable, quaternions_wxyz: FloatArray) -> FloatArray:
    norm = np.sqrt(np.sum(quaternions_wxyz**2, axis=1))
    bad = np.flatnonzero(np.abs(norm - 1.0) > _QUATERNION_TOLERANCE)
    if len(bad):
        raise table.error(
            bad[0], f"expected a quaternion of length 1, got {norm[bad[0]]:.6g}; check the order of columns"
        )
    return quaternions_wxyz / norm[:, None]


def _seconds(table: NumberTable, times: FloatArray) -> FloatArray:
    late = np.flatnonzero(np.abs(times) > _LATEST_S)
    if len(late):
        exponent, unit = next(
            (exponent, unit)
            for exponent, unit in ((9, "nanoseconds"), (6, "microseconds"), (3, "milliseconds"))
            if abs(times[late[0]]) > 10.0 ** (exponent + 8) or exponent == 3
        )
        raise table.error(
            late[0],
            f"expected a time in seconds, got {times[late[0]]:.0f}, which looks like {unit}: "
            f"divide the times by 1e{exponent}" + (", or name an EuRoC file .csv" if exponent == 9 else ""),
        )
    _increasing(table, times)
    return times.copy()


def _increasing(table: NumberTable, times: FloatArray) -> None:
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if len(back):
        row = int(back[0]) + 1
        raise table.error(
            row,
            f"expected increasing times, got {times[row]:.6f} after {times[row - 1]:.6f}; sort the lines "
            "and drop duplicates",
        )
