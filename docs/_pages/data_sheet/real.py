"""The real side of the sheet: computed from a folder of real data when there is one, else what was stored of it.

Only figures of our own are stored (``real.json``), never data. The folder holds ``nuscenes_motion_850.json`` (all
drives), ``nuscenes_motion_statistics.json`` (135 of them, with their frames), ``nuscenes_can_bus/``,
``nuscenes_keyframe_6cam/`` and ``kitti_06/``.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from docs._pages.data_sheet.images import real_pairs, real_pictures
from docs._pages.data_sheet.sensors import sensor_statistics
from experiments.stored_figures import load, save
from mixo_env.nuscenes.can_bus import scenes_with_can_bus

STORED = Path(__file__).parent / "real.json"
ENVIRONMENT = "MIXO_REAL_DATA"


def real_data_folder() -> Path | None:
    """Where the real data is, if the environment says so."""
    name = os.environ.get(ENVIRONMENT)
    return Path(name) if name and Path(name).is_dir() else None


def real_statistics(data: Path) -> dict[str, Any]:
    """Everything real that the sheet prints."""
    own = json.loads((data / "nuscenes_motion_statistics.json").read_text())
    motion, intervals = own["motion"], own["frame_intervals"]
    per_scene = {int(frames): scenes for frames, scenes in motion["rows_per_scene"].items()}
    frames = sorted(frames for frames, scenes in per_scene.items() for _ in range(scenes))
    can_bus = data / "nuscenes_can_bus"
    return {
        "motion": real_motion(data),
        "intervals": {
            "frames": _interval(intervals["both_scenes_CAM_FRONT"]),
            "keyframes": _interval(intervals["keyframes_ten_mini_scenes"]),
            "frames_per_scene": {
                "min": frames[0],
                "median": frames[len(frames) // 2],
                "max": frames[-1],
            },
        },
        "sensors": {scene: sensor_statistics(can_bus, scene) for scene in sorted(scenes_with_can_bus(can_bus))},
        "pictures": real_pictures(data),
        "pairs": real_pairs(data),
    }


def real_motion(data: Path) -> dict[str, dict[str, float]]:
    """Quantiles of all 850 drives, named as :func:`motion_statistics` does."""
    known = json.loads((data / "nuscenes_motion_850.json").read_text())
    return {
        name: {key: float(value) for key, value in entry.items() if key != "max"}
        for name, entry in known.items()
        if isinstance(entry, dict)
    }


def refresh() -> bool:
    """Store the figures anew if real data is there; whether it was."""
    data = real_data_folder()
    if data is not None:
        save(STORED, real_statistics(data))
    return data is not None


def load_real() -> dict[str, Any]:
    """The stored figures."""
    return load(STORED)


def _interval(entry: dict[str, Any]) -> dict[str, float]:
    shares = {f"share_{grid}_s": share for grid, share in entry["share_by_nearest_0p05_s"].items()}
    plain = {name: entry[name] for name in ("mean_s", "min_s", "max_s", "n")}
    return plain | {"grid_std_s": entry["deviation_from_0p05_grid_s"]["std"]} | shares
