"""The bundled recordings, read once, and a few of their drives for facts that do not need all of them."""

from __future__ import annotations

import functools

from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.folds import OUT_OF_DISTRIBUTION
from mixo_env.recordings.store import DEFAULT_RECORDINGS, load_recordings

_read = functools.cache(load_recordings)


def bundled(name: str = DEFAULT_RECORDINGS) -> Recordings:
    """A bundled recording, read once in a process."""
    return _read(name)


@functools.cache
def few_drives(each: int = 5) -> Recordings:
    """Of every fold of the bundled recordings ``each`` drives, evenly spaced: as many however large the bundle is."""
    scenes = bundled().scenes
    chosen: list[str] = []
    for fold in sorted({scene.fold for scene in scenes} - {OUT_OF_DISTRIBUTION}):
        names = [scene.name for scene in scenes if scene.fold == fold]
        chosen += [names[i * len(names) // each] for i in range(min(each, len(names)))]
    return bundled().select(scenes=chosen)
