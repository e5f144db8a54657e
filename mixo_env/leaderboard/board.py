"""The leaderboard: every policy through the same protocol, one table per track, never mixed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mixo_env.errors import ConfigurationError, PolicyError, unknown
from mixo_env.leaderboard.comparisons import Comparisons
from mixo_env.leaderboard.conditions import Group, groups_of
from mixo_env.leaderboard.crossvalidation import USUAL, CrossValidation, Run, Trial
from mixo_env.leaderboard.evaluation import FLOORS, Truth, noisy_truth
from mixo_env.leaderboard.noise import NOISE_FLOOR
from mixo_env.leaderboard.rows import Row, Scorer
from mixo_env.policies.linear import Linear
from mixo_env.policies.registry import POLICIES
from mixo_env.policies.registry import names as policy_names
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.folds import OUT_OF_DISTRIBUTION
from mixo_env.recordings.schema import UNEQUAL

RANKING_LOGS = 10
"""Drives needed before an order of rows means anything; fewer only show that everything works."""


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
        left_out: policies that do not fit these recordings -> why.
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
    progress: Callable[[str], None] = lambda _: None,
) -> Leaderboard:
    """Run and score policies on every track.

    Args:
        recordings: scenes to score; their folds divide training from test.
        tracks: to run; empty: all that differ on these recordings.
        policies: names of policies and floors, however they are spelt (case, hyphens); empty: all.
        trial: seeds, clock and policies from outside.
        folds: score scenes of these only; empty: all.
        night: score also those in no fold, unless ``folds`` says which.
        progress: told what is about to run.

    Raises:
        ConfigurationError: for an unknown track, policy or fold.
        PolicyError: when a policy asked for by name does not fit the recordings.
    """
    chosen, everything = requested(recordings, tracks, policies, tuple(trial.outside)), not policies
    protocol = CrossValidation(recordings, trial, tested_folds=folds)
    day = Builder(protocol, progress, everything)
    dark = None
    if protocol.folds and night and not folds and any(scene.fold == OUT_OF_DISTRIBUTION for scene in recordings.scenes):
        nights = CrossValidation(recordings, trial, out_of_distribution=True)
        quick = [name for name in chosen if not protocol.expensive(name)]
        dark = Builder(nights, lambda text: progress(f"night, {text}"), everything).board(
            tracks or recordings.distinct_tracks, quick
        )
    return day.board(tracks or recordings.distinct_tracks, chosen, dark)


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


def choose(asked: Sequence[str], valid: Sequence[str]) -> tuple[str, ...]:
    """The names asked for, in the order of the tables; all when none is asked for.

    Case, spaces, hyphens and underscores do not matter: ``highest-match`` is HIGHEST MATCH.

    Raises:
        ConfigurationError: for an unknown name.
    """

    def plain(name: str) -> str:
        return name.casefold().replace("-", " ").replace("_", " ")

    meant = {plain(name): name for name in valid}
    for name in asked:
        if plain(name) not in meant:
            raise ConfigurationError(unknown("policy", name, valid))
    wanted = {meant[plain(name)] for name in asked} or set(valid)
    return tuple(name for name in valid if name in wanted)


class Builder:
    """Builds the standings of one protocol.

    Args:
        protocol: scenes, folds, seeds.
        progress: told what is about to run.
        lenient: leave out a policy that does not fit the recordings instead of raising.
    """

    def __init__(self, protocol: CrossValidation, progress: Callable[[str], None], lenient: bool) -> None:
        """Prepare the truths."""
        self._protocol, self._progress, self._lenient = protocol, progress, lenient
        self._truths = {truth: Truth(protocol.recordings, truth) for truth in protocol.truths}
        headline = protocol.truths[0]
        self._floor = 0.0
        self._noisy = headline != "exact" and "INERTIAL" in protocol.recordings.manifest.inertial
        if self._noisy:
            noisy = self._truths[headline].measure(noisy_truth(protocol.recordings))
            samples = noisy.relative.rotation_deg_per_m
            self._floor = float(samples.mean()) if len(samples) else 0.0
        self._scorer = Scorer(protocol.recordings, self._truths, self._floor, protocol.trial.seed)

    def board(
        self, tracks: Sequence[str] | Mapping[str, object], chosen: Sequence[str], night: Leaderboard | None = None
    ) -> Leaderboard:
        """Standings for every track."""
        shown = tuple(name for name in chosen if name != NOISE_FLOOR or self._noisy)
        standings = tuple(self._standings(track, shown) for track in tracks)
        return Leaderboard(standings, shown, self._protocol, self._truths, self._floor, night)

    def _standings(self, track: str, chosen: Sequence[str]) -> Standings:
        """Rows tested everywhere, and apart from them those tested on one fold, beside the other learned ones."""
        runs: list[Run] = []
        left_out: dict[str, str] = {}
        for name in shown_in(self._protocol.recordings, track, chosen):
            self._progress(f"{track}: {name}")
            try:
                folds = self._protocol.tested_folds[-1:] if self._protocol.expensive(name) else None
                runs.append(self._protocol.run(name, track, folds=folds))
            except PolicyError as error:
                if not self._lenient:
                    raise
                left_out[name] = str(error)
        rows = [self._scorer.row(track, run) for run in runs]
        whole = tuple(row for row in rows if row.run.tested.all())
        one_fold, part = None, ()
        if len(whole) < len(rows):
            one_fold = self._protocol.tested_folds[-1]
            scenes = np.array([scene.fold == one_fold for scene in self._protocol.recordings.scenes])
            learned = [self._scorer.restrict(row, scenes) for row in rows if row.run.learns]
            part = tuple(self._scorer.detailed(track, row) for row in learned)
        recordings = self._protocol.recordings
        return Standings(
            track=track,
            rows=whole,
            comparisons=self._scorer.compare(whole),
            one_fold=one_fold,
            one_fold_rows=part,
            one_fold_comparisons=self._scorer.compare(part),
            groups=tuple(
                group for by in ("condition", "situation") for group in groups_of(whole, recordings, by, self._scorer)
            ),
            left_out=left_out,
        )
