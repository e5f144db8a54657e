"""Compiled steps of the filter of biases: one scene at a time, a handful of experts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.policies.calibration import FloatArray
from mixo_env.policies.consensus import SAFE, likeliest

Room = tuple[FloatArray, FloatArray, NDArray[np.int64]]
"""What :func:`step_row` writes on the way, ``(3, n, n)``, ``(5, n)`` and ``(n,)``: it may not make arrays."""


@inlined
def invert(matrix: FloatArray, n: int) -> None:
    """Replace the leading ``n`` x ``n`` block, symmetric positive definite, by its inverse (Gauss and Jordan)."""
    for k in range(n):
        pivot = 1.0 / matrix[k, k]  # never small: no others need be looked for
        matrix[k, k] = 1.0
        for j in range(n):
            matrix[k, j] *= pivot
        for i in range(n):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(n):
                    matrix[i, j] -= factor * matrix[k, j]


@inlined
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


@inlined
def update(
    state: tuple[FloatArray, FloatArray], heard: tuple[FloatArray, FloatArray, int], dt: float, room: Room
) -> float:
    """Best yaw increment and, in place, biases and covariance after hearing some experts.

    The increment is unknown beforehand (a flat prior): S = dt^2 P + diag(noise), u = S^-1 1,
    psi = u z / u 1, b += dt P S^-1 (z - psi), P -= dt^2 P (S^-1 - u u' / u 1) P.

    Args:
        state: biases ``(n,)`` as predicted [rad/s] and their covariance ``(n, n)``.
        heard: ``(n,)`` increments less the predicted biases [rad], variances of their white errors [rad^2], and how
            many are heard: they come first in the third part of ``room``.
        dt: duration of the step [s].
        room: matrices and the first of the vectors are written.
    """
    bias, covariance = state
    apart, noise, m = heard
    inverse, cross, gain = room[0][0], room[0][1], room[0][2]
    row, who = room[1][0], room[2]
    n = len(bias)
    for i in range(m):
        for j in range(m):
            inverse[i, j] = dt * dt * covariance[who[i], who[j]]
        inverse[i, i] += noise[who[i]]
    invert(inverse, m)
    total, psi = 0.0, 0.0
    for i in range(m):
        row[i] = 0.0
        for j in range(m):
            row[i] += inverse[i, j]
        total += row[i]
        psi += row[i] * apart[who[i]]
    psi /= total
    for i in range(m):
        for j in range(m):
            inverse[i, j] -= row[i] * row[j] / total
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


@inlined
def step_row(
    state: tuple[FloatArray, FloatArray],
    told: tuple[FloatArray, FloatArray, NDArray[np.bool_]],
    drift: FloatArray,
    dt: float,
    noise: FloatArray,
    room: Room,
) -> float:
    """One step of one scene: the best yaw increment; NaN, with biases only aged, where nobody known votes.

    Args:
        state: biases ``(n,)`` [rad/s] and their covariance ``(n, n)``, changed in place.
        told: ``(n,)`` increments, their calibrated standard deviations [rad], and who votes.
        drift: ``(5, n)`` the arrays of :class:`~mixo_env.policies.drift.Drift` in order.
        dt: duration [s].
        noise: ``(n,)`` written: variances of the white errors as believed [rad^2], infinite for who had no vote.
        room: see :data:`Room`.
    """
    bias, covariance = state
    values, std, counts = told
    n = len(values)
    predict(bias, covariance, drift, dt)
    apart, spread, white, weights, who = room[1][1], room[1][2], room[1][3], room[1][4], room[2]
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
    heard = 0
    for i in range(n):
        if weights[i] == 0.0:
            continue
        who[heard] = i
        heard += 1
        r = (apart[i] - centre) / spread[i]
        trust = min(1.0, (SAFE + 1.0) / (SAFE + r * r))
        noise[i] = spread[i] * spread[i] / trust - dt * dt * covariance[i, i]
    return update(state, (apart, noise, heard), dt, room)


@inlined
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


@compiled_unchecked
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
    everywhere, n = True, values.shape[1]
    noise, room = np.empty(n), (np.empty((3, n, n)), np.empty((5, n)), np.empty(n, np.int64))
    for b in range(len(values)):
        target = step_row((bias[b], covariance[b]), (values[b], std[b], counts[b]), drift, dt[b], noise, room)
        if math.isnan(target):
            weights[b] = 0.0
            everywhere = False
        else:
            point_at(target, values[b], counts[b], weights[b])
    return everywhere
