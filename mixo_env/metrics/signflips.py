"""Sign-flip tests over groups: if neither method is better, every drive's difference could have had the other sign.

The p-value is the share of all sign patterns whose sum is at least as far from zero as the observed one. Up to
``EXACT_GROUPS`` groups it is exact and costs next to nothing: the patterns of either half of the groups are added up
once, and sorting one half tells how many pairs of halves reach the observed sum. Beyond, patterns are drawn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixo_env.geometry import FloatArray

EXACT_GROUPS = 24
"""Up to this many groups all 2^groups patterns count."""

DRAWS = 1_000_000
"""Random patterns beyond: p-values of .001 are then known to 6 %."""

_CHUNK = 1 << 10
"""Patterns held in memory at once: their sums stay in the cache of a core."""

ROUNDING = 1e-12
"""Sums that differ by this share of the sum of all magnitudes are equal: the order of adding must not matter."""


def sign_flip_p_values(sums: ArrayLike, *, draws: int = DRAWS, seed: int = 0) -> FloatArray:
    """Two-sided p-values of several comparisons over the same groups.

    Args:
        sums: ``(groups, comparisons)`` sum of the paired differences in each group.
        draws: random patterns beyond ``EXACT_GROUPS`` groups; the observed one counts as one more, so that no p-value
            is 0. All comparisons share them.
        seed: of the draws.

    Returns:
        ``(comparisons,)``; never below 2 / 2^groups, the honest limit of few groups.
    """
    table = np.atleast_2d(np.asarray(sums, dtype=np.float64))
    reach = np.abs(table.sum(axis=0)) - ROUNDING * np.abs(table).sum(axis=0)
    if len(table) <= EXACT_GROUPS:
        return np.array([_exact(column, least) for column, least in zip(table.T, reach, strict=True)])
    rng = np.random.default_rng(seed)
    as_far = np.ones(table.shape[1])
    for start in range(0, draws, _CHUNK):
        size = min(_CHUNK, draws - start)
        bits = np.unpackbits(rng.integers(0, 256, (size, -(-len(table) // 8)), np.uint8), axis=1)[:, : len(table)]
        as_far += np.count_nonzero(np.abs((1.0 - 2.0 * bits) @ table) >= reach, axis=0)
    return as_far / (draws + 1)


def _exact(sums: FloatArray, reach: float) -> float:
    """Share of all patterns whose sum is at least ``reach`` from zero."""
    first, second = (_pattern_sums(half) for half in np.array_split(sums, 2))
    second.sort()
    above = len(second) - np.searchsorted(second, reach - first, side="left")
    below = np.searchsorted(second, -reach - first, side="right")
    both = len(first) * len(second)
    return 1.0 if reach <= 0.0 else float((above.sum() + below.sum()) / both)


def _pattern_sums(values: NDArray[np.float64]) -> FloatArray:
    """``(2^n,)`` sums of all sign patterns of ``(n,)`` values."""
    sums = np.zeros(1)
    for value in values:
        sums = np.concatenate([sums + value, sums - value])
    return sums
