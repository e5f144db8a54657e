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
from mixo_env.policies.blocks import AT_ONCE, shape_of
from mixo_env.policies.calibration import Calibration, scale_row
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


def blank_memory(batch: int, experts: int, views: int = 1) -> FloatArray:
    """What is remembered of every expert's distance from the consensus, of scenes that have not begun.

    Returns:
        ``(views blocks, 3, experts, scenes)`` in UNIT_RAD: in the last step; running mean of its size; and signed.
    """
    blocks, scenes = shape_of(batch)
    memory = np.zeros((views * blocks, 3, experts, scenes))
    memory[:, 1] = 1.0
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


class Room(NamedTuple):
    """Where a step is written.

    Attributes:
        pairs: ``(2, blocks, SIGNALS, experts, scenes)``: every signal is the logarithm of the first of two numbers
            times the second. Numpy takes the logarithms of all at once, many times as fast as one by one.
        whole, consensus: of :class:`Tokens`.
        voting: ``(batch, experts)``.
    """

    pairs: Single
    whole: Single
    consensus: FloatArray
    voting: NDArray[np.bool_]

    @classmethod
    def blank(cls, batch: int, experts: int, views: int = 1) -> Room:
        """For steps of so many scenes, seen in so many ways; the blocks of one follow those of another."""
        blocks, scenes = shape_of(batch)
        blocks *= views
        return cls(
            np.empty((2, blocks, SIGNALS, experts, scenes), np.float32),
            np.empty((blocks, WHOLE, scenes), np.float32),
            np.empty((blocks, experts, scenes)),
            np.empty((batch, experts), np.bool_),
        )

    def views(self, count: int) -> list[Tokens]:
        """Where the tokens of each of ``count`` views stand after every step."""
        parts = zip(*(np.split(part, count) for part in (self.pairs[1], self.whole)), strict=True)
        consensus = np.split(self.consensus, count)
        return [Tokens(signals, whole, of) for (signals, whole), of in zip(parts, consensus, strict=True)]


Parts = tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_], Single, FloatArray]
"""Those of :class:`Seen`, which costs a compiled function more to take apart."""

Told = tuple[Single, Single, Single, Single, Single, Single, Single, Single, Single]
"""What is picked from an observation, see :func:`_told`."""


class Tokens(NamedTuple):
    """One step as a gate sees it, in blocks of scenes.

    Attributes:
        signals: ``(blocks, SIGNALS, experts, scenes)``.
        whole: ``(blocks, WHOLE, scenes)``.
        consensus: ``(blocks, experts, scenes)`` weights of the Student-t consensus; they sum to one.
    """

    signals: Single
    whole: Single
    consensus: FloatArray


def read(observation: Observation, calibration: Calibration) -> Seen:
    """Pick what becomes tokens."""
    voting = np.empty(observation["yaw_rates"].shape, np.bool_)
    return Seen(*_read(_told(observation), calibration.std_rad, calibration.factor, voting))


def tokenise(seen: Seen, memory: FloatArray) -> Tokens:
    """Tokens of one step; ``memory``, as :func:`blank_memory` has it, goes on by it."""
    room = Room.blank(*seen.increment.shape)
    _tokenise(seen[:], memory, (room.pairs[0], room.pairs[1]), room.whole, room.consensus)
    return _finished(room)


def look(observation: Observation, calibration: Calibration, memory: FloatArray, room: Room) -> Tokens:
    """:func:`tokenise` of what is :func:`read`, in ``room``, where it is also written who votes."""
    _look(_told(observation), calibration.std_rad, calibration.factor, memory, *room)
    return _finished(room)


def look_twice(
    observation: Observation,
    calibration: Calibration,
    biases: tuple[FloatArray, FloatArray],
    memory: FloatArray,
    room: Room,
) -> None:
    """Write tokens of the votes as they are, as :func:`look`, and of what is left of them without their biases.

    Args:
        observation: of the step.
        calibration: of the voters.
        biases: ``(batch, experts)`` increments less their biases, and standard deviations of what is left [rad], which
            stand in the place of calibrated ones.
        memory: of both, ``(2 blocks, ...)``; goes on by the step.
        room: of both, from whose :meth:`Room.views` they are read; who votes is written in it.
    """
    apart, left = biases
    _look_twice(_told(observation), calibration.std_rad, calibration.factor, apart, left, memory, *room)
    _finished(room)


def past(seen: Seen, biases: tuple[FloatArray, FloatArray]) -> Seen:
    """A step as a filter leaves it, ``biases`` as in :func:`look_twice`."""
    apart, left = biases
    return seen._replace(increment=apart / UNIT_RAD, std=left / UNIT_RAD)


