"""Checks of yaw rates against the poses: sign, axis, unit, bias, clock."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mixo_env.nuscenes.checks.evidence import DETECTABLE_RAD, LAG_S, Evidence, Finding, yaw_rates
from mixo_env.nuscenes.checks.motion import integral, lag_of
from mixo_env.nuscenes.scene import CanBus

TURNING_RADPS = 0.05
"""The sign of a gyro can be told once the car turns faster than this for a second."""

CORRELATION = 0.95
SLOPES = (0.8, 1.25)
"""Sensed over true turn; 0.89 to 1.0 on real scenes, the less the straighter."""

MONITOR_SLOPES = (0.15, 4.0)
"""Of ``vehicle_monitor``: 0.35 was seen in a sound scene with one short turn; radians for degrees make 0.017."""

FASTEST_RADPS = 3.0
"""No car turns so fast: 33 deg/s is the most in real scenes."""

LARGEST_BIAS_RADPS = 0.03
"""Mean difference from the poses; below 0.002 on real scenes (``vehicle_monitor`` 0.007)."""

LAG_IS_CLEAR = 1.5
"""The best lag must fit better by this factor than any that is allowed."""


def gyro_sign(evidence: Evidence) -> Iterator[Finding]:
    """In turns a gyro turns with the poses."""
    for message, rates in evidence.yaw_rates.items():
        if rates.is_moving(TURNING_RADPS) and rates.correlation < CORRELATION:
            yield Finding(
                "wrong-axis",
                f"{message}: correlation of its yaw rate with the poses' is {rates.correlation:.2f}; at least "
                f"{CORRELATION} is expected: wrong axis, sign or clock",
            )


def gyro_size(evidence: Evidence) -> Iterator[Finding]:
    """A gyro turns as much as the poses, in rad/s, and does not drift."""
    for message, rates in evidence.yaw_rates.items():
        turns = rates.is_moving(TURNING_RADPS)
        if turns and rates.correlation < CORRELATION:
            continue
        # On a straight road the slope is noise, and the offset is the difference.
        slope = rates.slope if turns else 1.0
        if not SLOPES[0] < slope < SLOPES[1]:
            yield Finding("gyro-size", f"{message}: its yaw rate is {slope:.3g} times the poses'; rad/s are expected")
        # In a few windows of one turn slope and offset can stand for each other: either alone must not explain it.
        biases = [float(np.mean(rates.sensed - factor * rates.true)) for factor in (slope, 1.0)]
        if abs(bias := min(biases, key=abs)) > LARGEST_BIAS_RADPS:
            yield Finding("gyro-size", f"{message}: its yaw rate is off by {bias:.3f} rad/s on average: another unit?")
    for message, gyro in evidence.gyros.items():
        if (fastest := float(np.abs(gyro.value).max())) > FASTEST_RADPS:
            yield Finding(
                "gyro-size",
                f"{message}: a yaw rate of {fastest:.3g} rad/s; at most {FASTEST_RADPS:g} is expected: another unit?",
            )
    yield from _monitor_size(evidence)


def _monitor_size(evidence: Evidence) -> Iterator[Finding]:
    """``vehicle_monitor`` is slow, smoothed and biased: only another unit or sign can be told."""
    monitor = evidence.can_bus.monitor_yaw_rate_radps if evidence.can_bus else None
    if monitor is None or evidence.path is None or len(monitor.timestamp_us) < 2:
        return
    rates = yaw_rates(evidence.path, monitor)
    low, high = MONITOR_SLOPES
    if rates is not None and np.abs(rates.true).max() > 2 * TURNING_RADPS and not low < rates.slope < high:
        yield Finding(
            "gyro-size",
            f"vehicle_monitor: its yaw rate is {rates.slope:.3g} times the poses'; deg/s, positive to the left, "
            "are expected",
        )


def gyro_clock(evidence: Evidence) -> Iterator[Finding]:
    """The CAN bus and the poses have one clock."""
    for message, lag in evidence.pose_lags.items():
        if LAG_S[0] < lag.seconds < LAG_S[1]:
            continue
        if lag.residual_allowed > LAG_IS_CLEAR * lag.residual:
            yield Finding(
                "clock-offset",
                f"{message}: the poses turn {abs(lag.seconds):.2f} s {'after' if lag.seconds > 0 else 'before'} it; "
                "one clock is expected",
            )


def latency_s(can_bus: CanBus) -> float | None:
    """How late the yaw rate of ``pose``, a copy of ``ms_imu``'s, comes; ``None`` if the car turns too evenly."""
    imu, pose = can_bus.imu_yaw_rate_radps, can_bus.pose_yaw_rate_radps
    if imu is None or pose is None or min(len(imu.timestamp_us), len(pose.timestamp_us)) < 2:
        return None
    turned = integral(pose.timestamp_us, pose.value, pose.timestamp_us)
    lag = lag_of(pose.timestamp_us, turned, imu.timestamp_us, imu.value, LAG_S, DETECTABLE_RAD)
    return None if lag is None else lag.seconds
