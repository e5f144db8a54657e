"""SOFTMIN: trust by recent agreement with the consensus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked
from mixo_env.fusion import FloatArray
from mixo_env.policies.calibrated import Calibrated
from mixo_env.policies.consensus import agreement
from mixo_env.policies.policy import Observation, Weights

MEMORY = 30.0
"""Steps over which disagreement is forgotten (some 3 s), and the number of steps that the calibration counts for."""
SHARPNESS = 2.0
"""Of the softmin of logarithmic scales: 2 is inverse variance."""
MEAN_TO_SIGMA = 1.2533
"""sqrt(pi / 2): mean absolute deviation of a Gaussian to its standard deviation."""
SMALLEST = 1e-3
"""Keeps weights finite where an expert is the consensus."""


class Recent:
    """How far every expert lately was from the consensus, in calibrated standard deviations, ``(batch, experts)``.

    1.2533 x the exponentially forgetting mean of absolute deviations; a robust scale that starts at 1. Steps without a
    vote change nothing.
    """

    def __init__(self, batch: int, experts: int) -> None:
        """Nobody has disagreed yet."""
        self._scale = np.ones((batch, experts))

    def update(self, apart: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
        """The scales with the present step counted in; arguments as :func:`agreement` gives them."""
        _count_in(apart, known, self._scale)
        return self._scale


@compiled_unchecked
def _count_in(apart: FloatArray, known: NDArray[np.bool_], scale: FloatArray) -> None:
    for b in range(len(scale)):
        for e in range(scale.shape[1]):
            if known[b, e]:
                scale[b, e] += (MEAN_TO_SIGMA * abs(apart[b, e]) - scale[b, e]) / MEMORY


class Softmin(Calibrated):
    """w_i = softmin(2 log s_i), s_i the robust scale of what expert i lately did.

    s_i = sigma_i x the robust scale of (y_i - consensus) / sigma_i over the last steps (:class:`Recent`). The present
    step counts, so an expert that breaks is out at once and stays out for a while. The consensus (STUDENT-T, nu = 5)
    knows nothing of these scales: no expert can vote itself in.
    """

    name = "SOFTMIN"

    def reset(self, batch: int) -> None:
        """Nobody has disagreed yet."""
        self._recent = Recent(batch, len(self.experts))

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        apart, std, known = agreement(observation, self._calibration)
        scale = std * np.maximum(self._recent.update(apart, known), SMALLEST)
        weights = np.where(known, scale, np.inf) ** -SHARPNESS
        return weights / weights.sum(axis=1, keepdims=True)
