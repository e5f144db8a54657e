"""Paths of the rear axle along the streets: straights, rounded turns, a driver who does not hold the lane exactly.

A path is built on the street grid from its curvature, which is smooth everywhere, so that heading and position follow
by integration and the car can really drive it; then it is laid on the land, whose bends are smooth as well.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import rotation_from_yaw
from mixo_env.simulator.city.land import Land
from mixo_env.simulator.city.roundabout import EXTRA_M, REACH_M, swerve
from mixo_env.simulator.city.roundabout import PASSING_M as ISLAND_PASSING_M
from mixo_env.simulator.city.streets import BLOCK_M, HALF_CITY_BLOCKS, LANE_M

FloatArray = NDArray[np.float64]

STEP_M = 0.1
"""Spacing of the samples of a path."""

LEFT, STRAIGHT, RIGHT = 1, 0, -1
"""What to do at a crossing."""

STOP_BEFORE_CROSSING_M = 12.5
"""Rear axle to the centre of the crossing when the car waits at the stop line."""

SWERVE_EVERY_M = 100.0
"""Average distance between two swerves around something at the roadside."""

MAX_OFFSET_M = 1.0
"""The rear axle stays this close to the middle of its lane."""

PASSING_M = 1.25
"""A vehicle that stands in the lane, close to the parked ones, is passed with this offset to the left."""

_PASSING_HALF_M = 5.0  # the offset is held this long before and after the vehicle's centre ...
_PASSING_RAMP_M = 19.0  # ... and built up over this length
_PASSING_EXTRA_M = 700.0 / 429.0 * PASSING_M**2 / _PASSING_RAMP_M  # what the detour is longer than the straight way
_MARGIN_BLOCKS = 0.7  # routes keep this far inside the city's edge, so that there are houses on both sides
_RAMP_M = 7.0  # length over which the curvature builds up
# Left around an island: distance from its middle half-way, lengths of the parts, and what they share.
_AROUND_M, _SWING_M, _CIRCLE_M, _OVERLAP_M = 5.4, 12.0, 21.0, 4.0
_RADIUS_M = {LEFT: (10.0, 16.0), RIGHT: (7.0, 9.5)}
_TIGHT_RADIUS_M = {LEFT: (7.0, 8.0), RIGHT: (5.8, 6.4)}


@dataclass(frozen=True)
class Route:
    """A path, sampled every ``STEP_M`` along its length, map frame.

    Attributes:
        s_m: ``(n,)`` arc length from the start, along the slope.
        u_m, v_m: ``(n,)`` position on the street grid.
        x_m, y_m, z_m: ``(n,)`` position.
        course_rad: ``(n,)`` direction of travel, not wrapped.
        curvature_pm: ``(n,)`` d(course)/ds [1/m], positive to the left.
        stops_m: arc lengths of the stop lines.
        turns_m: first and last arc length of every turn.
        rounds_m: first and last arc length of every roundabout that is passed straight on.
        passed_m: arc lengths beside the vehicles that stand in the lane.
    """

    s_m: FloatArray
    u_m: FloatArray
    v_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray
    course_rad: FloatArray
    curvature_pm: FloatArray
    stops_m: tuple[float, ...]
    turns_m: tuple[tuple[float, float], ...]
    rounds_m: tuple[tuple[float, float], ...]
    passed_m: tuple[float, ...]

    def at(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y and course at arc lengths; straight on beyond both ends."""
        beyond = s_m - np.clip(s_m, self.s_m[0], self.s_m[-1])
        course = np.interp(s_m, self.s_m, self.course_rad)
        x = np.interp(s_m, self.s_m, self.x_m) + beyond * np.cos(course)
        y = np.interp(s_m, self.s_m, self.y_m) + beyond * np.sin(course)
        return x, y, course

    def on_grid(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """U and v at arc lengths; straight on beyond both ends."""
        beyond = s_m - np.clip(s_m, self.s_m[0], self.s_m[-1])
        end = np.where(beyond > 0, -1, 1)
        u, v = (
            np.interp(s_m, self.s_m, grid) + beyond * (grid[end] - grid[end - 1]) / STEP_M
            for grid in (self.u_m, self.v_m)
        )
        return u, v


class _Leg(NamedTuple):
    """One crossing and the way to it: what to do there, with which radius, and where a vehicle stands in the way."""

    move: int
    radius_m: float | None
    passed_m: float | None


class _Way(NamedTuple):
    """A path on the grid that begins at the origin: arc length, position, course, and marks as in :class:`Route`."""

    s: FloatArray
    x: FloatArray
    y: FloatArray
    course: FloatArray
    stops: list[float]
    turns: list[tuple[float, float]]
    rounds: list[tuple[float, float]]
    passed: list[float]


def plan_route(
    rng: np.random.Generator,
    moves: Sequence[int],
    speed_mps: float,
    land: Land,
    tight: bool = False,
    passing: float = 0.0,
) -> Route:
    """A path through the crossings ``moves`` (LEFT, STRAIGHT, RIGHT), somewhere in the city.

    Args:
        rng: draws radii, lane keeping and the place in the city.
        moves: what to do at each crossing; at most seven fit into the city.
        speed_mps: usual speed; a driver corrects the car's place in the lane every few seconds, not metres.
        land: of the city.
        tight: turn with the smallest radius.
        passing: probability of a vehicle in the way in each block but the first.
    """
    start_m = rng.uniform(0.35, 0.95) * BLOCK_M  # from the start to the centre of the first crossing
    legs = [_leg(rng, move, tight, passing if number else None) for number, move in enumerate(moves)]
    same_driver = copy.deepcopy(rng)
    way = _way(rng, legs, start_m, speed_mps, frozenset())
    quarter, shift_blocks = _place(rng, way.x - start_m, way.y)
    rotation = rotation_from_yaw(quarter * np.pi / 2.0)[:2, :2]
    # Only the place tells which crossings are roundabouts.
    met = _roundabouts(moves, rotation, shift_blocks, land)
    if met:
        way = _way(same_driver, legs, start_m, speed_mps, met)
    u, v = rotation @ np.stack([way.x - start_m, way.y]) + BLOCK_M * shift_blocks[:, None]
    return _laid(land, way, u, v, way.course + quarter * np.pi / 2.0)


def _leg(rng: np.random.Generator, move: int, tight: bool, passing: float | None) -> _Leg:
    passed_m = rng.uniform(-4.0, 4.0) if passing is not None and rng.uniform() < passing else None
    radius_m = None if move == STRAIGHT else rng.uniform(*(_TIGHT_RADIUS_M if tight else _RADIUS_M)[move])
    return _Leg(move, radius_m, passed_m)


def _roundabouts(moves: Sequence[int], rotation: FloatArray, shift_blocks: FloatArray, land: Land) -> frozenset[int]:
    """Numbers of the crossings on the way that have an island."""
    at, along = np.zeros(2), np.array([1.0, 0.0])
    met = set()
    for number, move in enumerate(moves):
        i, j = np.round(rotation @ at + shift_blocks).astype(int).tolist()
        if (i, j) in land.roundabouts:
            met.add(number)
        along = rotation_from_yaw(move * np.pi / 2.0)[:2, :2] @ along
        at = at + along
    return frozenset(met)


def _way(
    rng: np.random.Generator, legs: Sequence[_Leg], start_m: float, speed_mps: float, roundabouts: frozenset[int]
) -> _Way:
    """The path from its pieces.

    Args:
        rng: draws lane keeping.
        legs: crossing by crossing.
        start_m: from the start to the centre of the first crossing.
        speed_mps: usual speed.
        roundabouts: numbers of the crossings with an island.
    """
    pieces: list[FloatArray] = []
    stops, turns, rounds, passed = [], [], [], []
    length_m, to_crossing_m = 0.0, start_m
    for number, leg in enumerate(legs):
        if leg.passed_m is not None:  # in the middle of the block, clear of turns
            passed.append(length_m + to_crossing_m - 0.5 * BLOCK_M + leg.passed_m)
            to_crossing_m += _PASSING_EXTRA_M
        stops.append(length_m + to_crossing_m - STOP_BEFORE_CROSSING_M)
        if leg.radius_m is None:
            extra_m = 0.5 * EXTRA_M if number in roundabouts else 0.0
            pieces.append(np.zeros(_samples(to_crossing_m + extra_m)))
            length_m, to_crossing_m = length_m + to_crossing_m + extra_m, BLOCK_M + extra_m
            if number in roundabouts:
                rounds.append((length_m - REACH_M - extra_m, length_m + REACH_M + extra_m))
            continue
        around = number in roundabouts and leg.move == LEFT  # who turns right does not come near the island
        turn, tangent_m = _turn_around() if around else _turn(leg.radius_m)
        # The corner of the two lanes lies LANE_M before (right turn) or behind (left turn) the crossing's centre.
        approach = np.zeros(_samples(to_crossing_m + leg.move * LANE_M - tangent_m))
        pieces += [approach, leg.move * turn]
        first_m = length_m + len(approach) * STEP_M
        turns.append((first_m, first_m + len(turn) * STEP_M))
        length_m, to_crossing_m = turns[-1][1], BLOCK_M + leg.move * LANE_M - tangent_m - STEP_M
    pieces.append(np.zeros(_samples(to_crossing_m - STOP_BEFORE_CROSSING_M)))
    curvature = np.concatenate(pieces)
    s = STEP_M * np.arange(len(curvature), dtype=np.float64)
    offset_m = _swerving(_lane_keeping(rng, s, curvature, speed_mps), s, passed, rounds)
    course = _integrated(curvature) + np.gradient(offset_m, STEP_M)
    x = _integrated(np.cos(course))
    y = _integrated(np.sin(course)) - LANE_M + offset_m[0]
    return _Way(s, x, y, course, stops, turns, rounds, passed)


def _swerving(
    offset_m: FloatArray, s: FloatArray, passed: Sequence[float], rounds: Sequence[tuple[float, float]]
) -> FloatArray:
    """The place in the lane with the swerves around vehicles that stand in it and around islands."""
    offset_m = offset_m.copy()
    for centre_m in passed:
        near_m = _PASSING_HALF_M + _PASSING_RAMP_M - np.abs(s - centre_m)
        part = np.clip(near_m / _PASSING_RAMP_M, 0.0, 1.0)
        offset_m += part**4 * (35.0 - 84.0 * part + 70.0 * part**2 - 20.0 * part**3) * (PASSING_M - offset_m)
    for first_m, last_m in rounds:
        half_m = 0.5 * (last_m - first_m)
        aside_m, _ = swerve((s - first_m - half_m) * REACH_M / half_m)
        offset_m -= aside_m + aside_m / (ISLAND_PASSING_M - LANE_M) * offset_m
    return offset_m


def _laid(land: Land, way: _Way, u: FloatArray, v: FloatArray, course: FloatArray) -> Route:
    """A path laid on the land and sampled anew along its slope.

    Args:
        land: of the city.
        way: the path with its marks.
        u: of the path in its place on the grid.
        v: likewise.
        course: likewise.
    """
    x, y = land.map(u, v)
    z = land.height(u, v)
    along = np.concatenate([[0.0], np.cumsum(np.sqrt(np.diff(x) ** 2 + np.diff(y) ** 2 + np.diff(z) ** 2))])
    even: FloatArray = STEP_M * np.arange(int(along[-1] / STEP_M) + 1, dtype=np.float64)
    at = np.interp(even, along, way.s)
    u, v, course = (_smoothly(at / STEP_M, values) for values in (u, v, course))
    x, y = land.map(u, v)
    course = land.heading(u, v, course)
    stops, turns, rounds, passed = (
        np.interp(np.ravel(marks), way.s, along) for marks in (way.stops, way.turns, way.rounds, way.passed)
    )
    return Route(
        even,
        u,
        v,
        x,
        y,
        land.height(u, v),
        course,
        np.gradient(course, STEP_M),
        tuple(stops.tolist()),
        _pairs(turns),
        _pairs(rounds),
        tuple(passed.tolist()),
    )


def _pairs(marks: FloatArray) -> tuple[tuple[float, float], ...]:
    return tuple((first, last) for first, last in marks.reshape(-1, 2).tolist())


def _smoothly(at: FloatArray, values: FloatArray) -> FloatArray:
    """``values`` between their samples by Catmull-Rom cubics, whose slope does not jump as that of straight pieces."""
    padded = np.concatenate([[2.0 * values[0] - values[1]], values, 2 * values[-1] - values[-2] + [0.0, 0.0]])
    index = np.clip(at.astype(np.int64), 0, len(values) - 1)
    f = at - index
    before, here, there, after = (padded[index + k] for k in range(4))
    slope, next_slope = 0.5 * (there - before), 0.5 * (after - here)
    rest = 1.0 - f
    return (
        here * (1.0 + 2.0 * f) * rest * rest
        + there * f * f * (3.0 - 2.0 * f)
        + f * rest * (slope * rest - next_slope * f)
    )


def _turn(radius_m: float) -> tuple[FloatArray, float]:
    """Curvature samples of a quarter turn to the left, and its tangent length (first sample to the corner)."""
    core_m = 0.5 * np.pi * radius_m - _RAMP_M
    s = STEP_M * np.arange(_samples(core_m + 2.0 * _RAMP_M))
    ramp = np.clip(np.minimum(s, s[-1] - s) / _RAMP_M, 0.0, 1.0)
    curvature = ramp * ramp * (3.0 - 2.0 * ramp)
    curvature *= 0.5 * np.pi / (curvature.sum() * STEP_M)  # exactly 90 degrees on the sampled path
    return curvature, float(_integrated(np.cos(_integrated(curvature)))[-1])


@cache
def _turn_around() -> tuple[FloatArray, float]:
    """As :func:`_turn`, three quarters around an island: right, left around it, right again into the other street.

    The more it turns right first, the wider it swings; half-way it is to be ``_AROUND_M`` from the island's middle.
    """
    low, high = 0.0, 1.2
    for _ in range(40):
        first_right_rad = 0.5 * (low + high)
        x, y = _plotted(_around(first_right_rad))
        half = len(x) // 2
        # The lanes' corner lies sqrt(2) LANE_M from the island's middle, on the same diagonal.
        beyond_corner_m = (x[half] - x[-1] - y[half]) / np.sqrt(2.0)
        wide = beyond_corner_m + np.sqrt(2.0) * LANE_M > _AROUND_M
        low, high = (low, first_right_rad) if wide else (first_right_rad, high)
    curvature = _around(low)
    return curvature, float(_plotted(curvature)[0][-1])


def _plotted(curvature: FloatArray) -> tuple[FloatArray, FloatArray]:
    """X and y of a path that begins at the origin along x."""
    course = _integrated(curvature)
    return _integrated(np.cos(course)), _integrated(np.sin(course))


def _around(first_right_rad: float) -> FloatArray:
    """Curvature of a left turn that begins and ends with a turn to the right by ``first_right_rad``."""
    right = np.sin(np.pi * np.linspace(0.0, 1.0, _samples(_SWING_M) + 1)) ** 2
    s = STEP_M * np.arange(_samples(_CIRCLE_M) + 1)
    ramp = np.clip(np.minimum(s, s[-1] - s) / _RAMP_M, 0.0, 1.0)
    left = ramp * ramp * (3.0 - 2.0 * ramp)
    before = _samples(_SWING_M - _OVERLAP_M)
    curvature = np.zeros(2 * before + len(left))
    for first, shape, angle in (
        (0, right, -first_right_rad),
        (before, left, 0.5 * np.pi + 2.0 * first_right_rad),
        (len(curvature) - len(right), right, -first_right_rad),
    ):
        curvature[first : first + len(shape)] += angle * shape / (shape.sum() * STEP_M)
    return curvature


def _lane_keeping(rng: np.random.Generator, s: FloatArray, curvature: FloatArray, speed_mps: float) -> FloatArray:
    """How far left of the middle of its lane the car drives [m]: wandering slowly, fading out towards turns."""
    offset = np.zeros_like(s)
    for shortest_s, longest_s, amplitude_m in ((4.5, 6.0, 0.04), (6.5, 9.0, 0.1), (10.0, 14.0, 0.25)):
        wavelength_m = max(speed_mps, 5.0) * rng.uniform(shortest_s, longest_s)
        amplitude = amplitude_m * np.clip(rng.normal(1.0, 0.5), 0.2, 2.0)
        offset += amplitude * np.sin(2.0 * np.pi * (s / wavelength_m + rng.uniform()))
    for _ in range(rng.poisson(s[-1] / SWERVE_EVERY_M)):
        length_m = max(speed_mps, 5.0) * rng.uniform(4.0, 8.0)
        phase = np.clip((s - rng.uniform(s[0], s[-1])) / length_m, 0.0, 1.0)
        offset += np.clip(rng.normal(0.0, 0.6), -0.9, 0.9) * np.sin(np.pi * phase) ** 4
    offset = MAX_OFFSET_M * np.tanh(offset / MAX_OFFSET_M)
    reach = np.ones(2 * round(18.0 / STEP_M) + 1)
    fade = 1.0 - (np.convolve(curvature != 0.0, reach, mode="same") > 0.5)
    box = np.full(round(8.0 / STEP_M), 1.0 / round(8.0 / STEP_M))
    for _ in range(3):  # three boxes make the fade, and with it the curvature, smooth
        fade = np.convolve(np.pad(fade, len(box), mode="edge"), box, mode="same")[len(box) : -len(box)]
    return offset * fade


def _place(rng: np.random.Generator, x: FloatArray, y: FloatArray) -> tuple[int, FloatArray]:
    """A quarter turn and a shift in whole blocks that keep the path inside the city."""
    quarter = int(rng.integers(4))
    position = rotation_from_yaw(quarter * np.pi / 2.0)[:2, :2] @ np.stack([x, y]) / BLOCK_M
    limit = HALF_CITY_BLOCKS - _MARGIN_BLOCKS
    low = np.ceil(-limit - position.min(axis=1)).astype(int)
    high = np.floor(limit - position.max(axis=1)).astype(int)
    if np.any(low > high):
        raise ValueError(f"a route of {np.ptp(position, axis=1)} blocks does not fit into the city")
    return quarter, rng.integers(low, high + 1).astype(np.float64)


def _integrated(values: FloatArray) -> FloatArray:
    """Integral over arc length by the trapezium rule, starting at 0."""
    return STEP_M * np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))])


def _samples(length_m: float) -> int:
    return max(round(length_m / STEP_M), 1)
