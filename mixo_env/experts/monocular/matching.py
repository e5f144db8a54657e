"""Mutual matching of binary descriptors among features of similar words, orientation, size and place.

Every feature of the second image lies in the node of its nearest word. Features of the first look into the nodes of
their several nearest words: descriptors of one corner often fall on either side of a border between words, and with
a single node the best of the wrong ones would take their place. Within a node features are sorted by orientation, so
that only those that can match are touched at all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.experts.monocular.bits import population_count, trailing_zeros
from mixo_env.experts.monocular.features import Features

_X, _Y, _LEVEL, _ANGLE, _COSINE, _SINE = range(6)
"""Rows of looks: one single-precision block, so that the test of a block runs in SIMD."""

_FAR = 512  # more bits than a descriptor has
_TURN_RAD = 0.5  # orientations of a match may differ by so much: the camera hardly rolls
_MIN_COSINE = math.cos(_TURN_RAD)
_SECTORS = 64  # of orientation, in which a node is sorted: 13 can hold a match, hardly more than its range
_LEVELS = np.float32(1.5)  # pyramid levels of a match may differ by one: sizes change little between images
_BLOCK = 16  # candidates tested at a time: whole SIMD registers, and a multiple of the eight flags in a word
_REACH = math.ceil(_TURN_RAD / (2.0 * math.pi) * _SECTORS)


@compiled
def _sort(bucket: NDArray[np.int32], buckets: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Indices sorted by bucket (stable), and where each bucket starts: ``(buckets + 1,)``."""
    start = np.zeros(buckets + 1, np.int32)
    for k in bucket:
        start[k + 1] += 1
    for k in range(buckets):
        start[k + 1] += start[k]
    fill = start.copy()
    order = np.empty(len(bucket), np.int32)
    for i in range(len(bucket)):
        order[fill[bucket[i]]] = i
        fill[bucket[i]] += 1
    return order, start


@compiled
def _sector(angle: float) -> int:
    return int((angle / (2.0 * math.pi) + 1.0) * _SECTORS) % _SECTORS


@compiled
def _at_most(limit: float) -> np.float32:
    """Largest single precision number that is not above a limit: comparing with either is the same."""
    near = np.float32(limit)
    return near if near <= limit else np.nextafter(near, np.float32(-np.inf))


@compiled
def _compare_looks(
    look: NDArray[np.float32],
    looks: NDArray[np.float32],
    block: int,
    reach: np.floating,
    straight: np.floating,
    similar: NDArray[np.uint8],
) -> None:
    """Which features of a block are near one, of about its size and orientation: 1, else 0.

    No branch, single precision throughout: one instruction serves many features.

    Args:
        look: ``(6,)`` of the one: x, y, level, angle, its cosine and its sine.
        looks: ``(6, m)`` of the others.
        block: the first of the block.
        reach: distance along x and y, at most.
        straight: cosine of the angle between orientations, at least.
        similar: ``(block length,)``, overwritten.
    """
    x, y, level, cosine, sine = look[_X], look[_Y], look[_LEVEL], look[_COSINE], look[_SINE]
    xs, ys, levels, cosines, sines = looks[_X], looks[_Y], looks[_LEVEL], looks[_COSINE], looks[_SINE]
    for k in range(_BLOCK):
        j = np.uint64(block + k)
        similar[k] = (
            (abs(xs[j] - x) <= reach)
            & (abs(ys[j] - y) <= reach)
            & (abs(levels[j] - level) <= _LEVELS)
            & (cosine * cosines[j] + sine * sines[j] >= straight)
        )


class _Side(NamedTuple):
    """Features of one image as the kernel sees them.

    Attributes:
        nodes: ``(n, p)`` nearest nodes of each, the nearest first.
        descriptor: ``(n, 4)``.
        looks: ``(n, 6)`` x, y, level, angle, its cosine and its sine.
    """

    nodes: NDArray[np.int32]
    descriptor: NDArray[np.uint64]
    looks: NDArray[np.float32]


class _Grouped(NamedTuple):
    """Features sorted by nearest node, then by sector of orientation.

    Attributes:
        order: ``(m,)`` which feature each of them is.
        start: ``(nodes * sectors + 1,)`` where each sector of each node starts.
        descriptor: ``(m, 4)``.
        looks: ``(6, m + block)``, a block that is infinitely far at the end.
    """

    order: NDArray[np.int32]
    start: NDArray[np.int32]
    descriptor: NDArray[np.uint64]
    looks: NDArray[np.float32]


