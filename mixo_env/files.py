"""Writing files: whole or not at all, and one line when that cannot be done."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mixo_env.errors import OutputError

_PROBE = bytes(4096)
"""Written and removed again: a full disk still takes empty files."""


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary file in the same folder that becomes ``path`` when the block ends well and vanishes otherwise.

    Folders are made as needed. The temporary name has no suffix, so that no search for files by suffix finds what an
    interrupted program left; functions that choose a format by suffix must be told the format.

    Raises:
        OutputError: when anything in the block, or around it, meets an error of the file system.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".part-")
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            temporary.chmod(0o644)
            temporary.replace(path)
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
    except OSError as error:
        raise _cannot_write(path, error) from error


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file at once or not at all; folders are made as needed.

    Raises:
        OutputError: when it cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8, at once or not at all; halves of surrogate pairs (undecodable names) are spelt out.

    Raises:
        OutputError: when it cannot be written.
    """
    write_bytes(path, text.encode("utf-8", "backslashreplace"))


def write_json(path: Path, value: Any) -> None:
    """Write plain values or dataclasses as indented JSON, at once or not at all; what is not a number becomes null.

    Raises:
        OutputError: when it cannot be written.
    """
    import msgspec

    write_bytes(path, msgspec.json.format(msgspec.json.encode(value), indent=2) + b"\n")


def remove(path: Path) -> None:
    """Remove a file that is to be written anew; none is fine.

    Raises:
        OutputError: when it cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise _cannot_write(path, error) from error


def writable_folder(path: Path) -> Path:
    """Make a folder and see that a file can be written into it: before the work whose results shall go there.

    Returns:
        ``path``, which exists now.

    Raises:
        OutputError: when it cannot be made or written into.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path, prefix=".part-") as probe:
            probe.write(_PROBE)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _cannot_write(path, error) from error
    return path


def _cannot_write(path: Path, error: OSError | ValueError) -> OutputError:
    code = error.errno if isinstance(error, OSError) else None
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
    if code in (errno.EEXIST, errno.ENOTDIR, errno.EISDIR):
        reason = f"{reason.lower()}; something else is in the way"
    return OutputError(
        f"cannot write {path}: {reason}; free space, set permissions or choose another folder, then run again"
    )
