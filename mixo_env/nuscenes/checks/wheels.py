"""Checks of wheel speeds against the poses: sentinels, unit, clock."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mixo_env.nuscenes.checks.evidence import Evidence, Finding, TruePath
from mixo_env.nuscenes.checks.motion import integral, lag_of
from mixo_env.nuscenes.scene import FloatArray, IntArray, Signal

NOMINAL_RADIUS_M = 0.305
RATIOS = (0.9, 1.1)
"""Distance rolled over true distance, on the way of ``WAY_M`` at least."""

WAY_M = 10.0
SHORT_RATIOS, SHORT_WAY_M = (0.6, 1.6), 3.0
STANDING_M = 1.0

FASTEST_RADPS = 170.0
"""50 m/s; a lost sensor reads 65535."""

LAG_S = (-0.11, 0.11)
"""How late poses may follow the wheels: within 0.05 s on real scenes."""

DETECTABLE_M = 0.1
LAG_IS_CLEAR = 1.5

_WHEELS = ("front left", "front right", "rear left", "rear right")


def wheel_range(evidence: Evidence) -> Iterator[Finding]:
    """No wheel turns as no wheel can."""
    wheels = _wheels(evidence)
    if wheels is None:
        return
    wrong = (wheels.value < -FASTEST_RADPS) | (wheels.value > FASTEST_RADPS)
    for name, rows, values in zip(_WHEELS, wrong.T, wheels.value.T, strict=True):
        if rows.any():
            yield Finding(
                "wheel-range",
                f"zoe_veh_info: {np.count_nonzero(rows)} of {len(rows)} speeds of the {name} wheel are no speeds, "
                f"up to {np.abs(values).max() * 60 / (2 * np.pi):.0f} rpm",
            )


def wheel_unit(evidence: Evidence) -> Iterator[Finding]:
    """The rear wheels roll as far as the poses go; so do the other speeds."""
    wheels, path, can_bus = _wheels(evidence), evidence.path, evidence.can_bus
    if path is None or can_bus is None:
        return
    if wheels is not None:
        speed = NOMINAL_RADIUS_M * wheels.value[:, 2:]
        time_us = wheels.timestamp_us
        yield from _compare("zoe_veh_info: the rear wheels roll", time_us, speed.mean(axis=1), path)
        # In a turn one wheel rolls further than the other, so a single one has the wider bounds.
        for name, one in zip(_WHEELS[2:], speed.T, strict=True):
            yield from _compare(f"zoe_veh_info: the {name} wheel rolls", time_us, one, path, SHORT_RATIOS)
    for message, signal in (("pose", can_bus.pose_speed_mps), ("vehicle_monitor", can_bus.monitor_speed_mps)):
        if signal is not None:
            yield from _compare(f"{message}: its speed makes", signal.timestamp_us, signal.value, path)


def wheel_clock(evidence: Evidence) -> Iterator[Finding]:
    """The wheels and the poses have one clock."""
    wheels, path = _wheels(evidence), evidence.path
    if wheels is None or path is None or len(wheels.timestamp_us) < 2:
        return
    speed = NOMINAL_RADIUS_M * wheels.value[:, 2:].mean(axis=1)
    lag = lag_of(path.time_us, path.distance_m, wheels.timestamp_us, speed, LAG_S, DETECTABLE_M)
    if lag is None or LAG_S[0] < lag.seconds < LAG_S[1] or lag.residual_allowed < LAG_IS_CLEAR * lag.residual:
        return
    yield Finding(
        "clock-offset",
        f"zoe_veh_info: the poses move {abs(lag.seconds):.2f} s {'after' if lag.seconds > 0 else 'before'} the wheels; "
        "one clock is expected",
    )


def wheel_ratio(wheels: Signal, path: TruePath) -> float | None:
    """Distance rolled by the rear wheels over that of the poses; ``None`` for a way below ``WAY_M``."""
    ways = _ways(wheels.timestamp_us, NOMINAL_RADIUS_M * wheels.value[:, 2:].mean(axis=1), path)
    return ways[0] / ways[1] if ways is not None and ways[1] > WAY_M else None


def _wheels(evidence: Evidence) -> Signal | None:
    return evidence.can_bus.wheel_speed_radps if evidence.can_bus is not None else None


def _compare(
    what: str, time_us: IntArray, speed_mps: FloatArray, path: TruePath, ratios: tuple[float, float] = RATIOS
) -> Iterator[Finding]:
    ways = _ways(time_us, speed_mps, path)
    if ways is None:
        return
    sensed_m, true_m = ways
    low, high = ratios if true_m > WAY_M else SHORT_RATIOS
    if true_m > SHORT_WAY_M and not low < sensed_m / true_m < high:
        yield Finding(
            "wheel-unit",
            f"{what} {sensed_m / true_m:.2f} of the poses' distance; {low} to {high} is expected: wrong unit?",
        )
    elif true_m < STANDING_M and sensed_m > SHORT_WAY_M:
        yield Finding("wheel-unit", f"{what} {sensed_m:.1f} m while the poses stand still: of another scene?")


def _ways(time_us: IntArray, speed_mps: FloatArray, path: TruePath) -> tuple[float, float] | None:
    """Sensed and true distance in metres, where both exist."""
    both = (path.time_us >= time_us[0]) & (path.time_us <= time_us[-1])
    if np.count_nonzero(both) < 2 or len(time_us) < 2:
        return None
    sensed = integral(time_us, np.abs(speed_mps), path.time_us[both])
    return float(np.ptp(sensed)), float(np.ptp(path.distance_m[both]))
