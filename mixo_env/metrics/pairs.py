"""Which two poses make a piece of path of a wanted length: the pairs behind every relative error.

Pairs depend on the ground-truth path alone, so all methods scored on a scene share them and can be compared sample by
sample. The rules are those of docs/metrics.md, "Pairs".
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_once
from mixo_env.errors import ConfigurationError, unknown
from mixo_env.geometry import FloatArray

IntArray = NDArray[np.int64]

DEFAULT_LENGTHS_M = (10.0, 20.0, 30.0, 40.0, 50.0, 75.0, 100.0, 125.0, 150.0, 200.0)
"""The headline's lengths; few 20 s scenes reach the last ones, so counts are always printed with the score."""

KITTI_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
KITTI_START_STEP = 10
"""The KITTI odometry benchmark starts a piece at every tenth frame."""

_RPG_TOLERANCE = 0.2
_COMPILE_ABOVE = 300_000
"""Starts x lengths from which compiling (or loading) the search is cheaper than interpreting it."""


@dataclass(frozen=True)
class PairRule:
    """How pieces are chosen and what their error is divided by.

    Attributes:
        lengths_m: path lengths L, increasing [m].
        tolerance: ``"step"``: the path from i is at least L long and the miss is at most one local step, the longer of
            the two steps that meet at j; a number: the miss is below that fraction of L, whatever path is left.
        min_start_spacing_m: starts are at least this far apart along the path [m]; 0: every frame is a start.
        end_length: divide by the ``"nominal"`` L or by the ``"actual"`` path between i and j.
        pairs: ``"true"``, or ``"rpg"`` to reproduce rpg_trajectory_evaluation including its index shift (it implies a
            tolerance of 0.2 and dense starts).
    """

    lengths_m: tuple[float, ...] = DEFAULT_LENGTHS_M
    tolerance: Literal["step"] | float = "step"
    min_start_spacing_m: float = 1.0
    end_length: Literal["nominal", "actual"] = "nominal"
    pairs: Literal["true", "rpg"] = "true"

    def __post_init__(self) -> None:
        """Check the values; raise :class:`ConfigurationError` for one that makes no sense."""
        lengths = self.lengths_m
        rising = all(a < b for a, b in itertools.pairwise((0.0, *lengths, np.inf)))
        if not lengths or not rising:
            raise ConfigurationError(f"expected increasing path lengths above 0 m, got {list(lengths)}; reorder them")
        if isinstance(self.tolerance, str):
            if self.tolerance != "step":
                raise ConfigurationError(f"expected tolerance 'step' or a number, got {self.tolerance!r}; give either")
        elif not 0.0 < self.tolerance < 1.0:
            raise ConfigurationError(f"expected a tolerance between 0 and 1 of the length, got {self.tolerance}")
        if not 0.0 <= self.min_start_spacing_m < np.inf:
            raise ConfigurationError(f"expected a start spacing of 0 m or more, got {self.min_start_spacing_m}")
        if self.end_length not in ("nominal", "actual"):
            raise ConfigurationError(unknown("end length", self.end_length, ("nominal", "actual")))
        if self.pairs not in ("true", "rpg"):
            raise ConfigurationError(unknown("pairs", self.pairs, ("true", "rpg")))


@dataclass(frozen=True)
class Pairs:
    """Pieces of path, M in all, ordered by scene, then length, then start.

    Attributes:
        start, end: ``(M,)`` row of the first and last pose of a piece.
        scene: ``(M,)`` index of its scene.
        length_m: ``(M,)`` nominal length L.
        path_m: ``(M,)`` true path length between the two poses.
        lengths_m: the lengths that were asked for, also those without a piece.
        offsets: ``(scenes + 1,)`` first row of each scene searched, and the end.
    """

    start: IntArray
    end: IntArray
    scene: IntArray
    length_m: FloatArray
    path_m: FloatArray
    lengths_m: tuple[float, ...]
    offsets: IntArray


