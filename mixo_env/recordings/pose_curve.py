"""Poses between the images: a smooth curve through what was written at the steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.recordings.collection import Recordings

FloatArray = NDArray[np.float64]

POINTS = 5
"""Rows whose polynomial gives the slope in a row: two on each side, shifted at the ends of a scene."""


class Curve:
    """Values of every scene at any time: cubic between rows, with the slopes of a polynomial through five of them.

    The slope's error falls with the fourth power of the spacing, which matters between key frames. Outside the rows the
    rate of the first or last step goes on.
    """

    def __init__(self, recordings: Recordings, values: NDArray[np.inexact]) -> None:
        """Lay the curve through ``values`` ``(rows,)``: yaw [rad, unwrapped], or x + iy [m]."""
        rows = np.diff(recordings.offsets)
        first, last = np.repeat(recordings.offsets[:-1], rows), np.repeat(recordings.offsets[1:] - 1, rows)
        self._first, self._before_last = first, np.maximum(last - 1, first)
        self._time_s = recordings["time_s"]
        # One axis for all scenes, which may not overlap: searching once is much faster than scene by scene.
        self._shift_s = np.repeat(np.cumsum(self._time_s[recordings.offsets[1:] - 1] + 1.0), rows)
        self._shifted_s = self._time_s + self._shift_s
        self._values = values
        self._slopes = _slopes(self._time_s, values, first, last)

    def at(self, time_s: FloatArray, row: NDArray[np.int64]) -> NDArray[np.inexact]:
        """Values ``(n,)`` at the times [s] of the scenes to which ``row`` belongs."""
        left = np.searchsorted(self._shifted_s, time_s + self._shift_s[row], side="right") - 1
        left = np.clip(left, self._first[row], self._before_last[row])
        right = np.minimum(left + 1, len(self._time_s) - 1)
        step = np.maximum(self._time_s[right] - self._time_s[left], 1e-9)  # 0 in a scene of one row
        u = (time_s - self._time_s[left]) / step
        begin, rise = self._values[left], self._values[right] - self._values[left]
        start, end = self._slopes[left] * step - rise, self._slopes[right] * step - rise
        inside = (u > 0.0) & (u < 1.0)
        return begin + u * rise + np.where(inside, u * (1.0 - u) * ((1.0 - u) * start - u * end), 0.0)


def _slopes(
    time_s: FloatArray, values: NDArray[np.inexact], first: NDArray[np.int64], last: NDArray[np.int64]
) -> NDArray[np.inexact]:
    """Derivative in every row of the polynomial through ``POINTS`` rows of its scene (all, if it has fewer)."""
    row = np.arange(len(values))
    start = np.clip(row - POINTS // 2, first, np.maximum(last - POINTS + 1, first))
    near = [np.minimum(start + j, last) for j in range(POINTS)]
    there = [start + j <= last for j in range(POINTS)]
    slope = np.zeros_like(values)
    for j in range(POINTS):
        # Lagrange: the weight of row j is the product of (t - t_m) / (t_j - t_m) over the m that are neither.
        weight = np.ones(len(values))
        for m in range(POINTS):
            if m != j:
                counts = there[j] & there[m]
                gap = np.where(counts, time_s[near[j]] - time_s[near[m]], 1.0)
                other = np.where(counts & (near[m] != row), time_s[row] - time_s[near[m]], 1.0)
                weight *= other / gap
        weight[~there[j] | (near[j] == row)] = 0.0  # what is left of the row's own weight: the differences sum to it
        slope += weight * (values[near[j]] - values)
    return slope
