"""INVERSE VARIANCE: the minimum-variance mixture of independent, unbiased experts."""

from __future__ import annotations

import numpy as np

from mixo_env.policies.calibrated import Calibrated
from mixo_env.policies.consensus import agreement
from mixo_env.policies.policy import Observation, Weights

OUTLIER = 5.0
"""Standard deviations from the consensus beyond which an expert has no vote."""


class InverseVariance(Calibrated):
    """w_i = sigma_i^-2 / sum_j sigma_j^-2 (Aitken 1935; the scalar information filter).

    An expert's sigma is what it states times a factor, or a constant, both measured on the training scenes. The rule
    trusts these numbers blindly, so experts 5 sigma away from the consensus are cleaned out first (Hampel 1974); where
    that leaves nobody, nobody is.
    """

    name = "INVERSE VARIANCE"

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        apart, std, known = agreement(observation, self._calibration)
        kept = known & (np.abs(apart) <= OUTLIER)
        kept = np.where(kept.any(axis=1, keepdims=True), kept, known)
        weights = kept / std**2
        return weights / weights.sum(axis=1, keepdims=True)
