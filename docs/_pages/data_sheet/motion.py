"""How a set of scenes moves and when its cameras fire: the quantities of the real driving statistics, same definitions.

The real side is all 850 drives of nuScenes at 12 Hz, without time stamps, so here as there twelve frames count as one
second (the pattern of intervals is 0.05, 0.10, 0.10 s) and all windows that start at any frame are pooled over the
scenes.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.recordings.collection import Recordings

FloatArray = NDArray[np.float64]
Numbers = dict[str, float]

SECOND = 12
"""Frames that count as one second."""

PERCENTILES = (1, 5, 10, 25, 50, 75, 90, 95, 99)

STANDING_MPS = 0.2
"""Slower is standing."""

TURNING_MPS = 1.0
"""The real yaw rates while moving are those of windows at least so fast."""

GRID_S = 0.05
"""Intervals between images are whole multiples of it, give or take a jitter."""


@dataclass(frozen=True)
class Path:
    """The way of one car, one entry per frame: rear axle ``(n,)`` [m], heading ``(n,)`` [rad, not wrapped]."""

    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray


def recorded_paths(recordings: Recordings) -> list[Path]:
    """Written poses of every scene, a frame per firing round."""
    columns = [recordings[f"truth.{name}"] for name in ("x_m", "y_m", "yaw_rad")]
    return [Path(*(column[first:stop] for column in columns)) for first, stop in itertools.pairwise(recordings.offsets)]


def quantiles(values: FloatArray) -> Numbers:
    """``p1`` to ``p99``, mean, ends and number of ``values`` ``(n,)``; NaN without any."""
    if not len(values):
        return dict.fromkeys((*(f"p{p}" for p in PERCENTILES), "mean", "min", "max"), np.nan) | {"n": 0.0}
    return {
        **{f"p{p}": float(v) for p, v in zip(PERCENTILES, np.percentile(values, PERCENTILES), strict=True)},
        "mean": float(np.mean(values)),
        "min": float(np.min(values)),
        "max": float(np.max(values)),
        "n": float(len(values)),
    }


def forward_speed_mps(path: Path) -> FloatArray:
    """``(n - SECOND,)`` displacement over a second along the heading in its middle, signed."""
    dx, dy = path.x_m[SECOND:] - path.x_m[:-SECOND], path.y_m[SECOND:] - path.y_m[:-SECOND]
    heading = path.yaw_rad[SECOND // 2 :][: len(dx)]
    return dx * np.cos(heading) + dy * np.sin(heading)


def motion_samples(paths: Sequence[Path]) -> dict[str, FloatArray]:
    """Every motion quantity of the real statistics: values of all windows, or of all scenes."""
    speeds = [forward_speed_mps(path) for path in paths]
    speed = np.concatenate(speeds)
    turned = np.degrees(np.abs(np.concatenate([path.yaw_rad[SECOND:] - path.yaw_rad[:-SECOND] for path in paths])))
    return {
        "speed_1s_mps": speed,
        "speed_1s_mps_while_moving": speed[speed >= STANDING_MPS],
        "abs_yaw_rate_1s_degps": turned,
        "abs_yaw_rate_1s_degps_while_moving": turned[speed >= TURNING_MPS],
        "longitudinal_accel_1s_mps2": np.concatenate([values[SECOND:] - values[:-SECOND] for values in speeds]),
        "path_length_per_scene_m": np.array([np.hypot(np.diff(p.x_m), np.diff(p.y_m)).sum() for p in paths]),
        "abs_net_heading_change_deg": np.abs(np.degrees([path.yaw_rad[-1] - path.yaw_rad[0] for path in paths])),
        "top_speed_per_scene_mps": np.array([values.max() for values in speeds]),
    }


def motion_statistics(paths: Sequence[Path]) -> dict[str, Numbers]:
    """Quantiles of :func:`motion_samples`; ``shares`` holds the plain shares."""
    samples = motion_samples(paths)
    length_m, heading_deg = samples["path_length_per_scene_m"], samples["abs_net_heading_change_deg"]
    return {name: quantiles(values) for name, values in samples.items()} | {
        "shares": {
            "scenes_under_5_m": float((length_m < 5.0).mean()),
            **{f"heading_over_{angle}": float((heading_deg > angle).mean()) for angle in (30, 60, 120)},
            "heading_5_to_40": float(((heading_deg > 5.0) & (heading_deg < 40.0)).mean()),
            "time_below_0.2_mps": float((np.abs(samples["speed_1s_mps"]) < STANDING_MPS).mean()),
            **{f"path_over_{m}_m": float((length_m > m).mean()) for m in (150, 200)},
        }
    }


def distance(values: FloatArray, real: Numbers) -> float:
    """Kolmogorov-Smirnov distance to the real distribution, at those of its quantiles that are known.

    Args:
        values: ``(n,)``.
        real: quantiles, by ``p1`` to ``p99``.
    """
    ordered = np.sort(values)
    known = {name: value for name, value in real.items() if name[0] == "p" and name[1:].isdigit()}
    below = np.searchsorted(ordered, list(known.values()), side="right") / len(ordered)
    return float(np.abs(below - [int(name[1:]) / 100.0 for name in known]).max())


def interval_statistics(times_s: Sequence[FloatArray]) -> Numbers:
    """Intervals between consecutive images (or key frames), pooled over scenes.

    Args:
        times_s: ``(n,)`` for every scene.
    """
    intervals = np.concatenate([np.diff(times) for times in times_s])
    nearest = np.rint(intervals / GRID_S).astype(int)
    shares = {f"share_{k * GRID_S:.2f}_s": float((nearest == k).mean()) for k in sorted(set(nearest.tolist()))}
    return {
        "mean_s": float(intervals.mean()),
        "min_s": float(intervals.min()),
        "max_s": float(intervals.max()),
        "grid_std_s": float(np.std(intervals - nearest * GRID_S)),
        "n": float(len(intervals)),
        **shares,
    }


def recorded_intervals(recordings: Recordings, camera: str = "CAM_FRONT") -> dict[str, Numbers]:
    """Frame and key frame intervals of one camera in a recording, and the frames of a scene."""
    offset_s = recordings[f"{camera}.image_time_offset_s"].astype(np.float64)
    image_s = recordings["time_s"] + offset_s
    seen = np.isfinite(offset_s)
    frames = [image_s[first:stop][seen[first:stop]] for first, stop in itertools.pairwise(recordings.offsets.tolist())]
    keys = seen & recordings["is_keyframe"]
    keyframes = [
        image_s[first:stop][keys[first:stop]] for first, stop in itertools.pairwise(recordings.offsets.tolist())
    ]
    return {
        "frames": interval_statistics(frames),
        "keyframes": interval_statistics(keyframes),
        "frames_per_scene": quantiles(np.array([len(times) for times in frames], dtype=np.float64)),
    }
