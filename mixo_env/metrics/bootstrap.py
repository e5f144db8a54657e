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
from mixo_env.metrics.signflips import sign_flip_p_values

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


@dataclass(frozen=True)
class PairedDifference:
    """Mean of (a - b) over paired samples: negative when ``a`` is better (errors).

    Attributes:
        difference: the mean, with its bootstrap interval.
        p_value: two-sided, from flipping the sign of whole groups: small only when the groups agree.
        standard_error: of the mean, from the same resamples; NaN with fewer than two groups.
    """

    difference: Interval
    p_value: float
    standard_error: float


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
    return _interval(sums, resampled_means(sums, counts, resamples, seed), counts, confidence)


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
    drawn = _drawn(len(sums), resamples, seed)
    return ((drawn @ sums).T / (drawn @ counts)).T


@lru_cache(maxsize=4)
def _drawn(groups: int, resamples: int, seed: int) -> FloatArray:
    """``(resamples, groups)`` how often each group was drawn. Read only: every method of a table shares them."""
    drawn = np.random.default_rng(seed).multinomial(groups, np.full(groups, 1.0 / groups), size=resamples)
    shared = drawn.astype(np.float64)
    shared.flags.writeable = False
    return shared


def _interval(sums: FloatArray, means: FloatArray, counts: FloatArray, confidence: float) -> Interval:
    mean = float(sums.sum() / counts.sum()) if len(sums) else float("nan")
    if not len(means):
        return Interval(mean, float("nan"), float("nan"), len(sums), confidence)
    low, high = np.quantile(means, [0.5 - confidence / 2.0, 0.5 + confidence / 2.0])
    return Interval(mean, float(low), float(high), len(sums), confidence)


def paired_difference(
    a: ArrayLike,
    b: ArrayLike,
    groups: Sequence[object] | NDArray[np.generic],
    *,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> PairedDifference:
    """Is ``a`` better than ``b`` on the same samples (same scenes, same pairs)?

    The p-value is that of a sign-flip test on group sums (:mod:`~mixo_env.metrics.signflips`). With g groups it cannot
    fall below 2 / 2^g, which is the honest limit of few drives.

    Args:
        a: ``(N,)`` errors of one method.
        b: ``(N,)`` errors of the other, sample by sample.
        groups: ``(N,)`` label of each sample's group.
        confidence: of the interval.
        resamples: bootstrap draws.
        seed: of these and of random sign patterns.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if first.shape != second.shape:
        raise ConfigurationError(
            f"a paired difference needs the same samples, got {first.shape} and {second.shape}; score on the same pairs"
        )
    sums, counts = per_group(first - second, groups)
    means = resampled_means(sums, counts, resamples, seed)
    return PairedDifference(
        difference=_interval(sums, means, counts, confidence),
        p_value=float(sign_flip_p_values(sums[:, None], seed=seed)[0]),
        standard_error=float(means.std()) if len(means) else float("nan"),
    )


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
