"""What a gate sees of every expert, whatever their number, order and kind: one token each, and one of the whole step.

A token holds how far the expert is from the others, now and lately, how sure it is, and what it counts; a signal that
it does not have is zero and flagged. Nothing names the expert, so a gate over tokens serves any set of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.policies.calibration import Calibration, scale_row
from mixo_env.policies.consensus import likeliest
from mixo_env.policies.policy import Observation
from mixo_env.policies.robust import believe_row

FloatArray = NDArray[np.float64]

UNIT_RAD = 3e-4
"""0.017 deg, about the error of a good expert in one step; increments are told in it."""

SIGNALS = 14
"""Numbers in a token."""

WHOLE = 5
"""Numbers that tell of the whole step."""

FREEDOM = 2.0
"""Of the Student-t consensus that tokens are measured from: an outlier's pull fades soon."""

_FLOOR = 0.1
"""[UNIT_RAD] Disagreement below it is everybody's noise."""

_SHORT, _LONG = 0.1, 0.02
"""Share of the newest step in the running means: about one second, and five, at 12 Hz."""

_LEAST_DT_S = 1e-3


class Memory(NamedTuple):
    """What is remembered of every expert's distance from the consensus, ``(batch, experts)`` each, in UNIT_RAD.

    Attributes:
        last: in the last step.
        size: running mean of its size.
        lean: running mean with its sign.
    """

    last: FloatArray
    size: FloatArray
    lean: FloatArray

    @classmethod
    def blank(cls, batch: int, experts: int) -> Memory:
        """Of scenes that have not begun."""
        return cls(np.zeros((batch, experts)), np.ones((batch, experts)), np.zeros((batch, experts)))


class Seen(NamedTuple):
    """The part of an observation that becomes tokens.

    Attributes:
        increment: ``(batch, experts)`` in UNIT_RAD.
        stated: ``(batch, experts)`` standard deviation that the expert states, in UNIT_RAD; 0: none.
        std: ``(batch, experts)`` the same calibrated; infinite for a stranger: what is seen on the way then counts.
        voting: ``(batch, experts)``.
        counts: ``(4, batch, counting)`` matches, inliers, residual [px], flow [px]; the first experts count.
        step: ``(batch, 2)`` speed [m/s] and duration [s].
    """

    increment: FloatArray
    stated: FloatArray
    std: FloatArray
    voting: NDArray[np.bool_]
    counts: NDArray[np.float32]
    step: FloatArray


class Tokens(NamedTuple):
    """One step as a gate sees it.

    Attributes:
        signals: ``(batch, experts, SIGNALS)``.
        whole: ``(batch, WHOLE)``.
        consensus: ``(batch, experts)`` weights of the Student-t consensus; they sum to one.
    """

    signals: NDArray[np.float32]
    whole: NDArray[np.float32]
    consensus: FloatArray


def read(observation: Observation, calibration: Calibration) -> Seen:
    """Pick what becomes tokens."""
    shape = observation["yaw_rates"].shape
    numbers: FloatArray = np.empty((3, *shape))
    counts = np.array([observation[name] for name in ("matches", "inliers", "residual_px", "flow_px")])
    seen = Seen(numbers[0], numbers[1], numbers[2], np.empty(shape, np.bool_), counts, np.empty((shape[0], 2)))
    told = tuple(observation[name] for name in ("yaw_rates", "available", "yaw_rate_std", "speed", "dt"))
    _read(told, calibration.std_rad, calibration.factor, seen)
    return seen


@compiled_unchecked
def _read(told: tuple[NDArray[np.float32], ...], std_rad: FloatArray, factor: FloatArray, seen: Seen) -> None:
    """Write all of ``seen`` but the counts."""
    rates, available, stated, speed, dt = told
    for b in range(len(rates)):
        believe_row(rates[b], available[b], seen.voting[b])
        scale_row(stated[b], dt[b, 0], std_rad, factor, seen.std[b])
        unit = np.float64(dt[b, 0]) / UNIT_RAD
        for e in range(rates.shape[1]):
            seen.increment[b, e] = rates[b, e] * unit
            seen.stated[b, e] = stated[b, e] * unit
            seen.std[b, e] /= UNIT_RAD
        seen.step[b, 0], seen.step[b, 1] = speed[b, 0], dt[b, 0]


