"""From a camera's own image windows to the steps: each increment is carried by the camera's own rate, held.

A camera tells its increment over (t^c_{k-1}, t^c_k], from image to image; step k is (t_{k-1}, t_k]. Between its image
and the end of the round lies the tail a_k = t_k - t^c_k >= 0. The rate of the window, r_k = increment / w_k, is held
over the tail: r_k a_k is added at the end of the window and r_{k-1} a_{k-1}, which the step before has already
counted, taken off at its start. So the steps of a camera add up to its own increments and a tail at both ends. No
yaw-rate sensor and no pose enters.

Where round k-1 has an image but no rate (the first step, a LOST camera), the rate of window k is held backwards over
that tail as well: the own increment is scaled to the length of the step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixo_env.errors import RecordingError

FloatArray = NDArray[np.float64]

YAW_ACCELERATION_RADPS2 = 0.14
"""Root mean square of the yaw acceleration of 68 real nuScenes drives (as in ``experts/monocular/turn.py``)."""

YAW_ACCELERATION_TIME_S = 0.8
"""Correlation time of the yaw acceleration, so that the error of a held rate correlates by .90 from one tail to the
next, as on mixocity. It is then .0049 / .0068 / .0016 deg in a carried increment (front, front left, back right):
between .0034 / .0045 / .0013 on mixocity and .0074 / .0100 / .0026 by the gyro of four real scenes, noise included."""

NOISE_CORRELATION = 0.35
"""Of the errors of successive own increments on mixocity: .26 to .46, by camera (increments wrong by more than 0.06 deg
count as 0.06). What lies further back is taken as independent."""


@dataclass(frozen=True)
class OwnWindows:
    """What one camera says over its own image windows in one scene, row by row; NaN where there is nothing.

    Attributes:
        increment_rad: ``(rows,)`` raw increment since its previous image.
        std_rad: ``(rows,)`` standard deviation of that increment.
        window_s: ``(rows,)`` time since its previous image.
        tail_s: ``(rows,)`` from its image to the end of the round.
    """

    increment_rad: FloatArray
    std_rad: FloatArray
    window_s: FloatArray
    tail_s: FloatArray


def carry(own: OwnWindows, closing: ArrayLike | None = None) -> tuple[FloatArray, FloatArray]:
    """Increments over the steps and their standard deviations.

    A step from row i to row k is a linear form in the own increments of rows i to k: ones, 0 at i, and the held tails.

    Args:
        own: of one camera.
        closing: increasing rows that close the steps; default: all. Between key frames only both ends are carried.

    Returns:
        ``(len(closing),)`` increments and standard deviations [rad]; NaN at the first, and where an own increment
        within the step or the image that opens it is missing.
    """
    rows = np.arange(len(own.tail_s)) if closing is None else np.asarray(closing, dtype=np.int64)
    increments, stds = np.full((2, len(rows)), np.nan)
    if len(rows) < 2:
        return increments, stds
    window, tail = own.window_s, own.tail_s
    i, k = rows[:-1], rows[1:]
    has_rate = np.isfinite(own.increment_rad) & np.isfinite(window) & np.isfinite(tail)
    j = np.where(has_rate[i], i, i + 1)  # whose rate is held over the tail at the start: the one before, else the next
    first = np.concatenate([[0], np.cumsum(k - i + 1)[:-1]])  # the rows of one step after those of another
    row = np.arange(first[-1] + k[-1] - i[-1] + 1) + np.repeat(i - first, k - i + 1)
    weights = np.ones(len(row))
    weights[first] = 0.0
    weights[first + k - i] += tail[k] / window[k]
    weights[first + j - i] -= tail[i] / window[j]

    increments[1:] = np.add.reduceat(_weighted(weights, own.increment_rad[row]), first)
    noise = _weighted(weights, own.std_rad[row])
    beside = np.append(noise[:-1] * noise[1:], 0.0)
    beside[first + k - i] = 0.0  # the next step's
    variance = np.add.reduceat(noise * noise, first) + 2.0 * NOISE_CORRELATION * np.add.reduceat(beside, first)
    # The mean rate of a window differs from that of the tail by the acceleration times the time between middles.
    end = 0.5 * tail[k] * (tail[k] + window[k])
    start = 0.5 * tail[i] * (tail[i] + np.where(j == i, window[j], -window[j]))
    apart = np.add.reduceat(np.where(row > np.repeat(j, k - i + 1), window[row], 0.0), first)
    alike = np.exp(-apart / YAW_ACCELERATION_TIME_S)
    held = end**2 + start**2 - 2.0 * alike * end * start
    stds[1:] = np.sqrt(variance + YAW_ACCELERATION_RADPS2**2 * held)
    return increments, stds


def _weighted(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Products, 0 where the weight is 0 even if the value is missing."""
    counted = weights != 0.0
    return np.where(counted, weights * np.where(counted, values, 0.0), 0.0)


def scaled_to_step(two_frame_rad: ArrayLike, window_s: ArrayLike, tail_s: ArrayLike) -> FloatArray:
    """Stateless increments of two images, carried by their own rate: scaled from their window to the step.

    The image before the pair may never have been processed (a budget environment switches cameras off), so its rate
    must not enter.

    Args:
        two_frame_rad: ``(rows,)`` raw increment between the camera's last two images.
        window_s: ``(rows,)`` as in :class:`OwnWindows`.
        tail_s: ``(rows,)`` likewise.

    Returns:
        ``(rows,)`` rad; NaN in row 0 and wherever the image of this or the previous round is missing.
    """
    raw, window, tail = (np.asarray(values, dtype=np.float64) for values in (two_frame_rad, window_s, tail_s))
    step_s = window + tail - np.concatenate([[np.nan], tail[:-1]])
    return raw * step_s / window


def own_windows(columns: Mapping[str, NDArray[Any]], expert: str, camera: str) -> OwnWindows:
    """The own windows of one scene as its columns hold them, times exact to the microsecond.

    Args:
        columns: of one scene, ``(rows,)`` each.
        expert: a camera, or a variant of it.
        camera: whose images they are.

    Raises:
        RecordingError: if the recording lacks one of the columns.
    """
    names = (
        f"{expert}.own_window_yaw_increment_rad",
        f"{expert}.own_window_yaw_std_rad",
        f"{camera}.own_window_s",
        f"{camera}.image_time_offset_s",
    )
    if missing := [name for name in names if name not in columns]:
        raise RecordingError(f"recordings without own-window columns ({', '.join(missing)}): record anew")
    increment, std, window, offset = (columns[name].astype(np.float64) for name in names)
    return OwnWindows(increment, std, 1e-6 * np.rint(1e6 * window), -1e-6 * np.rint(1e6 * offset))


def carry_camera(columns: Mapping[str, NDArray[Any]], expert: str, camera: str, two_frame_rad: FloatArray) -> None:
    """Fill the carried columns of one expert in one scene from its own windows, in place.

    Args:
        columns: of one scene; the own-window columns and those of the images are there.
        expert: a camera, or a variant of it.
        camera: whose images they are.
        two_frame_rad: ``(rows,)`` raw stateless increments.
    """
    own = own_windows(columns, expert, camera)
    increment, std = carry(own)
    columns[f"{expert}.yaw_increment_rad"][:] = increment
    columns[f"{expert}.yaw_std_rad"][:] = std
    columns[f"{expert}.two_frame_yaw_increment_rad"][:] = scaled_to_step(two_frame_rad, own.window_s, own.tail_s)
