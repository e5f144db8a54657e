"""SMOOTHER (NON-CAUSAL): the filter of biases with two seconds of the future, a bound for anything that filters."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled, compiled_unchecked
from mixo_env.errors import PolicyError
from mixo_env.fusion import FloatArray
from mixo_env.policies.bias_filter import BiasFilter
from mixo_env.policies.bias_steps import blank_state, invert, point_at, step_batch
from mixo_env.policies.blocks import in_rows
from mixo_env.policies.policy import Observation, Weights
from mixo_env.policies.robust import believable, median_weights

LAG = 24
"""Steps of the future, two seconds at 12 Hz."""
Ring = tuple[FloatArray, FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]
"""Of the last steps shown, ``(slots, batch, ...)``: biases, variances of white errors, gains back to the step before
``(..., n, n)``, diagonal of F since then; and whether the scene still went on."""
SMALLEST_BIAS_RADPS = 1e-7
"""Keeps covariances invertible for an expert that never drifts."""


@compiled_unchecked
def lead_back(
    covariance: FloatArray,
    drift: FloatArray,
    dt: FloatArray,
    active: NDArray[np.bool_],
    gains: FloatArray,
    fades: FloatArray,
) -> None:
    """Write what leads back from a step that follows to the one before, where scenes are still ``active``.

    Gains G = P F' (F P F' + Q)^-1 of Rauch, Tung and Striebel.

    Args:
        covariance: P before the step that follows, ``(batch, n, n)``.
        drift: as in :func:`~mixo_env.policies.bias_steps.step`.
        dt: of the step that follows, ``(batch,)``.
        active: ``(batch,)``.
        gains: ``(batch, n, n)`` written.
        fades: ``(batch, n)`` written: diagonal of F.
    """
    batch, n = fades.shape
    following = np.empty((n, n, 1))
    for b in range(batch):
        if not active[b]:
            continue
        fade = fades[b]
        for i in range(n):
            fade[i] = math.exp(-dt[b] / drift[2, i])
        for i in range(n):
            for j in range(n):
                following[i, j, 0] = fade[i] * covariance[b, i, j] * fade[j]
            following[i, i, 0] += drift[1, i] ** 2 * (1.0 - fade[i] * fade[i])
        invert(following)
        gains[b] = 0.0
        for i in range(n):
            for j in range(n):
                for k in range(n):
                    gains[b, i, j] += covariance[b, i, k] * fade[k] * following[k, j, 0]


@compiled
def look_back(ring: Ring, first: int, b: int) -> FloatArray:
    """Biases ``(n,)`` of scene ``b`` at slot ``first`` given all later slots: b_k|K = b_k + G (b_k+1|K - F b_k)."""
    biases, _, gains, fades, active = ring
    slots, _, n = biases.shape
    last = 0
    while last + 1 < slots and active[(first + last + 1) % slots, b]:
        last += 1
    later = biases[(first + last) % slots, b].copy()
    for k in range(last, 0, -1):
        here, following = (first + k - 1) % slots, (first + k) % slots
        earlier = biases[here, b].copy()
        for i in range(n):
            for j in range(n):
                earlier[i] += gains[following, b, i, j] * (later[j] - fades[following, b, j] * biases[here, b, j])
        later = earlier
    return later


@compiled
def decide(
    ring: Ring, first: int, values: FloatArray, constant: FloatArray, dt: FloatArray, weights: FloatArray
) -> None:
    """Weights ``(batch, n)`` of the step in slot ``first``; zero where nobody had a vote. ``constant`` [rad/s]."""
    for b in range(len(values)):
        bias = look_back(ring, first, b)
        trust = 1.0 / ring[1][first, b]
        weights[b] = 0.0
        if trust.sum() > 0.0:
            target = (trust * (values[b] - dt[b] * (constant + bias))).sum() / trust.sum()
            point_at(target, values[b], ring[1][first, b], weights[b])


class Smoother(BiasFilter):
    """Fixed-lag smoother (Rauch, Tung and Striebel 1965) of BIAS FILTER's model: no deployed system can have it.

    It decides about a step after it has seen the following two seconds of all experts; ground truth it never sees. With
    the biases b smoothed, psi = sum_i R_i^-1 (y_i - (c_i + b_i) dt) / sum_i R_i^-1. What it gains over BIAS FILTER is
    what waiting is worth.
    """

    name = "SMOOTHER (NON-CAUSAL)"
    privileged = True
    lag: ClassVar[int] = LAG

    def reset(self, batch: int) -> None:
        """Forget the past and the future."""
        super().reset(batch)
        n, slots = len(self.experts), LAG + 1
        self._drifting = self._constants.copy()
        self._drifting[1] = np.maximum(self._drifting[1], SMALLEST_BIAS_RADPS)
        self._state = blank_state(batch, self._drifting)
        noises, active = np.full((slots, batch, n), np.inf), np.zeros((slots, batch), np.bool_)
        self._ring: Ring = np.zeros((slots, batch, n)), noises, np.zeros((slots, batch, n, n)), noises.copy(), active
        self._shown = self._decided = 0

    def preview(self, observation: Observation, active: NDArray[np.bool_]) -> None:
        """Filter a step of the future."""
        slot = self._shown % (LAG + 1)
        biases, noises, gains, fades, lasting = self._ring
        lasting[slot] = active
        dt = observation["dt"][:, 0].astype(np.float64)
        bias, covariance = self._state
        lead_back(in_rows(covariance, len(dt)), self._drifting, dt, active, gains[slot], fades[slot])
        found = noises[slot], np.empty(self._noise.shape), self.apart, self.left
        step_batch(self._state, self._hear(observation), self._drifting, found)
        biases[slot] = in_rows(bias, len(dt))
        self._shown += 1

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one.

        Raises:
            PolicyError: for a step without :meth:`preview`.
        """
        if self._decided >= self._shown:
            raise PolicyError(f"{self.name} needs the future: show it by `preview`, as mixo_env.policies.playing does")
        dt = observation["dt"][:, 0].astype(np.float64)
        values = observation["yaw_rates"] * dt[:, None]
        weights = np.empty(values.shape)
        decide(self._ring, self._decided % (LAG + 1), values, self._constants[0], dt, weights)
        undecided = ~weights.any(axis=1)
        if undecided.any():
            weights[undecided] = median_weights(values[undecided], believable(observation)[undecided])
        self._decided += 1
        return weights
