"""How experts drift: the part of their errors that stays for a while, and the part that grows in turns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.policies.calibration import FEWEST, Calibration, FloatArray, Past, robust_std, window_sums
from mixo_env.policies.storage import LARGEST

WINDOWS = (1, 3, 10, 30, 100)
"""Steps over which errors are summed: white noise grows with their root, drift with their number."""
MEMORIES = (3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
"""Candidates for the time constant of drift, in steps."""
SHARES = (0.0, 0.01, 0.03, 0.1, 0.2, 0.4, 0.6, 0.8, 0.95)
"""Candidates for the share of drift in the variance of one step."""
WILD = 10.0
"""Errors beyond so many standard deviations are cut off: one of them would otherwise fill every window around it."""
TURNING = 0.9
"""Quantile of the absolute yaw rate above which the car turns."""


@dataclass(frozen=True)
class Drift:
    """The errors of every expert, ``(experts,)`` each: constant + slow + white, the last growing with the turn.

    Attributes:
        constant_radps: median error of the rate, which never goes away.
        slow_radps: standard deviation of the slow part, an Ornstein-Uhlenbeck process.
        memory_s: its time constant.
        white_share: share of the white part in the variance of one step.
        turn_share: standard deviation of what a turn adds, as a share of the increment.
    """

    constant_radps: FloatArray
    slow_radps: FloatArray
    memory_s: FloatArray
    white_share: FloatArray
    turn_share: FloatArray

    @classmethod
    def fit(cls, past: Past) -> tuple[Drift, Calibration]:
        """Measure it on training scenes; the calibration beside it is that of errors without their constant part."""
        moving = np.isfinite(past.truth_rad) & (past.dt_s > 0.0)
        dt = float(np.mean(past.dt_s[moving])) if moving.any() else 1.0
        rate = np.abs(past.truth_rad) / np.where(past.dt_s > 0.0, past.dt_s, 1.0)
        constant = _median(past.error_rad[moving] / past.dt_s[moving, None])
        centred = replace(past, error_rad=past.error_rad - constant * past.dt_s[:, None])
        turning = rate >= np.nanquantile(rate, TURNING)
        calibration = Calibration.over(centred, 1)
        step_rad, share, memory = _slow_part(centred)
        drift = cls(
            constant_radps=constant,
            slow_radps=np.sqrt(share) * step_rad / dt,
            memory_s=memory * dt,
            white_share=1.0 - share,
            turn_share=_turn_share(_only(centred, turning), calibration),
        )
        return drift, calibration

    def tensors(self) -> dict[str, NDArray[Any]]:
        """All arrays, by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def shapes(cls, experts: int) -> dict[str, tuple[int, ...]]:
        """Of :meth:`tensors`."""
        return {field.name: (experts,) for field in fields(cls)}

    @classmethod
    def restore(cls, tensors: Mapping[str, NDArray[Any]]) -> Drift:
        """From :meth:`tensors`.

        Raises:
            ValueError: for values that :meth:`fit` cannot give.
        """
        values = {field.name: tensors[field.name].astype(np.float64) for field in fields(cls)}
        for name, value in values.items():
            if np.any(np.abs(value) > LARGEST) or (name != "constant_radps" and np.any(value < 0.0)):
                raise ValueError(f"expected {name} of 0 to {LARGEST:g}")
        if np.any(values["memory_s"] <= 0.0):
            raise ValueError("expected memory_s above 0")
        return cls(**values)


def summed_variance(window: NDArray[np.int64], memory: float) -> FloatArray:
    """Variance of the sum over ``window`` steps of an Ornstein-Uhlenbeck process of variance one.

    W (1 + f) / (1 - f) - 2 f (1 - f^W) / (1 - f)^2 with f = exp(-1 / memory), the sum of f^|i - j| over all pairs.
    """
    f = np.exp(-1.0 / memory)
    return window * (1.0 + f) / (1.0 - f) - 2.0 * f * (1.0 - f**window) / (1.0 - f) ** 2


def _slow_part(past: Past) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Standard deviation of a step [rad], share of the slow part in its variance, memory [steps]; ``(experts,)``.

    Least squares of the logarithm of the variance of windowed sums over a grid; robust at every length.
    """
    spread = robust_std(past.error_rad)
    known = np.isfinite(spread)
    limit = WILD * np.where(known, spread, 1.0)
    error = np.clip(past.error_rad, -limit, limit)
    variance = np.stack([_spread_of_sums(error, past.offsets, window) for window in WINDOWS]) ** 2
    count = error.shape[1]
    share, memory, step = np.zeros(count), np.full(count, MEMORIES[0]), np.where(known, spread, 0.0)
    for i in np.flatnonzero(known):
        told = np.isfinite(variance[:, i]) & (variance[:, i] > 0.0)
        if told.sum() < 3:
            continue
        window, found = np.array(WINDOWS)[told], np.log(variance[told, i])
        least = np.inf
        for candidate in MEMORIES:
            slow = summed_variance(window, candidate)
            for part in SHARES:
                apart = found - np.log(part * slow + (1.0 - part) * window)
                cost = float(np.var(apart))
                if cost < least:
                    least, share[i], memory[i], step[i] = cost, part, candidate, np.exp(0.5 * apart.mean())
    return step, share, memory


def _spread_of_sums(error: FloatArray, offsets: NDArray[np.int64], window: int) -> FloatArray:
    """Robust standard deviation ``(experts,)`` of sums over ``window`` steps of one scene; infinite if too few."""
    sums = window_sums(error, offsets, window)
    return np.where(np.isfinite(sums).sum(axis=0) >= FEWEST, robust_std(sums), np.inf)


def _turn_share(turning: Past, calibration: Calibration) -> FloatArray:
    """Excess of the errors in turns over their calibrated deviations, as a share of the increment ``(experts,)``."""
    usual = np.where(np.isfinite(turning.stated_rad), turning.stated_rad * calibration.factor, calibration.std_rad)
    usual = _median(np.where(np.isfinite(turning.error_rad), usual, np.nan))
    with np.errstate(invalid="ignore"):
        excess = robust_std(turning.error_rad) ** 2 - usual**2
    size = np.sqrt(np.nanmean(turning.truth_rad**2)) if np.isfinite(turning.truth_rad).any() else 0.0
    excess = np.where(np.isfinite(excess), np.maximum(excess, 0.0), 0.0)
    return np.sqrt(excess) / size if size > 0.0 else np.zeros(len(excess))


def _only(past: Past, rows: NDArray[np.bool_]) -> Past:
    """The same with everything outside ``rows`` unknown."""
    return replace(
        past,
        error_rad=np.where(rows[:, None], past.error_rad, np.nan),
        truth_rad=np.where(rows, past.truth_rad, np.nan),
    )


def _median(values: FloatArray) -> FloatArray:
    """Median ``(experts,)`` of the finite rows; 0 without any."""
    result = np.zeros(values.shape[1])
    some = np.isfinite(values).any(axis=0)
    if some.any():
        result[some] = np.nanmedian(values[:, some], axis=0)
    return result
