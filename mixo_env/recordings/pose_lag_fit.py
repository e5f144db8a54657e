"""How late the written poses of a vehicle are, told by what its cameras saw turn."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import MAD_TO_SIGMA
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.pose_curve import Curve
from mixo_env.recordings.pose_lag import EARLIEST_S, LATEST_S, as_written

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]

LARGEST_STD_S = 0.010
"""A lag less certain than this (standard error) is not used."""

LEAST_DRIVE_M = 20.0
"""What a vehicle must have driven: against a camera that stands without any error, wandering poses look informative."""

HUBER_SIGMAS = 1.345
"""Residuals beyond so many robust standard deviations count linearly."""

_GRID_S = 0.01
_TOLERANCE_S = 5e-5
_LEAST_SIGMA_RAD = 1e-6  # a source without error (a car that stands, the exact truth): no weight may become infinite
_BLOCK_S = 2.0  # errors further apart are taken as independent: localisation wanders for about so long
_LEAST_WINDOWS = 50


@dataclass(frozen=True)
class Turns:
    """What one source measured of the car's turning, in windows of its own; NaN where there is none.

    Attributes:
        begin_s, end_s: ``(rows,)`` the window, in scene time.
        turn_rad: ``(rows,)`` yaw increment over it.
    """

    begin_s: FloatArray
    end_s: FloatArray
    turn_rad: FloatArray


@dataclass(frozen=True)
class PoseLag:
    """A lag and how well it is known.

    Attributes:
        lag_s: how late written poses are.
        std_s: standard error; infinite where nothing can be said.
        windows: measured turns it rests on.
    """

    lag_s: float
    std_s: float
    windows: int

    @property
    def known(self) -> bool:
        """Certain enough to be used."""
        return self.std_s <= LARGEST_STD_S


UNKNOWN = PoseLag(0.0, float("inf"), 0)


def camera_turns(recordings: Recordings) -> list[Turns]:
    """Turns seen by every TRACKING camera over its own image windows: nothing carried, nothing inertial."""
    turns = []
    for camera in recordings.manifest.cameras:
        end = recordings["time_s"] + recordings[f"{camera}.image_time_offset_s"]
        window = recordings[f"{camera}.own_window_s"].astype(np.float64)
        own = recordings[f"{camera}.own_window_yaw_increment_rad"].astype(np.float64)
        turns.append(Turns(end - window, end, own))
    return turns


def step_turns(recordings: Recordings, increment_rad: NDArray[np.floating]) -> list[Turns]:
    """Turns of a source that covers whole steps: an inertial expert, or the exact truth."""
    end = recordings["time_s"]
    return [Turns(end - recordings["dt_s"], end, increment_rad.astype(np.float64))]


def fit_pose_lag(recordings: Recordings, sources: Sequence[Turns] | None = None) -> PoseLag:
    """The lag at which written poses turn like the sources.

    That is argmin over lag of the sum of huber([psi(t_e + lag) - psi(t_b + lag) - turn] / sigma_source) with psi the
    curve through the written yaw, (t_b, t_e] each source's own windows and sigma MAD_TO_SIGMA x the median absolute
    residual of a source. The curve is moved as a whole; a regression of the residual on the change of the poses' own
    rate finds some 4 ms less: the noise of that rate attenuates the coefficient, and differences over two steps flatten
    it (docs/decisions.md has figures).

    The standard error takes blocks of 2 s as independent (errors of a localisation wander) and as information only
    the changes of rate on which poses and sources agree: noise of the poses says nothing about their lag.

    Args:
        recordings: scenes of one vehicle, at 12 Hz or at key frames.
        sources: what turned when; default :func:`camera_turns`.

    Returns:
        :data:`UNKNOWN` if the scenes drive less than 20 m, if fewer than 50 windows are measured or if the best lag
        lies at the end of -50 to 150 ms.
    """
    recordings = as_written(recordings)
    if np.nansum(np.abs(recordings["truth.distance_m"])) < LEAST_DRIVE_M:
        return UNKNOWN
    windows = _Windows(recordings, camera_turns(recordings) if sources is None else sources)
    if len(windows.turn_rad) < _LEAST_WINDOWS:
        return UNKNOWN
    grid = np.arange(EARLIEST_S, LATEST_S + 0.5 * _GRID_S, _GRID_S)
    sigma = windows.sigma_rad(0.0)
    best = int(np.argmin([windows.cost(float(lag), sigma) for lag in grid]))
    if best in (0, len(grid) - 1):
        return UNKNOWN
    lag = float(grid[best])
    for reach in (_GRID_S, 0.5 * _GRID_S):
        sigma = windows.sigma_rad(lag)
        lag = windows.minimum(lag - reach, lag + reach, sigma)
    return PoseLag(lag, windows.standard_error_s(lag, sigma), len(windows.turn_rad))


def fit_pose_lags(training: Recordings, vehicles: Iterable[str]) -> dict[str, float]:
    """Lag by vehicle [s], from its own scenes in ``training`` alone; 0, and said in the log, where none is known."""
    lags = {}
    for vehicle in dict.fromkeys(vehicles):
        own = [scene.name for scene in training.scenes if scene.vehicle == vehicle]
        found = fit_pose_lag(training.select(scenes=own)) if own else UNKNOWN
        lags[vehicle] = found.lag_s if found.known else 0.0
        if not found.known:
            reason = "drives in no training scene" if not own else "shows its cameras too little turning to tell"
            logger.info("pose lag of vehicle %s stays 0: it %s", vehicle, reason)
    return lags


class _Windows:
    """All measured windows of all sources, flat."""

    def __init__(self, recordings: Recordings, sources: Sequence[Turns]) -> None:
        rows = np.diff(recordings.offsets)
        time_s = recordings["time_s"]
        first_s, last_s = (np.repeat(time_s[at], rows) for at in (recordings.offsets[:-1], recordings.offsets[1:] - 1))
        scene = np.repeat(np.arange(len(rows)), rows)
        self._curve = Curve(recordings, recordings["truth.yaw_rad"])
        found, gains = [], []
        for source in sources:
            # Moved by any lag, the window must stay among the poses: one set of windows for all lags.
            inside = (source.begin_s + EARLIEST_S >= first_s) & (source.end_s + LATEST_S <= last_s)
            found.append(np.flatnonzero(inside & np.isfinite(source.turn_rad)))
            gains.append(_rate_gain(source)[found[-1]])
        self._row = np.concatenate([*found, np.zeros(0, np.int64)])
        self._source = np.repeat(np.arange(len(found)), [len(kept) for kept in found])
        self._begin_s, self._end_s, self.turn_rad = (
            np.concatenate([*(getattr(s, name)[kept] for s, kept in zip(sources, found, strict=True)), np.zeros(0)])
            for name in ("begin_s", "end_s", "turn_rad")
        )
        self._gain = np.concatenate([*gains, np.zeros(0)])
        block = (self._end_s // _BLOCK_S).astype(np.int64)
        self._block = np.unique(scene[self._row] * 1_000_000 + block, return_inverse=True)[1]

    def _residual(self, lag_s: float) -> FloatArray:
        begin, end = (self._curve.at(t + lag_s, self._row).real for t in (self._begin_s, self._end_s))
        return end - begin - self.turn_rad

    def sigma_rad(self, lag_s: float) -> FloatArray:
        """``(windows,)`` robust standard deviation of the residuals of each window's source."""
        size = np.abs(self._residual(lag_s))
        sigma = [MAD_TO_SIGMA * np.median(size[own]) for own in self._owned()]
        return np.maximum(sigma, _LEAST_SIGMA_RAD)[self._source]

    def _owned(self) -> list[NDArray[np.bool_]]:
        count = int(self._source.max()) + 1
        owned = [self._source == source for source in range(count)]
        return [own if own.any() else np.ones_like(own) for own in owned]

    def cost(self, lag_s: float, sigma_rad: FloatArray) -> float:
        z = np.abs(self._residual(lag_s) / sigma_rad)
        return float(np.where(z <= HUBER_SIGMAS, 0.5 * z * z, HUBER_SIGMAS * (z - 0.5 * HUBER_SIGMAS)).sum())

    def minimum(self, low: float, high: float, sigma_rad: FloatArray) -> float:
        """Golden-section search."""
        golden = 0.5 * (5.0**0.5 - 1.0)
        left, right = high - golden * (high - low), low + golden * (high - low)
        at_left, at_right = self.cost(left, sigma_rad), self.cost(right, sigma_rad)
        while high - low > _TOLERANCE_S:
            if at_left < at_right:
                high, right, at_right = right, left, at_left
                left = high - golden * (high - low)
                at_left = self.cost(left, sigma_rad)
            else:
                low, left, at_left = left, right, at_right
                right = low + golden * (high - low)
                at_right = self.cost(right, sigma_rad)
        return 0.5 * (low + high)

    def standard_error_s(self, lag_s: float, sigma_rad: FloatArray) -> float:
        z = self._residual(lag_s) / sigma_rad
        gain = (self._residual(lag_s + 1e-3) - self._residual(lag_s - 1e-3)) / 2e-3  # of the poses' rate in the window
        score = np.bincount(self._block, np.clip(z, -HUBER_SIGMAS, HUBER_SIGMAS) * gain / sigma_rad)
        agreed = np.isfinite(self._gain) & (np.abs(z) <= HUBER_SIGMAS)
        share = max(np.isfinite(self._gain).mean(), 1e-9)  # windows without neighbours inform as well
        information = float(np.sum((gain * self._gain / sigma_rad**2)[agreed]) / share)
        return float(np.sqrt((score * score).sum()) / information) if information > 0.0 else float("inf")


def _rate_gain(source: Turns) -> FloatArray:
    """``(rows,)`` change of a source's own yaw rate over each window [rad/s], from the windows beside it."""
    window = source.end_s - source.begin_s
    turn = source.turn_rad
    rate = (turn[1:] + turn[:-1]) / np.maximum(window[1:] + window[:-1], 1e-9)  # where one window ends, the next begins
    gain = np.full(len(turn), np.nan)
    gain[1:-1] = np.diff(rate)
    return gain
