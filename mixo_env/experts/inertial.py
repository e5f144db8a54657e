"""Inertial odometry: the paper's discrete Kalman filter on speed and yaw rate from the CAN bus.

State [s, v, psi, dpsi/dt], inputs speed and yaw rate, R = diag(0.1, 0.01). The matrices are block diagonal, so the
four-state filter is two independent filters with the states [s, v] and [psi, dpsi/dt]; each takes its messages at their
own times.

P0 = 0 in the paper: the first pose is exact. The rates are no part of a pose; here the first message of each filter
sets its rate, with the variance of that message. Were it taken as exact, the filter would not believe its gyro for the
first half second, and a scene that begins in a turn would keep an error of up to ten degrees.

The paper gives no process noise Q, and with Q = 0 the filter would never leave its first speed. Here acceleration and
yaw acceleration are white noise, with densities fixed once by innovation likelihood on real CAN bus data
(``python -m experiments.fit_process_noise``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixo_env.errors import ConfigurationError, DatasetError, unknown
from mixo_env.experts.rate_filter import RateFilter
from mixo_env.nuscenes.scene import CanBus, FloatArray, IntArray, Signal

GRADES = ("INERTIAL", "INERTIAL_POSE", "INERTIAL_CONSUMER")
"""Wheels + ``ms_imu``; CAN ``pose`` as in the paper; wheels + production-grade gyro, else ``vehicle_monitor``."""

WHEEL_RADIUS_M = 0.305
"""Nominal, from the devkit's CAN bus tutorial; what a vehicle's tyres add is fitted in recordings/vehicles.py."""

SPEED_VARIANCE = 0.1
"""First entry of the paper's R, in m^2/s^2."""

PAPER_YAW_RATE_VARIANCE = 0.01
"""Second entry of the paper's R, in rad^2/s^2."""

SURPRISE_S = 1.0
"""Time constant of the mean of squared innovations that scales the variances where R is the paper's."""

LEAST_SURPRISE = 0.05**2
"""That mean counts as no less: no innovation shows a constant bias, and 0.1 deg/s are a twentieth of the paper's R."""

YAW_RATE_VARIANCE = {
    "INERTIAL": PAPER_YAW_RATE_VARIANCE,
    "INERTIAL_POSE": PAPER_YAW_RATE_VARIANCE,
    "INERTIAL_CONSUMER": 1e-4,
}
"""The same, and the variance of the consumer sensors, which the paper did not have.

0.01 is far above the noise of the real gyro; at 100 Hz that costs nothing, since the yaw estimate still adds up the
measured rates. At the 2 Hz of ``vehicle_monitor`` it would make the filter ignore its sensor in turns, so that grade
has the variance of the sensor itself (0.01 rad/s; 0.2 to 0.6 deg/s measured on real scenes).
"""


@dataclass(frozen=True)
class ProcessNoise:
    """Spectral densities of the white noise that drives the two filters.

    The defaults are the most likely values for the innovations of wheels and ``ms_imu`` with R as printed, over the
    real scenes 0061, 0655, 0757 and 0796. The time constants are then 0.14 s for speed and 0.52 s for yaw rate.

    Attributes:
        acceleration: m^2/s^3.
        yaw_acceleration: rad^2/s^3.
    """

    acceleration: float = 0.053
    yaw_acceleration: float = 3.7e-4


STANDSTILL_WHEEL_RADPS = 0.1
"""A rear wheel slower than this (3 cm/s) stands; the real sensor reports exactly 0 well above it."""

STANDSTILL_SETTLE_S = 0.5
"""The car must have stood this long before its gyro counts as bias: bodies pitch and wheels creep when braking."""

FIRST_MESSAGE_S = 0.1
"""How late the CAN bus may begin: real files start with the first lidar turn, up to 0.06 s after the first images."""

SAME_START_S = 0.05
"""A gyro whose first message comes later than this after the first speed is unknown until then."""


@dataclass(frozen=True)
class InertialEstimate:
    """Inertial odometry at the times asked for, ``(n,)`` each.

    Distance and yaw count from the first speed message, so they may be slightly negative at the first images; only
    differences carry meaning.

    Attributes:
        distance_m: travelled along the path of the rear axle.
        speed_mps: forward speed.
        yaw_rad: anticlockwise positive, not wrapped.
        yaw_rate_radps: its rate.
        yaw_variance_rad2: sum of the variances of the yaw increments between consecutive times given; it never shrinks.
            Where R is the paper's they are those of the filter times the running mean of its squared innovations over
            what it expects: R is far above the noise of the sensor, and turns are where the filter lags.
    """

    distance_m: FloatArray
    speed_mps: FloatArray
    yaw_rad: FloatArray
    yaw_rate_radps: FloatArray
    yaw_variance_rad2: FloatArray


