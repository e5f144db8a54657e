"""The difference of two methods on the same samples, one pair at a time: an oracle for the table of all pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixo_env.metrics.bootstrap import RESAMPLES, Interval, interval_over_groups, per_group, resampled_means
from mixo_env.metrics.signflips import sign_flip_p_values


@dataclass(frozen=True)
class PairedDifference:
    """Mean of (a - b), its interval, the p-value of flipped signs, and the standard error of the same resamples."""

    difference: Interval
    p_value: float
    standard_error: float


def paired_difference(
    a: ArrayLike,
    b: ArrayLike,
    groups: Sequence[object] | NDArray[np.generic],
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> PairedDifference:
    """Is ``a`` better than ``b``? ``(N,)`` errors of each, sample by sample, and the group of every sample."""
    errors = np.asarray(a, dtype=np.float64) - np.asarray(b, dtype=np.float64)
    sums, counts = per_group(errors, groups)
    means = resampled_means(sums, counts, resamples, seed)
    return PairedDifference(
        difference=interval_over_groups(errors, groups, resamples=resamples, seed=seed),
        p_value=float(sign_flip_p_values(sums[:, None], seed=seed)[0]),
        standard_error=float(means.std()) if len(means) else float("nan"),
    )
