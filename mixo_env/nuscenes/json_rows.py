"""Read a nuScenes table (one JSON array of objects) row by row with bounded memory.

The tables of the full data set reach 1.4 GB; read as one object each they cost the official devkit 7.8 GB of memory.
Here a block of the file at a time is decoded into typed rows that hold the needed fields only.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, TypeVar

import msgspec

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.files import open_file

BLOCK_BYTES = 2 * 2**20

LONGEST_ROW_BYTES = 2**20
"""Real rows hold half a kilobyte. It bounds what is kept of a block whose last row is not complete."""

ROW_ENDS_TRIED = 16
"""How many ``}`` are tried, from the last one backwards, before more of the file is read."""

Row = TypeVar("Row", bound=msgspec.Struct)


def read_blocks(path: Path, row_type: type[Row], block_bytes: int = BLOCK_BYTES) -> Iterator[list[Row]]:
    """Rows of the table at ``path`` in file order, some thousands at a time.

    Args:
        path: a ``.json`` file holding one array of objects.
        row_type: fields to keep; unknown fields of the file are skipped while parsing.
        block_bytes: file bytes decoded at once.

    Raises:
        DatasetError: the file is missing, truncated, not an array of objects, or a row lacks a needed field or holds
            a value beyond sense. A fault is found in the block it stands in.
    """
    try:
        with open_file(path) as file:
            yield from _blocks(path, file, msgspec.json.Decoder(list[row_type]), block_bytes)
    except FileNotFoundError:
        raise DatasetError(f"{path} is missing: unpack the nuScenes metadata of this version again") from None
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}") from error


def _blocks(
    path: Path, file: BinaryIO, decoder: msgspec.json.Decoder[list[Row]], block_bytes: int
) -> Iterator[list[Row]]:
    pending = file.read(block_bytes).lstrip()
    if not pending.startswith(b"["):
        raise broken(path, f"expected a JSON array, it starts with {pending[:20]!r}")
    pending = pending[1:]
    count = 0
    while True:
        block = file.read(block_bytes)
        pending += block
        rows, pending = _decode_complete_rows(path, decoder, pending, count, is_last=not block)
        yield rows
        count += len(rows)
        if not block:
            break
        if len(pending) > LONGEST_ROW_BYTES + 2 * block_bytes:
            raise broken(path, f"row {count} is longer than {LONGEST_ROW_BYTES // 2**20} MB or never ends")
    if pending.strip() != b"]":
        raise broken(path, "it ends before the closing ']', or something follows it")


def _decode_complete_rows(
    path: Path, decoder: msgspec.json.Decoder[list[Row]], text: bytes, count: int, is_last: bool
) -> tuple[list[Row], bytes]:
    """Decode everything up to the last ``}``, without the comma before it, and hand back the rest.

    A ``}`` normally ends a row. Inside a string or a nested object it does not: decoding then fails at the cut, and
    nowhere before; an earlier ``}`` is tried, and in the end the text is kept until a later block completes the row.
    """
    text = text.lstrip().removeprefix(b",")
    end = len(text)
    for _ in range(ROW_ENDS_TRIED):
        end = text.rfind(b"}", 0, end) + 1
        if end == 0:
            break
        try:
            return decoder.decode(b"[" + text[:end] + b"]"), text[end:]
        except msgspec.ValidationError as error:
            raise broken(path, _with_row(str(error), count)) from None
        except msgspec.DecodeError as error:
            if is_last or not _is_at_the_cut(str(error), end):
                raise broken(path, f"{error}, in the {len(text):,} bytes after row {count}") from None
        except UnicodeDecodeError as error:
            raise broken(path, f"it is not UTF-8 ({error.reason}), after row {count}") from None
        except RecursionError:
            raise broken(path, f"too deeply nested, after row {count}") from None
        end -= 1
    return [], text


def _is_at_the_cut(message: str, end: int) -> bool:
    """Whether decoding ``[`` + ``end`` bytes + ``]`` failed where the text was cut, and not before."""
    match = re.search(r"\(byte (\d+)\)", message)
    return match is None or int(match[1]) >= end


def _with_row(message: str, count: int) -> str:
    """The decoder counts rows from the beginning of its block."""
    return re.sub(r"`\$\[(\d+)\]", lambda match: f"`row[{count + int(match[1])}]", message)


def broken(path: Path, reason: str) -> DatasetError:
    """The error of a file that is there but is no nuScenes file."""
    return DatasetError(f"{path} is not a valid nuScenes file: {reason}; copy or unpack it again")