def path_length(positions_m: FloatArray, offsets: IntArray | None = None) -> FloatArray:
    """Length of the path travelled up to each pose, starting at 0 in every scene [m].

    Args:
        positions_m: ``(N, 2)`` or ``(N, 3)``.
        offsets: ``(scenes + 1,)`` first row of each scene and the end; ``None``: one scene.

    Returns:
        ``(N,)``.
    """
    offsets = scene_offsets(len(positions_m), offsets)
    distance = np.zeros(len(positions_m))
    distance[1:] = np.sqrt(np.sum(np.diff(positions_m, axis=0) ** 2, axis=1))
    for first, stop in itertools.pairwise(offsets):
        if stop > first:
            distance[first] = 0.0  # not the jump from the scene before
            np.cumsum(distance[first:stop], out=distance[first:stop])
    return distance


def find_pairs(distance_m: FloatArray, rule: PairRule | None = None, offsets: IntArray | None = None) -> Pairs:
    """All pieces the rule accepts.

    For every start i the end is the first j > i that minimises ``|d_j - d_i - L|``.

    Args:
        distance_m: ``(N,)`` path travelled, from :func:`path_length`.
        rule: lengths and acceptance; ``None``: the defaults.
        offsets: ``(scenes + 1,)`` first row of each scene and the end; ``None``: one scene.
    """
    rule = rule or PairRule()
    offsets = scene_offsets(len(distance_m), offsets)
    lengths = np.asarray(rule.lengths_m, dtype=np.float64)
    rpg = rule.pairs == "rpg"
    # A negative tolerance stands for "step": one compiled signature for both.
    tolerance = _RPG_TOLERANCE if rpg else -1.0 if isinstance(rule.tolerance, str) else float(rule.tolerance)
    spacing = 0.0 if rpg else rule.min_start_spacing_m
    most = len(distance_m) * len(lengths)
    start, end = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    counts = np.zeros((len(offsets) - 1, len(lengths)), dtype=np.int64)
    if most > _COMPILE_ABOVE:
        search, distance, limits = compiled_once(_search), np.ascontiguousarray(distance_m, dtype=np.float64), offsets
    else:  # lists are several times faster than arrays in interpreted code
        search, distance, limits = _search, distance_m.tolist(), offsets.tolist()
    total = search(distance, limits, lengths, tolerance, spacing, rpg, start, end, counts)
    return _pairs(distance_m, start[:total].copy(), end[:total].copy(), counts, rule.lengths_m, offsets)


def find_end_pairs(distance_m: FloatArray, offsets: IntArray | None = None) -> Pairs:
    """One piece per scene, from its first to its last pose: the end drift. Scenes that do not move have none.

    Args:
        distance_m: ``(N,)`` path travelled, from :func:`path_length`.
        offsets: ``(scenes + 1,)``; ``None``: one scene.
    """
    offsets = scene_offsets(len(distance_m), offsets)
    filled = np.flatnonzero(np.diff(offsets) > 0)
    scene = filled[distance_m[offsets[filled + 1] - 1] > 0.0]
    start, end = offsets[scene], offsets[scene + 1] - 1
    path_m = distance_m[end] - distance_m[start]
    return Pairs(start, end, scene, path_m, path_m, (), offsets)


def find_kitti_pairs(
    distance_m: FloatArray,
    offsets: IntArray | None = None,
    lengths_m: Sequence[float] = KITTI_LENGTHS_M,
    start_step: int = KITTI_START_STEP,
) -> Pairs:
    """Pieces of the KITTI odometry benchmark: every tenth frame starts one, it ends at the first d_j > d_i + L.

    Args:
        distance_m: ``(N,)`` path travelled, from :func:`path_length`.
        offsets: ``(scenes + 1,)``; ``None``: one scene.
        lengths_m: path lengths [m].
        start_step: frames between starts.
    """
    offsets = scene_offsets(len(distance_m), offsets)
    starts, ends = [], []
    counts = np.zeros((len(offsets) - 1, len(lengths_m)), dtype=np.int64)
    for scene, (first, stop) in enumerate(itertools.pairwise(offsets)):
        distance = distance_m[first:stop]
        start = np.arange(0, stop - first, start_step)
        for which, length in enumerate(lengths_m):
            end = np.searchsorted(distance, distance[start] + length, side="right")
            found = end < stop - first
            counts[scene, which] = np.count_nonzero(found)
            starts.append(first + start[found])
            ends.append(first + end[found])
    empty = np.empty(0, dtype=np.int64)
    start, end = np.concatenate([empty, *starts]), np.concatenate([empty, *ends])
    return _pairs(distance_m, start, end, counts, tuple(lengths_m), offsets)


