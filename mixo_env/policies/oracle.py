"""Privileged policies that read the true yaw rate: what perfect choosing could gain."""

from __future__ import annotations

import numpy as np

from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.recordings.schema import INERTIAL_EXPERTS


class MulticameraGT(Policy):
    """The camera whose increment is nearest the truth (eq. 2 as a policy; the paper's row of this name).

    An imported odometry counts as a camera. Only those with an increment of their own can be chosen; when none has one,
    any of them holds the substitute.
    """

    name = "MULTICAMERA GT"
    privileged = True

    def act(self, observation: Observation) -> Weights:
        """One-hot rows ``(batch, experts)``."""
        error = np.abs(observation["yaw_rates"] - observation["truth_yaw_rate"])
        visual = np.array([expert not in INERTIAL_EXPERTS for expert in self.experts])
        error = np.where((observation["available"] > 0) & visual, error, np.inf)
        return np.eye(error.shape[1])[np.argmin(error, axis=1)]


class OracleAll(Policy):
    """The voter nearest the truth, the inertial expert and substitutes included."""

    name = "ORACLE ALL"
    privileged = True

    def act(self, observation: Observation) -> Weights:
        """One-hot rows ``(batch, experts)``."""
        error = np.abs(observation["yaw_rates"] - observation["truth_yaw_rate"])
        return np.eye(error.shape[1])[np.argmin(error, axis=1)]


class OracleHull(Policy):
    """The truth clipped to the interval the voters span: what the best convex mixture could reach."""

    name = "ORACLE HULL"
    privileged = True

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)``: the nearest voters on either side of the truth share the weight.

        The nearest, because a wild increment is clipped in what is observed, and rounded like anything large.
        """
        rates = observation["yaw_rates"].astype(np.float64)
        apart = rates - observation["truth_yaw_rate"]
        row = np.arange(len(rates))
        low = np.argmax(np.where(apart <= 0.0, apart, -np.inf), axis=1)
        high = np.argmin(np.where(apart >= 0.0, apart, np.inf), axis=1)
        nearest = np.argmin(np.abs(apart), axis=1)
        low = np.where((apart <= 0.0).any(axis=1), low, nearest)
        high = np.where((apart >= 0.0).any(axis=1), high, nearest)
        span = rates[row, high] - rates[row, low]
        share = np.divide(-apart[row, low], span, out=np.zeros_like(span), where=span > 0.0)
        weights = np.zeros(rates.shape)
        weights[row, high] += share
        weights[row, low] += 1.0 - share
        return weights
