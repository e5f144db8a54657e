"""The folder a run writes into: probed before any work, and written by one process at a time."""

from __future__ import annotations

import errno
import os
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mixo_env.errors import ConfigurationError, OutputError, printable
from mixo_env.files import writable_folder

LOCK_FILE = ".lock"

SPARE_BYTES = 16 << 20
"""Least free space to begin with."""


@contextmanager
def claimed(folder: str | Path, need_bytes: int = 0) -> Iterator[Path]:
    """Inside the block this process alone writes into ``folder``, which exists and has room.

    The claim is a lock of the operating system on ``folder/.lock``: it ends with the process, however that dies. Who
    only reads needs none.

    Args:
        folder: made if it does not exist.
        need_bytes: that the run will write, on top of ``SPARE_BYTES``.

    Raises:
        ConfigurationError: if another process writes there.
        OutputError: if nothing can be written there, or too little.
    """
    folder = Path(folder)
    path = folder / LOCK_FILE
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = _locked(path)
    try:
        writable_folder(folder)
        free = shutil.disk_usage(folder).free
        if free < need_bytes + SPARE_BYTES:
            raise OutputError(
                f"expected {(need_bytes + SPARE_BYTES) / 1e6:.0f} MB free for {folder}, found {free / 1e6:.0f} MB: "
                "make room or choose another --out"
            )
        yield folder
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)  # before the lock goes: who finds the file gone makes a new one
        os.close(handle)


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """A full disk or a folder that vanished becomes one line.

    Raises:
        OutputError: in place of an ``OSError``.
    """
    try:
        yield
    except OSError as error:
        reason = f"{error.filename or folder}: {error.strerror or error}"
        raise OutputError(f"cannot write into {folder} ({reason}): make room or choose another folder") from None


def _locked(path: Path) -> int:
    """Descriptor of the lock file, locked by this process; other processes do not inherit it."""
    import fcntl

    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(path, handle):
                os.ftruncate(handle, 0)
                os.pwrite(handle, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
                return handle
        except OSError as error:
            owner = printable(os.pread(handle, 200, 0).decode(errors="replace"))
            os.close(handle)
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise
            raise ConfigurationError(
                f"{path.parent} is being written by {owner or 'another process'}: wait for it or choose another --out"
            ) from None
        os.close(handle)


def _is_at(path: Path, handle: int) -> bool:
    """Whether the locked file is the one at ``path``: its owner may have removed it before the lock was ours."""
    try:
        return os.path.samestat(path.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False