def _told(observation: Observation) -> Told:
    return (
        observation["yaw_rates"],
        observation["available"],
        observation["yaw_rate_std"],
        observation["speed"],
        observation["dt"],
        observation["matches"],
        observation["inliers"],
        observation["residual_px"],
        observation["flow_px"],
    )


def _finished(room: Room) -> Tokens:
    inside, factor = room.pairs
    return Tokens(np.multiply(np.log(inside, out=inside), factor, out=factor), room.whole, room.consensus)


@compiled_unchecked
def _look(
    told: Told,
    std_rad: FloatArray,
    factor: FloatArray,
    memory: FloatArray,
    pairs: Single,
    whole: Single,
    consensus: FloatArray,
    voting: NDArray[np.bool_],
) -> None:
    """Write what :func:`look` does, but for the logarithms."""
    seen = _read(told, std_rad, factor, voting)
    _tokenise(seen, memory, (pairs[0], pairs[1]), whole, consensus)


@compiled_unchecked
def _look_twice(
    told: Told,
    std_rad: FloatArray,
    factor: FloatArray,
    apart: FloatArray,
    left: FloatArray,
    memory: FloatArray,
    pairs: Single,
    whole: Single,
    consensus: FloatArray,
    voting: NDArray[np.bool_],
) -> None:
    """Write what :func:`look_twice` does, but for the logarithms."""
    seen = _read(told, std_rad, factor, voting)
    increment, std, half = seen[0], seen[2], len(memory) // 2
    _tokenise(seen, memory[:half], (pairs[0, :half], pairs[1, :half]), whole[:half], consensus[:half])
    for b in range(len(voting)):
        for e in range(voting.shape[1]):
            increment[b, e], std[b, e] = apart[b, e] / UNIT_RAD, left[b, e] / UNIT_RAD
    _tokenise(seen, memory[half:], (pairs[0, half:], pairs[1, half:]), whole[half:], consensus[half:])


@compiled_unchecked
def _read(told: Told, std_rad: FloatArray, factor: FloatArray, voting: NDArray[np.bool_]) -> Parts:
    """The parts of :class:`Seen`; who votes is written to where it is wanted."""
    rates, available, said, speed, dt, matches, inliers, residual, flow = told
    batch, experts = voting.shape
    increment, stated, std = np.empty((batch, experts)), np.empty((batch, experts)), np.empty((batch, experts))
    counts, step = np.empty((4, batch, matches.shape[1]), np.float32), np.empty((batch, 2))
    for b in range(batch):
        believe_row(rates[b], available[b], voting[b])
        scale_row(said[b], dt[b, 0], std_rad, factor, std[b])
        unit = np.float64(dt[b, 0]) / UNIT_RAD
        for e in range(experts):
            increment[b, e] = rates[b, e] * unit
            stated[b, e] = said[b, e] * unit
            std[b, e] /= UNIT_RAD
        for c in range(matches.shape[1]):
            counts[0, b, c], counts[1, b, c] = matches[b, c], inliers[b, c]
            counts[2, b, c], counts[3, b, c] = residual[b, c], flow[b, c]
        step[b, 0], step[b, 1] = speed[b, 0], dt[b, 0]
    return increment, stated, std, voting, counts, step


@compiled_unchecked
def _tokenise(
    seen: Parts, memory: FloatArray, pairs: tuple[Single, Single], whole: Single, consensus: FloatArray
) -> None:
    """Write tokens, see :class:`Room`."""
    increment, stated, std, voting, counts, step = seen
    batch = len(increment)
    blocks, _, experts, scenes = memory.shape
    numbers, steps, room = np.empty((5, experts, scenes)), np.empty((5, scenes)), np.empty((1 + ROOM, scenes))
    values, spread, scale, off, said = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    centre = room[0]
    inside, factor = pairs
    flat = inside.reshape(blocks, SIGNALS, experts * scenes), factor.reshape(blocks, SIGNALS, experts * scenes)
    for k in range(blocks):
        last, size, lean = memory[k, 0], memory[k, 1], memory[k, 2]
        for s in range(scenes):
            b = min(k * AT_ONCE + s, batch - 1)
            for e in range(experts):
                values[e, s], said[e, s] = increment[b, e], stated[b, e]
                scale[e, s] = std[b, e] if std[b, e] < math.inf else size[e, s]
                spread[e, s] = scale[e, s] if voting[b, e] else math.inf
            steps[0, s], steps[1, s] = step[b]
        _count(counts, k * AT_ONCE, inside[k], factor[k])
        likeliest(values, spread, FREEDOM, consensus[k], centre, room[1:])
        _sum_up(values, spread, centre, off, steps[2:])
        _signals(
            (off.ravel(), scale.ravel(), said.ravel()),
            (last.ravel(), size.ravel(), lean.ravel()),
            flat[0][k],
            flat[1][k],
        )
        _remember(off, spread, last, size, lean)
        for s in range(scenes):
            speed, dt, apart, count, information = steps[:, s]
            whole[k, 0, s] = 0.1 * speed
            whole[k, 1, s] = math.asinh(centre[s] * UNIT_RAD / max(dt, _LEAST_DT_S) / 0.05)
            whole[k, 2, s] = math.log(apart / count + _FLOOR)
            whole[k, 3, s] = 0.25 * count
            whole[k, 4, s] = -0.5 * math.log(information)


