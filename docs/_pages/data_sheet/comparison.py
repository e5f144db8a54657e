"""Simulated beside real: tables in which every figure outside its stated band stands out, and a list of those."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from docs._pages.data_sheet.motion import PERCENTILES, FloatArray, Numbers, distance
from mixo_env.tables import Column, Table

RELATIVE = 0.25
"""A simulated motion figure may differ from the real one by this share of it ..."""

WIDENED = 0.5
"""Where several real values form a range, it is widened by this share of its width on each side."""

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Quantity:
    """A motion quantity: key, how it is called, and the difference that is always allowed."""

    key: str
    name: str
    floor: float
    digits: int


MOTION = (
    Quantity("speed_1s_mps", "speed over 1 s [m/s]", 0.5, 2),
    Quantity("speed_1s_mps_while_moving", "speed over 1 s while moving [m/s]", 0.5, 2),
    Quantity("abs_yaw_rate_1s_degps", "absolute yaw rate over 1 s [deg/s]", 0.5, 3),
    Quantity("abs_yaw_rate_1s_degps_while_moving", "the same while moving at 1 m/s or more [deg/s]", 0.5, 3),
    Quantity("longitudinal_accel_1s_mps2", "acceleration over 1 s [m/s²]", 0.15, 2),
    Quantity("path_length_per_scene_m", "path per scene [m]", 10.0, 1),
    Quantity("abs_net_heading_change_deg", "absolute net heading change per scene [deg]", 10.0, 1),
    Quantity("top_speed_per_scene_mps", "top speed per scene [m/s]", 0.5, 2),
)
SENSORS = {
    "pose_rate_hz": "pose: rate [Hz]",
    "pose_speed_minus_path_mps": "pose: speed minus derivative of position, mean [m/s]",
    "pose_speed_minus_path_std_mps": "pose: speed minus derivative of position, standard deviation [m/s]",
    "path_over_pose_speed": "pose: path over integral of speed",
    "gyro_rate_hz": "ms_imu: rate [Hz]",
    "gyro_bias_degps": "gyro: bias [deg/s]",
    "gyro_leads_pose_s": "gyro: leads the pose by [s]",
    "gyro_noise_raw_radps": "gyro: noise, single messages [rad/s]",
    "gyro_noise_0p1_s_radps": "gyro: noise of means over 0.1 s [rad/s]",
    "gyro_noise_0p5_s_radps": "gyro: noise of means over 0.5 s [rad/s]",
    "gyro_sample_to_sample_radps": "gyro: message to message [rad/s]",
    "gyro_drift_1_s_deg": "gyro: drift of heading in 1 s, bias removed [deg]",
    "gyro_drift_5_s_deg": "gyro: drift of heading in 5 s, bias removed [deg]",
    **{
        f"accel_{axis}_{key}_mps2": f"accelerometer {axis}: {name} [m/s²]"
        for key, name in (("mean", "mean"), ("std", "standard deviation"), ("sample_to_sample", "message to message"))
        for axis in "xyz"
    },
    "wheel_rate_hz": "zoe_veh_info: rate [Hz]",
    "wheel_repeats": "wheels: share of messages that repeat the last value",
    "wheel_radius_from_distance_m": "wheels: radius from distance [m]",
    "wheel_spread_of_radii": "wheels: largest difference of radii, relative",
    "wheel_radius_m": "wheels: radius from pose speed [m]",
    "wheel_noise_mps": "wheels: noise of the rear axle's speed [m/s]",
    "wheel_leads_pose_speed_s": "wheels: lead the pose's speed by [s]",
    "monitor_rate_hz": "vehicle_monitor: rate [Hz]",
    "monitor_gaps": "vehicle_monitor: gaps above 0.75 s per scene",
    "monitor_yaw_bias_degps": "vehicle_monitor: bias of the yaw rate [deg/s]",
    "monitor_yaw_noise_degps": "vehicle_monitor: noise of the yaw rate [deg/s]",
    "monitor_yaw_resolution_degps": "vehicle_monitor: resolution of the yaw rate [deg/s]",
    "monitor_speed_scale": "vehicle_monitor: scale of the speed",
    "monitor_speed_noise_mps": "vehicle_monitor: noise of the speed [m/s]",
    "production_gyro_rate_hz": "production_gyro: rate [Hz]",
    "production_gyro_bias_degps": "production_gyro: bias [deg/s]",
    "production_gyro_noise_0p1_s_radps": "production_gyro: noise of means over 0.1 s [rad/s]",
    "production_gyro_drift_5_s_deg": "production_gyro: drift of heading in 5 s, bias removed [deg]",
}
SHARE_FLOOR = 0.05
"""... or by this much, if it is a share."""

PICTURES = {
    "mean": ("grey", 0),
    "contrast": ("contrast", 1),
    "corners": ("corners", 0),
    "empty_cells": ("empty cells", 2),
    "slope": ("slope", 2),
    "repeatability": ("repeatable", 3),
    "correct": ("correct", 3),
    "hamming": ("Hamming", 1),
}
PAIRS = {
    "match_ratio": ("matches / corners", 3),
    "inlier_ratio": ("inliers / matches", 3),
    "hamming": ("Hamming", 1),
    "flow_px": ("flow [px]", 1),
}


@dataclass
class Differences:
    """Everything found outside its band, in the order of the sheet."""

    found: list[str] = field(default_factory=list)
    checked: int = 0

    def judge(self, what: str, simulated: float, low: float, high: float, digits: int, real: str) -> str:
        """The figure as text, bold and remembered when outside ``low`` .. ``high``."""
        text = number(simulated, digits)
        if not np.isfinite([simulated, low, high]).all():
            return text
        self.checked += 1
        if low <= simulated <= high:
            return text
        self.found.append(f"{what}: {text} against {real}")
        return f"**{text}**"


def number(value: float, digits: int) -> str:
    """``value`` with ``digits`` decimals, a dash if it does not exist."""
    if not np.isfinite(value):
        return "-"
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def motion_table(simulated: Mapping[str, Numbers], real: Mapping[str, Numbers], differences: Differences) -> str:
    """Two lines per quantity, real and simulated, every quantile and the mean."""
    keys = [*(f"p{p}" for p in PERCENTILES), "mean"]
    rows = []
    for quantity in MOTION:
        theirs, ours = real[quantity.key], simulated[quantity.key]
        rows.append([quantity.name, "real", *(number(theirs[key], quantity.digits) for key in keys)])
        cells = []
        for key in keys:
            allowed = max(RELATIVE * abs(theirs[key]), quantity.floor)
            label = f"{quantity.name}, {'mean' if key == 'mean' else key[1:] + ' % quantile'}"
            low, high = theirs[key] - allowed, theirs[key] + allowed
            shown = number(theirs[key], quantity.digits)
            cells.append(differences.judge(label, ours[key], low, high, quantity.digits, shown))
        rows.append(["", "simulated", *cells])
    headings = ["quantity", "", *(f"{key[1:]} %" for key in keys[:-1]), "mean"]
    return _table(headings, rows)


DISTANCES = {
    "speed_1s_mps": 0.05,
    "abs_yaw_rate_1s_degps": 0.05,
    "path_length_per_scene_m": 0.09,
    "abs_net_heading_change_deg": 0.09,
}
"""Largest allowed Kolmogorov-Smirnov distance: what 320 perfect draws of scenes would pass."""


def distances_table(simulated: Mapping[str, FloatArray], real: Mapping[str, Numbers], differences: Differences) -> str:
    """Kolmogorov-Smirnov distances of all quantities; those with a limit are judged."""
    rows = []
    for quantity in MOTION:
        found, limit = distance(simulated[quantity.key], real[quantity.key]), DISTANCES.get(quantity.key, np.nan)
        shown = f"at most {limit:.2f}" if np.isfinite(limit) else "-"
        text = differences.judge(f"{quantity.name}, distance", found, 0.0, limit, 3, shown)
        rows.append([quantity.name, text, shown])
    return _table(["Kolmogorov-Smirnov distance", "simulated to real", "limit"], rows)


def shares_table(simulated: Numbers, real: Numbers, differences: Differences) -> str:
    """Plain shares, a line each."""
    rows = []
    for key, share in real.items():
        name = "share of " + key.replace("_", " ").replace(" mps", " m/s")
        shown = number(share, 3)
        allowed = max(RELATIVE * share, SHARE_FLOOR)
        rows.append([name, shown, differences.judge(name, simulated[key], share - allowed, share + allowed, 3, shown)])
    return _table(["", "real", "simulated"], rows)


def intervals_table(simulated: Mapping[str, Numbers], real: Mapping[str, Numbers]) -> str:
    """Frame intervals; nothing is judged: their pattern is copied on purpose."""
    rows = []
    for kind, title in (("frames", "CAM_FRONT images"), ("keyframes", "key frames")):
        ours, theirs = simulated[kind], real[kind]
        for key, unit, digits in (("mean_s", "s", 4), ("min_s", "s", 4), ("max_s", "s", 4), ("grid_std_s", "µs", 0)):
            factor = 1e6 if unit == "µs" else 1.0
            name = {"mean_s": "mean", "min_s": "shortest", "max_s": "longest"}.get(key, "jitter about the 50 ms grid")
            rows.append(
                [f"{title}: {name} [{unit}]", number(factor * theirs[key], digits), number(factor * ours[key], digits)]
            )
        for key in sorted({key for key in (*ours, *theirs) if key.startswith("share_")}):
            name = f"{title}: share near {key.removeprefix('share_').removesuffix('_s')} s"
            rows.append([name, number(theirs.get(key, 0.0), 4), number(ours.get(key, 0.0), 4)])
    frames = simulated["frames_per_scene"]
    theirs = real["frames_per_scene"]
    rows.append(
        [
            "images per scene: least, median, most",
            f"{theirs['min']}, {theirs['median']}, {theirs['max']}",
            f"{frames['min']:.0f}, {frames['p50']:.0f}, {frames['max']:.0f}",
        ]
    )
    return _table(["", "real", "simulated"], rows)


def widened(values: Iterable[float]) -> tuple[float, float]:
    """The range of ``values``, a little wider on both sides."""
    finite = [value for value in values if np.isfinite(value)]
    if not finite:
        return np.nan, np.nan
    low, high = min(finite), max(finite)
    return low - WIDENED * (high - low), high + WIDENED * (high - low)


def sensors_table(simulated: Mapping[str, Numbers], real: Mapping[str, Numbers], differences: Differences) -> str:
    """Range of the real scenes beside median and 5 to 95 % of the simulated ones."""
    rows = []
    for key, name in SENSORS.items():
        ours = simulated.get(key)
        if ours is None:  # no scene moves enough to show it
            continue
        values = [scene[key] for scene in real.values() if key in scene]
        finite = [value for value in values if np.isfinite(value)]
        scale = max(map(abs, (*finite, ours["p5"], ours["p50"], ours["p95"])))
        digits = int(np.clip(3 - np.floor(np.log10(scale)), 0, 5)) if scale > 0 else 2
        low, high = widened(values)
        if len(finite) > 1 and low == high:  # a resolution is a resolution
            low, high = low - 1e-9, high + 1e-9
        shown = f"{number(min(finite), digits)} to {number(max(finite), digits)}" if finite else "-"
        median = differences.judge(f"{name}, median", ours["p50"], low, high, digits, shown)
        spread = f"{number(ours['p5'], digits)} to {number(ours['p95'], digits)}"
        rows.append([name, shown, median, spread])
    return _table(["figure", f"real, {len(real)} scenes", "simulated, median", "5 % to 95 %"], rows)


def pictures_table(simulated: Mapping[str, Values], real: Mapping[str, Values], differences: Differences) -> str:
    """Means over single pictures; cameras by day are judged against the range of the real means."""
    rows = [[group, *_means(values, PICTURES), f"{_count(values):.0f}"] for group, values in real.items()]
    for group, values in simulated.items():
        cells = []
        for key, (name, digits) in PICTURES.items():
            mean = values[key]["mean"]
            reals = [other[key]["mean"] for other in real.values()]
            low, high = widened(reals) if group.endswith(" day") else (np.nan, np.nan)
            shown = f"{number(min(reals), digits)} to {number(max(reals), digits)}"
            cells.append(differences.judge(f"{group}, {name}", mean, low, high, digits, shown))
        rows.append([f"simulated, {group}", *cells, f"{_count(values):.0f}"])
    return _table(["pictures", *(name for name, _ in PICTURES.values()), "count"], rows)


def pairs_table(simulated: Mapping[str, Values], real: Mapping[str, Values], differences: Differences) -> str:
    """Means over pairs; the front camera is judged against 5 to 95 % of the real pairs, the others have no match."""
    rows = [[group, *_means(values, PAIRS), f"{_count(values):.0f}"] for group, values in real.items()]
    (reference,) = real.values()
    for group, values in simulated.items():
        cells = []
        for key, (name, digits) in PAIRS.items():
            ends = reference[key]["p5"], reference[key]["p95"]
            low, high = widened(ends) if group.startswith("CAM_FRONT ") else (np.nan, np.nan)
            shown = f"{number(ends[0], digits)} to {number(ends[1], digits)}"
            cells.append(differences.judge(f"{group}, {name}", values[key]["mean"], low, high, digits, shown))
        rows.append([f"simulated, {group}", *cells, f"{_count(values):.0f}"])
    return _table(["pairs", *(name for name, _ in PAIRS.values()), "count"], rows)


def _means(values: Values, names: Mapping[str, tuple[str, int]]) -> list[str]:
    return [number(values[key]["mean"], digits) for key, (_, digits) in names.items()]


def _count(values: Values) -> float:
    return next(iter(values.values()))["n"]


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table without a caption."""
    return Table("", tuple(Column(heading) for heading in headings), rows).markdown().lstrip()
