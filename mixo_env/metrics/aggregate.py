"""From errors to scores: statistics of one list, pooled and per-length relative errors, the named alternates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import FloatArray
from mixo_env.metrics.relative import RelativeSamples

HIGH_ATE_M = 0.5
"""The paper's Fig. 6 counts scenes above this ATE."""


@dataclass(frozen=True)
class Statistics:
    """Plain statistics of one list of errors; NaN when it is empty. ``std`` divides by the count (ddof 0)."""

    rmse: float
    mean: float
    median: float
    std: float
    max: float
    count: int


@dataclass(frozen=True)
class LengthScore:
    """Relative errors at one length L.

    Attributes:
        length_m: L.
        samples, scenes: how many pieces, and how many scenes contribute at least one.
        translation_m, translation_percent, rotation_deg, rotation_deg_per_m: statistics over the pieces.
    """

    length_m: float
    samples: int
    scenes: int
    translation_m: Statistics
    translation_percent: Statistics
    rotation_deg: Statistics
    rotation_deg_per_m: Statistics


@dataclass(frozen=True)
class RelativeScore:
    """A pair of relative errors and what it rests on; NaN without a sample."""

    translation_percent: float
    rotation_deg_per_m: float
    samples: int
    scenes: int


def statistics(errors: FloatArray) -> Statistics:
    """Statistics of ``errors`` ``(N,)``."""
    if len(errors) == 0:
        return Statistics(np.nan, np.nan, np.nan, np.nan, np.nan, 0)
    return Statistics(
        rmse=float(np.sqrt(np.mean(np.square(errors)))),
        mean=float(np.mean(errors)),
        median=float(np.median(errors)),
        std=float(np.std(errors)),
        max=float(np.max(errors)),
        count=len(errors),
    )


def pooled(samples: RelativeSamples) -> RelativeScore:
    """The headline: the mean over all samples of all lengths of all scenes (METRICS: pooled RTE)."""
    return _score(_mean(samples.translation_percent), _mean(samples.rotation_deg_per_m), samples)


def per_length(samples: RelativeSamples) -> tuple[LengthScore, ...]:
    """Statistics at each length that was asked for, also those without a sample."""
    scores = []
    for length in samples.lengths_m:
        here = np.flatnonzero(samples.length_m == length)
        scores.append(
            LengthScore(
                length_m=length,
                samples=len(here),
                scenes=_distinct(samples.scene[here]),
                translation_m=statistics(samples.translation_m[here]),
                translation_percent=statistics(samples.translation_percent[here]),
                rotation_deg=statistics(samples.rotation_deg[here]),
                rotation_deg_per_m=statistics(samples.rotation_deg_per_m[here]),
            )
        )
    return tuple(scores)


def mean_of_length_means(samples: RelativeSamples) -> RelativeScore:
    """Named alternate: every length counts the same, however few samples it has; lengths without any are left out."""
    scores = [score for score in per_length(samples) if score.samples]
    translation = _mean(np.array([score.translation_percent.mean for score in scores]))
    rotation = _mean(np.array([score.rotation_deg_per_m.mean for score in scores]))
    return _score(translation, rotation, samples)


def rmse_over_length(samples: RelativeSamples) -> RelativeScore:
    """Named alternate: sum of the RMSE [m, deg] at each length over the sum of those lengths."""
    scores = [score for score in per_length(samples) if score.samples]
    total_m = sum(score.length_m for score in scores)
    if not scores:
        return _score(np.nan, np.nan, samples)
    translation = 100.0 * sum(score.translation_m.rmse for score in scores) / total_m
    rotation = sum(score.rotation_deg.rmse for score in scores) / total_m
    return _score(translation, rotation, samples)


def share_above(ate_m: FloatArray, limit_m: float = HIGH_ATE_M) -> float:
    """Share of scenes whose ATE ``(scenes,)`` exceeds ``limit_m``."""
    return _mean((np.asarray(ate_m) > limit_m).astype(np.float64))


def scene_rmse(errors: FloatArray, offsets: NDArray[np.int64]) -> FloatArray:
    """RMSE of each scene ``(scenes,)`` from errors ``(N,)`` of all; NaN for an empty scene."""
    return np.sqrt(scene_mean(np.square(errors), offsets))


def scene_mean(values: FloatArray, offsets: NDArray[np.int64]) -> FloatArray:
    """Mean of each scene ``(scenes,)``; NaN for an empty scene."""
    scene = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    sums = np.bincount(scene, weights=values, minlength=len(offsets) - 1)
    with np.errstate(invalid="ignore"):
        return sums / np.diff(offsets)


def interquartile_mean(scores: FloatArray) -> float:
    """Mean of the middle half of all scores, whatever their shape: a robust mean (Agarwal et al. 2021).

    A quarter of the scores, rounded down to whole ones, is cut off at either end. NaN without a score.
    """
    ordered = np.sort(np.asarray(scores, dtype=np.float64), axis=None)
    cut = len(ordered) // 4
    return _mean(ordered[cut : len(ordered) - cut])


def probability_of_improvement(errors: FloatArray, others: FloatArray) -> float:
    """Chance that one run of a method errs less than one of another on the same task, mean over the tasks.

    The Mann-Whitney statistic of every task over the number of pairs of runs, ties count half (Agarwal et al. 2021).

    Args:
        errors: ``(runs, tasks)`` lower is better.
        others: ``(other runs, tasks)`` of the method compared with.

    Returns:
        Between 0 and 1, one half where neither is better; NaN without a task.
    """
    less = errors[:, None, :] < others[None, :, :]
    same = errors[:, None, :] == others[None, :, :]
    return _mean((less + 0.5 * same).mean(axis=(0, 1)))


def _mean(values: FloatArray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def _score(translation: float, rotation: float, samples: RelativeSamples) -> RelativeScore:
    return RelativeScore(float(translation), float(rotation), len(samples.scene), _distinct(samples.scene))


def _distinct(indices: NDArray[np.int64]) -> int:
    return int(np.count_nonzero(np.bincount(indices)))
