"""Compiled steps of the filter of biases: scenes side by side, a handful of experts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.policies.blocks import AT_ONCE, shape_of
from mixo_env.policies.calibration import FloatArray
from mixo_env.policies.consensus import ROOM, SAFE, Single, likeliest

State = tuple[FloatArray, FloatArray]
"""Of all scenes, in blocks: biases ``(blocks, n, scenes)`` [rad/s] and their covariances ``(blocks, n, n, scenes)``."""

Room = tuple[FloatArray, FloatArray, FloatArray]
"""What :func:`step` writes on the way, ``(3, n, n, scenes)``, ``(4, n, scenes)`` and ``(1 + ROOM, scenes)``."""

Told = tuple[Single, Single, FloatArray, FloatArray, NDArray[np.bool_]]
"""Of every scene and expert, ``(batch, n)``: rates [rad/s]; duration [s] ``(batch, 1)``; calibrated standard deviations
[rad], the scale that they have had lately, and who votes with a known one."""

BEST_SCALE = 0.7071
"""Agreement with the others, whose consensus an expert is part of, proves no more than half the calibrated variance."""


def blank_state(batch: int, drift: FloatArray) -> State:
    """Every bias is 0, as uncertain as it was on the training scenes; ``drift`` as in :func:`step`."""
    blocks, scenes = shape_of(batch)
    bias = np.zeros((blocks, drift.shape[1], scenes))
    return bias, np.tile(np.diag(drift[1] ** 2)[:, :, None], (blocks, 1, 1, scenes))


@inlined
def _clear(out: FloatArray) -> None:
    for s in range(len(out)):
        out[s] = 0.0


@inlined
def _copy(x: FloatArray, out: FloatArray) -> None:
    for s in range(len(out)):
        out[s] = x[s]


@inlined
def _scale(x: FloatArray, out: FloatArray) -> None:
    for s in range(len(out)):
        out[s] *= x[s]


@inlined
def _add_products(x: FloatArray, y: FloatArray, out: FloatArray) -> None:
    """Add products of ``(n, scenes)`` to ``out`` ``(scenes,)``, one after the other."""
    whole = len(x) // 4 * 4
    for k in range(0, whole, 4):  # four at once: ``out`` is loaded and stored a quarter as often
        for s in range(len(out)):
            two = out[s] + x[k, s] * y[k, s] + x[k + 1, s] * y[k + 1, s]
            out[s] = two + x[k + 2, s] * y[k + 2, s] + x[k + 3, s] * y[k + 3, s]
    for k in range(whole, len(x)):
        for s in range(len(out)):
            out[s] += x[k, s] * y[k, s]


@inlined
def _add(x: FloatArray, out: FloatArray) -> None:
    for s in range(len(out)):
        out[s] += x[s]


@inlined
def _subtract(x: FloatArray, out: FloatArray) -> None:
    for s in range(len(out)):
        out[s] -= x[s]


@inlined
def _subtract_product(x: FloatArray, y: FloatArray, out: FloatArray) -> None:
    """Subtract products from ``out``."""
    for s in range(len(out)):
        out[s] -= x[s] * y[s]


@inlined
def invert(matrix: FloatArray) -> None:
    """Replace matrices ``(n, n, scenes)``, symmetric positive definite, by their inverses (Gauss and Jordan)."""
    n, _, scenes = matrix.shape
    for k in range(n):
        pivot = matrix[k, k]
        for s in range(scenes):
            pivot[s] = 1.0 / pivot[s]  # never small: no others need be looked for
        for j in range(n):
            if j != k:
                _scale(pivot, matrix[k, j])
        for i in range(n):
            if i != k:
                for j in range(n):
                    if j != k:
                        _subtract_product(matrix[i, k], matrix[k, j], matrix[i, j])
                for s in range(scenes):
                    matrix[i, k, s] *= -pivot[s]


@inlined
def predict(bias: FloatArray, covariance: FloatArray, drift: FloatArray, dt: FloatArray, fade: FloatArray) -> None:
    """Let biases age.

    Args:
        bias: ``(n, scenes)`` [rad/s], changed in place.
        covariance: ``(n, n, scenes)``, changed in place.
        drift: as in :func:`step`.
        dt: ``(scenes,)`` [s].
        fade: ``(n, scenes)`` written: what is left of a bias.
    """
    n, scenes = bias.shape
    for i in range(n):
        for s in range(scenes):
            same = s > 0 and dt[s] == dt[s - 1]
            fade[i, s] = fade[i, s - 1] if same else math.exp(-dt[s] / drift[2, i])
        _scale(fade[i], bias[i])
        for j in range(i):
            _scale(fade[j], covariance[i, j])
            _scale(fade[i], covariance[i, j])
            _copy(covariance[i, j], covariance[j, i])
        for s in range(scenes):
            left = fade[i, s]
            covariance[i, i, s] = covariance[i, i, s] * left * left + drift[1, i] * drift[1, i] * (1.0 - left * left)


@inlined
def _invert_sum(covariance: FloatArray, noise: FloatArray, dt: FloatArray, inverse: FloatArray) -> None:
    """Write (dt^2 P + diag(noise))^-1 ``(n, n, scenes)``; who is not heard has a row and a column of zeros in it."""
    n, scenes = noise.shape
    for i in range(n):
        for j in range(n):
            for s in range(scenes):
                both = (noise[i, s] < math.inf) & (noise[j, s] < math.inf)
                inverse[i, j, s] = dt[s] * dt[s] * covariance[i, j, s] if both else 0.0
        for s in range(scenes):
            inverse[i, i, s] += noise[i, s] if noise[i, s] < math.inf else 1.0
    invert(inverse)
    for i in range(n):
        for s in range(scenes):
            inverse[i, i, s] = inverse[i, i, s] if noise[i, s] < math.inf else 0.0


@inlined
def update(
    state: tuple[FloatArray, FloatArray],
    heard: tuple[FloatArray, FloatArray],
    dt: FloatArray,
    psi: FloatArray,
    room: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Best yaw increments and, in place, biases and covariances after hearing some experts.

    The increment is unknown beforehand (a flat prior): S = dt^2 P + diag(noise), u = S^-1 1,
    psi = u z / u 1, b += dt P S^-1 (z - psi), P -= dt^2 P (S^-1 - u u' / u 1) P.

    Args:
        state: biases ``(n, scenes)`` as predicted [rad/s] and their covariances ``(n, n, scenes)``.
        heard: ``(n, scenes)`` increments less the predicted biases [rad], and variances of their white errors [rad^2],
            infinite for who is not heard.
        dt: ``(scenes,)`` durations of the step [s].
        psi: ``(scenes,)`` written; NaN where nobody is heard.
        room: ``(3, n, n, scenes)``, ``(n, scenes)`` and ``(scenes,)``, written.
    """
    bias, covariance = state
    apart, noise = heard
    inverse, cross, turned, gain = room[0][0], room[0][1], room[0][2], room[0][0]
    row, total = room[1], room[2]
    n, scenes = bias.shape
    _invert_sum(covariance, noise, dt, inverse)
    for s in range(scenes):
        total[s], psi[s] = 0.0, 0.0
    for i in range(n):
        _clear(row[i])
        for j in range(n):
            _add(inverse[i, j], row[i])
        for s in range(scenes):
            total[s] += row[i, s]
            psi[s] += row[i, s] * apart[i, s]
    for s in range(scenes):
        psi[s] /= total[s]
    for i in range(n):
        for j in range(n):
            for s in range(scenes):
                known = row[i, s] * row[j, s] / total[s]
                turned[j, i, s] = inverse[i, j, s] - (known if total[s] != 0.0 else 0.0)
    for i in range(n):
        for j in range(n):
            for s in range(scenes):
                cross[i, j, s] = dt[s] * covariance[i, j, s]
    for i in range(n):
        for j in range(n):
            _clear(gain[i, j])
            _add_products(cross[i], turned[j], gain[i, j])
        _add_products(gain[i], apart, bias[i])  # the columns of `turned` sum to zero: psi drops out
    for i in range(n):
        for k in range(i + 1):
            change = turned[i, k]
            _clear(change)
            _add_products(gain[i], cross[k], change)
            _subtract(change, covariance[i, k])
            if k < i:
                _copy(covariance[i, k], covariance[k, i])


