"""What a program says about its poses: ``03.quality.csv`` beside ``03.txt``, a heading and one line a pose.

Columns, in any order: ``matches``, ``state`` (tracking, lost or initialising), ``confidence`` and ``yaw_std_rad`` (of
the turn since the pose before: the square root of its covariance entry). A column ``time`` or ``frame`` is there to be
read by people; lines belong to poses one by one.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from mixo_env.errors import TrajectoryError, unknown
from mixo_env.experts.imported import Quality
from mixo_env.trajectory.text import read_text

SUFFIX = ".quality.csv"

_NUMBERS = ("matches", "confidence", "yaw_std_rad")
_IGNORED = ("time", "frame")
_STATES = {"tracking": False, "lost": True, "initialising": True}


def quality_file(trajectory: Path) -> Path:
    """Where the quality of a trajectory's poses may stand."""
    return trajectory.with_name(trajectory.stem + SUFFIX)


def read_quality(path: Path, poses: int) -> Quality:
    """The quality of ``poses`` poses.

    Raises:
        TrajectoryError: for an unknown column, a cell that is no number of 0 or more or no state, another number of
            lines.
    """
    rows = list(csv.reader(io.StringIO(read_text(path))))
    if not rows:
        raise TrajectoryError(f"{path}: expected a heading and one line a pose, the file is empty")
    heading = [name.strip().lower() for name in rows[0]]
    for name in heading:
        if name not in (*_NUMBERS, *_IGNORED, "state"):
            raise TrajectoryError(f"{path}: {unknown('column', name, (*_NUMBERS, *_IGNORED, 'state'))}")
    if len(set(heading)) < len(heading):
        raise TrajectoryError(f"{path}: expected every column once, got {', '.join(heading)}")
    body = [(number, row) for number, row in enumerate(rows[1:], start=2) if any(cell.strip() for cell in row)]
    if len(body) != poses:
        raise TrajectoryError(f"{path}: expected {poses} lines, one per pose, got {len(body)}")
    numbers = {name: np.full(poses, np.nan) for name in _NUMBERS}
    lost = np.zeros(poses, np.bool_)
    for i, (line, row) in enumerate(body):
        if len(row) != len(heading):
            raise TrajectoryError(f"{path}, line {line}: expected {len(heading)} cells, got {len(row)}")
        for name, cell in zip(heading, map(str.strip, row), strict=True):
            if name == "state":
                lost[i] = _state(path, line, cell)
            elif name in numbers:
                numbers[name][i] = _number(path, line, name, cell)
    return Quality(lost=lost, **numbers)


def _state(path: Path, line: int, cell: str) -> bool:
    if cell.lower() not in _STATES:
        raise TrajectoryError(f"{path}, line {line}: {unknown('state', cell, _STATES)}")
    return _STATES[cell.lower()]


def _number(path: Path, line: int, name: str, cell: str) -> float:
    """A number; an empty cell says nothing."""
    if not cell:
        return np.nan
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not 0.0 <= value < 1e9:
        raise TrajectoryError(f"{path}, line {line}: expected {name} of 0 or more, got {cell[:40]!r}")
    return value
