"""Kalman filter of a quantity whose rate is measured now and then, evaluated causally at any time.

Filtering is filterpy's; this module adds messages at irregular times, prediction between messages and the variance of
increments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.scene import FloatArray, IntArray, Signal

MAXIMUM_GAP_S = 2.0
"""Longest prediction without a message: twice the pause that a lost 2 Hz message leaves."""


@dataclass(frozen=True)
class RateFilter:
    """A Kalman filter of [quantity, rate] after each of its ``n`` rate messages.

    Attributes:
        time_us: ``(n,)`` when the message arrived, taken as the time of its measurement: how late wheel messages are is
            a constant of the vehicle and is made up for when rows are read (recordings/vehicles.py).
        state: ``(n, 2)``.
        covariance: ``(n, 2, 2)``.
        gain: ``(n, 2)`` Kalman gain of the message.
        measurement_variance: of the rate.
        noise_density: of the white noise on the rate's derivative.
    """

    time_us: IntArray
    state: FloatArray
    covariance: FloatArray
    gain: FloatArray
    measurement_variance: float
    noise_density: float

    @classmethod
    def run(cls, rate: Signal, measurement_variance: float, noise_density: float) -> RateFilter:
        """Filter all messages of ``rate``; arguments as :func:`run_filter`."""
        states, covariances, gains, _ = run_filter(rate, measurement_variance, noise_density)
        return cls(
            time_us=rate.timestamp_us,
            state=states,
            covariance=covariances,
            gain=gains,
            measurement_variance=measurement_variance,
            noise_density=noise_density,
        )

    def at(self, time_us: IntArray, knows_start: bool = True) -> tuple[FloatArray, FloatArray]:
        """Quantity and rate, predicted to each time from the last message that had arrived.

        Args:
            time_us: ``(n,)`` ascending.
            knows_start: before the first message its rate holds; otherwise the rate is unknown there, taken as 0.

        Raises:
            DatasetError: more than ``MAXIMUM_GAP_S`` from the nearest message that had arrived.
        """
        last, elapsed = self._last_message(time_us)
        if len(elapsed) and np.abs(elapsed).max() > MAXIMUM_GAP_S:
            pause = float(np.abs(elapsed).max())
            raise DatasetError(
                f"the CAN bus is silent for {pause:.1f} s at the images: at most {MAXIMUM_GAP_S} s is fine"
            )
        origin = np.maximum(last, 0)
        rate = np.where((last >= 0) | knows_start, self.state[origin, 1], 0.0)
        return self.state[origin, 0] + rate * elapsed, rate

    def increment_variance(self, time_us: IntArray, knows_start: bool = True) -> FloatArray:
        """Variance of the quantity's increment since the time before: ``(n,)``, 0 at the first time.

        Var(e_b - e_a) = P_b + P_a - 2 Phi P_a for consecutive times a, b, where Phi carries the error from a to b.
        """
        last, elapsed = self._last_message(time_us)
        variance = np.zeros(len(time_us))
        before = np.zeros((2, 2))
        for k in range(len(time_us)):
            here = self._predicted_covariance(int(last[k]), float(elapsed[k]), bool(last[k] >= 0) or knows_start)
            if k > 0:
                phi = self._error_transition(int(last[k - 1]), int(time_us[k - 1]), int(last[k]), int(time_us[k]))
                variance[k] = max(here[0, 0] + before[0, 0] - 2.0 * (phi @ before)[0, 0], 0.0)
            before = here
        return variance

    def surprise(self, rate: Signal, memory_s: float) -> FloatArray:
        """How large innovations are, squared over the variance that the filter expects: ``(n,)`` after each message.

        A running mean that begins at 1. Were all its variances so many times as large, the filter would say the same.

        Args:
            rate: what was filtered.
            memory_s: time constant of the mean.
        """
        elapsed = 1e-6 * np.diff(self.time_us)
        expected = self.covariance[:-1, 1, 1] + self.noise_density * elapsed + self.measurement_variance
        square = (rate.value[1:] - self.state[:-1, 1]) ** 2 / expected
        mean = np.ones(len(self.time_us))
        for k, keep in enumerate(np.exp(-elapsed / memory_s)):
            mean[k + 1] = keep * mean[k] + (1.0 - keep) * square[k]
        return mean

    def _last_message(self, time_us: IntArray) -> tuple[IntArray, FloatArray]:
        """Number of the last message that had arrived (-1: none), and seconds since then (or until the first)."""
        last = np.searchsorted(self.time_us, time_us, side="right") - 1
        return last, 1e-6 * (time_us - self.time_us[np.maximum(last, 0)]).astype(np.float64)

    def _predicted_covariance(self, last: int, elapsed: float, known: bool) -> FloatArray:
        if not known:  # a constant unknown rate since then, zero mean, as uncertain as a measurement
            return self.measurement_variance * np.array([[elapsed**2, elapsed], [elapsed, 1.0]])
        transition = _transition(elapsed)
        noise = _process_noise(abs(elapsed), self.noise_density)
        return transition @ self.covariance[max(last, 0)] @ transition.T + noise

    def _error_transition(self, last_a: int, a_us: int, last_b: int, b_us: int) -> FloatArray:
        """``(2, 2)`` map of the state's error at a to the error at b, through the messages that arrived in between."""
        if last_a == last_b:
            return _transition(1e-6 * (b_us - a_us))
        if last_a < 0:  # the first message sets the state
            return np.zeros((2, 2))
        phi = np.eye(2)
        from_us = a_us
        for i in range(last_a + 1, last_b + 1):
            phi = _transition(1e-6 * (self.time_us[i] - from_us)) @ phi
            phi -= np.outer(self.gain[i], phi[1])  # I - K H with H = [0, 1]
            from_us = self.time_us[i]
        return _transition(1e-6 * (b_us - from_us)) @ phi


