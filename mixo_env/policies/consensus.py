"""STUDENT-T: the consensus of heavy-tailed experts, a redescending M-estimate of the yaw increment."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.policies.blocks import AT_ONCE, gather, scatter
from mixo_env.policies.calibration import Calibration, Past, scale_row
from mixo_env.policies.inner import by_log, inner_folds
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.robust import believable, believe_row, median_weights
from mixo_env.recordings.collection import Recordings

FloatArray = NDArray[np.float64]
Single = NDArray[np.float32]

DEGREES_OF_FREEDOM = (1.0, 2.0, 3.0, 5.0, 8.0, 16.0)
"""Choices of nu: from Cauchy's tails to nearly Gaussian ones."""
SAFE = 5.0
"""nu where there are no logs to choose it on."""
ITERATIONS = 20
SETTLED = 1e-4
"""The climb ends with a move of less than so many of the smallest standard deviation."""
ROOM = 4
"""Numbers a scene that :func:`likeliest` needs room for."""
LARGEST_PRODUCT = 1e100
"""Of inverse likelihoods. Beyond it the product is folded: divided by it, and the folds are counted."""


@inlined
def likeliest(
    values: FloatArray, std: FloatArray, nu: float, weights: FloatArray, centre: FloatArray, room: FloatArray
) -> None:
    """Most likely common value of ``values`` with errors ``std`` x Student's t of ``nu`` degrees of freedom.

    The likelihood has several maxima where experts disagree. The search starts at the vote of highest likelihood and
    climbs by reweighted least squares, which never descends: weights (nu + 1) / (nu sigma^2 + r^2).

    Args:
        values: ``(n, scenes)``.
        std: ``(n, scenes)``; who has an infinite one has no vote.
        nu: degrees of freedom.
        weights: ``(n, scenes)`` written; they sum to one, or are all zero where nobody votes.
        centre: ``(scenes,)`` written: the value; NaN where nobody votes.
        room: ``(ROOM, scenes)`` written.
    """
    n, scenes = values.shape
    for j in range(n):
        for s in range(scenes):
            weights[j, s] = 1.0 / (nu * std[j, s] * std[j, s]) if std[j, s] < math.inf else 0.0
    _choose(values, weights, centre, (room[0], room[1], room[2], room[3]))
    total = room[0]
    _climb(values, std, nu, weights, centre, (total, room[1], room[2], room[3]))
    for j in range(n):
        for s in range(scenes):
            weights[j, s] = weights[j, s] / total[s] if total[s] > 0.0 else 0.0


