"""Inner folds by log: where a policy chooses a setting, never on a drive that scores it."""

from __future__ import annotations

from collections.abc import Iterator

from mixo_env.policies.playing import collect
from mixo_env.policies.policy import Observation
from mixo_env.policies.robust import Mean
from mixo_env.recordings.collection import Recordings

FOLDS = 5
"""At most; with fewer logs every one is held out by itself."""


def by_log(training: Recordings, track: str) -> dict[str, Observation]:
    """What is seen in all scenes of a log, with ``truth_yaw_rate``; the previous yaw rate is that of MEAN.

    Returns:
        Log -> name -> ``(steps, width)``.
    """
    seen = {}
    for log in sorted({scene.log for scene in training.scenes}):
        policy = Mean()
        policy.start(training.voters(track))
        scenes = [scene.name for scene in training.scenes if scene.log == log]
        seen[log] = collect(training.select(scenes=scenes), track, policy)
    return seen


def inner_folds(training: Recordings) -> Iterator[tuple[tuple[str, ...], Recordings]]:
    """Held-out logs and the scenes of the others; nothing where there is but one log."""
    logs = sorted({scene.log for scene in training.scenes})
    if len(logs) < 2:
        return
    for i in range(min(FOLDS, len(logs))):
        held_out = tuple(logs[i::FOLDS])
        yield held_out, training.select(scenes=[scene.name for scene in training.scenes if scene.log not in held_out])
