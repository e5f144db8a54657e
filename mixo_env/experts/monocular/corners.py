"""FAST corners on one image, their orientation and binary descriptor: the numba kernels of the feature detector.

FAST-9 (Rosten and Drummond, ECCV 2006): a pixel is a corner when 9 neighbours in a row on a circle of 16 are all
brighter or all darker by more than a threshold; its score is the largest such threshold. ORB (Rublee et al., ICCV
2011): orientation by the intensity centroid, 256 brightness comparisons turned with it in steps of 12 degrees.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.experts.monocular.bits import trailing_zeros

BORDER_PX = 19
"""No corner nearer to the edge: descriptor (radius 13 turned, plus smoothing) and orientation patch fit inside."""

CELL_PX = 32
"""Side of a grid cell: a multiple of 8, since peaks are read eight bytes at a time; a place within fits 16 bits."""

_PATCH_RADIUS = 15  # as in ORB: 31 pixels across, for orientation and comparisons alike
_TURNS = 30  # discrete orientations of the descriptor: steps of 12 degrees, as in ORB


def _comparison_pattern(radius: float = 13.0) -> NDArray[np.int8]:
    """Point pairs of the 256 comparisons for each orientation: ``(30, 256, 4)`` as x1, y1, x2, y2.

    Both points are normal about the corner with a fifth of the patch side as standard deviation (the best of the
    patterns tried by Calonder et al., ECCV 2010), redrawn when outside the radius or nearer than 2 px to one another.
    """
    rng = np.random.default_rng(20230)  # any number, but ever the same: descriptors of other patterns do not compare
    pairs: list[NDArray[np.float64]] = []
    while len(pairs) < 256:
        pair = rng.normal(0.0, (2 * _PATCH_RADIUS + 1) / 5.0, 4)
        inside = max(math.hypot(pair[0], pair[1]), math.hypot(pair[2], pair[3])) <= radius
        if inside and math.hypot(pair[0] - pair[2], pair[1] - pair[3]) >= 2.0:
            pairs.append(pair)
    straight = np.array(pairs).reshape(256, 2, 2)
    turned = []
    for turn in range(_TURNS):
        c, s = math.cos(2.0 * math.pi * turn / _TURNS), math.sin(2.0 * math.pi * turn / _TURNS)
        turned.append(np.rint(straight @ np.array([[c, s], [-s, c]])).reshape(256, 4))
    return np.array(turned).astype(np.int8)


_PATTERN = _comparison_pattern()

_DISC = np.array(
    [[255 * (x * x + y * y <= _PATCH_RADIUS**2) for x in range(-15, 17)] for y in range(-15, 16)], np.uint8
)  # mask of the round orientation patch, an empty 32nd column added


@compiled
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


@compiled
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


@compiled
def corner_scores(image: NDArray[np.uint8], first: int, scores: NDArray[np.uint8]) -> None:
    """FAST-9 scores of consecutive rows, 0 within ``BORDER_PX`` of the edge.

    No branch in the inner loop and bytes throughout: the compiler turns it into instructions on 32 pixels at a time,
    faster than any early rejection.

    Args:
        image: ``(height, width)``.
        first: row that the first row of ``scores`` stands for; may lie outside the image, as may the last.
        scores: ``(rows, >= width)``, overwritten.
    """
    height, width = image.shape
    b = BORDER_PX
    for row in range(len(scores)):
        y, out = first + row, scores[row, b:]
        scores[row] = 0
        if y < b or y >= height - b:
            continue
        centre = image[y, b:]
        r0, r1, r2, r3 = image[y - 3, b:], image[y - 3, b + 1 :], image[y - 2, b + 2 :], image[y - 1, b + 3 :]
        r4, r5, r6, r7 = image[y, b + 3 :], image[y + 1, b + 3 :], image[y + 2, b + 2 :], image[y + 3, b + 1 :]
        r8, r9, r10, r11 = image[y + 3, b:], image[y + 3, b - 1 :], image[y + 2, b - 2 :], image[y + 1, b - 3 :]
        r12, r13, r14, r15 = image[y, b - 3 :], image[y - 1, b - 3 :], image[y - 2, b - 2 :], image[y - 3, b - 1 :]
        for x in range(width - 2 * b):
            ring = (
                r0[x], r1[x], r2[x], r3[x], r4[x], r5[x], r6[x], r7[x],
                r8[x], r9[x], r10[x], r11[x], r12[x], r13[x], r14[x], r15[x],
            )  # fmt: skip
            c = centre[x]
            brighter = np.uint8(max(_largest_minimum(ring), c) - c)
            out[x] = max(brighter, np.uint8(c - min(_smallest_maximum(ring), c)))


@compiled
def _keep_peaks(scores: NDArray[np.uint8], low: int, peaks: NDArray[np.uint8]) -> None:
    """Of all rows but the first and the last: scores above ``low`` that are the maximum of their 3 x 3 neighbourhood.

    Everything else is 0. Of equals the first in reading order stays.
    """
    for y in range(len(peaks)):
        above, here, below, out = scores[y], scores[y + 1], scores[y + 2], peaks[y, 1:]
        a0, a1, a2, h0, h1, h2 = above, above[1:], above[2:], here, here[1:], here[2:]
        b0, b1, b2 = below, below[1:], below[2:]
        least = np.uint8(low)
        for x in range(scores.shape[1] - 2):
            s = h1[x]
            before = max(max(a0[x], a1[x]), max(max(a2[x], h0[x]), least))
            after = max(max(h2[x], b0[x]), max(b1[x], b2[x]))
            out[x] = s * np.uint8((s > before) & (s >= after))


@compiled
def _cell_peaks(
    image: NDArray[np.uint8], high: int, low: int, wanted: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Peaks by grid cell, those below ``high`` left out of cells that have ``wanted`` above it.

    One row of cells at a time, whose scores stay in the processor's cache.

    Returns:
        Keys ``(n,)`` that are smaller the better the peak (its score, then reading order within the cell), and where
        each cell starts ``(cells + 1,)``.
    """
    height, width = image.shape
    rows, columns = -(-height // CELL_PX), -(-width // CELL_PX)
    key = np.empty(height * width // 4 + 1, np.int32)  # of 2 x 2 pixels, one at most is a peak
    start = np.zeros(rows * columns + 1, np.int32)
    scores = np.zeros((CELL_PX + 2, columns * CELL_PX), np.uint8)
    peaks = np.zeros((CELL_PX, columns * CELL_PX), np.uint8)
    words = peaks.view(np.uint64)
    weak = np.int32(255 - high) << 16
    total = 0
    for row in range(rows):
        scores[:2] = scores[CELL_PX:]
        corner_scores(image, row * CELL_PX + 1, scores[2:])
        _keep_peaks(scores, low, peaks)
        for column in range(columns):
            begin = total
            strong = 0
            for y in range(CELL_PX):
                for part in range(CELL_PX // 8):
                    word = words[y, column * (CELL_PX // 8) + part]
                    while word != 0:
                        bit = trailing_zeros(word) & np.uint64(56)  # of the byte, not of its lowest bit
                        score = np.int32((word >> bit) & np.uint64(255))
                        word ^= np.uint64(score) << bit
                        key[total] = (255 - score) << 16 | y * CELL_PX + 8 * part + np.int32(bit >> np.uint64(3))
                        strong += score > high
                        total += 1
            if strong >= wanted:
                end, total = total, begin
                for k in range(begin, end):
                    key[total] = key[k]
                    total += key[k] < weak
            start[row * columns + column + 1] = total
    return key, start


@compiled
def grid_corners(image: NDArray[np.uint8], high: int, low: int, wanted: int, quota: int) -> NDArray[np.int32]:
    """Corners spread evenly: the best of every grid cell first, then the second best of every cell, and so on.

    The threshold falls, cell by cell, where too few exceed it. Of the last round the highest scores are taken.

    Args:
        image: ``(height, width)``.
        high: threshold [grey levels].
        low: threshold of cells with fewer than ``wanted`` corners above ``high``.
        wanted: corners a cell should have.
        quota: corners to take from the image, at most.

    Returns:
        ``(n, 3)``: x, y, score; cell by cell, best first.
    """
    key, start = _cell_peaks(image, high, low, wanted)
    counts = np.diff(start)
    columns = -(-image.shape[1] // CELL_PX)
    # how many rounds are taken in full, and what is left for the last
    full, left = 0, quota
    taken = np.sum(counts > 0)
    while 0 < taken <= left:
        full, left = full + 1, left - taken
        taken = np.sum(counts > full)
    out = np.empty((quota, 3), np.int32)
    last = np.zeros(256, np.int32)  # how often each score occurs in the last round
    for cell in range(len(counts)):  # move the best to the front, in order
        keys = key[start[cell] : start[cell + 1]]
        for rank in range(min(counts[cell], full + 1)):
            best = keys[rank]
            for k in range(rank + 1, len(keys)):
                best, keys[k] = min(best, keys[k]), max(best, keys[k])
            keys[rank] = best
        if counts[cell] > full:
            last[255 - (keys[full] >> 16)] += 1
    lowest = 255  # score from which on the last round is taken; of those that have it, ``left``
    while lowest > 0 and last[lowest] <= left:
        left -= last[lowest]
        lowest -= 1
    total = 0
    for cell in range(len(counts)):
        for rank in range(min(counts[cell], full + 1)):
            at, score = key[start[cell] + rank] & 0xFFFF, 255 - (key[start[cell] + rank] >> 16)
            if rank == full:
                if score < lowest or (score == lowest and left == 0):
                    continue
                left -= score == lowest
            out[total, 0] = cell % columns * CELL_PX + at % CELL_PX
            out[total, 1] = cell // columns * CELL_PX + at // CELL_PX
            out[total, 2] = score
            total += 1
    return out[:total]


@compiled
def orientations(image: NDArray[np.uint8], corners: NDArray[np.int32]) -> NDArray[np.float32]:
    """Direction [rad] ``(n,)`` from corners ``(n, >=2)`` x, y to the centroid of the grey values about them.

    Sixteen bits hold all sums of a patch's columns, plain and weighted: many columns fit one instruction.
    """
    angle = np.empty(len(corners), np.float32)
    side = _DISC.shape[1]
    plain, weighted = np.empty(side, np.int16), np.empty(side, np.int16)
    for i in range(len(corners)):
        left, y = corners[i, 0] - _PATCH_RADIUS, corners[i, 1]
        pixels, mask = image[y, left:], _DISC[_PATCH_RADIUS]
        for k in range(side):
            plain[k] = pixels[k] & mask[k]
            weighted[k] = 0
        for down in range(1, _PATCH_RADIUS + 1):
            below, above, mask = image[y + down, left:], image[y - down, left:], _DISC[_PATCH_RADIUS + down]
            for k in range(side):
                lower, upper = np.int16(below[k] & mask[k]), np.int16(above[k] & mask[k])
                plain[k] += lower + upper
                weighted[k] += np.int16(down) * (lower - upper)
        mx, my = 0, 0
        for k in range(side):
            mx += (k - _PATCH_RADIUS) * plain[k]
            my += weighted[k]
        angle[i] = math.atan2(my, mx)
    return angle


@compiled
def descriptors(
    smooth: NDArray[np.uint8], corners: NDArray[np.int32], angle: NDArray[np.float32]
) -> NDArray[np.uint64]:
    """Descriptors ``(n, 4)`` of corners ``(n, >=2)`` x, y with orientation [rad] ``(n,)`` on the smoothed image."""
    descriptor = np.empty((len(corners), 4), np.uint64)
    stride = smooth.shape[1]
    flat = smooth.ravel()
    offset = np.empty((_TURNS, 2, 256), np.int64)
    for turn in range(_TURNS):
        for k in range(256):
            for point in range(2):
                offset[turn, point, k] = _PATTERN[turn, k, 2 * point] + stride * _PATTERN[turn, k, 2 * point + 1]
    for i in range(len(corners)):
        turn = round(angle[i] * _TURNS / (2.0 * math.pi)) % _TURNS
        at = np.int64(corners[i, 1] * stride + corners[i, 0])
        for word in range(4):
            ones, twos = offset[turn, 0, 64 * word :], offset[turn, 1, 64 * word :]
            bits = np.uint64(0)
            for k in range(64):  # unsigned positions: no test for negative ones
                brighter = flat[np.uint64(at + ones[k])] < flat[np.uint64(at + twos[k])]
                bits |= np.uint64(brighter) << np.uint64(k)
            descriptor[i, word] = bits
    return descriptor
