"""FIXED SHARE: prediction with expert advice, with the consensus in the place of the truth that nobody has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.fusion import FloatArray
from mixo_env.policies.calibrated import Calibrated
from mixo_env.policies.consensus import agreement
from mixo_env.policies.policy import Observation, Weights

SWITCHING = 0.01
"""Share of the trust that is dealt out anew every step: the best expert changes about every 100 steps (10 s)."""
LARGEST_LOSS = 50.0


class FixedShare(Calibrated):
    """Herbster and Warmuth 1998: trust is multiplied by exp(-loss), then a fixed share of it is dealt out evenly.

    The loss of an expert is its negative log likelihood given the consensus (STUDENT-T, nu = 5),
    (r_i / sigma_i)^2 / 2 + log(sigma_i / sigma_min), at most 50. Those without a vote sleep: they lose as much as the
    mixture does (Freund et al. 1997). However the losses fall, the mixture loses at most log n + k log(n / alpha) +
    (T - 1 - k) log(1 / (1 - alpha)) more than the best sequence of experts with k changes: a promise about the
    consensus, which is not the truth.
    """

    name = "FIXED SHARE"

    def reset(self, batch: int) -> None:
        """Everybody is trusted alike."""
        self._trust = np.full((batch, len(self.experts)), 1.0 / len(self.experts))

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        apart, std, known = agreement(observation, self._calibration)
        surest = np.where(known, std, np.inf).min(axis=1, keepdims=True)
        loss = np.minimum(0.5 * apart**2 + np.log(np.where(known, std, 1.0) / surest), LARGEST_LOSS)
        posterior, self._trust, _ = share(self._trust, loss, known)
        return posterior


def share(trust: FloatArray, loss: FloatArray, awake: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One round.

    Args:
        trust: ``(batch, n)`` rows that sum to one.
        loss: ``(batch, n)``; of those asleep it is not read.
        awake: ``(batch, n)`` who takes part, at least one a row.

    Returns:
        Trust after the loss among those awake, rows that sum to one; trust before the next round; loss of the mixture
        ``(batch,)``, -log sum_i trust_i exp(-loss_i) over those awake with their trust scaled to one.
    """
    waking = np.where(awake, trust, 0.0)
    total = waking.sum(axis=1, keepdims=True)
    after = waking * np.exp(-np.where(awake, loss, 0.0))
    kept = after.sum(axis=1, keepdims=True)
    posterior = after / kept
    updated = np.where(awake, posterior * total, trust)
    following = (1.0 - SWITCHING) * updated + SWITCHING / trust.shape[1]
    return posterior, following / following.sum(axis=1, keepdims=True), -np.log(kept / total)[:, 0]