@inlined
def step(
    state: tuple[FloatArray, FloatArray],
    told: tuple[FloatArray, FloatArray],
    drift: FloatArray,
    dt: FloatArray,
    found: tuple[FloatArray, FloatArray],
    room: Room,
) -> None:
    """One step: the best yaw increments; NaN, with biases only aged, where nobody known votes.

    Args:
        state: biases ``(n, scenes)`` [rad/s] and their covariances ``(n, n, scenes)``, changed in place.
        told: ``(n, scenes)`` increments and their calibrated standard deviations [rad]; infinite: no vote.
        drift: ``(5, n)`` the arrays of :class:`~mixo_env.policies.drift.Drift` in order.
        dt: ``(scenes,)`` durations [s].
        found: written: ``(scenes,)`` increments [rad], and ``(n, scenes)`` variances of the white errors as believed
            [rad^2], infinite for who had no vote.
        room: see :data:`Room`; the first two of its vectors are left with the increments less the predicted biases,
            and with the standard deviations of what is left of their errors [rad].
    """
    bias, covariance = state
    values, std = told
    psi, noise = found
    apart, spread, white, weights = room[1][0], room[1][1], room[1][2], room[1][3]
    centre, more = room[2][0], room[2][1:]
    n, scenes = values.shape
    predict(bias, covariance, drift, dt, weights)
    for i in range(n):
        for s in range(scenes):
            apart[i, s] = values[i, s] - dt[s] * (drift[0, i] + bias[i, s])
            white[i, s] = std[i, s] * std[i, s] * drift[3, i]
            spread[i, s] = math.sqrt(white[i, s] + dt[s] * dt[s] * covariance[i, i, s])
    likeliest(apart, spread, SAFE, weights, centre, more)
    for i in range(n):  # once the turn is known, so is what it adds
        for s in range(scenes):
            white[i, s] += drift[4, i] * drift[4, i] * centre[s] * centre[s]
            spread[i, s] = math.sqrt(white[i, s] + dt[s] * dt[s] * covariance[i, i, s])
    likeliest(apart, spread, SAFE, weights, centre, more)
    for i in range(n):
        for s in range(scenes):
            r = (apart[i, s] - centre[s]) / spread[i, s]
            trust = min(1.0, (SAFE + 1.0) / (SAFE + r * r))
            believed = spread[i, s] * spread[i, s] / trust - dt[s] * dt[s] * covariance[i, i, s]
            noise[i, s] = believed if weights[i, s] != 0.0 else math.inf
    update(state, (apart, noise), dt, psi, (room[0], weights, centre))


