"""TUM, KITTI, EuRoC and VINS trajectory files, told apart by what they hold and not by their names.

==========  ========  ==============================================================  ==========================
format      columns   one line                                                        times
==========  ========  ==============================================================  ==========================
``tum``     8         ``t x y z qx qy qz qw``                                         seconds or nanoseconds
``euroc``   8, 14+    ``t, x, y, z, qw, qx, qy, qz, ...``                             nanoseconds or seconds
``vins``    11        ``t, x, y, z, qw, qx, qy, qz, vx, vy, vz``                      nanoseconds or seconds
``kitti``   12, 13    the 3x4 matrix row by row, a time or frame number before it     none, column 1, or a file
``matrix``  16, 17    the 4x4 matrix row by row, a time or frame number before it     none, column 1, or a file
==========  ========  ==============================================================  ==========================

The stamped files of the rpg layout are TUM files. Separators are blanks, commas or semicolons in all of them. Where
quaternions have w is told by :mod:`mixo_env.trajectory.quaternions`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mixo_env.errors import ConfigurationError, TrajectoryError
from mixo_env.files import write_text
from mixo_env.geometry import FloatArray
from mixo_env.trajectory.poses import Trajectory
from mixo_env.trajectory.quaternions import QuaternionOrder, nanoseconds, quaternion_columns
from mixo_env.trajectory.text import NumberTable, read_numbers

_LEAST_POSES = 2
_QUATERNION_TOLERANCE = 5e-3
"""Four printed decimals put the length of a quaternion off by up to 2e-4."""
_ROTATION_TOLERANCE = 1e-2
_LATEST_S = 1e11
"""The year 5138: larger stamps are not seconds."""
_FURTHEST_M = 1e9
"""Larger coordinates are no place on Earth, and squares of much larger ones overflow."""
_LAST_FRAME = 10_000_000
_LAST_ROW_TOLERANCE = 1e-6
_LONGEST_STEP_S = 1e3


@dataclass
class TrajectoryFiles:
    """Reads trajectory files, each one once: pipes can be read once only.

    Attributes:
        times: for KITTI files and matrices, a file with one time a line.
        quaternions: order of quaternions in files that do not tell it themselves.
        notes: file -> what had to be assumed to read it.
    """

    times: Path | None = None
    quaternions: QuaternionOrder = "file"
    notes: dict[Path, str] = field(default_factory=dict)
    _stamps: NumberTable | None = None
    _read: dict[Path, Trajectory] = field(default_factory=dict, repr=False)

    def read(self, path: Path) -> Trajectory:
        """The trajectory in a file; its format is told from its columns.

        Raises:
            TrajectoryError: with file and line, when the file cannot be read as that format.
            ConfigurationError: when times are given for a file that holds its own.
        """
        if path not in self._read:
            self._read[path] = self._trajectory(read_numbers(path))
        return self._read[path]

    def _trajectory(self, table: NumberTable) -> Trajectory:
        table = _without_row_numbers(table)
        columns = table.values.shape[1]
        if columns not in (8, 11, 12, 13) and columns < 14:
            raise table.error(
                0,
                "expected 8 columns (TUM, EuRoC), 11 (VINS), 12 or 13 (KITTI), 16 or 17 (4x4 matrices) or 14 and more "
                f"(EuRoC with states), got {columns}" + ("; write one matrix a line" if columns == 4 else ""),
            )
        if len(table.values) < _LEAST_POSES:
            raise table.error(0, f"expected at least {_LEAST_POSES} poses, got this one only; a path needs more")
        matrix = _matrix_columns(table)
        if matrix is None:
            if self.times is not None:
                raise ConfigurationError(f"{table.path} holds its own times: leave out {self.times}")
            return self._quaternion_poses(table)
        return self._matrix_poses(table, matrix)

    def _quaternion_poses(self, table: NumberTable) -> Trajectory:
        values = table.values
        stamps = _times(table, values[:, 0])
        positions_m = _positions(table, values[:, 1:4])
        _check_unit(table, values[:, 4:8])
        quaternions, note = quaternion_columns(table, self.quaternions)
        if note:
            self.notes[table.path] = note
        quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
        return Trajectory(positions_m, quaternions, stamps, counted=_counted(values[:, 0]))

    def _matrix_poses(self, table: NumberTable, columns: FloatArray) -> Trajectory:
        stamps, counted = None, False
        if table.values.shape[1] % 2:  # 13 or 17
            stamps, counted = _times(table, table.values[:, 0]), _counted(table.values[:, 0])
        if self.times is not None:
            if stamps is not None and not counted:
                raise ConfigurationError(
                    f"{table.path} holds its own times ({table.values.shape[1]} columns): leave out {self.times}"
                )
            self._stamps = self._stamps or read_numbers(self.times)
            stamps, counted = _stamps_of(self._stamps, table, stamps), False
        matrices = columns.reshape(-1, 3, 4)
        _positions(table, matrices[:, :, 3])
        _check_rotations(table, matrices[:, :, :3])
        poses = Trajectory.from_matrices(matrices, stamps, camera_axes=True)
        return Trajectory(poses.positions_m, poses.quaternions_wxyz, stamps, camera_axes=True, counted=counted)


def read_trajectory(path: Path, times: Path | None = None, quaternions: QuaternionOrder = "file") -> Trajectory:
    """Read one trajectory file, see :class:`TrajectoryFiles`."""
    return TrajectoryFiles(times, quaternions).read(path)


def tum_text(trajectory: Trajectory, decimals: int | None = None) -> str:
    """A TUM file's content. It needs times.

    Args:
        trajectory: its poses.
        decimals: to which numbers are rounded; ``None``: reading gives the same bits.

    Raises:
        TrajectoryError: when the trajectory has no times.
    """
    if trajectory.timestamps_s is None:
        raise TrajectoryError("a TUM file needs a time for each pose, this trajectory has none; write KITTI")
    quaternions_xyzw = np.roll(trajectory.quaternions_wxyz, -1, axis=1)
    rows = np.column_stack([trajectory.timestamps_s, trajectory.positions_m, quaternions_xyzw])
    return _text(rows if decimals is None else np.round(rows, decimals))


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
    """Shortest numbers that give the same bits, or nan; a JSON encoder is four times as fast as repr."""
    from msgspec import json

    encoded = json.encode(rows.tolist())[2:-2].replace(b"null", b"nan")
    return encoded.replace(b"],[", b"\n").replace(b",", b" ").decode() + "\n" if len(rows) else ""


def _without_row_numbers(table: NumberTable) -> NumberTable:
    """Without the first of nine columns when it counts the rows, as pandas writes them."""
    values = table.values
    if values.shape[1] != 9 or not np.array_equal(values[:, 0], np.arange(len(values))):
        return table
    return replace(table, values=values[:, 1:], names=table.names[1:])


def _matrix_columns(table: NumberTable) -> FloatArray | None:
    """The 12 columns of the 3x4 matrices, or ``None`` when the file holds quaternions."""
    values = table.values
    columns = values.shape[1]
    if columns in (12, 13):
        return values[:, columns - 12 :]
    if columns not in (16, 17):
        return None
    last = np.abs(values[:, -4:] - np.array([0.0, 0.0, 0.0, 1.0])).max(axis=1)
    if last.max() < _LAST_ROW_TOLERANCE:
        return values[:, columns - 16 : columns - 4]
    if columns == 17:  # EuRoC with velocity and biases
        return None
    if not np.any(values[:, 3:12:4]) and np.all(values[:, 15] == 1.0):
        raise table.error(0, "expected 4x4 matrices row by row, these look written column by column; transpose them")
    row = int(np.argmax(last))
    raise table.error(row, "expected a 4x4 matrix (16 columns) with the last row 0 0 0 1, got another last row")


def _positions(table: NumberTable, positions_m: FloatArray) -> FloatArray:
    far = np.flatnonzero(np.abs(positions_m).max(axis=1) > _FURTHEST_M)
    if len(far):
        raise table.error(
            far[0],
            f"expected coordinates up to {_FURTHEST_M:g} m, got {np.abs(positions_m[far[0]]).max():.3g}: "
            "out of range; check unit and columns",
        )
    return positions_m.copy()


def _check_rotations(table: NumberTable, rotation: FloatArray) -> None:
    large = np.abs(rotation).max(axis=(1, 2)) > 2.0  # whose products may overflow
    sound = np.where(large[:, None, None], 0.0, rotation)
    skewed = np.abs(sound @ sound.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > _ROTATION_TOLERANCE
    # A triple product: LAPACK's determinant divides by pivots, which may be too small for that.
    mirrors = np.sum(np.cross(sound[:, 0], sound[:, 1]) * sound[:, 2], axis=1) < 0.0
    bad = np.flatnonzero(skewed | mirrors)
    if len(bad):
        raise table.error(
            bad[0], "expected a rotation in columns 1-3, 5-7 and 9-11, its rows are not orthonormal or mirror"
        )


def _counted(stamps: FloatArray) -> bool:
    """Whether a first column may number the frames of another file."""
    return bool(stamps[0] >= 0.0 and stamps[-1] <= _LAST_FRAME and np.all(stamps == np.rint(stamps)))


def _stamps_of(table: NumberTable, poses: NumberTable, frames: FloatArray | None) -> FloatArray:
    """From a table of times: those of all poses, or of the frames they number."""
    if table.values.shape[1] != 1:
        raise table.error(0, f"expected one time in seconds a line, got {table.values.shape[1]} columns")
    times = _times(table, table.values[:, 0])
    if frames is not None:
        if frames[-1] >= len(times):
            raise TrajectoryError(
                f"{table.path}: expected a time for frame {frames[-1]:.0f} of {poses.path}, got {len(times)} times; "
                "frames count from 0"
            )
        return times[frames.astype(np.int64)]
    if len(times) != len(poses.values):
        raise TrajectoryError(
            f"{table.path}: expected {len(poses.values)} times, one per pose of {poses.path}, got {len(times)}"
        )
    return times


def _check_unit(table: NumberTable, quaternions: FloatArray) -> None:
    norm = np.linalg.norm(np.clip(quaternions, -2.0, 2.0), axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > _QUATERNION_TOLERANCE)
    if len(bad):
        raise table.error(
            bad[0], f"expected a quaternion of length 1, got {norm[bad[0]]:.6g}; check the order of columns"
        )


def _times(table: NumberTable, stamps: FloatArray) -> FloatArray:
    """Seconds, from seconds or nanoseconds."""
    wild = np.flatnonzero(np.abs(stamps) > 1e9 * _LATEST_S)
    if len(wild):
        raise table.error(
            wild[0], f"expected a time in seconds or nanoseconds, got {stamps[wild[0]]:.6g}, out of range"
        )
    back = np.flatnonzero(np.diff(stamps) <= 0.0)
    if len(back):
        row = int(back[0]) + 1
        raise table.error(
            row,
            f"expected increasing times, got {stamps[row]:.6f} after {stamps[row - 1]:.6f}; sort the lines "
            "and drop duplicates",
        )
    times = stamps / 1e9 if nanoseconds(stamps) else stamps.copy()
    late = np.flatnonzero(np.abs(times) > _LATEST_S)
    if len(late):
        value = np.abs(stamps[late[0]])
        unit = {14: "microseconds: divide the times by 1e6", 11: "milliseconds: divide the times by 1e3"}
        hint = next((words for power, words in unit.items() if 10.0**power < value < 1e17), None)
        raise table.error(
            late[0],
            f"expected a time in seconds or nanoseconds, got {stamps[late[0]]:.6g}, "
            + (f"which looks like {hint}" if hint else "out of range; check the first column"),
        )
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    if step > _LONGEST_STEP_S:
        raise table.error(
            0, f"expected times in seconds or nanoseconds, got steps of {step:g}: convert the times to seconds"
        )
    return times
