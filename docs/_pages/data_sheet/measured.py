"""What only the simulated folder can tell: logs, situations, pictures, CAN bus, movers. Saved beside the page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from docs._pages.data_sheet.folder import City
from docs._pages.data_sheet.images import simulated_pairs, simulated_pictures
from docs._pages.data_sheet.movers import MoverShares, Sight, mover_shares, sights
from docs._pages.data_sheet.samples import write_movers, write_situations, write_strip
from docs._pages.data_sheet.sensors import production_gyro_statistics, sensor_statistics
from mixo_env.recordings.provenance import software_versions

CAPTURED = 0.5
"""A pair of pictures is captured when more than this share of its inliers lies on movers."""

LONG_ENOUGH_M = 20.0
"""Sensors are compared on scenes that move at least so far, as all real ones do."""


def measure(city: City, figures: Path, strip: bool = True, told: Callable[[str], None] = print) -> dict[str, Any]:
    """Everything, pictures written on the way.

    Args:
        city: the folder.
        figures: where the pictures go.
        strip: also render all six cameras (builds a world: half a minute).
        told: called with what is about to be done.

    Raises:
        DatasetError: if a picture or a CAN message is missing, or the simulator has changed since.
    """
    figures.mkdir(parents=True, exist_ok=True)
    told("moving vehicles")
    found = sights(city)
    told("sample pictures")
    samples = write_situations(city, figures)
    told("matches on moving vehicles")
    shares = mover_shares(city, found)
    if any(shares.values()):
        samples.append(write_movers(city, shares, figures))
    if strip:
        told("all six cameras")
        samples.append(write_strip(city, figures))
    told("CAN bus")
    sensors = sensor_summary(city)
    told("pictures")
    return {
        "configuration": {name: value for name, value in asdict(city.config).items() if name != "fault"},
        "software": software_versions(),
        "logs": [log_entry(city, number) for number in range(len(city.logs))],
        "situations": {plan.name: plan.situation for _, plan in city.scenes()},
        "pictures": simulated_pictures(city),
        "pairs": simulated_pairs(city),
        "sensors": sensors,
        "covered": {
            channel: float(np.mean([sight.covered for sight in found if sight.channel == channel]))
            for channel in city.config.cameras
        },
        "movers": {channel: mover_summary(rows) for channel, rows in shares.items() if rows},
        "samples": {sample.file: {"title": sample.title, "source": sample.source} for sample in samples},
    }


def log_entry(city: City, number: int) -> dict[str, Any]:
    """What is constant in one log."""
    log = city.logs[number]
    sensors = log.sensors
    return {
        "log": log.logfile,
        "vehicle": log.vehicle,
        "weather": log.weather,
        "low_sun": log.low_sun,
        "low_texture": log.low_texture,
        "world_seed": log.world_seed,
        "wheel_radius_m": float(sensors.wheel_radius_m[2:].mean()),
        "course_offset_deg": float(np.degrees(log.course_offset_rad)),
        "localisation_lag_s": float(log.localisation_lag_s),
        "imu_bias_degps": float(np.degrees(sensors.imu_bias_radps)),
        "monitor_bias_degps": float(np.degrees(sensors.monitor_bias_radps)),
        "production_gyro_bias_degps": float(np.degrees(sensors.gyro_bias_radps)),
        "scenes": [plan.name for plan in log.scenes],
    }


def sensor_summary(city: City) -> dict[str, dict[str, float]]:
    """Median, 5 % and 95 % quantile over the scenes that move, by figure."""
    can_bus = city.root / "can_bus"
    rows = []
    for _, plan in city.scenes():
        reel = city.dataset.reel(plan.name, city.config.cameras[0])
        if np.hypot(np.diff(reel.x_m), np.diff(reel.y_m)).sum() >= LONG_ENOUGH_M:
            rows.append(sensor_statistics(can_bus, plan.name) | production_gyro_statistics(can_bus, plan.name))
    summary = {}
    for name in rows[0] if rows else ():
        values = np.array([row[name] for row in rows])
        values = values[np.isfinite(values)]
        if len(values):
            summary[name] = {f"p{p}": float(np.percentile(values, p)) for p in (5, 50, 95)} | {"n": len(values)}
    return summary


def mover_summary(rows: list[tuple[Sight, MoverShares]]) -> dict[str, float]:
    """Means over the pairs of one camera, and the share of captured pairs."""
    values = {name: np.array([getattr(share, name) for _, share in rows]) for name in MoverShares.__dataclass_fields__}
    captured = {
        f"captured_{name}": float((np.nan_to_num(values[name]) > CAPTURED).mean()) for name in ("inliers", "odometry")
    }
    return {name: float(np.nanmean(column)) for name, column in values.items()} | captured | {"pairs": len(rows)}
