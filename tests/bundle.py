"""A few of the bundled drives, for facts about recorded drives that do not need all of them."""

from __future__ import annotations

import functools

from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings


@functools.cache
def few_drives(each: int = 5) -> Recordings:
    """Of every fold of the bundled recordings ``each`` drives, evenly spaced: as many however large the bundle is."""
    bundled = load_recordings()
    chosen: list[str] = []
    for fold in sorted({scene.fold for scene in bundled.scenes} - {-1}):
        names = [scene.name for scene in bundled.scenes if scene.fold == fold]
        chosen += [names[i * len(names) // each] for i in range(min(each, len(names)))]
    return bundled.select(scenes=chosen)