@inlined
def _choose(
    values: FloatArray,
    weights: FloatArray,
    centre: FloatArray,
    room: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Write the vote of highest likelihood; of the first of several."""
    product, folds, least, fewest = room
    n, scenes = values.shape
    for s in range(scenes):
        centre[s], least[s], fewest[s] = math.nan, math.inf, n
    for i in range(n):
        for s in range(scenes):
            product[s], folds[s] = 1.0, 0.0
        for j in range(n):
            if _multiply(values[i], values[j], weights[j], product) > 0:
                _fold(product, folds)
        for s in range(scenes):
            fewer = (folds[s] < fewest[s]) | ((folds[s] == fewest[s]) & (product[s] < least[s]))
            better = fewer & (product[s] < math.inf) & (weights[i, s] > 0.0)
            centre[s] = values[i, s] if better else centre[s]
            least[s] = product[s] if better else least[s]
            fewest[s] = folds[s] if better else fewest[s]


@inlined
def _multiply(at: FloatArray, values: FloatArray, weights: FloatArray, product: FloatArray) -> int:
    """Let an expert's inverse likelihood into the products; how many of them are too large now."""
    large = 0
    for s in range(len(product)):
        apart = values[s] - at[s]
        grown = product[s] * (1.0 + apart * apart * weights[s])
        product[s] = grown
        large += grown > LARGEST_PRODUCT
    return large


@inlined
def _fold(product: FloatArray, folds: FloatArray) -> None:
    for s in range(len(product)):
        if product[s] > LARGEST_PRODUCT:
            folds[s], product[s] = folds[s] + 1.0, product[s] / LARGEST_PRODUCT


@inlined
def _climb(
    values: FloatArray,
    std: FloatArray,
    nu: float,
    weights: FloatArray,
    centre: FloatArray,
    room: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Move centres uphill until they have settled; weights and, as the first of ``room``, their sum are written.

    A scene that has settled waits for the others of its block, unchanged.
    """
    total, moved, near, climbing = room
    n, scenes = values.shape
    for s in range(scenes):
        near[s], climbing[s] = math.inf, 0.0 if math.isnan(centre[s]) else 1.0
    for j in range(n):
        for s in range(scenes):
            near[s] = min(near[s], std[j, s])
    for _ in range(ITERATIONS):
        for s in range(scenes):
            total[s], moved[s] = 0.0, 0.0
        for j in range(n):
            for s in range(scenes):
                apart = values[j, s] - centre[s]
                weight = 1.0 / (nu * std[j, s] * std[j, s] + apart * apart)
                weight = weight if (climbing[s] > 0.0) & (weights[j, s] > 0.0) else weights[j, s]
                weights[j, s] = weight
                total[s] += weight
                moved[s] += weight * apart
        others = 0
        for s in range(scenes):
            move = moved[s] / total[s]
            climbs = climbing[s] > 0.0
            centre[s] = centre[s] + move if climbs else centre[s]
            climbs &= abs(move) > SETTLED * near[s]
            climbing[s] = 1.0 if climbs else 0.0
            others += climbs
        if others == 0:
            break


@compiled_unchecked
def find_consensus(
    values: FloatArray, std: FloatArray, counts: NDArray[np.bool_], nu: float, weights: FloatArray
) -> bool:
    """:func:`likeliest` of every row ``(batch, n)`` among those that count; whether all rows have been decided."""
    batch, n = values.shape
    scenes, everywhere = min(batch, AT_ONCE), True
    room, centre = np.empty((ROOM, scenes)), np.empty(scenes)
    value, spread, weight = np.empty((n, scenes)), np.empty((n, scenes)), np.empty((n, scenes))
    for first in range(0, batch, AT_ONCE):
        gather(values, first, value)
        for s in range(scenes):
            b = min(first + s, batch - 1)
            for e in range(n):
                spread[e, s] = std[b, e] if counts[b, e] else math.inf
        likeliest(value, spread, nu, weight, centre, room)
        scatter(weight, first, weights)
        for s in range(scenes):
            everywhere &= not math.isnan(centre[s])
    return everywhere


def agreement(observation: Observation, calibration: Calibration) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """The consensus as a judge of experts: deviations from it in standard deviations, these, and who can be trusted.

    Returns:
        ``(batch, experts)`` deviations from the STUDENT-T consensus with nu = 5 over calibrated standard deviations;
        the standard deviations [rad]; who votes with a known one (where nobody does: all that vote, with 1 rad).
    """
    rates = observation["yaw_rates"]
    apart, std, known = np.empty(rates.shape), np.empty(rates.shape), np.empty(rates.shape, np.bool_)
    seen = rates, observation["available"], observation["yaw_rate_std"], observation["dt"]
    if not _agree(seen, calibration.std_rad, calibration.factor, apart, std, known):
        undecided = np.isnan(apart[:, 0])
        increments = (rates.astype(np.float64) * observation["dt"])[undecided]
        weights = median_weights(increments, known[undecided])
        apart[undecided] = increments - np.sum(weights * increments, axis=1, keepdims=True)
    return apart, std, known


@compiled_unchecked
def _agree(
    seen: tuple[Single, Single, Single, Single],
    std_rad: FloatArray,
    factor: FloatArray,
    apart: FloatArray,
    std: FloatArray,
    known: NDArray[np.bool_],
) -> bool:
    """Write what :func:`agreement` returns; false, and NaN how far apart, where the median must decide."""
    rates, available, stated, dt = seen
    batch, n = rates.shape
    scenes, everywhere = min(batch, AT_ONCE), True
    room, centre = np.empty((ROOM, scenes)), np.empty(scenes)
    value, spread, weight = np.empty((n, scenes)), np.empty((n, scenes)), np.empty((n, scenes))
    for first in range(0, batch, AT_ONCE):
        for s in range(scenes):
            b = min(first + s, batch - 1)
            believe_row(rates[b], available[b], known[b])
            scale_row(stated[b], dt[b, 0], std_rad, factor, std[b])
            for e in range(n):
                value[e, s] = np.float64(rates[b, e]) * dt[b, 0]
                spread[e, s] = std[b, e] if known[b, e] else math.inf
        likeliest(value, spread, SAFE, weight, centre, room)
        for s in range(scenes):
            b = min(first + s, batch - 1)
            if math.isnan(centre[s]):
                everywhere = False
                std[b], apart[b] = 1.0, math.nan
                continue
            mean = 0.0
            for e in range(n):
                mean += weight[e, s] * value[e, s]
            for e in range(n):
                apart[b, e] = (value[e, s] - mean) / std[b, e]
                known[b, e] &= std[b, e] < math.inf
    return everywhere


def consensus_weights(values: FloatArray, std: FloatArray, counts: NDArray[np.bool_], nu: float) -> Weights:
    """Weights ``(batch, n)`` of :func:`find_consensus`; those of the median where only unknown experts vote."""
    weights = np.empty(values.shape)
    if not find_consensus(values, std, counts, nu, weights):
        undecided = ~weights.any(axis=1)
        weights[undecided] = median_weights(values[undecided], counts[undecided])
    return weights


class StudentT(Policy):
    """Maximum likelihood of the yaw increment when the experts' errors are Student's t (Lange, Little, Taylor 1989).

    psi = argmax sum_i log t_nu((y_i - psi) / sigma_i). The influence of an expert falls again once it is further than
    sqrt(nu) sigma from the others, so that one broken by 40 degrees is ignored where Huber's still pulls. Standard
    deviations are calibrated on the training scenes; nu is the one of least mean log RMSE over inner folds by log.

    Attributes:
        nu: degrees of freedom after :meth:`fit`.
    """

    name = "STUDENT-T"
    learns = True
    nu: float

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Calibrate, and choose nu."""
        super().fit(training, track)
        self._calibration = Calibration.fit(Past.read(training, self.experts))
        self.nu = self._choose(training, track)

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        return _act(observation, self._calibration, self.nu)

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Calibration and nu."""
        return {**self._calibration.tensors(), "nu": np.array([self.nu])}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Of the calibration, and one number."""
        return {**Calibration.shapes(len(self.experts)), "nu": (1,)}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take them back."""
        self._calibration, self.nu = Calibration.restore(tensors), float(tensors["nu"][0])
        if self.nu not in DEGREES_OF_FREEDOM:
            raise ValueError(f"expected nu among {DEGREES_OF_FREEDOM}, got {self.nu:g}")

    def _choose(self, training: Recordings, track: str) -> float:
        seen = by_log(training, track)
        scores = [np.zeros(0)] * len(DEGREES_OF_FREEDOM)
        for held_out, rest in inner_folds(training):
            calibration = Calibration.fit(Past.read(rest, self.experts))
            for i, nu in enumerate(DEGREES_OF_FREEDOM):
                scores[i] = np.append(scores[i], [_log_rmse(seen[log], calibration, nu) for log in held_out])
        if not len(scores[0]):
            return SAFE
        return DEGREES_OF_FREEDOM[int(np.argmin([score.mean() for score in scores]))]


def _act(observation: Observation, calibration: Calibration, nu: float) -> Weights:
    increments = observation["yaw_rates"].astype(np.float64) * observation["dt"]
    return consensus_weights(increments, calibration.std(observation), believable(observation), nu)


def _log_rmse(seen: Observation, calibration: Calibration, nu: float) -> float:
    fused = np.sum(_act(seen, calibration, nu) * seen["yaw_rates"], axis=1)
    error = (fused - seen["truth_yaw_rate"][:, 0]) * seen["dt"][:, 0]
    return float(np.log(np.sqrt(np.mean(error**2)) + 1e-12))
