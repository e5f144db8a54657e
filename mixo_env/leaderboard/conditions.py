"""The same rows by condition (day, rain, night) and by staged situation: where a method wins or fails."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.comparisons import Comparisons
from mixo_env.leaderboard.rows import Row, Scorer
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import SceneEntry

Grouping = Literal["condition", "situation"]

SITUATIONS = "situations"
"""Key of the manifest's parameters: scene -> what was staged in it. Only simulated recordings have it."""


@dataclass(frozen=True)
class Group:
    """All rows of a table on the scenes that have something in common.

    Attributes:
        by: what.
        name: which.
        rows: scored on these scenes alone.
        comparisons: of them, exploratory.
    """

    by: Grouping
    name: str
    rows: tuple[Row, ...]
    comparisons: Comparisons


def condition_of(scene: SceneEntry) -> str:
    """``night``, ``rain`` or ``day``: every scene has one of them, rain by night counts as night."""
    return next((name for name in ("night", "rain") if name in scene.conditions), "day")


def members(recordings: Recordings, by: Grouping) -> dict[str, NDArray[np.bool_]]:
    """Name of every group -> ``(scenes,)`` its scenes; every scene is in one group. Ordinary ones come first.

    Situations are known of simulated scenes only: there is no group where one is missing.
    """
    if by == "condition":
        of_scene = [condition_of(scene) for scene in recordings.scenes]
    else:
        known: Mapping[str, str] = recordings.manifest.parameters.get(SITUATIONS, {})
        if any(scene.name not in known for scene in recordings.scenes):
            return {}
        of_scene = [known[scene.name] for scene in recordings.scenes]
    order = sorted(set(of_scene), key=lambda name: (name not in ("day", "ordinary"), name))
    return {name: np.array([own == name for own in of_scene]) for name in order}


def groups_of(rows: Sequence[Row], recordings: Recordings, by: Grouping, scorer: Scorer) -> tuple[Group, ...]:
    """Every group's table; empty where there is but one group."""
    found = members(recordings, by)
    if len(found) < 2:
        return ()
    groups = []
    for name, scenes in found.items():
        here = tuple(scorer.restrict(row, scenes) for row in rows)
        groups.append(Group(by, name, here, scorer.compare(here)))
    return tuple(groups)


def check_grouping(recordings: Recordings, by: Grouping) -> None:
    """Raise :class:`ConfigurationError` where these recordings cannot be grouped so."""
    if not members(recordings, by):
        raise ConfigurationError(
            f"--by {by}: the manifest of these recordings does not say what was staged in which scene "
            f"(parameters: {SITUATIONS!r}); simulated recordings such as mixocity do"
        )