def run_filter(
    rate: Signal, measurement_variance: float, noise_density: float
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Kalman filter with the state [quantity, rate] over measurements of the rate.

    The quantity starts at exactly 0. The first message sets the rate, with the variance of a measurement.

    Args:
        rate: measured rate.
        measurement_variance: its entry of R.
        noise_density: spectral density of the white noise on the rate's derivative.

    Returns:
        After each message: states ``(n, 2)``, covariances ``(n, 2, 2)``, gains ``(n, 2)``; and the log-likelihood of
        the innovations.
    """
    from filterpy.kalman import KalmanFilter  # imports scipy and matplotlib: over a second

    count = len(rate.timestamp_us)
    states, covariances, gains = np.zeros((count, 2)), np.zeros((count, 2, 2)), np.zeros((count, 2))
    log_likelihood = 0.0
    kalman = KalmanFilter(dim_x=2, dim_z=1)
    kalman.x = np.array([[0.0], [rate.value[0]]])
    kalman.P = np.diag([0.0, measurement_variance])
    kalman.H = np.array([[0.0, 1.0]])
    kalman.R = np.array([[measurement_variance]])
    states[0], covariances[0] = kalman.x[:, 0], kalman.P
    for k, elapsed in enumerate(1e-6 * np.diff(rate.timestamp_us), start=1):
        kalman.predict(F=_transition(elapsed), Q=_process_noise(elapsed, noise_density))
        kalman.update(rate.value[k])
        states[k], covariances[k], gains[k] = kalman.x[:, 0], kalman.P, kalman.K[:, 0]
        innovation, variance = float(kalman.y[0, 0]), float(kalman.S[0, 0])
        log_likelihood -= 0.5 * (innovation**2 / variance + np.log(2.0 * np.pi * variance))
    return states, covariances, gains, log_likelihood


def _transition(elapsed_s: float) -> FloatArray:
    """F of constant rate over ``elapsed_s``."""
    return np.array([[1.0, elapsed_s], [0.0, 1.0]])


def _process_noise(elapsed_s: float, density: float) -> FloatArray:
    """Q of white noise on the derivative of the rate over ``elapsed_s``."""
    t = elapsed_s
    return density * np.array([[t**3 / 3.0, t**2 / 2.0], [t**2 / 2.0, t]])