def tokenise(seen: Seen, memory: Memory) -> Tokens:
    """Tokens of one step; ``memory`` goes on by it."""
    batch, experts = seen.increment.shape
    inside = np.full((batch, experts, SIGNALS), np.e, np.float32)
    signals = np.zeros((batch, experts, SIGNALS), np.float32)
    whole = np.zeros((batch, WHOLE), np.float32)
    consensus = np.empty((batch, experts))
    _tokenise(seen, memory, (inside, signals), whole, consensus)
    signals *= np.log(inside, out=inside)
    return Tokens(signals, whole, consensus)


@inlined
def _asinh(x: float, inside: NDArray[np.float32], factor: NDArray[np.float32], k: int) -> None:
    """Write the inverse hyperbolic sine as a logarithm times a sign."""
    inside[k] = abs(x) + math.sqrt(x * x + 1.0)
    factor[k] = math.copysign(1.0, x)


@compiled_unchecked
def _tokenise(
    seen: Seen,
    memory: Memory,
    signals: tuple[NDArray[np.float32], NDArray[np.float32]],
    whole: NDArray[np.float32],
    consensus: FloatArray,
) -> None:
    """Write tokens; every signal is the logarithm of the first of two arrays, e unless written, times the second.

    Numpy takes the logarithms of all of them at once, many times as fast as one by one.
    """
    batch, experts = seen.increment.shape
    scale, off = np.empty(experts), np.empty(experts)
    for b in range(batch):
        increment, voting, weight = seen.increment[b], seen.voting[b], consensus[b]
        for e in range(experts):
            scale[e] = seen.std[b, e] if seen.std[b, e] < math.inf else memory.size[b, e]
        centre = likeliest(increment, scale, voting, FREEDOM, weight)
        spread, count, information = 0.0, 0, 0.0
        for e in range(experts):
            off[e] = increment[e] - centre if voting[e] else 0.0
            spread += abs(off[e])
            if voting[e]:
                count += 1
                information += 1.0 / (scale[e] * scale[e])
        for e in range(experts):
            inside, factor = signals[0][b, e], signals[1][b, e]
            _asinh(off[e], inside, factor, 0)
            inside[1], factor[1] = abs(off[e]) + _FLOOR, 1.0
            _asinh(off[e] / scale[e], inside, factor, 2)
            _asinh(memory.last[b, e], inside, factor, 3)
            inside[4], factor[4] = memory.size[b, e] + _FLOOR, 1.0
            _asinh(memory.lean[b, e], inside, factor, 5)
            if seen.stated[b, e] > 0.0:
                inside[6], factor[6] = max(seen.stated[b, e], _FLOOR), 1.0
                factor[7] = 1.0
            if e < seen.counts.shape[2]:
                matches = seen.counts[0, b, e]
                inside[8], factor[8] = 1.0 + matches, 0.2
                factor[9] = seen.counts[1, b, e] / max(matches, 1.0)
                factor[10] = seen.counts[2, b, e]
                inside[11], factor[11] = 1.0 + seen.counts[3, b, e], 0.2
                factor[12] = 1.0
            inside[13], factor[13] = scale[e], 1.0
            if voting[e]:
                memory.last[b, e] = off[e]
                memory.size[b, e] += _LONG * (abs(off[e]) - memory.size[b, e])
                memory.lean[b, e] += _SHORT * (off[e] - memory.lean[b, e])
        speed, dt = seen.step[b]
        whole[b, 0] = 0.1 * speed
        whole[b, 1] = math.asinh(centre * UNIT_RAD / max(dt, _LEAST_DT_S) / 0.05)
        whole[b, 2] = math.log(spread / count + _FLOOR)
        whole[b, 3] = 0.25 * count
        whole[b, 4] = -0.5 * math.log(information)
