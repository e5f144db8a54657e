"""The leaderboard: every policy through the same protocol, one table per track, never mixed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from mixo_env.errors import ConfigurationError, PolicyError, unknown
from mixo_env.leaderboard.comparisons import Comparisons
from mixo_env.leaderboard.computing import Contest, Place, compute, usual_workers
from mixo_env.leaderboard.conditions import Group, groups_of
from mixo_env.leaderboard.crossvalidation import USUAL, CrossValidation, Trial
from mixo_env.leaderboard.evaluation import FLOORS, Truth
from mixo_env.leaderboard.rows import Row
from mixo_env.policies.linear import Linear
from mixo_env.policies.registry import POLICIES
from mixo_env.policies.registry import names as policy_names
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.folds import OUT_OF_DISTRIBUTION
from mixo_env.recordings.schema import UNEQUAL

RANKING_LOGS = 10
"""Drives needed before an order of rows means anything; fewer only show that everything works."""


ALL = "all"
"""In the place of names of rows: every row, also those that nobody would fit unasked."""


@dataclass(frozen=True)
class Standings:
    """The rows of one track and what stands with them.

    Attributes:
        track: its name.
        rows: tested on every scene, in the order of the registry, floors last.
        comparisons: of these rows, paired.
        one_fold: the fold on which expensive policies were tested; ``None`` when there is none.
        one_fold_rows: those policies and all other learned ones, scored on that fold alone.
        one_fold_comparisons: of those, paired.
        groups: the rows by condition and by situation.
        left_out: policies that do not fit these recordings, or were too slow to fit unasked -> why.
    """

    track: str
    rows: tuple[Row, ...]
    comparisons: Comparisons
    one_fold: int | None
    one_fold_rows: tuple[Row, ...]
    one_fold_comparisons: Comparisons
    groups: tuple[Group, ...]
    left_out: dict[str, str]

    def linear_weights(self) -> dict[int, dict[str, float]]:
        """LINEAR's weights by held-out fold; empty when it was not run."""
        return {
            fold: dict(zip(policy.experts, map(float, policy.weights), strict=True))
            for row in self.rows
            for fold, policy in row.run.policies.items()
            if isinstance(policy, Linear)
        }


@dataclass(frozen=True)
class Leaderboard:
    """The standings of every track and what they rest on.

    Attributes:
        standings: one a track.
        policies: names of the rows that were asked for.
        protocol: recordings, folds and seed.
        truths: those the scores refer to, by name, the headline's first.
        noise_floor: headline error [deg/m] that the truth's own noise makes; 0 for exact truth, and where no gyro
            tells the noise.
        night: the same for the scenes that are in no fold, by policies that learned from all folds; ``None`` without
            such scenes.
    """

    standings: tuple[Standings, ...]
    policies: tuple[str, ...]
    protocol: CrossValidation
    truths: Mapping[str, Truth]
    noise_floor: float
    night: Leaderboard | None = None

    @property
    def recordings(self) -> Recordings:
        """The scenes that were scored."""
        return self.protocol.recordings

    @property
    def headline(self) -> str:
        """The truth of the headline."""
        return next(iter(self.truths))

    @property
    def logs(self) -> int:
        """Number of drives among them."""
        return len({scene.log for scene in self.recordings.scenes})


