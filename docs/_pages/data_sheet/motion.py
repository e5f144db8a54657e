"""How a set of scenes moves and when its cameras fire: the quantities of the real driving statistics, same definitions.

The real side is 135 trajectories of nuScenes' validation split at 12 Hz, without time stamps, so here as there twelve
frames count as one second (the pattern of intervals is 0.05, 0.10, 0.10 s) and all windows that start at any frame are
pooled over the scenes.
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

PERCENTILES = (1, 5, 25, 50, 75, 95, 99)

STANDING_MPS = 0.2
"""Slower is standing."""

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


def motion_statistics(paths: Sequence[Path]) -> dict[str, Numbers]:
    """Every motion quantity of the real statistics, pooled over ``paths``; ``shares`` holds the plain shares."""
    speeds = [forward_speed_mps(path) for path in paths]
    speed = np.concatenate(speeds)
    turned = [path.yaw_rad[SECOND:] - path.yaw_rad[:-SECOND] for path in paths]
    acceleration = [speed[SECOND:] - speed[:-SECOND] for speed in speeds]
    length_m = np.array([np.hypot(np.diff(path.x_m), np.diff(path.y_m)).sum() for path in paths])
    duration_s = np.array([(len(path.x_m) - 1) / SECOND for path in paths])
    heading_deg = np.degrees([path.yaw_rad[-1] - path.yaw_rad[0] for path in paths])
    stops_and_drives = [np.abs(s).min() < STANDING_MPS < 1.0 < np.abs(s).max() for s in speeds]
    return {
        "speed_1s_mps": quantiles(speed),
        "speed_1s_mps_while_moving": quantiles(speed[speed >= STANDING_MPS]),
        "abs_yaw_rate_1s_degps": quantiles(np.degrees(np.abs(np.concatenate(turned)))),
        "longitudinal_accel_1s_mps2": quantiles(np.concatenate(acceleration)),
        "path_length_per_scene_m": quantiles(length_m),
        "mean_speed_per_scene_mps": quantiles(length_m / duration_s),
        "net_heading_change_per_scene_deg": quantiles(heading_deg),
        "abs_net_heading_change_per_scene_deg": quantiles(np.abs(heading_deg)),
        "shares": {
            "time_below_0p2_mps": float((np.abs(speed) < STANDING_MPS).mean()),
            "scenes_under_5_m": float((length_m < 5.0).mean()),
            "scenes_with_stop_and_drive": float(np.mean(stops_and_drives)),
            "scenes_turning_over_45_deg": float((np.abs(heading_deg) > 45.0).mean()),
            **{f"scenes_at_least_{m}_m": float((length_m >= m).mean()) for m in (10, 20, 50, 100, 150, 200)},
        },
    }


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
