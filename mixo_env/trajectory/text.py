"""Tables of numbers in text files, with errors that name file and line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mixo_env.errors import TrajectoryError
from mixo_env.geometry import FloatArray


@dataclass(frozen=True)
class NumberTable:
    """Numbers of a text file.

    Attributes:
        path: the file.
        values: ``(rows, columns)``, all finite.
        lines: line number of each row, counted from 1.
    """

    path: Path
    values: FloatArray
    lines: list[int]

    def error(self, row: int, message: str) -> TrajectoryError:
        """The error that says what is wrong in ``row``."""
        return TrajectoryError(f"{self.path}, line {self.lines[row]}: {message}")


def read_numbers(path: Path) -> NumberTable:
    """Read a table of numbers separated by blanks or commas.

    Blank lines and lines that start with ``#`` are skipped; Windows line ends and a byte-order mark are accepted.

    Raises:
        TrajectoryError: when the file is missing, empty or not text, or a line holds something else than as many
            finite numbers as the first.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not a text file"
        raise TrajectoryError(f"{path}: expected a text file of numbers, cannot read it: {reason}") from None
    rows, lines = [], []
    for number, line in enumerate(text.replace(",", " ").splitlines(), start=1):
        stripped = line.strip()
        if stripped and stripped[0] != "#":
            rows.append(stripped)
            lines.append(number)
    if not rows:
        raise TrajectoryError(f"{path}: expected at least 2 poses, the file is empty; check how it was written")
    try:
        values = np.loadtxt(rows, dtype=np.float64, comments=None, ndmin=2)
    except ValueError:
        raise _first_bad_line(path, rows, lines) from None
    table = NumberTable(path, values, lines)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise table.error(bad[0], "expected finite numbers, got NaN or infinity; remove the line or repair it")
    return table


def _first_bad_line(path: Path, rows: list[str], lines: list[int]) -> TrajectoryError:
    expected = len(rows[0].split())
    for number, row in zip(lines, rows, strict=True):
        words = row.split()
        for word in words:
            try:
                float(word)
            except ValueError:
                return TrajectoryError(
                    f"{path}, line {number}: expected numbers, got {word[:40]!r}; comments start with #"
                )
        if len(words) != expected:
            return TrajectoryError(
                f"{path}, line {number}: expected {expected} columns as in line {lines[0]}, got {len(words)}"
            )
    return TrajectoryError(f"{path}: expected a table of numbers, one pose a line")
