"""Checks of CAN bus messages as such: there, in order, without long silence, in time with the images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mixo_env.nuscenes.checks.evidence import Evidence, Finding
from mixo_env.nuscenes.scene import IntArray

NEEDED = ("zoe_veh_info", "ms_imu")
"""Without these there is no inertial odometry."""

NOMINAL_HZ = {"zoe_veh_info": 100.0, "ms_imu": 100.0, "pose": 50.0, "vehicle_monitor": 2.0}
LONGEST_GAP_S = {"zoe_veh_info": 0.5, "ms_imu": 0.5, "pose": 0.5, "vehicle_monitor": 1.6}
"""A lost 2 Hz message leaves a gap of 1 s."""

LATEST_START_S = {"zoe_veh_info": 0.1, "ms_imu": 0.1, "pose": 0.2, "vehicle_monitor": 1.1}
"""After the first image; real messages begin up to 0.07 s after it, with the first turn of the lidar."""

EARLIEST_START_S = 0.15
"""Before the first image: published messages are cut to the scene."""

EARLIEST_END_S = {"zoe_veh_info": 0.2, "ms_imu": 0.2, "pose": 0.2, "vehicle_monitor": 1.1}
"""Before the last image."""

GREATEST_DISORDER_S = 0.05


def can_bus_there(evidence: Evidence) -> Iterator[Finding]:
    """There is a CAN bus, with wheels and an IMU."""
    if not evidence.is_can_bus_readable:
        return
    if evidence.can_bus is None:
        yield Finding("can-bus", "no CAN bus data: it cannot be recorded", is_problem=evidence.expects_can_bus)
        return
    for message in NOMINAL_HZ:
        if not len(evidence.message_times_us[message]):
            yield Finding("can-bus", f"no {message} messages", is_problem=message in NEEDED)


def coverage(evidence: Evidence) -> Iterator[Finding]:
    """Messages cover the images without silence, in the order of time, at the rate of the real car."""
    if evidence.path is None:
        return
    image_us = evidence.path.time_us
    for message in NOMINAL_HZ:
        times = evidence.message_times_us[message]
        if not len(times):
            continue
        needed = message in NEEDED
        if (disorder := _disorder_s(times)) > GREATEST_DISORDER_S:
            yield Finding(
                "can-order", f"{message} goes back in time by {disorder:.2f} s: were times exchanged?", needed
            )
        for text in _gaps(message, np.sort(times), image_us):
            yield Finding("can-coverage", f"{message} {text}", needed)
        if (early := 1e-6 * float(image_us[0] - times.min())) > EARLIEST_START_S:
            text = f"{message} begins {early:.2f} s before the first image; one clock is expected"
            yield Finding("can-coverage", text, is_problem=False)
        hertz = message_rate_hz(times)
        if hertz is not None and not 0.7 < hertz / NOMINAL_HZ[message] < 1.4:
            yield Finding(
                "can-coverage",
                f"{message} comes at {hertz:.3g} Hz; {NOMINAL_HZ[message]:g} is expected",
                is_problem=False,
            )


def message_rate_hz(times_us: IntArray) -> float | None:
    """One over the median interval; ``None`` for fewer than three messages or equal times."""
    middle = float(np.median(np.diff(np.sort(times_us)))) if len(times_us) > 2 else 0.0
    return 1e6 / middle if middle > 0 else None


def _disorder_s(times_us: IntArray) -> float:
    """How far the file goes back in time."""
    return 1e-6 * float((np.maximum.accumulate(times_us) - times_us).max())


def _gaps(message: str, message_us: IntArray, image_us: IntArray) -> Iterator[str]:
    if (late := 1e-6 * (message_us[0] - image_us[0])) > LATEST_START_S[message]:
        yield f"begins {late:.2f} s after the first image"
    if (early := 1e-6 * (image_us[-1] - message_us[-1])) > EARLIEST_END_S[message]:
        yield f"ends {early:.2f} s before the last image"
    inside = message_us[(message_us >= image_us[0] - 1_000_000) & (message_us <= image_us[-1] + 1_000_000)]
    if len(inside) > 1 and (gap := 1e-6 * np.diff(inside).max()) > LONGEST_GAP_S[message]:
        yield f"is silent for {gap:.2f} s"
