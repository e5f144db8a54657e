"""How noisy the truth of real data is: below that error no difference between rows means anything.

Poses p, cameras c and gyro i are three instruments of one turn, with errors that have nothing to do with each other. So
over windows of any length the mean of (p - c)(p - i) is the variance of the poses' own error alone, whatever cameras
and gyro are wrong by (a three-cornered hat). Its growth with the length of the window tells how long the errors last.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import MAD_TO_SIGMA
from mixo_env.recordings.collection import Recordings

FloatArray = NDArray[np.float64]

NOISE_FLOOR = "NOISE FLOOR"
"""Row of the leaderboard: the true yaw plus the noise estimated here. Only where the headline is no exact truth."""

INDEPENDENT = "INERTIAL"
"""The third instrument: a gyro. ``INERTIAL_POSE`` comes from the localisation itself and cannot be one."""

TIMES_S = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
"""Correlation times whose mixture, with white noise, is fitted to the variances."""

LONGEST_S = 4.0
"""Windows in which the drift of the gyro does not yet bury the noise of the poses."""

LEAST_WINDOWS = 100
MOVING_MPS = 1.0  # localisation wanders while the car moves, and pieces of path are driven
CLIPPED = 5.0  # robust standard deviations: a captured camera or a jump of the gyro must not decide

DIFFERENCES = 3
GAIN = 20.0  # variance of third differences of white noise over that of the noise: 1 + 9 + 9 + 1

Source = Literal["cameras and gyro", "gyro", "nothing"]


@dataclass(frozen=True)
class YawNoise:
    """Noise of the true yaw while the car moves: white, and Ornstein-Uhlenbeck processes of ``TIMES_S``.

    Attributes:
        white_rad: standard deviation of what is new in every pose.
        lasting_rad: standard deviation for each of ``TIMES_S``.
        source: what it was told from. The gyro alone tells white noise only, a weak lower bound.
    """

    white_rad: float
    lasting_rad: tuple[float, ...]
    source: Source

    def variance_rad2(self, window_s: FloatArray) -> FloatArray:
        """Of the error of the yaw increment over windows ``(n,)`` [s] of driving."""
        return _growth(window_s) @ np.square([self.white_rad, *self.lasting_rad])

    def draw(self, recordings: Recordings, seed: int = 0) -> FloatArray:
        """``(rows,)`` yaw errors [rad] like those of the poses; they rest while the car stands."""
        rng = np.random.default_rng(seed)
        times, std = np.array(TIMES_S), np.array(self.lasting_rad)
        moving = _moving(recordings)
        passed_s = np.where(moving, np.nan_to_num(recordings["dt_s"]), 0.0)
        keep = np.exp(-passed_s[:, None] / times)
        new, white = rng.standard_normal(keep.shape), rng.standard_normal(len(keep))
        errors = np.empty(len(keep))
        for first, stop in itertools.pairwise(recordings.offsets.tolist()):
            state, last = new[first], white[first]
            errors[first] = state @ std + last * self.white_rad
            for k in range(first + 1, stop):
                state = keep[k] * state + np.sqrt(1.0 - keep[k] ** 2) * new[k]
                last = white[k] if moving[k] else last
                errors[k] = state @ std + last * self.white_rad
        return errors


def yaw_noise(recordings: Recordings) -> YawNoise:
    """The noise of the poses, from the cameras' median and the gyro; what their errors share with either stays unseen.

    Without cameras only what a smooth gyro cannot follow can be told: white noise. Without a gyro, nothing.
    """
    nothing = (0.0,) * len(TIMES_S)
    if f"{INDEPENDENT}.yaw_increment_rad" not in recordings:
        return YawNoise(0.0, nothing, "nothing")
    windows, variances, errors = hat(recordings)
    if len(windows) < 2:
        return YawNoise(white_noise_rad(recordings), nothing, "gyro")
    parts = np.sqrt(_least_squares_from_zero(_growth(windows) / errors[:, None], variances / errors))
    return YawNoise(float(parts[0]), tuple(map(float, parts[1:])), "cameras and gyro")


def hat(recordings: Recordings) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Variance of the poses' error over windows of 1, 2, 4 ... steps up to 4 s, from poses, cameras and gyro.

    Returns:
        ``(n,)`` lengths [s], variances of the yaw increment [rad^2] (negative by chance where they are small) and
        their standard errors; empty without cameras or with too few windows that move.
    """
    cameras = recordings.manifest.cameras
    found = []
    if cameras:
        seen = np.stack([recordings[f"{camera}.yaw_increment_rad"].astype(np.float64) for camera in cameras])
        there = np.isfinite(seen).any(axis=0)
        consensus = np.full(seen.shape[1], np.nan)
        consensus[there] = np.nanmedian(seen[:, there], axis=0)
        truth = recordings["truth.yaw_increment_rad"]
        apart = (truth - consensus, truth - recordings[f"{INDEPENDENT}.yaw_increment_rad"].astype(np.float64))
        for first, last in _windows(recordings):
            by_camera, by_gyro = (_sums(values, first, last) for values in apart)
            both = np.isfinite(by_camera + by_gyro)
            if both.sum() < LEAST_WINDOWS:
                continue
            product = _clipped(by_camera[both]) * _clipped(by_gyro[both])
            length = float(np.mean(recordings["time_s"][last[both]] - recordings["time_s"][first[both]]))
            steps = recordings["dt_s"][last[both]].mean()
            independent = max(len(product) * steps / length, 1.0)  # overlapping windows repeat each other
            found.append((length, product.mean(), max(np.sqrt(np.mean(product**2) / independent), 1e-18)))
    lengths, variances, errors = np.array(found, dtype=np.float64).reshape(-1, 3).T
    return lengths, variances, errors