class InertialOdometry:
    """Causal inertial odometry of one scene.

    A value at t uses messages stamped up to t only and predicts from the last one to t. The exception is the very
    start: images taken in the 0.1 s before the first message, when no step can have closed yet, are given that
    message's speed and yaw rate, so that increments which begin at them are right.

    The wheel grades take off the gyro's bias: the mean of all past messages while the wheels stood. It is taken to be
    constant over the 20 s of a scene. Where the car never stands nothing is known and nothing is taken off; real
    ``ms_imu`` then drifts by up to 0.1 deg/s and ``vehicle_monitor`` by up to 0.3 deg/s. INERTIAL_POSE is left as it is
    in the paper.
    """

    def __init__(
        self,
        can_bus: CanBus,
        grade: str = "INERTIAL",
        process_noise: ProcessNoise | None = None,
    ) -> None:
        """Filter all messages of a scene.

        Args:
            can_bus: of the scene.
            grade: one of ``GRADES``.
            process_noise: other than the fitted default, for studies.

        Raises:
            ConfigurationError: unknown grade.
            DatasetError: a message the grade needs is missing.
        """
        speed, yaw_rate = grade_inputs(can_bus, grade)
        noise = process_noise or ProcessNoise()
        self._distance = RateFilter.run(speed, SPEED_VARIANCE, noise.acceleration)
        self._yaw = RateFilter.run(yaw_rate, YAW_RATE_VARIANCE[grade], noise.yaw_acceleration)
        overstates = YAW_RATE_VARIANCE[grade] == PAPER_YAW_RATE_VARIANCE
        self._surprise = self._yaw.surprise(yaw_rate, SURPRISE_S) if overstates else np.ones(len(yaw_rate.value))

    def at(self, timestamps_us: IntArray) -> InertialEstimate:
        """Evaluate at ascending times.

        Args:
            timestamps_us: ``(n,)`` Unix microseconds.

        Raises:
            ConfigurationError: times that descend.
            DatasetError: the CAN bus does not cover the times: it begins more than 0.1 s late, or pauses for over 2 s.
        """
        time = np.asarray(timestamps_us, dtype=np.int64)
        if np.any(np.diff(time) < 0):
            raise ConfigurationError("inertial odometry expects ascending times: sort them first")
        first_us = self._distance.time_us[0]
        if len(time) and time[0] < first_us - FIRST_MESSAGE_S * 1e6:
            late_s = 1e-6 * (first_us - time[0])
            raise DatasetError(
                f"the CAN bus begins {late_s:.2f} s after the first image: at most {FIRST_MESSAGE_S} s is fine"
            )
        knows_start = bool(self._yaw.time_us[0] - first_us <= SAME_START_S * 1e6)
        distance_m, speed_mps = self._distance.at(time)
        yaw_rad, yaw_rate_radps = self._yaw.at(time, knows_start)
        variance = self._yaw.increment_variance(time, knows_start) * self._scale(time)
        return InertialEstimate(distance_m, speed_mps, yaw_rad, yaw_rate_radps, np.cumsum(variance))

    def _scale(self, time_us: IntArray) -> FloatArray:
        """``(n,)`` what past messages say about the variances assumed; 1 before the first."""
        last = np.searchsorted(self._yaw.time_us, time_us, side="right") - 1
        return np.where(last >= 0, np.maximum(self._surprise[np.maximum(last, 0)], LEAST_SURPRISE), 1.0)


def standstill_bias(rate: Signal, wheel_speed_radps: Signal) -> FloatArray:
    """Gyro bias known at each of its messages, from the messages at standstill up to and including it.

    Args:
        rate: yaw rate, rad/s.
        wheel_speed_radps: ``(m, 4)`` FL, FR, RL, RR.

    Returns:
        ``(n,)`` rad/s; 0 before the car has stood for ``STANDSTILL_SETTLE_S``.
    """
    wheel_us = wheel_speed_radps.timestamp_us
    moves = np.abs(wheel_speed_radps.value[:, 2:]).max(axis=1) > STANDSTILL_WHEEL_RADPS
    moves[0] = True  # nothing is known of the time before
    last_moved_us = np.maximum.accumulate(np.where(moves, wheel_us, wheel_us[0]))
    last_wheel = np.searchsorted(wheel_us, rate.timestamp_us, side="right") - 1
    stood_us = wheel_us[last_wheel] - last_moved_us[last_wheel]
    stands = (last_wheel >= 0) & (stood_us >= STANDSTILL_SETTLE_S * 1e6)
    count = np.cumsum(stands)
    return np.cumsum(np.where(stands, rate.value, 0.0)) / np.maximum(count, 1)


def grade_inputs(can_bus: CanBus, grade: str) -> tuple[Signal, Signal]:
    """Speed in m/s and yaw rate in rad/s of a grade, bias taken off where the grade does so."""
    if grade not in GRADES:
        raise ConfigurationError(unknown("inertial grade", grade, GRADES))
    if grade == "INERTIAL_POSE":
        speed = _require(can_bus.pose_speed_mps, grade, "pose")
        return speed, _require(can_bus.pose_yaw_rate_radps, grade, "pose")
    wheels = _require(can_bus.wheel_speed_radps, grade, "zoe_veh_info")
    if grade == "INERTIAL":
        rate = _require(can_bus.imu_yaw_rate_radps, grade, "ms_imu")
    else:
        production = can_bus.consumer_yaw_rate_radps
        rate = production or _require(can_bus.monitor_yaw_rate_radps, grade, "vehicle_monitor")
    # The mean of the rear wheels is the speed of the rear axle's middle, in turns too.
    speed = Signal(wheels.timestamp_us, WHEEL_RADIUS_M * wheels.value[:, 2:].mean(axis=1))
    return speed, Signal(rate.timestamp_us, rate.value - standstill_bias(rate, wheels))


def _require(signal: Signal | None, grade: str, message: str) -> Signal:
    if signal is None:
        raise DatasetError(
            f"{grade} needs the CAN bus message {message}, which this scene lacks: leave this expert out"
        )
    return signal
