"""FAST corners on one image, their orientation and binary descriptor: the numba kernels of the feature detector.

FAST-9 (Rosten and Drummond, ECCV 2006): a pixel is a corner when 9 neighbours in a row on a circle of 16 are all
brighter or all darker by more than a threshold; its score is the largest such threshold. ORB (Rublee et al., ICCV
2011): orientation by the intensity centroid, 256 brightness comparisons turned with it in steps of 12 degrees.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

BORDER_PX = 19
"""No corner nearer to the edge: descriptor (radius 13 turned, plus smoothing) and orientation patch fit inside."""

_PATCH_RADIUS = 15
_TURNS = 30  # discrete orientations of the descriptor


def _comparison_pattern(radius: float = 13.0) -> NDArray[np.int8]:
    """Point pairs of the 256 comparisons for each orientation: ``(30, 256, 4)`` as x1, y1, x2, y2.

    Both points are normal about the corner with a fifth of the patch side as standard deviation (the best of the
    patterns tried by Calonder et al., ECCV 2010), redrawn when outside the radius or nearer than 2 px to one another.
    """
    rng = np.random.default_rng(20230)
    pairs: list[NDArray[np.float64]] = []
    while len(pairs) < 256:
        pair = rng.normal(0.0, 31.0 / 5.0, 4)
        inside = max(math.hypot(pair[0], pair[1]), math.hypot(pair[2], pair[3])) <= radius
        if inside and math.hypot(pair[0] - pair[2], pair[1] - pair[3]) >= 2.0:
            pairs.append(pair)
    straight = np.array(pairs).reshape(256, 2, 2)
    turned = []
    for turn in range(_TURNS):
        c, s = math.cos(2.0 * math.pi * turn / _TURNS), math.sin(2.0 * math.pi * turn / _TURNS)
        turned.append(np.rint(straight @ np.array([[c, s], [-s, c]])).reshape(256, 4))
    return np.array(turned).astype(np.int8)


@njit(cache=True)
def _largest_minimum(ring: tuple[int, ...]) -> int:
    """Largest, over the 16 runs of nine in a row, of the run's smallest value; runs k and k + 1 share eight."""
    d0, d1, d2, d3, d4, d5, d6, d7, d8, d9, d10, d11, d12, d13, d14, d15 = ring
    a1, a3, a5, a7 = min(d1, d2), min(d3, d4), min(d5, d6), min(d7, d8)
    a9, a11, a13, a15 = min(d9, d10), min(d11, d12), min(d13, d14), min(d15, d0)
    b1, b3, b5, b7 = min(a1, a3), min(a3, a5), min(a5, a7), min(a7, a9)
    b9, b11, b13, b15 = min(a9, a11), min(a11, a13), min(a13, a15), min(a15, a1)
    best = min(min(b1, b5), max(d0, d9))
    best = max(best, min(min(b3, b7), max(d2, d11)))
    best = max(best, min(min(b5, b9), max(d4, d13)))
    best = max(best, min(min(b7, b11), max(d6, d15)))
    best = max(best, min(min(b9, b13), max(d8, d1)))
    best = max(best, min(min(b11, b15), max(d10, d3)))
    best = max(best, min(min(b13, b1), max(d12, d5)))
    return max(best, min(min(b15, b3), max(d14, d7)))


@njit(cache=True)
def _smallest_maximum(ring: tuple[int, ...]) -> int:
    """The mirror of :func:`_largest_minimum`."""
    d0, d1, d2, d3, d4, d5, d6, d7, d8, d9, d10, d11, d12, d13, d14, d15 = ring
    a1, a3, a5, a7 = max(d1, d2), max(d3, d4), max(d5, d6), max(d7, d8)
    a9, a11, a13, a15 = max(d9, d10), max(d11, d12), max(d13, d14), max(d15, d0)
    b1, b3, b5, b7 = max(a1, a3), max(a3, a5), max(a5, a7), max(a7, a9)
    b9, b11, b13, b15 = max(a9, a11), max(a11, a13), max(a13, a15), max(a15, a1)
    best = max(max(b1, b5), min(d0, d9))
    best = min(best, max(max(b3, b7), min(d2, d11)))
    best = min(best, max(max(b5, b9), min(d4, d13)))
    best = min(best, max(max(b7, b11), min(d6, d15)))
    best = min(best, max(max(b9, b13), min(d8, d1)))
    best = min(best, max(max(b11, b15), min(d10, d3)))
    best = min(best, max(max(b13, b1), min(d12, d5)))
    return min(best, max(max(b15, b3), min(d14, d7)))