class MatchLimits(NamedTuple):
    """What a match must keep to.

    Attributes:
        radius_px: half the side of the search window [working px].
        max_bits: largest Hamming distance.
        ratio: best distance over second best, at most.
    """

    radius_px: float
    max_bits: int
    ratio: float


@compiled
def _group(side: _Side, nodes: int) -> _Grouped:
    m = len(side.nodes)
    bucket = np.empty(m, np.int32)
    for j in range(m):
        bucket[j] = side.nodes[j, 0] * _SECTORS + _sector(side.looks[j, _ANGLE])
    order, start = _sort(bucket, nodes * _SECTORS)
    beyond = np.full((6, _BLOCK), np.inf, np.float32)  # whole blocks are tested: what lies beyond the last is far
    looks = np.concatenate((side.looks[order].T, beyond), axis=1)
    return _Grouped(order, start, side.descriptor[order], looks)


@compiled
def _mutual(ours: _Side, theirs: _Side, nodes: int, limits: MatchLimits) -> NDArray[np.int32]:
    """Index into their set for each of ours, -1 without a mutual match."""
    nodes1, d1, looks1 = ours
    n, m = len(ours.nodes), len(theirs.nodes)
    order, start, words, looks = _group(theirs, nodes)
    radius, max_bits, ratio = limits
    reach, straight = _at_most(radius), -_at_most(-_MIN_COSINE)
    similar = np.empty(_BLOCK, np.uint8)
    flags = similar.view(np.uint64)
    found = np.full(n, -1, np.int32)
    back = np.full(m, _FAR, np.int32)
    back_i = np.full(m, -1, np.int32)
    for i in range(n):
        a0, a1, a2, a3 = d1[i, 0], d1[i, 1], d1[i, 2], d1[i, 3]
        low = _sector(looks1[i, _ANGLE]) - _REACH
        high = low + 2 * _REACH + 1
        nearest, next_nearest, at = _FAR, _FAR, -1
        for node in nodes1[i]:
            base = node * _SECTORS
            for around in (-_SECTORS, 0, _SECTORS):  # sectors close to a circle
                first, last = max(low + around, 0), min(high + around, _SECTORS)
                if first >= last:
                    continue
                end = start[base + last]
                for block in range(start[base + first], end, _BLOCK):
                    _compare_looks(looks1[i], looks, block, reach, straight, similar)
                    for part in range(_BLOCK // 8):
                        flag = flags[part]
                        while flag != 0:
                            j = block + 8 * part + np.int64(trailing_zeros(flag) >> np.uint64(3))
                            flag &= flag - np.uint64(1)
                            if j >= end:
                                break
                            bits = np.int32(
                                population_count(a0 ^ words[j, 0])
                                + population_count(a1 ^ words[j, 1])
                                + population_count(a2 ^ words[j, 2])
                                + population_count(a3 ^ words[j, 3])
                            )
                            if bits < nearest:
                                next_nearest, nearest, at = nearest, bits, j
                            elif bits < next_nearest:
                                next_nearest = bits
                            if bits < back[j]:
                                back[j], back_i[j] = bits, i
        if nearest <= max_bits and nearest <= ratio * next_nearest:
            found[i] = at
    for i in range(n):
        if found[i] >= 0:
            found[i] = order[found[i]] if back_i[found[i]] == i else -1
    return found


def _looks(features: Features) -> NDArray[np.float32]:
    (x, y), angle = features.position_px.T, features.angle_rad
    return np.stack([x, y, features.level.astype(np.float32), angle, np.cos(angle), np.sin(angle)], axis=1)


def match_features(
    first: Features,
    second: Features,
    words1: NDArray[np.int32],
    words2: NDArray[np.int32],
    words: int,
    limits: MatchLimits,
) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Mutual nearest neighbours of similar words, near one another, of about equal size and orientation.

    Args:
        first: features of one image.
        second: features of another.
        words1: ``(len(first), p)`` nearest words of each feature, the nearest first.
        words2: ``(len(second), p)`` the same; only the nearest counts.
        words: number of words; 1 compares everything with everything.
        limits: window and distances.

    Returns:
        Indices ``(k,)`` into the first and ``(k,)`` into the second set.
    """
    found = _mutual(
        _Side(words1, first.descriptor, _looks(first)), _Side(words2, second.descriptor, _looks(second)), words, limits
    )
    chosen = np.flatnonzero(found >= 0)
    return chosen, found[chosen]
