"""The leaderboard: every policy through the same protocol, one table per track, never mixed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, PolicyError, unknown
from mixo_env.leaderboard.crossvalidation import CrossValidation, Run
from mixo_env.leaderboard.evaluation import FLOORS, Course, Errors, lost_tracks
from mixo_env.metrics.aggregate import share_above
from mixo_env.metrics.bootstrap import Interval, interval_over_groups
from mixo_env.metrics.tracks import LostTracks
from mixo_env.policies.linear import Linear
from mixo_env.policies.registry import names as policy_names
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import TRACKS
from mixo_env.recordings.variants import as_variant, variants

ONE_FOLD = ("PPO",)
"""Policies too slow to train for every fold: they are tested on the last one only, and compared there."""

RANKING_LOGS = 10
"""Drives needed before an order of rows means anything; fewer only show that everything works."""


@dataclass(frozen=True)
class Score:
    """What a table prints about one row, against one truth.

    Attributes:
        translation_percent, rotation_deg_per_m: pooled RTE with its interval over logs.
        samples, sampled_scenes: the RTE rests on; standing scenes contribute none.
        scenes: tested.
        ate_m, ate_deg: mean over the scenes of their RMSE.
        yaw_increment_rmse_deg: over all steps.
        high_ate_share: share of scenes above 0.5 m.
    """

    translation_percent: Interval
    rotation_deg_per_m: Interval
    samples: int
    sampled_scenes: int
    scenes: int
    ate_m: float
    ate_deg: float
    yaw_increment_rmse_deg: float
    high_ate_share: float


@dataclass(frozen=True)
class Row:
    """One policy in one track, scored against every recorded truth.

    Attributes:
        run: how it drove.
        errors: per truth, all scenes.
        scores: per truth, on the tested scenes.
        lost: of all scenes; ``None`` where there is no track to lose.
        lost_instantly: the same if cameras tracked again with the first good pair of images.
        fused: several experts may take part (not one alone).
        votes: false for an expert that has no vote in this track and is shown for reference.
    """

    run: Run
    errors: dict[str, Errors]
    scores: dict[str, Score]
    lost: LostTracks | None
    lost_instantly: LostTracks | None
    fused: bool
    votes: bool


@dataclass(frozen=True)
class Table:
    """One track.

    Attributes:
        track: its name.
        rows: tested on every scene, in the order of the registry, floors last.
        one_fold: the fold on which ``ONE_FOLD`` policies were tested; ``None`` when there is none.
        one_fold_rows: those policies and all other learned ones, scored on that fold alone.
        left_out: policies that do not fit these recordings -> why.
    """

    track: str
    rows: tuple[Row, ...]
    one_fold: int | None
    one_fold_rows: tuple[Row, ...]
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
    """All tables and what they rest on.

    Attributes:
        tables: one per track.
        policies: names of the rows that were asked for.
        protocol: recordings, folds and seed.
        courses: the truths the scores refer to, ``"truth"`` first.
    """

    tables: tuple[Table, ...]
    policies: tuple[str, ...]
    protocol: CrossValidation
    courses: dict[str, Course]

    @property
    def recordings(self) -> Recordings:
        """The scenes that were scored."""
        return self.protocol.recordings

    @property
    def logs(self) -> int:
        """Number of drives among them."""
        return len({scene.log for scene in self.recordings.scenes})


def build(
    recordings: Recordings,
    *,
    tracks: Sequence[str] = (),
    policies: Sequence[str] = (),
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Leaderboard:
    """Run and score policies on every track.

    Args:
        recordings: scenes to score; their folds divide training from test.
        tracks: to run; empty: all.
        policies: names of policies and floors, however they are spelt (case, hyphens); empty: all.
        seed: of every learned policy and of the bootstrap.
        progress: told what is about to run.

    Raises:
        ConfigurationError: for an unknown track or policy.
        PolicyError: when a policy asked for by name does not fit the recordings.
    """
    for track in tracks:
        if track not in TRACKS:
            raise ConfigurationError(unknown("track", track, TRACKS))
    protocol = CrossValidation(recordings, seed=seed)
    chosen = choose(policies, (*policy_names(protocol.recordings), *FLOORS))
    exact = bool(np.isfinite(protocol.recordings["exact.x_m"]).all())
    courses = {truth: Course(protocol.recordings, truth) for truth in (("truth", "exact") if exact else ("truth",))}
    scorer = Scorer(protocol.recordings, courses, seed)
    tables = []
    for track in tracks or TRACKS:
        runs: list[Run] = []
        left_out: dict[str, str] = {}
        for name in chosen:
            progress(f"{track}: {name}")
            folds = protocol.folds[-1:] if name in ONE_FOLD else None
            try:
                runs.append(protocol.run(name, track, folds=folds))
            except PolicyError as error:
                if policies:
                    raise
                left_out[name] = str(error)
        tables.append(scorer.table(track, runs, left_out, protocol.folds))
    return Leaderboard(tuple(tables), chosen, protocol, courses)


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


class Scorer:
    """Scores runs on the same scenes against the same truths."""

    def __init__(self, recordings: Recordings, courses: dict[str, Course], seed: int) -> None:
        """Remember what every row shares."""
        self._recordings = recordings
        self._courses = courses
        self._seed = seed
        self._logs = np.unique([scene.log for scene in recordings.scenes], return_inverse=True)[1]
        self._folds = np.array([scene.fold for scene in recordings.scenes])

    def table(self, track: str, runs: Sequence[Run], left_out: dict[str, str], folds: Sequence[int]) -> Table:
        """Rows tested everywhere, and apart from them those tested on one fold, beside the other learned ones."""
        rows = [self.row(track, run) for run in runs]
        partial = any(not run.tested.all() for run in runs)
        one_fold = folds[-1] if partial else None
        return Table(
            track=track,
            rows=tuple(row for row in rows if row.run.tested.all()),
            one_fold=one_fold,
            one_fold_rows=tuple(self.restrict(row, self._folds == one_fold) for row in rows if row.run.learns)
            if partial
            else (),
            left_out=left_out,
        )

    def row(self, track: str, run: Run) -> Row:
        """Measure a run against every truth."""
        errors = {truth: course.measure(run.motion) for truth, course in self._courses.items()}
        scores = {truth: self.score(measured, run.tested) for truth, measured in errors.items()}
        recordings, alone = as_variant(self._recordings, run.name), variants(self._recordings).get(run.name, run.name)
        lost, instantly = (lost_tracks(recordings, alone, instantly=instantly) for instantly in (False, True))
        fused = alone not in recordings.experts
        votes = fused or run.name in recordings.voters(track)
        return Row(run, errors, scores, lost, instantly, fused, votes)

    def restrict(self, row: Row, scenes: NDArray[np.bool_]) -> Row:
        """The same row scored on some scenes only."""
        scores = {truth: self.score(errors, scenes) for truth, errors in row.errors.items()}
        return replace(row, run=replace(row.run, tested=scenes), scores=scores)

    def score(self, errors: Errors, scenes: NDArray[np.bool_]) -> Score:
        """Statistics of the errors on ``scenes`` ``(scenes,)``."""
        relative, absolute = errors.relative, errors.absolute
        here = scenes[relative.scene]
        logs = self._logs[relative.scene[here]]
        squared, steps = errors.squared_yaw_increment_deg2[scenes].sum(), errors.steps[scenes].sum()
        return Score(
            translation_percent=interval_over_groups(relative.translation_percent[here], logs, seed=self._seed),
            rotation_deg_per_m=interval_over_groups(relative.rotation_deg_per_m[here], logs, seed=self._seed),
            samples=int(here.sum()),
            sampled_scenes=len(np.unique(relative.scene[here])),
            scenes=int(scenes.sum()),
            ate_m=float(absolute.translation_m[scenes].mean()),
            ate_deg=float(absolute.rotation_deg[scenes].mean()),
            yaw_increment_rmse_deg=float(np.sqrt(squared / steps)),
            high_ate_share=share_above(absolute.translation_m[scenes]),
        )
