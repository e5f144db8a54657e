"""Recordings and tables opened once a process: environments of equal settings share them, read only.

A training script makes dozens of environments; each with its own copy would cost minutes and gigabytes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable
from importlib.resources import files
from pathlib import Path
from typing import TypeVar
from weakref import WeakValueDictionary

from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import DEFAULT_RECORDINGS, bundled_recordings, load_recordings

Prepared = TypeVar("Prepared")

MOST_RECORDINGS = 4
"""Recordings kept open; the one opened first goes first."""

_opened: dict[Hashable, Recordings] = {}
_prepared: WeakValueDictionary[Hashable, object] = WeakValueDictionary()


def identity(source: str | Path | None) -> Hashable:
    """What tells one state of a recording from another: its resolved folder, and every file's inode, size and time."""
    name = DEFAULT_RECORDINGS if source is None else source
    bundled = isinstance(name, str) and name in bundled_recordings()
    folder = Path(str(files("mixo_env.recordings") / "data" / str(name))) if bundled else Path(os.path.realpath(name))
    status = [path.stat() for path in sorted(folder.glob("*"))] if folder.is_dir() else []
    return str(folder), tuple((one.st_ino, one.st_size, one.st_mtime_ns) for one in status)


def shared_recordings(source: str | Path | None) -> Recordings:
    """The recordings of a folder or bundled name, read when this process first asks and again when a file changes.

    Their columns cannot be written: everybody in the process holds the same ones.

    Raises:
        RecordingError: when they cannot be read.
    """
    key = identity(source)
    if key not in _opened:
        recordings = load_recordings(source)
        for name in recordings.column_names:
            recordings[name].flags.writeable = False
        while len(_opened) >= MOST_RECORDINGS:
            _opened.pop(next(iter(_opened)))
        _opened[key] = recordings
    return _opened[key]


def prepared(key: Hashable, prepare: Callable[[], Prepared]) -> Prepared:
    """What ``prepare`` returns for ``key``, made anew only when nobody holds it any longer; None is nobody's key."""
    if key is None:
        return prepare()
    found = _prepared.get(key)
    if found is None:
        found = _prepared[key] = prepare()
    return found  # type: ignore[return-value]
