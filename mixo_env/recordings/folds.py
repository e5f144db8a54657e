"""Which fold each scene belongs to. Night is out of distribution and in no fold (-1)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mixo_env.recordings.schema import SceneEntry

FOLDS = 4
"""As in the paper."""

OUT_OF_DISTRIBUTION = -1

MOST_FOLDS = 1000
"""With every log left out in turn."""


def folds_by_log(scenes: Sequence[SceneEntry]) -> list[int]:
    """Whole logs dealt out to folds of nearly equal numbers of scenes, so that clips of one drive never straddle.

    The largest log first, each to the fold that is smallest so far (the lower one when equal); with fewer logs than
    folds the last folds stay empty.
    """
    sizes = Counter(scene.log for scene in scenes if "night" not in scene.conditions)
    fold_of, filled = {}, [0] * FOLDS
    for log, size in sorted(sizes.items(), key=lambda item: (-item[1], item[0])):
        fold_of[log] = filled.index(min(filled))
        filled[fold_of[log]] += size
    return [OUT_OF_DISTRIBUTION if "night" in scene.conditions else fold_of[scene.log] for scene in scenes]


def one_log_out(scenes: Sequence[SceneEntry]) -> list[int]:
    """Every log a fold of its own, in the order of their names: each is tested by what the others taught."""
    logs = sorted({scene.log for scene in scenes if "night" not in scene.conditions})
    return [OUT_OF_DISTRIBUTION if "night" in scene.conditions else logs.index(scene.log) for scene in scenes]


def contiguous_folds(scenes: Sequence[SceneEntry]) -> list[int]:
    """The paper's folds: four contiguous blocks of scenes in ascending order of their names.

    The paper prints 1-184, 185-368, 368-552, 553-736; the third block is taken to start at 369.
    """
    day = sorted(scene.name for scene in scenes if "night" not in scene.conditions)
    blocks = np.array_split(np.arange(len(day)), FOLDS)
    fold_of = {day[i]: fold for fold, block in enumerate(blocks) for i in block}
    return [fold_of.get(scene.name, OUT_OF_DISTRIBUTION) for scene in scenes]


FOLD_RULES: dict[str, Callable[[Sequence[SceneEntry]], list[int]]] = {
    "log": folds_by_log,
    "contiguous": contiguous_folds,
    "one-log-out": one_log_out,
}


def with_folds(scenes: Sequence[SceneEntry], rule: str) -> tuple[SceneEntry, ...]:
    """The same scenes with folds by a rule of ``FOLD_RULES``."""
    return tuple(replace(scene, fold=fold) for scene, fold in zip(scenes, FOLD_RULES[rule](scenes), strict=True))
