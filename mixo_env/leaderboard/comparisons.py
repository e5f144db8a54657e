"""Paired comparisons of the rows of one table on the headline: which differences are real, how small one could be.

Two families, each corrected after Holm (1979) by itself. The *confirmatory* one is fixed beforehand: what the paper
claims, and whether a rule that trains next to nothing does as well. All pairs of rows are *exploratory* and give the
letters. Rows that read the truth are in no family.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.letters import letters
from mixo_env.metrics.bootstrap import RESAMPLES, Interval, holm, resampled_means
from mixo_env.metrics.signflips import sign_flip_p_values

CONFIRMATORY = (("MIXO", "LINEAR"), ("LINEAR", "CAM_FRONT"), ("MIXO", "CAM_FRONT"), ("MIXO", "HUBER"))
"""The differences (first - second) asked for beforehand."""

REFERENCES = ("LINEAR", "MIXO")
"""Every row prints its difference to these."""

LEVEL = 0.05
POWER = 0.80


@dataclass(frozen=True)
class Comparison:
    """Paired difference of two rows in their headline error.

    Attributes:
        first, second: rows; the difference is first - second, negative where the first is better.
        second_error: mean error of the second row [deg/m].
        difference: mean over all samples with its bootstrap interval over logs [deg/m].
        p_value: of the sign-flip test over logs.
        p_holm: the same, corrected for all comparisons of its family.
        detectable: true difference that a test at 5 % would find with 80 % power, 2.8 standard errors.
        detectable_holm: the same at Holm's strictest level, 5 % over the size of the family.
    """

    first: str
    second: str
    second_error: float
    difference: Interval
    p_value: float
    p_holm: float
    detectable: float
    detectable_holm: float

    @property
    def share(self) -> float:
        """The difference as a share of the second row's error."""
        return self.difference.mean / self.second_error if self.second_error else float("nan")

    def reversed(self) -> Comparison:
        """The same comparison seen from the other row."""
        d = self.difference
        return replace(
            self,
            first=self.second,
            second=self.first,
            second_error=self.second_error + d.mean,
            difference=replace(d, mean=-d.mean, low=-d.high, high=-d.low),
        )


@dataclass(frozen=True)
class Comparisons:
    """What can be said about the rows of a table.

    Attributes:
        logs: with samples; with g of them no p-value falls below 2 / 2^g.
        confirmatory: of the pairs fixed beforehand, those whose rows are there.
        exploratory: all pairs of rows.
        letters: row -> letters; rows that cannot be told apart share one. None for a row below the noise floor.
    """

    logs: int
    confirmatory: tuple[Comparison, ...]
    exploratory: tuple[Comparison, ...]
    letters: Mapping[str, str]

    def between(self, first: str, second: str) -> Comparison | None:
        """The exploratory comparison of two rows, in this order; ``None`` for the same row or one in no family."""
        for found in self.exploratory:
            if (found.first, found.second) == (first, second):
                return found
            if (found.first, found.second) == (second, first):
                return found.reversed()
        return None


def compare_rows(
    errors: Mapping[str, FloatArray], logs: NDArray[np.generic], *, floor: float = 0.0, seed: int = 0
) -> Comparisons:
    """Compare all rows with each other.

    Args:
        errors: row -> ``(samples,)``, the same samples for all.
        logs: ``(samples,)`` the drive each comes from.
        floor: mean error that the truth's own noise makes; rows below it are given no letter.
        seed: of bootstrap and sign patterns.
    """
    rows = list(errors)
    drives, of_sample = np.unique(logs, return_inverse=True)
    counts = np.bincount(of_sample, minlength=len(drives)).astype(np.float64)
    sums: dict[str, FloatArray] = {
        row: np.bincount(of_sample, weights=errors[row], minlength=len(drives)).astype(np.float64) for row in rows
    }
    if not len(drives):
        return Comparisons(0, (), (), dict.fromkeys(rows, ""))
    confirmatory = [pair for pair in CONFIRMATORY if set(pair) <= set(rows)]
    exploratory = list(itertools.combinations(rows, 2))
    every = _family(sums, counts, exploratory, seed)
    means = {row: float(values.sum() / counts.sum()) for row, values in sums.items()}
    lettered = [row for row in sorted(rows, key=lambda row: means[row]) if means[row] >= floor]
    differ = {(c.first, c.second) for c in every if c.p_holm < LEVEL and {c.first, c.second} <= set(lettered)}
    return Comparisons(len(drives), _family(sums, counts, confirmatory, seed), every, letters(lettered, differ))


def _family(
    sums: Mapping[str, FloatArray], counts: FloatArray, pairs: Sequence[tuple[str, str]], seed: int
) -> tuple[Comparison, ...]:
    """Comparisons of ``pairs``, corrected together; ``sums`` are ``(logs,)`` a row, ``counts`` its samples."""
    if not pairs:
        return ()
    table = np.stack([sums[first] - sums[second] for first, second in pairs], axis=1)
    means = resampled_means(table, counts, RESAMPLES, seed)
    low, high = np.quantile(means, [0.025, 0.975], axis=0) if len(means) else np.full((2, len(pairs)), np.nan)
    errors = means.std(axis=0) if len(means) else np.full(len(pairs), np.nan)
    p_values = sign_flip_p_values(table, seed=seed)
    corrected = holm(dict(zip(pairs, p_values.tolist(), strict=True)))
    found = []
    for j, (first, second) in enumerate(pairs):
        mean = float(table[:, j].sum() / counts.sum())
        found.append(
            Comparison(
                first=first,
                second=second,
                second_error=float(sums[second].sum() / counts.sum()),
                difference=Interval(mean, float(low[j]), float(high[j]), len(counts), 0.95),
                p_value=float(p_values[j]),
                p_holm=corrected[first, second],
                detectable=detectable(float(errors[j])),
                detectable_holm=detectable(float(errors[j]), LEVEL / len(pairs)),
            )
        )
    return tuple(found)


def detectable(standard_error: float, level: float = LEVEL) -> float:
    """True difference that a two-sided test at ``level`` finds with 80 % power: 2.80 standard errors at 5 %."""
    normal = NormalDist()
    return standard_error * (normal.inv_cdf(1.0 - level / 2.0) + normal.inv_cdf(POWER))
