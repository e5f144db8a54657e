"""Read a nuScenes table (one JSON array of objects) row by row with bounded memory.

The tables of the full data set reach 1.4 GB; read as one object each they cost the official devkit 7.8 GB of memory.
Here a block of the file at a time is decoded into typed rows that hold the needed fields only.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

import msgspec

from mixo_env.errors import DatasetError

BLOCK_BYTES = 2 * 2**20

Row = TypeVar("Row", bound=msgspec.Struct)


def read_rows(path: Path, row_type: type[Row], block_bytes: int = BLOCK_BYTES) -> Iterator[Row]:
    """Rows of the table at ``path`` in file order.

    Args:
        path: a ``.json`` file holding one array of objects.
        row_type: fields to keep; unknown fields of the file are skipped while parsing.
        block_bytes: file bytes decoded at once.

    Raises:
        DatasetError: the file is missing, truncated, not an array of objects, or a row lacks a needed field.
    """
    decoder = msgspec.json.Decoder(list[row_type])
    try:
        with path.open("rb") as file:
            pending = file.read(block_bytes).lstrip()
            if not pending.startswith(b"["):
                raise _broken(path, f"expected a JSON array, it starts with {pending[:20]!r}")
            pending = pending[1:]
            while True:
                block = file.read(block_bytes)
                pending += block
                rows, pending = _decode_complete_rows(path, decoder, pending, is_last=not block)
                yield from rows
                if not block:
                    break
    except FileNotFoundError:
        raise DatasetError(f"{path} is missing: unpack the nuScenes metadata of this version again") from None
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}") from error
    if pending.strip() != b"]":
        raise _broken(path, "it ends before the closing ']'")


def _decode_complete_rows(
    path: Path, decoder: msgspec.json.Decoder[list[Row]], text: bytes, is_last: bool
) -> tuple[list[Row], bytes]:
    """Decode everything up to the last ``}``, without the comma before it, and hand back the rest.

    A ``}`` normally ends a row. Inside a string or a nested object it does not: decoding then fails, and the text is
    kept until a later block completes the row.
    """
    text = text.lstrip().removeprefix(b",")
    end = text.rfind(b"}") + 1
    if end == 0:
        return [], text
    try:
        rows = decoder.decode(b"[" + text[:end] + b"]")
    except msgspec.ValidationError as error:
        raise _broken(path, str(error)) from error
    except msgspec.DecodeError as error:
        if is_last:
            raise _broken(path, str(error)) from error
        return [], text
    return rows, text[end:]


def _broken(path: Path, reason: str) -> DatasetError:
    return DatasetError(f"{path} is not a valid nuScenes file: {reason}; copy or unpack it again")
