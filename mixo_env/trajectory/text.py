"""Tables of numbers in text files, with errors that name file and line."""

from __future__ import annotations

import gzip
import io
import re
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mixo_env.errors import TrajectoryError
from mixo_env.geometry import FloatArray

STANDARD_INPUT = Path("-")

_LARGEST_BYTES = 2**28
"""A million poses with all digits take 200 MB; what never ends must stop somewhere."""
_LONGEST_LINE = 10_000
_COMMENTS = ("#", "%")


@dataclass(frozen=True)
class NumberTable:
    """Numbers of a text file.

    Attributes:
        path: the file.
        values: ``(rows, columns)``, all finite.
        lines: line number of each row, counted from 1.
        names: of the columns, if a line above the first row holds as many words; else empty.
        separator: ``","`` or ``";"`` if the first row holds one, else a blank.
        trailing: the first row ends with its separator.
    """

    path: Path
    values: FloatArray
    lines: list[int]
    names: tuple[str, ...] = ()
    separator: str = " "
    trailing: bool = False

    def error(self, row: int, message: str) -> TrajectoryError:
        """The error that says what is wrong in ``row``."""
        return TrajectoryError(f"{self.path}, line {self.lines[row]}: {message}")


def read_numbers(path: Path) -> NumberTable:
    """Read a table of numbers separated by blanks, tabs, commas or semicolons.

    Blank lines, comments from ``#`` or ``%`` to the end of a line, and a heading (a first line without any number) are
    skipped; Windows line ends, a byte-order mark, quotes around cells, separators at the end of lines, gzip and
    ``-`` (standard input) are accepted.

    Raises:
        TrajectoryError: when the file is missing, empty, too long or not text, or a line holds something else than as
            many finite numbers as the first.
    """
    rows, lines, heading = _rows(path, read_text(path))
    if not rows:
        raise TrajectoryError(f"{path}: expected at least 2 poses, the file is empty; check how it was written")
    separator = next((mark for mark in ";," if mark in rows[0]), " ")
    plain = _without_separators(path, rows, lines, separator)
    try:
        values = np.loadtxt(plain, dtype=np.float64, comments=None, ndmin=2)
    except ValueError:
        raise _first_bad_line(path, plain, lines) from None
    columns = values.shape[1]
    table = NumberTable(path, values, lines, _names(heading, columns), separator, rows[0].endswith((",", ";")))
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise table.error(bad[0], "expected finite numbers, got NaN or infinity; remove the line or repair it")
    return table


def read_text(path: Path) -> str:
    """A text file whole, at most 256 MB of it, unpacked if need be.

    Raises:
        TrajectoryError: when it is missing, no text or too long.
    """
    try:
        if path == STANDARD_INPUT:
            data = sys.stdin.buffer.read(_LARGEST_BYTES + 1)
        else:
            with path.open("rb") as file:
                data = file.read(_LARGEST_BYTES + 1)
        if data.startswith(b"\x1f\x8b"):
            data = _unpacked(data)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise TrajectoryError(f"{path}: expected a text file of numbers, cannot read it: {reason}") from None
    if len(data) > _LARGEST_BYTES:
        raise TrajectoryError(
            f"{path}: expected at most {_LARGEST_BYTES >> 20} MB of text, got more; cut the file or thin out its poses"
        )
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise TrajectoryError(f"{path}: it is not a text file in UTF-8 but in UTF-16; save it as UTF-8")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise TrajectoryError(
            f"{path}: expected a text file of numbers, cannot read it: it is not a text file; save it as UTF-8"
        )
    return text


def _unpacked(data: bytes) -> bytes:
    try:
        return gzip.GzipFile(fileobj=io.BytesIO(data)).read(_LARGEST_BYTES + 1)
    except (OSError, EOFError, zlib.error):
        raise OSError("it is not a whole gzip file") from None


def _rows(path: Path, text: str) -> tuple[list[str], list[int], str]:
    """Lines of numbers without comments, their numbers, and the heading: the last other line above them."""
    rows: list[str] = []
    lines: list[int] = []
    heading = ""
    # Only these three line ends: str.splitlines knows others, and line numbers would differ from an editor's.
    for number, line in enumerate(io.StringIO(text, newline=None), start=1):
        if len(line) > _LONGEST_LINE:
            raise TrajectoryError(
                f"{path}, line {number}: expected one pose a line, got {len(line)} characters; check the line ends"
            )
        stripped = line.replace('"', " ").strip()
        if stripped.startswith(_COMMENTS):
            heading = heading if rows else stripped.lstrip("#% ")
            continue
        for mark in _COMMENTS:
            stripped = stripped.partition(mark)[0].rstrip()
        if not stripped:
            continue
        if not rows and not lines and _is_heading(stripped):
            heading = stripped
            lines.append(number)
            continue
        rows.append(stripped)
        lines.append(number)
    return rows, lines[len(lines) - len(rows) :], heading


def _is_heading(line: str) -> bool:
    return not any(_is_number(word) for word in re.split(r"[\s,;]+", line) if word)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and "_" not in word  # Python alone reads 1_000 and the digits of other scripts


def _names(heading: str, columns: int) -> tuple[str, ...]:
    """Names in a heading, without units in brackets; none unless there is one for every column."""
    bare = re.sub(r"\[.*?\]|\(.*?\)", " ", heading)
    for pattern in (r"[,;]", r"[\s,;]+"):
        names = tuple(name.strip().lower() for name in re.split(pattern, bare.strip(" ,;")))
        if len(names) == columns:
            return names
    return ()


def _without_separators(path: Path, rows: list[str], lines: list[int], separator: str) -> list[str]:
    """Rows with blanks for separators; an empty cell would otherwise vanish and shift its row."""
    if separator == " ":
        return rows
    plain = []
    for number, row in zip(lines, rows, strict=True):
        if separator == ";" and "," in row:
            raise TrajectoryError(
                f"{path}, line {number}: expected semicolons or commas between numbers, got both; "
                "write decimal points, not decimal commas"
            )
        cells = row.split(separator)
        if separator == "," and len(cells) > 3 and all(len(cell.split()) > 1 for cell in cells[1:-1]):
            raise TrajectoryError(f"{path}, line {number}: expected decimal points, got what looks like decimal commas")
        if not all(cell and not cell.isspace() for cell in cells[:-1]):
            raise TrajectoryError(f"{path}, line {number}: expected a number in every cell, one is empty")
        plain.append(" ".join(cells))
    return plain


def _first_bad_line(path: Path, rows: list[str], lines: list[int]) -> TrajectoryError:
    expected = len(rows[0].split())
    for number, row in zip(lines, rows, strict=True):
        words = row.split()
        for word in words:
            if not _is_number(word):
                return TrajectoryError(
                    f"{path}, line {number}: expected numbers, got {word[:40]!r}; comments start with #"
                )
        if len(words) != expected:
            return TrajectoryError(
                f"{path}, line {number}: expected {expected} columns as in line {lines[0]}, got {len(words)}"
            )
    return TrajectoryError(f"{path}: expected a table of numbers, one pose a line")
