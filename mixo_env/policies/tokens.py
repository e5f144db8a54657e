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
from mixo_env.policies.blocks import AT_ONCE
from mixo_env.policies.consensus import ROOM, likeliest
from mixo_env.policies.policy import Observation
from mixo_env.policies.robust import believe_row

FloatArray = NDArray[np.float64]
Single = NDArray[np.float32]

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


def blank_memory(batch: int, experts: int) -> FloatArray:
    """What is remembered of every expert's distance from the consensus, of scenes that have not begun.

    Returns:
        ``(3, batch, experts)`` in UNIT_RAD: in the last step; running mean of its size; the same with its sign.
    """
    memory = np.zeros((3, batch, experts))
    memory[1] = 1.0
    return memory


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
    counts: Single
    step: FloatArray


class Tokens(NamedTuple):
    """One step as a gate sees it.

    Attributes:
        signals: ``(batch, experts, SIGNALS)``.
        whole: ``(batch, WHOLE)``.
        consensus: ``(batch, experts)`` weights of the Student-t consensus; they sum to one.
    """

    signals: Single
    whole: Single
    consensus: FloatArray


def read(observation: Observation, calibration: Calibration) -> Seen:
    """Pick what becomes tokens."""
    told = (
        observation["yaw_rates"],
        observation["available"],
        observation["yaw_rate_std"],
        observation["speed"],
        observation["dt"],
    )
    counted = observation["matches"], observation["inliers"], observation["residual_px"], observation["flow_px"]
    numbers: FloatArray = np.empty((3, *told[0].shape))
    voting, step = np.empty(told[0].shape, np.bool_), np.empty((len(told[0]), 2))
    counts = np.empty((4, *counted[0].shape), np.float32)
    _read(told, counted, calibration.std_rad, calibration.factor, numbers, voting, counts, step)
    return Seen(numbers[0], numbers[1], numbers[2], voting, counts, step)


@compiled_unchecked
def _read(
    told: tuple[Single, Single, Single, Single, Single],
    counted: tuple[Single, Single, Single, Single],
    std_rad: FloatArray,
    factor: FloatArray,
    numbers: FloatArray,
    voting: NDArray[np.bool_],
    counts: Single,
    step: FloatArray,
) -> None:
    """Write what makes :class:`Seen`; the first three parts as one."""
    rates, available, stated, speed, dt = told
    increment, said, std = numbers[0], numbers[1], numbers[2]
    for b in range(len(rates)):
        believe_row(rates[b], available[b], voting[b])
        scale_row(stated[b], dt[b, 0], std_rad, factor, std[b])
        unit = np.float64(dt[b, 0]) / UNIT_RAD
        for e in range(rates.shape[1]):
            increment[b, e] = rates[b, e] * unit
            said[b, e] = stated[b, e] * unit
            std[b, e] /= UNIT_RAD
        step[b, 0], step[b, 1] = speed[b, 0], dt[b, 0]
        for c in range(counts.shape[2]):
            for k in range(4):
                counts[k, b, c] = counted[k][b, c]


def tokenise(seen: Seen, memory: FloatArray) -> Tokens:
    """Tokens of one step; ``memory``, as :func:`blank_memory` has it, goes on by it."""
    batch, experts = seen.increment.shape
    signals = np.empty((2, batch, experts, SIGNALS), np.float32)
    whole, consensus = np.empty((batch, WHOLE), np.float32), np.empty((batch, experts))
    _tokenise(tuple(seen), memory, signals, whole, consensus)
    inside, factor = signals
    factor *= np.log(inside, out=inside)
    return Tokens(factor, whole, consensus)


@inlined
def _asinh(x: float, inside: Single, factor: Single, k: int) -> None:
    """Write the inverse hyperbolic sine as a logarithm times a sign."""
    inside[k] = abs(x) + math.sqrt(x * x + 1.0)
    factor[k] = math.copysign(1.0, x)


