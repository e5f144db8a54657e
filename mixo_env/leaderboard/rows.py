"""Rows of a table: what one policy scored, against every truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.anatomy import anatomy_of
from mixo_env.leaderboard.comparisons import Comparisons, compare_rows
from mixo_env.leaderboard.crossvalidation import Run
from mixo_env.leaderboard.evaluation import Errors, Truth, lost_tracks, mean_errors, scene_means
from mixo_env.metrics.aggregate import interquartile_mean, probability_of_improvement, share_above
from mixo_env.metrics.anatomy import ErrorAnatomy
from mixo_env.metrics.bootstrap import Interval, interval_over_groups
from mixo_env.metrics.relative import RelativeSamples
from mixo_env.metrics.tracks import LostTracks
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.variants import as_variant, variants


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
class AtLength:
    """RTE of one row at one length L, on the tested scenes, against the headline's truth.

    Attributes:
        length_m: L.
        translation_percent, rotation_deg_per_m: mean with its interval over logs; NaN without a piece.
        samples: pieces.
    """

    length_m: float
    translation_percent: Interval
    rotation_deg_per_m: Interval
    samples: int


@dataclass(frozen=True)
class Row:
    """One policy in one track, scored against every recorded truth.

    Attributes:
        run: how it drove.
        errors: per truth, all scenes; the mean over the seeds.
        scores: per truth, the headline first, on the tested scenes.
        lost: of all scenes; ``None`` where there is no track to lose.
        lost_instantly: the same if cameras tracked again with the first good pair of images.
        fused: several experts may take part (not one alone).
        votes: false for an expert that has no vote in this track and is shown for reference.
        scene_deg_per_m: ``(seeds, scenes)`` headline RTE of every scene, NaN where it has no sample.
        lengths: RTE by length of path; empty for a row restricted to some scenes.
        anatomy: what its headline error is made of; ``None`` likewise.
    """

    run: Run
    errors: Mapping[str, Errors]
    scores: Mapping[str, Score]
    lost: LostTracks | None
    lost_instantly: LostTracks | None
    fused: bool
    votes: bool
    scene_deg_per_m: FloatArray
    lengths: tuple[AtLength, ...] = ()
    anatomy: ErrorAnatomy | None = None

    @property
    def name(self) -> str:
        """Of the policy or floor."""
        return self.run.name

    @property
    def headline(self) -> Score:
        """Its score against the headline's truth."""
        return next(iter(self.scores.values()))

    def interquartile_mean(self) -> float:
        """Of the headline RTE [deg/m] over tested scenes and seeds."""
        return interquartile_mean(self._tested_scenes())

    def improvement_on(self, other: Row) -> float:
        """Chance that it errs less than another row, tested on the same scenes, on one of them."""
        return probability_of_improvement(self._tested_scenes(), other._tested_scenes())

    def _tested_scenes(self) -> FloatArray:
        """``(seeds, tested scenes with a sample)``: which scenes have one depends on the truth alone."""
        tested = self.scene_deg_per_m[:, self.run.tested]
        return tested[:, np.isfinite(tested).all(axis=0)]


class Scorer:
    """Scores runs on the same scenes against the same truths.

    Args:
        recordings: the tested scenes.
        truths: by name, the headline first.
        floor: headline error [deg/m] that the truth's own noise makes; 0 for exact truth.
        seed: of bootstrap and sign patterns.
    """

    def __init__(self, recordings: Recordings, truths: Mapping[str, Truth], floor: float, seed: int) -> None:
        """Remember what every row shares."""
        self._recordings = recordings
        self._truths = truths
        self._floor = floor
        self._seed = seed
        self._logs = np.unique([scene.log for scene in recordings.scenes], return_inverse=True)[1]

    def row(self, track: str, run: Run) -> Row:
        """Measure a run against every truth."""
        measured = {
            name: [truth.measure(travel) for travel in run.travels[name]] for name, truth in self._truths.items()
        }
        errors = {name: mean_errors(seeds) for name, seeds in measured.items()}
        headline = next(iter(self._truths))
        scenes = np.stack([scene_means(seed.relative, len(run.tested))[1] for seed in measured[headline]])
        scores = {name: self.score(errors_of, run.tested) for name, errors_of in errors.items()}
        recordings, alone = as_variant(self._recordings, run.name), variants(self._recordings).get(run.name, run.name)
        lost, instantly = (lost_tracks(recordings, alone, instantly=instantly) for instantly in (False, True))
        fused = alone not in recordings.experts
        votes = fused or run.name in recordings.voters(track)
        return self.detailed(track, Row(run, errors, scores, lost, instantly, fused, votes, scenes))

    def detailed(self, track: str, row: Row) -> Row:
        """The same row with its errors by length and its anatomy, on the scenes it was tested on."""
        headline, truth = next(iter(self._truths.items()))
        lengths = self._by_length(row.errors[headline].relative, row.run.tested)
        return replace(row, lengths=lengths, anatomy=anatomy_of(row.run, track, self._recordings, truth, headline))

    def _by_length(self, relative: RelativeSamples, scenes: NDArray[np.bool_]) -> tuple[AtLength, ...]:
        """RTE at every length that was asked for, of ``scenes``."""
        found = []
        for length in relative.lengths_m:
            here = (relative.length_m == length) & scenes[relative.scene]
            logs = self._logs[relative.scene[here]]
            translation, rotation = (
                interval_over_groups(values[here], logs, seed=self._seed)
                for values in (relative.translation_percent, relative.rotation_deg_per_m)
            )
            found.append(AtLength(length, translation, rotation, int(here.sum())))
        return tuple(found)

    def restrict(self, row: Row, scenes: NDArray[np.bool_]) -> Row:
        """The same row scored on some scenes only."""
        scores = {truth: self.score(errors, scenes) for truth, errors in row.errors.items()}
        return replace(row, run=replace(row.run, tested=scenes), scores=scores, lengths=(), anatomy=None)

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

    def compare(self, rows: Sequence[Row]) -> Comparisons:
        """Paired comparisons of rows tested on the same scenes; those that read the truth take no part."""
        taking_part = [row for row in rows if not row.run.privileged]
        samples, logs = {}, np.zeros(0, np.int64)
        for row in taking_part:
            relative = next(iter(row.errors.values())).relative
            here = row.run.tested[relative.scene]
            samples[row.name], logs = relative.rotation_deg_per_m[here], self._logs[relative.scene[here]]
        return compare_rows(samples, logs, floor=self._floor, seed=self._seed)