@inlined
def point_at(target: float, values: FloatArray, std: FloatArray, weights: FloatArray) -> None:
    """Write convex ``weights`` ``(n,)`` of the two votes around ``target``, so that they mix to it.

    A target outside what the voters span is moved to the nearest of them; for NaN all weights are zero. Who has an
    infinite ``std`` has no vote.
    """
    low, high = -1, -1
    for i in range(len(values)):
        weights[i] = 0.0
        if std[i] < math.inf:
            if values[i] <= target and (low < 0 or values[i] > values[low]):
                low = i
            if values[i] >= target and (high < 0 or values[i] < values[high]):
                high = i
    if math.isnan(target):
        return
    if low < 0 or high < 0 or values[low] == values[high]:
        weights[max(low, high)] = 1.0
        return
    weights[high] = (target - values[low]) / (values[high] - values[low])
    weights[low] = 1.0 - weights[high]


@compiled_unchecked
def step_batch(
    state: State, told: Told, drift: FloatArray, found: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
) -> bool:
    """:func:`step` of every scene; whether all have been decided.

    Args:
        state: changed in place.
        told: see :data:`Told`.
        drift: as in :func:`step`.
        found: ``(batch, n)`` written: variances of the white errors as believed; weights, all zero where nobody
            known votes; increments less the biases predicted before the step [rad]; and standard deviations of what is
            left of their errors [rad], infinite for who had no vote.
    """
    biases, covariances = state
    rates, dt, std, scale, known = told
    noise, weights, apart, left = found
    batch, n = rates.shape
    everywhere, scenes = True, biases.shape[2]
    matrices, vectors, room = np.empty((3, n, n, scenes)), np.empty((7, n, scenes)), np.empty((3 + ROOM, scenes))
    values, spread, believed, duration, psi = vectors[0], vectors[1], vectors[2], room[0], room[1]
    for k in range(len(biases)):
        first = k * AT_ONCE
        for s in range(scenes):
            b = min(first + s, batch - 1)
            duration[s] = dt[b, 0]
            for i in range(n):
                values[i, s] = rates[b, i] * duration[s]
                spread[i, s] = std[b, i] * max(scale[b, i], BEST_SCALE) if known[b, i] else math.inf
        inner = matrices, vectors[3:], room[2:]
        step((biases[k], covariances[k]), (values, spread), drift, duration, (psi, believed), inner)
        for s in range(scenes):
            b = min(first + s, batch - 1)
            everywhere &= not math.isnan(psi[s])
            for i in range(n):
                noise[b, i], apart[b, i], left[b, i] = believed[i, s], vectors[3, i, s], vectors[4, i, s]
            point_at(psi[s], values[:, s], spread[:, s], weights[b])
    return everywhere
