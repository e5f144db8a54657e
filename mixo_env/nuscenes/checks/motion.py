"""Two sensors that saw one motion: how well they agree, in which ratio, and how late one is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixo_env.nuscenes.scene import FloatArray, IntArray

GRID_US = 20_000
LONGEST_LAG_S = 0.4
SHORTEST_COMPARED_S = 1.4


@dataclass(frozen=True)
class Rates:
    """Mean rates of two sensors over the same windows, ``(n,)`` each."""

    true: FloatArray
    sensed: FloatArray

    def is_moving(self, threshold: float) -> bool:
        """Whether either sensor exceeds ``threshold`` in two windows one after the other."""
        return any(_twice_in_a_row(np.abs(rate) > threshold) for rate in (self.true, self.sensed))

    @property
    def correlation(self) -> float:
        """Pearson's; 0 where one of them is constant."""
        if min(np.std(self.true), np.std(self.sensed)) < 1e-9:
            return 0.0
        return float(np.corrcoef(self.true, self.sensed)[0, 1])

    @property
    def slope(self) -> float:
        """Sensed change for one of the truth (least squares with an offset); NaN where the truth is constant."""
        centred = self.true - self.true.mean()
        power = float(centred @ centred)
        return float(centred @ self.sensed) / power if power > 1e-12 else float("nan")


def integral(time_us: IntArray, rate: FloatArray, at_us: IntArray) -> FloatArray:
    """Trapezoid integral of a signal from its first message, at other times; flat outside."""
    seconds = 1e-6 * (time_us - time_us[0])
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(seconds)
    return np.interp(1e-6 * (at_us - time_us[0]), seconds, np.concatenate([[0.0], np.cumsum(steps)]))


def window_rates(
    time_us: IntArray, value: FloatArray, sensor_us: IntArray, sensor_rate: FloatArray, window_s: float = 0.5
) -> Rates | None:
    """Rates of a true value and of a sensor of its rate, over windows that both cover.

    Args:
        time_us: ``(n,)`` of the true value.
        value: ``(n,)`` e.g. unwrapped yaw.
        sensor_us: ``(m,)``.
        sensor_rate: ``(m,)`` per second.
        window_s: 0.5 s averages the vibration away that two sensors see differently.

    Returns:
        ``None`` where the two overlap by less than four windows.
    """
    begin, end = max(time_us[0], sensor_us[0]), min(time_us[-1], sensor_us[-1])
    edges = np.arange(begin, end, int(1e6 * window_s))
    if len(edges) < 5:
        return None
    true = np.interp(1e-6 * (edges - time_us[0]), 1e-6 * (time_us - time_us[0]), value)
    sensed = integral(sensor_us, sensor_rate, edges)
    return Rates(np.diff(true) / window_s, np.diff(sensed) / window_s)


@dataclass(frozen=True)
class Lag:
    """How late a true value follows a sensor.

    Attributes:
        seconds: of the best fit; positive when the truth is late.
        residual: RMS of the fit there, in the unit of the value.
        seconds_allowed: of the best fit among the lags allowed.
        residual_allowed: RMS there.
    """

    seconds: float
    residual: float
    seconds_allowed: float
    residual_allowed: float


def lag_of(
    time_us: IntArray,
    value: FloatArray,
    sensor_us: IntArray,
    sensor_rate: FloatArray,
    allowed_s: tuple[float, float],
    detectable: float,
) -> Lag | None:
    """Shift the integral of a sensor against the true value until they fit best, but for scale, offset and drift.

    Args:
        time_us: ``(n,)`` of the true value.
        value: ``(n,)``.
        sensor_us: ``(m,)``.
        sensor_rate: ``(m,)`` per second.
        allowed_s: lags that count as sound.
        detectable: unit of ``value``; the residual must rise by this within 0.4 s.

    Returns:
        ``None`` where the motion is too even to tell, or the overlap is short.
    """
    margin_us = int(1e6 * LONGEST_LAG_S)
    begin = max(time_us[0], sensor_us[0]) + margin_us
    end = min(time_us[-1], sensor_us[-1]) - margin_us
    if 1e-6 * (end - begin) < SHORTEST_COMPARED_S:
        return None
    at_us = np.arange(begin, end, GRID_US)
    true = np.interp(1e-6 * (at_us - time_us[0]), 1e-6 * (time_us - time_us[0]), value)
    drift = np.linspace(-1.0, 1.0, len(at_us))
    drift /= np.linalg.norm(drift)
    true = true - true.mean()
    true -= (drift @ true) * drift
    # Lags are whole steps of the grid: one integral over a longer grid holds the shifted ones, the latest lag first.
    steps = margin_us // GRID_US
    lags: FloatArray = 1e-6 * GRID_US * np.arange(-steps, steps + 1, dtype=np.float64)
    longer = integral(sensor_us, sensor_rate, begin + GRID_US * np.arange(-steps, len(at_us) + steps))
    longer -= longer.mean()
    # What offset and drift leave of a shifted integral: its power, and its product with the true value.
    sums, squares = (np.concatenate([[0.0], np.cumsum(values)]) for values in (longer, longer**2))
    power = squares[len(at_us) :] - squares[: -len(at_us)] - np.correlate(longer, drift, "valid") ** 2
    power = (power - (sums[len(at_us) :] - sums[: -len(at_us)]) ** 2 / len(at_us))[::-1]
    product = np.correlate(longer, true, "valid")[::-1]
    explained = np.divide(product**2, power, out=np.zeros(len(lags)), where=power > 1e-12)
    residual = np.sqrt(np.maximum(true @ true - explained, 0.0) / len(at_us))
    if residual.max() - residual.min() < detectable or residual.max() < 3.0 * residual.min():
        return None
    best = int(residual.argmin())
    allowed = np.flatnonzero((lags > allowed_s[0]) & (lags < allowed_s[1]))
    nearest = int(allowed[residual[allowed].argmin()])
    return Lag(_refined(lags, residual, best), float(residual[best]), float(lags[nearest]), float(residual[nearest]))


def _refined(lags: FloatArray, residual: FloatArray, best: int) -> float:
    """Vertex of the parabola through the squares of the best residual and its neighbours."""
    if not 0 < best < len(lags) - 1:
        return float(lags[best])
    before, at, after = residual[best - 1 : best + 2] ** 2
    bend = before - 2.0 * at + after
    return float(lags[best] + (0.5e-6 * GRID_US * (before - after) / bend if bend > 0 else 0.0))


def _twice_in_a_row(flags: np.ndarray) -> bool:
    return bool(np.any(flags[1:] & flags[:-1]))