@njit(cache=True)
def corner_scores(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """FAST-9 score of every pixel, 0 within ``BORDER_PX`` of the edge; same shape as ``image``.

    No branch in the inner loop: the compiler turns it into instructions on 32 pixels at a time, faster than any early
    rejection.
    """
    height, width = image.shape
    scores = np.zeros_like(image)
    b = BORDER_PX
    for y in range(b, height - b):
        centre, out = image[y, b:], scores[y, b:]
        r0, r1, r2, r3 = image[y - 3, b:], image[y - 3, b + 1 :], image[y - 2, b + 2 :], image[y - 1, b + 3 :]
        r4, r5, r6, r7 = image[y, b + 3 :], image[y + 1, b + 3 :], image[y + 2, b + 2 :], image[y + 3, b + 1 :]
        r8, r9, r10, r11 = image[y + 3, b:], image[y + 3, b - 1 :], image[y + 2, b - 2 :], image[y + 1, b - 3 :]
        r12, r13, r14, r15 = image[y, b - 3 :], image[y - 1, b - 3 :], image[y - 2, b - 2 :], image[y - 3, b - 1 :]
        for x in range(width - 2 * b):
            ring = (
                r0[x], r1[x], r2[x], r3[x], r4[x], r5[x], r6[x], r7[x],
                r8[x], r9[x], r10[x], r11[x], r12[x], r13[x], r14[x], r15[x],
            )  # fmt: skip
            bright, dark = np.int16(_largest_minimum(ring)), np.int16(_smallest_maximum(ring))
            c = np.int16(centre[x])
            out[x] = np.uint8(max(max(bright - c, c - dark), np.int16(0)))
    return scores


@njit(cache=True)
def _keep_peaks(scores: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Scores with all but the maxima of 3 x 3 neighbourhoods set to 0; of equals the first in reading order stays."""
    height, width = scores.shape
    peaks = np.zeros_like(scores)
    for y in range(1, height - 1):
        above, here, below, out = scores[y - 1], scores[y], scores[y + 1], peaks[y, 1:]
        a0, a1, a2, h0, h1, h2 = above, above[1:], above[2:], here, here[1:], here[2:]
        b0, b1, b2 = below, below[1:], below[2:]
        for x in range(width - 2):
            s = h1[x]
            first = (s > a0[x]) & (s > a1[x]) & (s > a2[x]) & (s > h0[x])
            out[x] = s * np.uint8(first & (s >= h2[x]) & (s >= b0[x]) & (s >= b1[x]) & (s >= b2[x]))
    return peaks


@njit(cache=True)
def grid_corners(image: NDArray[np.uint8], high: int, low: int, cell_px: int, wanted: int) -> NDArray[np.int32]:
    """Local maxima of the corner score above a threshold that falls, cell by cell, where too few exceed it.

    Args:
        image: ``(height, width)``.
        high: threshold [grey levels].
        low: threshold of cells with fewer than ``wanted`` corners above ``high``.
        cell_px: side of a grid cell.
        wanted: corners a cell should have.

    Returns:
        ``(n, 4)``: x, y, score, rank of the corner within its cell (0 is the best).
    """
    peaks = _keep_peaks(corner_scores(image))
    height, width = peaks.shape
    cell = np.empty((cell_px * cell_px, 3), np.int32)
    out = np.empty((height * width // 4 + 1, 4), np.int32)
    total = 0
    for top in range(0, height, cell_px):
        for left in range(0, width, cell_px):
            count, strong = 0, 0
            for y in range(top, min(top + cell_px, height)):
                for x in range(left, min(left + cell_px, width)):
                    score = np.int32(peaks[y, x])
                    if score > low:
                        cell[count, 0], cell[count, 1], cell[count, 2] = x, y, score
                        count += 1
                        strong += score > high
            order = np.argsort(-cell[:count, 2], kind="mergesort")
            for rank in range(strong if strong >= wanted else count):
                k = order[rank]
                out[total, 0], out[total, 1], out[total, 2], out[total, 3] = cell[k, 0], cell[k, 1], cell[k, 2], rank
                total += 1
    return out[:total]


@njit(cache=True)
def describe(
    image: NDArray[np.uint8],
    smooth: NDArray[np.uint8],
    corners: NDArray[np.int32],
    half_widths: NDArray[np.int32],
    pattern: NDArray[np.int8],
) -> tuple[NDArray[np.float32], NDArray[np.uint64]]:
    """Orientation [rad] ``(n,)`` and descriptor ``(n, 4)`` uint64 of corners ``(n, >=2)`` x, y."""
    n = len(corners)
    angle = np.empty(n, np.float32)
    descriptor = np.empty((n, 4), np.uint64)
    radius = len(half_widths) - 1
    stride = smooth.shape[1]
    flat = smooth.ravel()
    offset = np.empty((_TURNS, 256, 2), np.int32)
    for turn in range(_TURNS):
        for k in range(256):
            for point in range(2):
                offset[turn, k, point] = pattern[turn, k, 2 * point] + stride * np.int32(
                    pattern[turn, k, 2 * point + 1]
                )
    for i in range(n):
        x, y = corners[i, 0], corners[i, 1]
        mx = np.int32(0)
        my = np.int32(0)
        for dy in range(-radius, radius + 1):
            row = np.int32(0)
            for dx in range(-half_widths[abs(dy)], half_widths[abs(dy)] + 1):
                value = np.int32(image[y + dy, x + dx])
                row += value
                mx += np.int32(dx) * value
            my += np.int32(dy) * row
        angle[i] = math.atan2(my, mx)
        turn = round(angle[i] * _TURNS / (2.0 * math.pi)) % _TURNS
        at = y * stride + x
        for word in range(4):
            bits = np.uint64(0)
            for k in range(64):
                first, second = offset[turn, word * 64 + k, 0], offset[turn, word * 64 + k, 1]
                bits |= np.uint64(flat[at + first] < flat[at + second]) << np.uint64(k)
            descriptor[i, word] = bits
    return angle, descriptor


HALF_WIDTHS = np.array([math.floor(math.sqrt(_PATCH_RADIUS**2 - dy**2)) for dy in range(_PATCH_RADIUS + 1)], np.int32)
"""Half the width of each row of the round orientation patch."""

PATTERN = _comparison_pattern()
