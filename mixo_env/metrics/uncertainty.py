"""Is a stated standard deviation true? NLL, NEES and coverage (docs/metrics.md, "Uncertainty")."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from mixo_env.errors import ConfigurationError
from mixo_env.geometry import FloatArray


@dataclass(frozen=True)
class UncertaintyScore:
    """Calibration of scalar errors against their stated standard deviations.

    Attributes:
        nll: mean negative log likelihood of a normal distribution, in nats; lower is better. Its value depends on
            the unit of the error (rad here), so compare it between methods only.
        nees: mean of error^2 / std^2; 1 is right, above 1 overconfident, below 1 timid.
        coverage_68, coverage_95: share of errors inside the central 68 and 95 % interval.
        count: errors scored: those with a stated, finite standard deviation.
    """

    nll: float
    nees: float
    coverage_68: float
    coverage_95: float
    count: int


def uncertainty_score(error_rad: FloatArray, std_rad: FloatArray) -> UncertaintyScore:
    """Score errors ``(M,)`` with their standard deviations ``(M,)``; steps where either is NaN are left out.

    Raises:
        ConfigurationError: when a standard deviation is not above 0.
    """
    given = np.isfinite(error_rad) & np.isfinite(std_rad)
    error, std = np.asarray(error_rad)[given], np.asarray(std_rad)[given]
    if not len(error):
        return UncertaintyScore(np.nan, np.nan, np.nan, np.nan, 0)
    if std.min() <= 0.0:
        raise ConfigurationError(f"expected standard deviations above 0, got {std.min()}; NaN marks a missing one")
    ratio = error / std
    inside = {share: NormalDist().inv_cdf(0.5 + share / 2.0) for share in (0.68, 0.95)}
    return UncertaintyScore(
        nll=float(np.mean(0.5 * np.log(2.0 * np.pi) + np.log(std) + 0.5 * ratio**2)),
        nees=float(np.mean(ratio**2)),
        coverage_68=float(np.mean(np.abs(ratio) <= inside[0.68])),
        coverage_95=float(np.mean(np.abs(ratio) <= inside[0.95])),
        count=len(error),
    )
