"""BIAS FILTER: every expert has a bias that a Kalman filter learns from its disagreement with the others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.policies.bias_steps import Told, blank_state, step_batch
from mixo_env.policies.calibration import Calibration, Past
from mixo_env.policies.consensus import agreement
from mixo_env.policies.drift import Drift
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.robust import believable, median_weights
from mixo_env.policies.softmin import Recent
from mixo_env.recordings.collection import Recordings


class BiasFilter(Policy):
    """Vision-aided gyro-bias filter, for every expert at once.

    Increment of expert i: y_i = psi + (c_i + b_i) dt + e_i, with a constant c_i, a slow bias b_i (first-order
    Gauss-Markov, Gelb 1974, section 3.8) and a white e_i with Student's t tails, larger in turns. A Kalman filter keeps
    the biases of all experts; the yaw increment itself is free at every step, so it is what best explains them. In
    CONSUMER the gyro drifts and the cameras do not, which makes it the classical filter of yaw rate and gyro bias with
    robust camera updates; among visual odometries it splits who is right in the short and in the long run. All
    constants are measured on the training scenes; the variance of e_i follows recent agreement with the consensus
    (adaptive filtering, Mehra 1970), down to half of what was measured.

    Attributes:
        apart: ``(batch, experts)`` increments of the last step less the biases predicted for it [rad].
        left: ``(batch, experts)`` standard deviations of what is left of their errors [rad]; infinite: no vote.
    """

    name = "BIAS FILTER"
    learns = True

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Measure errors and drift."""
        super().fit(training, track)
        self._adopt(*Drift.fit(Past.read(training, self.experts)))

    def reset(self, batch: int) -> None:
        """Every bias is 0, as uncertain as it was on the training scenes; nobody has disagreed yet."""
        self._state = blank_state(batch, self._constants)
        self._noise, self.apart, self.left = (np.empty((batch, len(self.experts))) for _ in range(3))
        self._recent = Recent(batch, len(self.experts))

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        weights = np.empty(self._noise.shape)
        found = self._noise, weights, self.apart, self.left
        if not step_batch(self._state, self._hear(observation), self._constants, found):
            undecided = ~weights.any(axis=1)
            increments = observation["yaw_rates"].astype(np.float64) * observation["dt"]
            weights[undecided] = median_weights(increments[undecided], believable(observation)[undecided])
        return weights

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Calibration and drift."""
        return {**self._calibration.tensors(), **self._drift.tensors()}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """A number an expert each."""
        return {**Calibration.shapes(len(self.experts)), **Drift.shapes(len(self.experts))}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take them back."""
        self._adopt(Drift.restore(tensors), Calibration.restore(tensors))

    def _adopt(self, drift: Drift, calibration: Calibration) -> None:
        self._drift, self._calibration = drift, calibration
        self._constants = np.stack(list(drift.tensors().values()))

    def _hear(self, observation: Observation) -> Told:
        """What a step of the filter is told; recent agreement counts it in."""
        apart, std, known = agreement(observation, self._calibration)
        return observation["yaw_rates"], observation["dt"], std, self._recent.update(apart, known), known