@inlined
def _count(counts: Single, first: int, inside: Single, factor: Single) -> None:
    """Write signals 8 to 12 of scenes from ``first`` on: of those that count ``(4, batch, counting)``, and others."""
    _, batch, counting = counts.shape
    for e in range(inside.shape[1]):
        for k in range(8, 13):
            for s in range(inside.shape[2]):
                inside[k, e, s], factor[k, e, s] = math.e, 0.0
        if e < counting:
            for s in range(inside.shape[2]):
                b = min(first + s, batch - 1)
                matches = counts[0, b, e]
                inside[8, e, s], factor[8, e, s] = 1.0 + matches, 0.2
                factor[9, e, s] = counts[1, b, e] / max(matches, 1.0)
                factor[10, e, s] = counts[2, b, e]
                inside[11, e, s], factor[11, e, s] = 1.0 + counts[3, b, e], 0.2
                factor[12, e, s] = 1.0


@inlined
def _sum_up(values: FloatArray, spread: FloatArray, centre: FloatArray, off: FloatArray, sums: FloatArray) -> None:
    """Write distances of those that vote from the consensus; their sum, their number, and the voters' information."""
    total, count, information = sums[0], sums[1], sums[2]
    for s in range(len(centre)):
        total[s], count[s], information[s] = 0.0, 0.0, 0.0
    for e in range(len(values)):
        for s in range(len(centre)):
            votes = spread[e, s] < math.inf
            off[e, s] = values[e, s] - centre[s] if votes else 0.0
            total[s] += abs(off[e, s])
            count[s] += 1.0 if votes else 0.0
            information[s] += 1.0 / (spread[e, s] * spread[e, s])


@inlined
def _signals(
    now: tuple[FloatArray, FloatArray, FloatArray],
    before: tuple[FloatArray, FloatArray, FloatArray],
    inside: Single,
    factor: Single,
) -> None:
    """Write all other signals; all scenes of all experts in one row."""
    off, scale, stated = now
    last, size, lean = before
    _asinh(off, inside[0], factor[0])
    _asinh(last, inside[3], factor[3])
    _asinh(lean, inside[5], factor[5])
    for t in range(len(off)):
        inside[1, t], factor[1, t] = abs(off[t]) + _FLOOR, 1.0
        far = off[t] / scale[t]
        inside[2, t], factor[2, t] = abs(far) + math.sqrt(far * far + 1.0), math.copysign(1.0, far)
        inside[4, t], factor[4, t] = size[t] + _FLOOR, 1.0
        says = 1.0 if stated[t] > 0.0 else 0.0
        inside[6, t], factor[6, t] = max(stated[t], _FLOOR), says
        inside[7, t], factor[7, t] = math.e, says
        inside[13, t], factor[13, t] = scale[t], 1.0


@inlined
def _asinh(x: FloatArray, inside: Single, factor: Single) -> None:
    """Write inverse hyperbolic sines as logarithms times signs."""
    for t in range(len(x)):
        inside[t] = abs(x[t]) + math.sqrt(x[t] * x[t] + 1.0)
        factor[t] = math.copysign(1.0, x[t])


@inlined
def _remember(off: FloatArray, spread: FloatArray, last: FloatArray, size: FloatArray, lean: FloatArray) -> None:
    """Let the memory go on by a step of those that vote."""
    for e in range(len(off)):
        for s in range(off.shape[1]):
            votes, now = spread[e, s] < math.inf, off[e, s]
            last[e, s] = now if votes else last[e, s]
            size[e, s] += _LONG * (abs(now) - size[e, s]) if votes else 0.0
            lean[e, s] += _SHORT * (now - lean[e, s]) if votes else 0.0
