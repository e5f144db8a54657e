"""Mutual matching of binary descriptors within the nodes of a vocabulary."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixo_env.experts.monocular.bits import population_count
from mixo_env.experts.monocular.features import Features

_FAR = 512  # more bits than a descriptor has
_MIN_COSINE = math.cos(0.5)  # orientations of a match may differ by 0.5 rad: the camera hardly rolls


@njit(cache=True)
def _by_node(node: NDArray[np.int32], nodes: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Indices sorted by node (stable), and where each node starts: ``(nodes + 1,)``."""
    start = np.zeros(nodes + 1, np.int32)
    for k in node:
        start[k + 1] += 1
    for k in range(nodes):
        start[k + 1] += start[k]
    fill = start.copy()
    order = np.empty(len(node), np.int32)
    for i in range(len(node)):
        order[fill[node[i]]] = i
        fill[node[i]] += 1
    return order, start


@njit(cache=True)
def _mutual(
    node1: NDArray[np.int32],
    node2: NDArray[np.int32],
    nodes: int,
    d1: NDArray[np.uint64],
    d2: NDArray[np.uint64],
    looks1: NDArray[np.float32],
    looks2: NDArray[np.float32],
    radius: float,
    max_bits: int,
    ratio: float,
) -> NDArray[np.int32]:
    """Index into the second set for each of the first, -1 without a mutual match.

    ``looks`` holds x, y, level, cosine and sine of the angle as rows ``(5, n)``.
    """
    order1, start1 = _by_node(node1, nodes)
    order2, start2 = _by_node(node2, nodes)
    n, m = len(node1), len(node2)
    b0, b1, b2, b3 = d2[order2, 0], d2[order2, 1], d2[order2, 2], d2[order2, 3]
    x2, y2, level2, cosine2, sine2 = looks2[:, order2]
    found = np.full(n, -1, np.int32)
    back = np.full(m, _FAR, np.int32)
    back_i = np.full(m, -1, np.int32)
    bits = np.empty(m, np.int32)
    for node in range(nodes):
        low, high = start2[node], start2[node + 1]
        for i in order1[start1[node] : start1[node + 1]]:
            a0, a1, a2, a3 = d1[i, 0], d1[i, 1], d1[i, 2], d1[i, 3]
            x, y, level, cosine, sine = looks1[0, i], looks1[1, i], looks1[2, i], looks1[3, i], looks1[4, i]
            for j in range(low, high):  # no branches here: the compiler turns it into vector instructions
                distance = np.int32(
                    population_count(a0 ^ b0[j])
                    + population_count(a1 ^ b1[j])
                    + population_count(a2 ^ b2[j])
                    + population_count(a3 ^ b3[j])
                )
                unlike = (
                    (abs(x2[j] - x) > radius)
                    | (abs(y2[j] - y) > radius)
                    | (abs(level2[j] - level) > 1.5)
                    | (cosine * cosine2[j] + sine * sine2[j] < _MIN_COSINE)
                )
                bits[j] = distance + np.int32(_FAR) * np.int32(unlike)
            nearest, next_nearest, at = _FAR, _FAR, -1
            for j in range(low, high):
                if bits[j] < nearest:
                    next_nearest, nearest, at = nearest, bits[j], j
                elif bits[j] < next_nearest:
                    next_nearest = bits[j]
                if bits[j] < back[j]:
                    back[j], back_i[j] = bits[j], i
            if nearest <= max_bits and nearest <= ratio * next_nearest:
                found[i] = at
    for i in range(n):
        if found[i] >= 0:
            found[i] = order2[found[i]] if back_i[found[i]] == i else -1
    return found


def _looks(features: Features) -> NDArray[np.float32]:
    x, y = features.position_px.T
    return np.stack([x, y, features.level.astype(np.float32), np.cos(features.angle_rad), np.sin(features.angle_rad)])


def match_features(
    first: Features,
    second: Features,
    node1: NDArray[np.int32],
    node2: NDArray[np.int32],
    nodes: int,
    radius_px: float,
    max_bits: int,
    ratio: float,
) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Mutual nearest neighbours in the same node, near one another, of about equal size and orientation.

    Args:
        first: features of one image.
        second: features of another.
        node1: ``(len(first),)`` vocabulary node of each feature.
        node2: ``(len(second),)`` the same.
        nodes: number of nodes; 1 compares everything with everything.
        radius_px: half the side of the search window [working px].
        max_bits: largest Hamming distance.
        ratio: best distance over second best, at most.

    Returns:
        Indices ``(k,)`` into the first and ``(k,)`` into the second set.
    """
    found = _mutual(
        node1,
        node2,
        nodes,
        first.descriptor,
        second.descriptor,
        _looks(first),
        _looks(second),
        radius_px,
        max_bits,
        ratio,
    )
    chosen = np.flatnonzero(found >= 0)
    return chosen, found[chosen]
