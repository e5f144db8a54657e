"""Rules that trust the majority: MEAN, MEDIAN and the Huber M-estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled, compiled_unchecked, inlined
from mixo_env.envs.observation import PAPER
from mixo_env.geometry import MAD_TO_SIGMA
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.storage import LARGEST
from mixo_env.recordings.collection import Recordings

EFFICIENCY_95 = 1.345
"""Residual, in standard deviations, beyond which Huber's loss grows linearly: 95 % efficient on Gaussian errors."""
ITERATIONS = 8
RATE_BOUND = np.float32(next(quantity.high for quantity in PAPER if quantity.name == "yaw_rates"))
"""Observed yaw rates end here [rad/s]."""
SMALLEST_SCALE_RAD = 1e-6
"""Keeps weights finite when an expert is exact on the training scenes."""


def votes(observation: Observation) -> NDArray[np.bool_]:
    """Who counts, ``(batch, experts)``: experts with an increment of their own; all of them when nobody has one.

    A lost expert's substitute is the inertial increment, identical for all lost experts. The inertial expert casts that
    vote where it takes part; where it does not, it only bridges the steps in which everything is lost.
    """
    available = observation["available"] > 0
    return available | ~available.any(axis=1, keepdims=True)


def believable(observation: Observation) -> NDArray[np.bool_]:
    """Who counts, ``(batch, experts)``: :func:`votes` without rates at the bound of what is observed.

    No car turns by half a turn a second. Such a rate was clipped, and a weight would multiply the wild increment behind
    it. Where nothing else was said, it counts after all.
    """
    rates = observation["yaw_rates"]
    counted = np.empty(rates.shape, np.bool_)
    _believe(rates, observation["available"], counted)
    return counted


@compiled
def _believe(rates: NDArray[np.float32], available: NDArray[np.float32], counted: NDArray[np.bool_]) -> None:
    for b in range(len(rates)):
        believe_row(rates[b], available[b], counted[b])


@inlined
def believe_row(rates: NDArray[np.float32], available: NDArray[np.float32], counted: NDArray[np.bool_]) -> None:
    """Write :func:`believable` of one scene; all ``(experts,)``."""
    somebody = inside = False
    for e in range(len(rates)):
        somebody |= available[e] > 0.0
    for e in range(len(rates)):
        counted[e] = ((available[e] > 0.0) | (not somebody)) & (abs(rates[e]) < RATE_BOUND)
        inside |= counted[e]
    if not inside:
        for e in range(len(rates)):
            counted[e] = available[e] > 0.0 or not somebody


def median_weights(values: NDArray[np.floating[Any]], voting: NDArray[np.bool_]) -> Weights:
    """Weights ``(batch, n)`` that make the median of the voting ``values``; of an even count, the middle two share."""
    order = np.argsort(np.where(voting, values, np.inf), axis=1, kind="stable")
    count = voting.sum(axis=1)
    row = np.arange(len(values))
    weights = np.zeros(values.shape)
    weights[row, order[row, (count - 1) // 2]] += 0.5
    weights[row, order[row, count // 2]] += 0.5
    return weights


def error_scale_rad(recordings: Recordings, expert: str) -> float:
    """1.4826 x the median absolute error of the expert's own increments; infinite when it never delivered one."""
    error = recordings[f"{expert}.yaw_increment_rad"] - recordings["truth.yaw_increment_rad"]
    error = error[np.isfinite(error)]
    return max(MAD_TO_SIGMA * float(np.median(np.abs(error))), SMALLEST_SCALE_RAD) if len(error) else np.inf


class Mean(Policy):
    """Equal weight for every vote."""

    name = "MEAN"

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        voting = votes(observation)
        return voting / voting.sum(axis=1, keepdims=True)


class Median(Policy):
    """The median of the votes."""

    name = "MEDIAN"

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        return median_weights(observation["yaw_rates"], votes(observation))


class Huber(Policy):
    """Huber's M-estimate of the yaw increment, with one constant error scale per expert.

    Nothing is trained but the scales. Per step, iteratively reweighted least squares from the median (Huber 1981,
    section 7.8).
    """

    name = "HUBER"
    learns = True

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Measure the scales on the training scenes; an infinite one means no weight."""
        super().fit(training, track)
        self._scale_rad = np.array([error_scale_rad(training, expert) for expert in self.experts])

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        increments = observation["yaw_rates"].astype(np.float64) * observation["dt"]
        voting = votes(observation)
        weights = median_weights(increments, voting)
        _reweigh(increments, voting, self._scale_rad, weights)
        return weights

    def tensors(self) -> dict[str, NDArray[Any]]:
        """The scales."""
        return {"scale_rad": self._scale_rad}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """One scale an expert."""
        return {"scale_rad": (len(self.experts),)}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back the scales."""
        self._scale_rad = tensors["scale_rad"].astype(np.float64)
        known = self._scale_rad[np.isfinite(self._scale_rad)]  # an infinite one means no weight
        if np.any(self._scale_rad < SMALLEST_SCALE_RAD) or np.any(known > LARGEST):
            raise ValueError(f"expected scales of errors from {SMALLEST_SCALE_RAD:g} to {LARGEST:g} rad, or infinite")


@compiled_unchecked
def _reweigh(
    values: NDArray[np.float64], voting: NDArray[np.bool_], scale: NDArray[np.float64], weights: Weights
) -> None:
    """Replace weights ``(batch, n)`` by Huber's; where only experts of infinite scale vote, they stand."""
    experts = len(scale)
    for b in range(len(values)):
        usable = False
        for e in range(experts):
            usable |= voting[b, e] and scale[e] < np.inf
        if not usable:
            continue
        for _ in range(ITERATIONS):
            estimate, total = 0.0, 0.0
            for e in range(experts):
                estimate += weights[b, e] * values[b, e]
            for e in range(experts):
                residual = abs(values[b, e] - estimate) / scale[e]
                pull = EFFICIENCY_95 / max(residual, EFFICIENCY_95) / (scale[e] * scale[e])
                weights[b, e] = pull if voting[b, e] else 0.0
                total += weights[b, e]
            for e in range(experts):
                weights[b, e] /= total
