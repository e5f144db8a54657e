"""Intervals and comparisons over groups: the group is the log (a drive), not the frame or the scene.

Samples of one drive share its street, weather and sensor biases, so only drives are close to independent
(docs/metrics.md, "Intervals").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.geometry import FloatArray

Name = TypeVar("Name")

RESAMPLES = 10_000


@dataclass(frozen=True)
class Interval:
    """A mean with a percentile bootstrap interval; both ends are NaN with fewer than two groups."""

    mean: float
    low: float
    high: float
    groups: int
    confidence: float


def interval_over_groups(
    values: ArrayLike,
    groups: Sequence[object] | NDArray[np.generic],
    *,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Interval:
    """Percentile bootstrap of the mean of all samples, drawing whole groups with replacement.

    A group keeps its number of samples, so the resampled mean is the sum over drawn groups of their sums over the sum
    of their counts. For an RMSE pass squared errors and take the root of all three numbers.

    Args:
        values: ``(N,)`` samples.
        groups: ``(N,)`` label of each sample's group, e.g. its log.
        confidence: share of resampled means inside the interval.
        resamples: bootstrap draws.
        seed: of the draws; the same seed draws the same groups for every method.
    """
    sums, counts = per_group(values, groups)
    if not 0.0 < confidence < 1.0:
        raise ConfigurationError(f"expected a confidence between 0 and 1, got {confidence}; 0.95 is usual")
    mean = float(sums.sum() / counts.sum()) if len(sums) else float("nan")
    return percentile_interval(mean, resampled_means(sums, counts, resamples, seed), len(sums), confidence)


def resampled_means(sums: FloatArray, counts: FloatArray, resamples: int, seed: int) -> FloatArray:
    """Means of all samples of as many groups drawn with replacement.

    Args:
        sums: ``(groups, ...)`` of the samples of each group.
        counts: ``(groups,)`` their number.
        resamples: draws.
        seed: of the draws.

    Returns:
        ``(resamples, ...)``; none below two groups.
    """
    if len(sums) < 2:
        return np.empty((0, *sums.shape[1:]))
    drawn = draws(len(sums), resamples, seed)
    return ((drawn @ sums).T / (drawn @ counts)).T


@lru_cache(maxsize=32)  # a table by situation has groups of many sizes
def draws(groups: int, resamples: int, seed: int) -> FloatArray:
    """``(resamples, groups)`` how often each was drawn. Read only: all methods of a table share them."""
    drawn = np.random.default_rng(seed).multinomial(groups, np.full(groups, 1.0 / groups), size=resamples)
    shared = drawn.astype(np.float64)
    shared.flags.writeable = False
    return shared


def percentile_interval(value: float, drawn: FloatArray, groups: int, confidence: float = 0.95) -> Interval:
    """A statistic of all groups with the percentiles of what it is in every draw of them.

    Args:
        value: the statistic.
        drawn: of every draw that has one; none below two groups.
        groups: their number.
        confidence: share of draws inside the interval.
    """
    if not len(drawn):
        return Interval(value, float("nan"), float("nan"), groups, confidence)
    low, high = np.quantile(drawn, [0.5 - confidence / 2.0, 0.5 + confidence / 2.0])
    return Interval(value, float(low), float(high), groups, confidence)


def holm(p_values: Mapping[Name, float]) -> dict[Name, float]:
    """p-values corrected for several comparisons after Holm (1979), in the order given; never above 1."""
    corrected: dict[Name, float] = {}
    running = 0.0
    for rank, name in enumerate(sorted(p_values, key=lambda name: p_values[name])):
        running = max(running, (len(p_values) - rank) * p_values[name])
        corrected[name] = min(1.0, running)
    return {name: corrected[name] for name in p_values}


def per_group(values: ArrayLike, groups: Sequence[object] | NDArray[np.generic]) -> tuple[FloatArray, FloatArray]:
    """Sum and number of the samples of each group, ``(groups,)`` each."""
    samples = np.asarray(values, dtype=np.float64)
    if len(samples) != len(groups):
        raise ConfigurationError(f"expected a group for each of {len(samples)} samples, got {len(groups)}")
    _, index = np.unique(np.asarray(groups), return_inverse=True)
    sums = np.asarray(np.bincount(index, weights=samples), dtype=np.float64)
    return sums, np.asarray(np.bincount(index), dtype=np.float64)