def white_noise_rad(recordings: Recordings) -> float:
    """Standard deviation of the white noise of the true yaw, from what INERTIAL cannot follow.

    INERTIAL is smooth: what is left of the disagreement after three differences is the noise of the poses (and the
    gyro's, which is filtered). The median absolute deviation keeps turns and jumps out.
    """
    disagreement = recordings["truth.yaw_increment_rad"] - recordings[f"{INDEPENDENT}.yaw_increment_rad"]
    left = [
        np.diff(disagreement[first + 1 : stop], DIFFERENCES - 1)  # an increment is the first difference
        for first, stop in itertools.pairwise(recordings.offsets.tolist())
    ]
    values = np.concatenate(left)
    values = values[np.isfinite(values)]
    return float(MAD_TO_SIGMA * np.median(np.abs(values)) / np.sqrt(GAIN)) if len(values) else 0.0


def _least_squares_from_zero(columns: FloatArray, values: FloatArray) -> FloatArray:
    """Coefficients >= 0 that fit ``columns`` ``(n, few)`` to ``values`` ``(n,)`` best: every subset is tried."""
    best, least = np.zeros(columns.shape[1]), float(values @ values)
    for size in range(1, columns.shape[1] + 1):
        for subset in map(list, itertools.combinations(range(columns.shape[1]), size)):
            found = np.linalg.lstsq(columns[:, subset], values, rcond=None)[0]
            left = values - columns[:, subset] @ found
            if (found >= 0.0).all() and left @ left < least:
                best, least = np.zeros(columns.shape[1]), float(left @ left)
                best[subset] = found
    return best


def _growth(window_s: FloatArray) -> FloatArray:
    """``(n, 1 + times)`` variance of an increment per unit variance of the white and of each lasting noise."""
    lasting = 2.0 * (1.0 - np.exp(-window_s[:, None] / np.array(TIMES_S)))
    return np.concatenate([np.full((len(window_s), 1), 2.0), lasting], axis=1)


def _moving(recordings: Recordings) -> NDArray[np.bool_]:
    moved = np.abs(np.nan_to_num(recordings["distance_m"].astype(np.float64)))
    return moved > MOVING_MPS * np.nan_to_num(recordings["dt_s"])


def _windows(recordings: Recordings) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """First and last rows of all windows of 1, 2, 4 ... steps within a scene in which every step moves."""
    rows, row = np.diff(recordings.offsets), np.arange(recordings.offsets[-1])
    end = np.repeat(recordings.offsets[1:], rows)
    stood = np.cumsum(~_moving(recordings))
    typical_s = float(np.median(recordings["dt_s"][recordings["step"] > 0])) if (rows > 1).any() else np.inf
    steps = 1
    while steps * typical_s <= LONGEST_S:
        first = row[row + steps < end]
        last = first + steps
        moves = stood[last] == stood[first]
        yield first[moves], last[moves]
        steps *= 2


def _sums(increments: FloatArray, first: NDArray[np.int64], last: NDArray[np.int64]) -> FloatArray:
    """Increments added up over the windows; NaN where one is missing."""
    total, missing = np.cumsum(np.nan_to_num(increments)), np.cumsum(~np.isfinite(increments))
    return np.where(missing[last] == missing[first], total[last] - total[first], np.nan)


def _clipped(values: FloatArray) -> FloatArray:
    reach = CLIPPED * MAD_TO_SIGMA * float(np.median(np.abs(values)))
    return np.clip(values, -reach, reach)