def scene_offsets(rows: int, offsets: IntArray | None) -> IntArray:
    """``offsets`` checked against the number of rows; ``None`` becomes one scene over all of them."""
    if offsets is None:
        return np.array([0, rows], dtype=np.int64)
    checked = np.asarray(offsets, dtype=np.int64)
    if checked[0] != 0 or checked[-1] != rows or np.any(np.diff(checked) < 0):
        raise ConfigurationError(f"expected scene offsets rising from 0 to {rows}, got {checked[0]} to {checked[-1]}")
    return checked


def _pairs(
    distance_m: FloatArray,
    start: IntArray,
    end: IntArray,
    counts: IntArray,
    lengths_m: tuple[float, ...],
    offsets: IntArray,
) -> Pairs:
    scenes = len(counts)
    return Pairs(
        start=start,
        end=end,
        scene=np.repeat(np.arange(scenes), counts.sum(axis=1)),
        length_m=np.repeat(np.tile(np.asarray(lengths_m, dtype=np.float64), scenes), counts.ravel()),
        path_m=distance_m[end] - distance_m[start],
        lengths_m=lengths_m,
        offsets=offsets,
    )


def _search(
    distance: Any,
    offsets: Any,
    lengths: FloatArray,
    tolerance: float,
    spacing: float,
    rpg: bool,
    start: IntArray,
    end: IntArray,
    counts: IntArray,
) -> int:
    """Write all accepted pieces into ``start`` and ``end`` and their number into ``counts``; return the total.

    Plain Python that numba can compile: one source for both speeds. Two pointers make it linear in the poses. Misses
    are written as in the definition, ``(d_j - d_i) - L``, because another order of rounding would break ties otherwise.
    """
    total = 0
    for scene in range(len(offsets) - 1):
        first, stop = offsets[scene], offsets[scene + 1]
        for which in range(len(lengths)):
            length = lengths[which]
            before = total
            beyond = first + 1  # the first pose at or beyond the wanted length
            previous_start = -np.inf
            for i in range(first, stop - 1):
                here = distance[i]
                if here - previous_start < spacing:
                    continue
                previous_start = here
                if tolerance < 0.0 and distance[stop - 1] - here < length:
                    break
                if beyond <= i:
                    beyond = i + 1
                while beyond < stop and (distance[beyond] - here) - length < 0.0:
                    beyond += 1
                j = min(beyond, stop - 1)
                miss = abs((distance[j] - here) - length)
                # Not only one pose back: at a standstill the *first* pose of the plateau counts.
                while j - 1 > i and abs((distance[j - 1] - here) - length) <= miss:
                    j -= 1
                    miss = abs((distance[j] - here) - length)
                if tolerance < 0.0:
                    step = distance[j] - distance[j - 1]
                    if j + 1 < stop:
                        step = max(step, distance[j + 1] - distance[j])
                    accepted = miss <= step
                else:
                    accepted = miss < tolerance * length
                if accepted and distance[j] > here:  # a piece moves, even across a gap longer than 2 L
                    # The reference tool drops starts without an end and then uses the list position as start.
                    start[total] = first + (total - before) if rpg else i
                    end[total] = j
                    total += 1
            if rpg and total - before < 2:  # it also refuses a single sample
                total = before
            counts[scene, which] = total - before
    return total
