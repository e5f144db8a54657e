"""Intervals and comparisons over groups: the group is the log (a drive), not the frame or the scene.

Samples of one drive share its street, weather and sensor biases, so only drives are close to independent
(docs/metrics.md, "Intervals").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.geometry import FloatArray

RESAMPLES = 10_000
_EXACT_GROUPS = 14
"""Up to this many groups every one of the 2^groups sign patterns is tried."""


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
    """

    difference: Interval
    p_value: float


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
    sums, counts = _per_group(values, groups)
    if not 0.0 < confidence < 1.0:
        raise ConfigurationError(f"expected a confidence between 0 and 1, got {confidence}; 0.95 is usual")
    mean = float(sums.sum() / counts.sum()) if len(sums) else float("nan")
    if len(sums) < 2:
        return Interval(mean, float("nan"), float("nan"), len(sums), confidence)
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(len(sums), np.full(len(sums), 1.0 / len(sums)), size=resamples)
    means = (drawn @ sums) / (drawn @ counts)
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

    The p-value is that of a sign-flip permutation test on group sums: if neither is better, every group's difference
    could as well have had the other sign. All patterns are tried up to 14 groups, ``resamples`` random ones beyond.
    With g groups it cannot fall below 2 / 2^g, which is the honest limit of few drives.

    Args:
        a: ``(N,)`` errors of one method.
        b: ``(N,)`` errors of the other, sample by sample.
        groups: ``(N,)`` label of each sample's group.
        confidence: of the interval.
        resamples: bootstrap draws and random sign patterns.
        seed: of both.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if first.shape != second.shape:
        raise ConfigurationError(
            f"a paired difference needs the same samples, got {first.shape} and {second.shape}; score on the same pairs"
        )
    difference = interval_over_groups(first - second, groups, confidence=confidence, resamples=resamples, seed=seed)
    sums, _ = _per_group(first - second, groups)
    return PairedDifference(difference, _sign_flip_p_value(sums, resamples, seed))


def holm(p_values: Mapping[str, float]) -> dict[str, float]:
    """p-values corrected for several comparisons after Holm (1979), in the order given; never above 1."""
    corrected: dict[str, float] = {}
    running = 0.0
    for rank, name in enumerate(sorted(p_values, key=lambda name: p_values[name])):
        running = max(running, (len(p_values) - rank) * p_values[name])
        corrected[name] = min(1.0, running)
    return {name: corrected[name] for name in p_values}


def _per_group(values: ArrayLike, groups: Sequence[object] | NDArray[np.generic]) -> tuple[FloatArray, FloatArray]:
    """Sum and number of the samples of each group, ``(groups,)`` each."""
    samples = np.asarray(values, dtype=np.float64)
    if len(samples) != len(groups):
        raise ConfigurationError(f"expected a group for each of {len(samples)} samples, got {len(groups)}")
    _, index = np.unique(np.asarray(groups), return_inverse=True)
    sums = np.asarray(np.bincount(index, weights=samples), dtype=np.float64)
    return sums, np.asarray(np.bincount(index), dtype=np.float64)


def _sign_flip_p_value(sums: FloatArray, resamples: int, seed: int) -> float:
    observed = abs(sums.sum()) * (1.0 - 1e-12)  # equal sums must count as equal whatever the order of adding
    if len(sums) <= _EXACT_GROUPS:
        patterns = np.arange(2 ** len(sums))[:, None] >> np.arange(len(sums)) & 1
        return float(np.mean(np.abs((1.0 - 2.0 * patterns) @ sums) >= observed))
    signs = 1.0 - 2.0 * np.random.default_rng(seed).integers(0, 2, size=(resamples, len(sums)))
    # The observed pattern counts as one of the draws, so the p-value is never 0.
    return float((1 + np.count_nonzero(np.abs(signs @ sums) >= observed)) / (resamples + 1))
