"""Compiled steps of the filter of biases: one scene at a time, a handful of experts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.policies.calibration import FloatArray
from mixo_env.policies.consensus import SAFE, likeliest


@compiled
def invert(matrix: FloatArray) -> None:
    """Replace a small symmetric positive definite matrix by its inverse (Gauss and Jordan, no pivots needed)."""
    n = len(matrix)
    for k in range(n):
        pivot = 1.0 / matrix[k, k]
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] *= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]


@compiled
def predict(bias: FloatArray, covariance: FloatArray, drift: FloatArray, dt: float) -> None:
    """Let biases ``(n,)`` [rad/s] and their covariance ``(n, n)`` age by ``dt``; ``drift`` as in :func:`step_row`."""
    n = len(bias)
    for i in range(n):
        fade = math.exp(-dt / drift[2, i])
        bias[i] *= fade
        for j in range(n):
            covariance[i, j] *= fade
            covariance[j, i] *= fade
        covariance[i, i] += drift[1, i] * drift[1, i] * (1.0 - fade * fade)


@compiled
def update(
    bias: FloatArray, covariance: FloatArray, apart: FloatArray, noise: FloatArray, who: NDArray[np.int64], dt: float
) -> float:
    """Best yaw increment and, in place, biases and covariance after hearing the experts ``who``.

    The increment is unknown beforehand (a flat prior): S = dt^2 P + diag(noise), u = S^-1 1,
    psi = u z / u 1, b += dt P S^-1 (z - psi), P -= dt^2 P (S^-1 - u u' / u 1) P.

    Args:
        bias: ``(n,)`` as predicted [rad/s].
        covariance: ``(n, n)`` of it.
        apart: ``(n,)`` increments less the predicted biases [rad].
        noise: ``(n,)`` variances of the white errors [rad^2].
        who: ``(m,)`` indices of those that are heard.
        dt: duration of the step [s].
    """
    n, m = len(bias), len(who)
    inverse, row = np.empty((m, m)), np.zeros(m)
    for i in range(m):
        for j in range(m):
            inverse[i, j] = dt * dt * covariance[who[i], who[j]]
        inverse[i, i] += noise[who[i]]
    invert(inverse)
    total, psi = 0.0, 0.0
    for i in range(m):
        for j in range(m):
            row[i] += inverse[i, j]
        total += row[i]
        psi += row[i] * apart[who[i]]
    psi /= total
    for i in range(m):
        for j in range(m):
            inverse[i, j] -= row[i] * row[j] / total
    cross, gain = np.empty((n, m)), np.empty((n, m))
    for i in range(n):
        for j in range(m):
            cross[i, j] = dt * covariance[i, who[j]]
        for j in range(m):
            change = 0.0
            for k in range(m):
                change += cross[i, k] * inverse[k, j]
            gain[i, j] = change
    for i in range(n):
        for j in range(m):
            bias[i] += gain[i, j] * apart[who[j]]  # the rows of `inverse` sum to zero: psi drops out
        for k in range(i + 1):
            change = 0.0
            for j in range(m):
                change += gain[i, j] * cross[k, j]
            covariance[i, k] -= change
            covariance[k, i] = covariance[i, k]
    return psi


@compiled
def step_row(
    state: tuple[FloatArray, FloatArray],
    told: tuple[FloatArray, FloatArray, NDArray[np.bool_]],
    drift: FloatArray,
    dt: float,
    noise: FloatArray,
) -> float:
    """One step of one scene: the best yaw increment; NaN, with biases only aged, where nobody known votes.

    Args:
        state: biases ``(n,)`` [rad/s] and their covariance ``(n, n)``, changed in place.
        told: ``(n,)`` increments, their calibrated standard deviations [rad], and who votes.
        drift: ``(5, n)`` the arrays of :class:`~mixo_env.policies.drift.Drift` in order.
        dt: duration [s].
        noise: ``(n,)`` written: variances of the white errors as believed [rad^2], infinite for who had no vote.
    """
    bias, covariance = state
    values, std, counts = told
    n = len(values)
    predict(bias, covariance, drift, dt)
    room = np.empty((4, n))  # one allocation in place of four
    apart, spread, white, weights = room[0], room[1], room[2], room[3]
    for i in range(n):
        noise[i] = math.inf
        apart[i] = values[i] - dt * (drift[0, i] + bias[i])
        white[i] = std[i] * std[i] * drift[3, i]
        spread[i] = math.sqrt(white[i] + dt * dt * covariance[i, i])
    centre = likeliest(apart, spread, counts, SAFE, weights)
    if math.isnan(centre):
        return centre
    for i in range(n):  # once the turn is known, so is what it adds
        white[i] += drift[4, i] * drift[4, i] * centre * centre
        spread[i] = math.sqrt(white[i] + dt * dt * covariance[i, i])
    centre = likeliest(apart, spread, counts, SAFE, weights)
    who, heard = np.empty(n, np.int64), 0
    for i in range(n):
        if weights[i] == 0.0:
            continue
        who[heard] = i
        heard += 1
        r = (apart[i] - centre) / spread[i]
        trust = min(1.0, (SAFE + 1.0) / (SAFE + r * r))
        noise[i] = spread[i] * spread[i] / trust - dt * dt * covariance[i, i]
    return update(bias, covariance, apart, noise, who[:heard], dt)


@compiled
def point_at(target: float, values: FloatArray, counts: NDArray[np.bool_], weights: FloatArray) -> None:
    """Write convex ``weights`` ``(n,)`` of the two votes around ``target``, so that they mix to it.

    A target outside what the voters span is moved to the nearest of them.
    """
    low, high = -1, -1
    for i in range(len(values)):
        weights[i] = 0.0
        if counts[i]:
            if values[i] <= target and (low < 0 or values[i] > values[low]):
                low = i
            if values[i] >= target and (high < 0 or values[i] < values[high]):
                high = i
    if low < 0 or high < 0 or values[low] == values[high]:
        weights[max(low, high)] = 1.0
        return
    weights[high] = (target - values[low]) / (values[high] - values[low])
    weights[low] = 1.0 - weights[high]


@compiled
def step_batch(
    state: tuple[FloatArray, FloatArray],
    told: tuple[FloatArray, FloatArray, NDArray[np.bool_]],
    drift: FloatArray,
    dt: FloatArray,
    weights: FloatArray,
) -> bool:
    """:func:`step_row` of every scene, as weights ``(batch, n)``; whether all have been decided."""
    bias, covariance = state
    values, std, counts = told
    everywhere = True
    noise = np.empty(values.shape[1])
    for b in range(len(values)):
        target = step_row((bias[b], covariance[b]), (values[b], std[b], counts[b]), drift, dt[b], noise)
        if math.isnan(target):
            weights[b] = 0.0
            everywhere = False
        else:
            point_at(target, values[b], counts[b], weights[b])
    return everywhere
