"""COVARIANCE INTERSECTION: fusion of experts whose errors may be correlated in any way."""

from __future__ import annotations

import numpy as np

from mixo_env.policies.calibrated import Calibrated
from mixo_env.policies.consensus import agreement
from mixo_env.policies.policy import Observation, Weights

CONSISTENT = 3.0
"""Standard deviations from the consensus within which an expert's own one can be true."""


class CovarianceIntersection(Calibrated):
    """P^-1 = sum_i omega_i P_i^-1 with omega on the simplex that makes P least (Julier and Uhlmann 1997).

    Of one number, the yaw increment, 1 / P is linear in omega and largest at a corner: the expert that is surest at
    this step takes all. Consistency is what the rule asks of its inputs, so experts more than 3 calibrated standard
    deviations from the consensus are out; where that leaves nobody, the nearest one in these units remains.
    """

    name = "COVARIANCE INTERSECTION"

    def act(self, observation: Observation) -> Weights:
        """One-hot rows ``(batch, experts)``; the earlier expert wins a tie."""
        apart, std, known = agreement(observation, self._calibration)
        distance = np.where(known, np.abs(apart), np.inf)
        consistent = distance <= np.maximum(distance.min(axis=1, keepdims=True), CONSISTENT)
        return np.eye(std.shape[1])[np.argmin(np.where(consistent, std, np.inf), axis=1)]
