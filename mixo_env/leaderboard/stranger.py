"""One policy from outside, beside the rows everyone knows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mixo_env.errors import ConfigurationError, unknown
from mixo_env.leaderboard.board import Leaderboard, build, requested
from mixo_env.leaderboard.comparisons import Comparison
from mixo_env.leaderboard.crossvalidation import Trial
from mixo_env.leaderboard.exports import comparison_json, to_json
from mixo_env.leaderboard.report import scores_table
from mixo_env.leaderboard.rows import Row
from mixo_env.leaderboard.sentences import p_text
from mixo_env.leaderboard.weights import PREFIX, shipped, shipped_piece
from mixo_env.policies.agent import Frozen
from mixo_env.policies.fitting import check, drives
from mixo_env.policies.outside import Outside, Reading, resolve
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.drives import drive_hash
from mixo_env.recordings.store import load_recordings

BESIDE = ("CAM_FRONT", "LINEAR", "HUBER", "MIXO")
"""The rows it is compared with."""

TRAINING_FOLDS = (0, 1, 2)
"""What ``gym.make`` plays when nothing is said: split "train"."""


@dataclass(frozen=True)
class Options(Reading):
    """What is rarely said: how the policy is read, and the seeds.

    Attributes:
        seed: of everything random.
        seeds: fits of every learned policy.
    """

    seed: int = 0
    seeds: int = 1


@dataclass(frozen=True)
class Scored:
    """What came out.

    Attributes:
        name: of the policy's row.
        board: its table, with the rows beside it.
    """

    name: str
    board: Leaderboard

    @property
    def row(self) -> Row:
        """The policy's own row, on all scored scenes."""
        return next(row for row in self.board.standings[0].rows if row.name == self.name)

    @property
    def differences(self) -> tuple[Comparison, ...]:
        """Paired differences, policy - row, to the rows beside it; none for a policy that reads the truth."""
        found = (self.board.standings[0].comparisons.between(self.name, other) for other in BESIDE)
        return tuple(comparison for comparison in found if comparison)

    def lines(self) -> list[str]:
        """What :func:`score` found: the row beside the others as a table, then the differences in words."""
        return [*scores_table(self.board.standings[0]).text().splitlines(), "", *self.difference_lines()]

    def difference_lines(self) -> list[str]:
        """The differences in words."""
        return [
            f"{c.first} - {c.second}: {c.difference.mean:+.5f} deg/m [{c.difference.low:+.5f}, "
            f"{c.difference.high:+.5f}], {100 * c.share:+.1f} % ({p_text(c.p_holm)}, Holm over all pairs)"
            for c in self.differences
        ]

    def to_json(self) -> dict[str, Any]:
        """Every number, as `mixo benchmark` writes it, with the policy's name and its own differences."""
        differences = [comparison_json(comparison) for comparison in self.differences]
        return {"policy": self.name, "differences": differences} | to_json(self.board)


def score(
    policy: Any,
    recordings: Recordings | str | Path | None = None,
    track: str = "VISION",
    *,
    folds: Sequence[int] = (),
    fitted_on: Recordings | Iterable[str] | None = None,
    options: Options | None = None,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> Scored:
    """Score a policy from outside beside CAM_FRONT, LINEAR, HUBER and MIXO, with paired differences.

    A class (``module:Class`` too) that learns is fitted for every fold on the other ones. Everything else is played as
    it is, and refused on the drives it was trained on.

    Args:
        policy: a :class:`~mixo_env.policies.policy.Policy`, its class, a function ``observation -> action``, or text:
            ``module:Class``, ``file.py:Class``, a folder written by ``Policy.save``, a zip of Stable-Baselines3, the
            name of a row, ``shipped:ROW`` (weights that come with the package). A function sees what an agent of
            ``gym.make`` sees: by default the flat ``"paper"`` observation of one scene, and its
            action is read as by ``weights="softmax"``; see ``options``.
        recordings: scenes, or where they lie; ``None``: the bundled mixocity.
        track: who votes besides the cameras.
        folds: score the scenes of these only; empty: all.
        fitted_on: where a frozen policy was trained: recordings, or what :func:`declared` takes.
        options: what is rarely said; ``None``: the defaults.
        progress: told how many rows are done, and of how many.

    Raises:
        ConfigurationError: for an unknown track, fold, or text that means nothing.
        PolicyError: for a policy that cannot be made, does not fit, or was trained on a tested drive.
    """
    if isinstance(policy, str) and policy.startswith(PREFIX):
        policy = shipped_piece(policy, track)
    scenes = recordings if isinstance(recordings, Recordings) else load_recordings(recordings and str(recordings))
    trained = None if fitted_on is None else declared(fitted_on, scenes)
    options = options or Options()
    found = resolve(policy, scenes, options, trained)
    present = sorted({scene.fold for scene in scenes.scenes if scene.fold >= 0})
    chosen = tuple(folds) or tuple(present[-1:] if found.kind.expensive else ())
    names = beside(found, scenes)
    outside = {} if found.builtin else {found.name: found.kind}
    requested(scenes, (track,), names, tuple(outside))
    if isinstance(found.kind, Frozen):  # before minutes are spent on the rows beside it
        found.kind.start(scenes.voters(track))
        check(found.kind, scenes.select(folds=chosen or present) if present else scenes, track)
    board = build(
        scenes,
        tracks=(track,),
        policies=names,
        trial=Trial(options.seed, options.seeds, outside=outside, weights=shipped()),
        folds=chosen,
        night=False,
        progress=progress,
    )
    return Scored(found.name, board)


def beside(found: Outside, recordings: Recordings) -> tuple[str, ...]:
    """Rows of the table: a rig without a front camera has no row of it."""
    return (*(n for n in BESIDE if n != "CAM_FRONT" or n in recordings.experts), found.name)


def declared(given: Recordings | Iterable[str], recordings: Recordings) -> frozenset[str]:
    """Hashes of the drives that a policy was trained on.

    Args:
        given: recordings; or names of scenes of ``recordings``, or hashes of drives (64 hexadecimal digits); the word
            ``"none"``, or ``"train"`` for the folds that ``gym.make`` plays when nothing is said.
        recordings: for the names.

    Raises:
        ConfigurationError: for a name that is no scene of theirs.
    """
    if isinstance(given, Recordings):
        return drives(given)
    if given == "none":
        return frozenset()
    if given == "train":
        return drives(recordings.select(folds=TRAINING_FOLDS))
    if isinstance(given, str):
        given = (given,)
    place = {scene.name: i for i, scene in enumerate(recordings.scenes)}
    hashes = set()
    for name in given:
        if name in place:
            hashes.add(drive_hash(recordings, place[name]))
        elif len(name) >= 32 and set(name) <= set("0123456789abcdef"):
            hashes.add(name)
        else:
            raise ConfigurationError(unknown("training scene", name, place))
    return frozenset(hashes)
