"""Open files of a data set: only files, never a pipe that waits for ever or a device that never ends."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import BinaryIO

from mixo_env.errors import DatasetError

LARGEST_FILE_BYTES = 200 * 2**20
"""Of files that are read in one piece (CAN bus 0.6 MB, exact poses 1 MB, images 0.3 MB)."""


def open_file(path: str | Path) -> BinaryIO:
    """Open a file for reading; links are followed, as people keep ``samples`` on another disk.

    Raises:
        FileNotFoundError: nothing is there.
        DatasetError: a folder, pipe, socket or device stands in its place, or it cannot be read.
    """
    # A pipe without a writer would block the plain open() for ever.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
    try:
        handle = os.open(path, flags)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}") from error
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise DatasetError(f"{path} is not a file but a folder, pipe or device: unpack it again")
    return os.fdopen(handle, "rb")


def read_file(path: Path, limit: int = LARGEST_FILE_BYTES) -> bytes:
    """All bytes of a file.

    Raises:
        FileNotFoundError: nothing is there.
        DatasetError: as :func:`open_file`; a file larger than ``limit`` bytes.
    """
    with open_file(path) as file:
        try:
            # As many bytes as there are: a buffer of the limit costs more than a small file.
            content = file.read(min(os.fstat(file.fileno()).st_size, limit) + 1)
        except OSError as error:
            raise DatasetError(f"{path} cannot be read: {error.strerror}") from error
    if len(content) > limit:
        raise DatasetError(f"{path} is larger than {limit // 2**20} MB: no such file belongs to nuScenes")
    return content