@inlined
def _signal(
    off: float, scale: float, stated: float, memory: tuple[float, float, float], inside: Single, factor: Single
) -> None:
    """Write an expert's signals, all but what it counts."""
    last, size, lean = memory
    _asinh(off, inside, factor, 0)
    inside[1], factor[1] = abs(off) + _FLOOR, 1.0
    _asinh(off / scale, inside, factor, 2)
    _asinh(last, inside, factor, 3)
    inside[4], factor[4] = size + _FLOOR, 1.0
    _asinh(lean, inside, factor, 5)
    says = 1.0 if stated > 0.0 else 0.0
    inside[6], factor[6] = max(stated, _FLOOR), says
    inside[7], factor[7] = math.e, says
    for k in range(8, 13):
        inside[k], factor[k] = math.e, 0.0
    inside[13], factor[13] = scale, 1.0


@inlined
def _count(counts: Single, b: int, e: int, inside: Single, factor: Single) -> None:
    """Write the signals of an expert that counts."""
    matches = counts[0, b, e]
    inside[8], factor[8] = 1.0 + matches, 0.2
    factor[9] = counts[1, b, e] / max(matches, 1.0)
    factor[10] = counts[2, b, e]
    inside[11], factor[11] = 1.0 + counts[3, b, e], 0.2
    factor[12] = 1.0


@compiled_unchecked
def _tokenise(
    seen: tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_], Single, FloatArray],
    memory: FloatArray,
    signals: Single,
    whole: Single,
    consensus: FloatArray,
) -> None:
    """Write tokens; every signal is the logarithm of the first of two numbers times the second.

    Numpy takes the logarithms of all of them at once, many times as fast as one by one.
    """
    increment, stated, std, voting, counts, step = seen
    batch, experts = increment.shape
    scenes = min(batch, AT_ONCE)
    room, centre, scale = np.empty((ROOM, scenes)), np.empty(scenes), np.empty(experts)
    values, spread = np.empty((experts, scenes)), np.empty((experts, scenes))
    weights = np.empty((experts, scenes))
    last, size, lean = memory[0], memory[1], memory[2]
    for first in range(0, batch, AT_ONCE):
        stop = min(first + AT_ONCE, batch)
        for s in range(scenes):
            b = min(first + s, batch - 1)
            for e in range(experts):
                values[e, s] = increment[b, e]
                known = std[b, e] if std[b, e] < math.inf else size[b, e]
                spread[e, s] = known if voting[b, e] else math.inf
        likeliest(values, spread, FREEDOM, weights, centre, room)
        for b in range(first, stop):
            s = b - first
            total, count, information = 0.0, 0, 0.0
            for e in range(experts):
                consensus[b, e] = weights[e, s]
                scale[e] = std[b, e] if std[b, e] < math.inf else size[b, e]
                off = increment[b, e] - centre[s] if voting[b, e] else 0.0
                total += abs(off)
                count += voting[b, e]
                information += 1.0 / (scale[e] * scale[e]) if voting[b, e] else 0.0
                inside, factor = signals[0, b, e], signals[1, b, e]
                before = last[b, e], size[b, e], lean[b, e]
                _signal(off, scale[e], stated[b, e], before, inside, factor)
                if e < counts.shape[2]:
                    _count(counts, b, e, inside, factor)
                if voting[b, e]:
                    last[b, e] = off
                    size[b, e] += _LONG * (abs(off) - size[b, e])
                    lean[b, e] += _SHORT * (off - lean[b, e])
            speed, dt = step[b]
            whole[b, 0] = 0.1 * speed
            whole[b, 1] = math.asinh(centre[s] * UNIT_RAD / max(dt, _LEAST_DT_S) / 0.05)
            whole[b, 2] = math.log(total / count + _FLOOR)
            whole[b, 3] = 0.25 * count
            whole[b, 4] = -0.5 * math.log(information)