def build(
    recordings: Recordings,
    *,
    tracks: Sequence[str] = (),
    policies: Sequence[str] = (),
    trial: Trial = USUAL,
    folds: Sequence[int] = (),
    night: bool = True,
    workers: int | None = 1,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> Leaderboard:
    """Run and score policies on every track.

    Args:
        recordings: scenes to score; their folds divide training from test.
        tracks: to run; empty: all that differ on these recordings.
        policies: names of policies and floors, however they are spelt (case, hyphens); empty: all but those that do
            not fit the recordings, or would be slow to fit; ``all``: these are fitted as well.
        trial: seeds, clock and policies from outside.
        folds: score scenes of these only; empty: all.
        night: score also those in no fold, unless ``folds`` says which.
        workers: processes for the rows, then threads for the comparisons; the result does not depend on it. ``None``:
            as many as pay.
        progress: told how many rows are done, and of how many.

    Raises:
        ConfigurationError: for an unknown track, policy or fold, or no workers.
        PolicyError: when a policy asked for by name does not fit the recordings.
    """
    chosen, patient = requested(recordings, tracks, policies, tuple(trial.outside)), everything(policies)
    lenient = patient or not policies
    day = Contest(CrossValidation(recordings, trial, tested_folds=folds), lenient, patient)
    contests, protocol = [day], day.protocol
    if protocol.folds and night and not folds and any(scene.fold == OUT_OF_DISTRIBUTION for scene in recordings.scenes):
        contests.append(Contest(CrossValidation(recordings, trial, out_of_distribution=True), lenient, patient))
    asked = [tuple(name for name in chosen if contest.shows(name)) for contest in contests]
    shown = tracks or recordings.distinct_tracks
    places = [
        Place(bool(k), track, name)
        for k, names in enumerate(asked)
        for track in shown
        for name in shown_in(recordings, track, names)
    ]
    workers = usual_workers(len(places)) if workers is None else workers
    found = compute(contests, places, workers, progress)

    def standings(table: tuple[int, str]) -> Standings:
        k, track = table
        rows = {place.name: found[place] for place in places if (place.night, place.track) == (bool(k), track)}
        return _standings(contests[k], track, rows)

    tables = [(k, track) for k in range(len(contests)) for track in shown]
    with ThreadPoolExecutor(workers) as pool:  # resampling is arithmetic of arrays, which threads share well
        done = dict(zip(tables, pool.map(standings, tables), strict=True))

    def board(k: int, other: Leaderboard | None = None) -> Leaderboard:
        of, at = contests[k], tuple(done[k, track] for track in shown)
        return Leaderboard(at, asked[k], of.protocol, of.truths, of.floor, other)

    return board(0, board(1) if len(contests) > 1 else None)


def requested(
    recordings: Recordings, tracks: Sequence[str], policies: Sequence[str], outside: Sequence[str] = ()
) -> tuple[str, ...]:
    """Names of the rows that :func:`build` will run.

    Raises:
        ConfigurationError: for an unknown track or policy.
    """
    for track in tracks:
        recordings.voters(track)  # raises
    chosen = choose(policies, (*policy_names(recordings), *outside, *FLOORS))
    if not any(shown_in(recordings, track, chosen) for track in tracks or recordings.distinct_tracks):
        home = " and ".join(dict.fromkeys(_home(row, recordings) for row in chosen))
        raise ConfigurationError(
            f"{', '.join(chosen)}: shown in track {home} alone, got --tracks {' '.join(tracks)}: add {home}"
        )
    return chosen


def shown_in(recordings: Recordings, track: str, rows: Sequence[str]) -> tuple[str, ...]:
    """Those of ``rows`` that the table of a track has: experts of other families and slow agents are in one alone."""
    return tuple(row for row in rows if _home(row, recordings) in ("", track))


def _home(row: str, recordings: Recordings) -> str:
    """The only track that shows a row; "": all."""
    return UNEQUAL if row in recordings.further else POLICIES[row].only_track if row in POLICIES else ""


def everything(asked: Sequence[str]) -> bool:
    """Whether ``all`` rows are asked for by that word, however slow to fit."""
    return any(name.casefold() == ALL for name in asked)


def choose(asked: Sequence[str], valid: Sequence[str]) -> tuple[str, ...]:
    """The names asked for, in the order of the tables; all when none is asked for, or ``all``.

    Case, spaces, hyphens and underscores do not matter: ``highest-match`` is HIGHEST MATCH.

    Raises:
        ConfigurationError: for an unknown name.
    """

    def plain(name: str) -> str:
        return name.casefold().replace("-", " ").replace("_", " ")

    meant = {plain(name): name for name in valid}
    asked = [] if everything(asked) else asked
    for name in asked:
        if plain(name) not in meant:
            raise ConfigurationError(unknown("policy", name, valid))
    wanted = {meant[plain(name)] for name in asked} or set(valid)
    return tuple(name for name in valid if name in wanted)


def _standings(contest: Contest, track: str, found: Mapping[str, Row | PolicyError]) -> Standings:
    """Rows tested everywhere, and apart from them those tested on one fold, beside the other learned ones."""
    protocol, scorer = contest.protocol, contest.scorer
    rows = [row for row in found.values() if isinstance(row, Row)]
    whole = tuple(row for row in rows if row.run.tested.all())
    one_fold, part = None, ()
    if len(whole) < len(rows):
        one_fold = protocol.tested_folds[-1]
        scenes = np.array([scene.fold == one_fold for scene in protocol.recordings.scenes])
        learned = [scorer.restrict(row, scenes) for row in rows if row.run.learns]
        part = tuple(scorer.detailed(track, row) for row in learned)
    return Standings(
        track=track,
        rows=whole,
        comparisons=scorer.compare(whole),
        one_fold=one_fold,
        one_fold_rows=part,
        one_fold_comparisons=scorer.compare(part),
        groups=tuple(
            group for by in ("condition", "situation") for group in groups_of(whole, protocol.recordings, by, scorer)
        ),
        left_out={name: str(row) for name, row in found.items() if isinstance(row, PolicyError)},
    )
