"""SMOOTHER (NON-CAUSAL): the filter of biases with two seconds of the future, a bound for anything that filters."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.fusion import FloatArray
from mixo_env.policies.bias_filter import BiasFilter
from mixo_env.policies.bias_steps import invert, point_at, step_row
from mixo_env.policies.policy import Observation, Weights
from mixo_env.policies.robust import believable, median_weights

LAG = 24
"""Steps of the future, two seconds at 12 Hz."""
SMALLEST_BIAS_RADPS = 1e-7
"""Keeps covariances invertible for an expert that never drifts."""


@compiled
def backward_gain(covariance: FloatArray, drift: FloatArray, dt: float) -> FloatArray:
    """G = P F' (F P F' + Q)^-1 ``(n, n)`` of Rauch, Tung and Striebel for a step of ``dt`` that follows."""
    n = len(covariance)
    fade = np.exp(-dt / drift[2])
    following = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            following[i, j] = fade[i] * covariance[i, j] * fade[j]
        following[i, i] += drift[1, i] ** 2 * (1.0 - fade[i] * fade[i])
    invert(following)
    gain = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            for k in range(n):
                gain[i, j] += covariance[i, k] * fade[k] * following[k, j]
    return gain


@compiled
def remember(state: tuple[Any, ...], told: tuple[Any, ...], drift: FloatArray, dt: FloatArray, active: Any) -> tuple:
    """One filtered step of every active scene: biases, their noise, and the gain that leads back to the step before.

    Returns:
        ``(batch, n)`` biases, variances of the white errors, and ``(batch, n, n)`` gains.
    """
    bias, covariance = state
    values, std, counts = told
    batch, n = values.shape
    noise, gain = np.full((batch, n), math.inf), np.zeros((batch, n, n))
    for b in range(batch):
        if active[b]:
            gain[b] = backward_gain(covariance[b], drift, dt[b])
            step_row((bias[b], covariance[b]), (values[b], std[b], counts[b]), drift, dt[b], noise[b])
    return bias.copy(), noise, gain


@compiled
def smoothed(biases: FloatArray, gains: FloatArray, fades: FloatArray) -> FloatArray:
    """Biases ``(n,)`` of the first of some steps given all of them.

    b_k|K = b_k + G (b_k+1|K - F b_k).

    Args:
        biases: ``(steps, n)`` filtered.
        gains: ``(steps, n, n)``; entry k leads from step k back to k - 1.
        fades: ``(steps, n)`` diagonal of F from step k - 1 to k.
    """
    steps, n = biases.shape
    later = biases[steps - 1].copy()
    for k in range(steps - 1, 0, -1):
        here = biases[k - 1].copy()
        for i in range(n):
            for j in range(n):
                here[i] += gains[k, i, j] * (later[j] - fades[k, j] * biases[k - 1, j])
        later = here
    return later


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
        index = np.arange(len(self.experts))
        self._covariance[:, index, index] = np.maximum(self._drift.slow_radps, SMALLEST_BIAS_RADPS) ** 2
        self._ahead: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]] = []

    def preview(self, observation: Observation, active: NDArray[np.bool_]) -> None:
        """Filter a step of the future."""
        told, dt = self._hear(observation)
        drift = self._constants.copy()
        drift[1] = np.maximum(drift[1], SMALLEST_BIAS_RADPS)
        state = self._bias, self._covariance
        bias, noise, gain = remember(state, told, drift, dt, active)
        self._ahead.append((bias, noise, gain, np.exp(-dt[:, None] / drift[2]), active.copy()))

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one.

        Raises:
            KeyError: without :meth:`preview`: it must be played as non-causal.
        """
        if not self._ahead:
            raise KeyError(f"the future: {self.name} is played by mixo_env.policies.playing.play alone")
        dt = observation["dt"][:, 0].astype(np.float64)
        values, counts = observation["yaw_rates"] * dt[:, None], believable(observation)
        weights = np.zeros(values.shape)
        biases, noises, gains, fades, active = (np.stack(rows, axis=1) for rows in zip(*self._ahead, strict=True))
        for b in range(len(values)):
            steps = max(int(active[b].sum()), 1)
            bias = smoothed(biases[b, :steps], gains[b, :steps], fades[b, :steps])
            trust = 1.0 / noises[b, 0]
            if trust.sum() > 0.0:
                apart = values[b] - dt[b] * (self._constants[0] + bias)
                point_at(float(trust @ apart / trust.sum()), values[b], trust > 0.0, weights[b])
            else:
                weights[b] = median_weights(values[b : b + 1], counts[b : b + 1])[0]
        self._ahead.pop(0)
        return weights
