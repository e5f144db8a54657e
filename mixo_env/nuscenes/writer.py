"""Write a folder in nuScenes format: the thirteen tables, the CAN bus, image files and one tiny map.

The official devkit opens the result, and so does :mod:`mixo_env.nuscenes.tables`: a folder written here and a real one
take the same path. Tokens are derived from what they stand for, so equal input gives equal files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.files import write_bytes
from mixo_env.geometry import quaternion_wxyz_from_rotation, quaternion_wxyz_from_yaw
from mixo_env.nuscenes.scene import CameraReel, Scene

Row = dict[str, Any]
Tables = dict[str, list[Row]]

SCENE_TABLES = ("scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "log", "sensor")
"""Tables that :func:`scene_tables` fills; rows of ``log`` and ``sensor`` repeat from scene to scene."""

EMPTY_TABLES = ("category", "attribute", "visibility", "instance", "sample_annotation")
"""Tables about annotated objects: written empty."""

MAP_FILE = "maps/blank.png"
"""The devkit refuses to start without a map image; odometry needs none."""

# A grey PNG of one black pixel.
_BLANK_PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108000000003a7e9b55"
    "0000000a49444154789c636000000002000148afa4710000000049454e44ae426082"
)


def token(*parts: object) -> str:
    """The 32 hexadecimal digits that identify a row made of ``parts``."""
    return hashlib.blake2b("\x1f".join(map(str, parts)).encode(), digest_size=16).hexdigest()


def image_name(log: str, channel: str, timestamp_us: int, is_keyframe: bool) -> str:
    """Path of an image below the data set's root, named as nuScenes does."""
    folder = "samples" if is_keyframe else "sweeps"
    return f"{folder}/{channel}/{log}__{channel}__{timestamp_us}.jpg"


def scene_tables(root: Path, scene: Scene, sample_us: Sequence[int] | NDArray[np.int64]) -> Tables:
    """All rows that describe one scene.

    Args:
        root: the data set's folder; image paths are written relative to it.
        scene: cameras with one key frame for every sample.
        sample_us: ``(K,)`` times of the key frames (the lidar's).

    Returns:
        Rows by the names of ``SCENE_TABLES``.

    Raises:
        DatasetError: a camera whose key frames do not match the samples, times that do not increase, no samples.
    """
    times = [int(time) for time in sample_us]
    if not times or any(later <= earlier for earlier, later in pairwise(times)):
        raise DatasetError(f"{scene.name}: sample times must increase and be at least one, got {len(times)} times")
    samples = [token("sample", scene.log, scene.name, time) for time in times]
    log_token, scene_token = token("log", scene.log), token("scene", scene.log, scene.name)
    tables: Tables = {name: [] for name in SCENE_TABLES}
    tables["log"].append(
        {
            "token": log_token,
            "logfile": scene.log,
            "vehicle": scene.vehicle,
            "date_captured": _date(scene.log),
            "location": scene.location,
        }
    )
    tables["scene"].append(
        {
            "token": scene_token,
            "log_token": log_token,
            "nbr_samples": len(samples),
            "first_sample_token": samples[0],
            "last_sample_token": samples[-1],
            "name": scene.name,
            "description": scene.description,
        }
    )
    chain = ["", *samples, ""]
    tables["sample"] += [
        {
            "token": samples[k],
            "timestamp": times[k],
            "prev": chain[k],
            "next": chain[k + 2],
            "scene_token": scene_token,
        }
        for k in range(len(samples))
    ]
    for channel, reel in scene.cameras.items():
        _add_camera(tables, root, scene, channel, reel, samples)
    return tables


def write_tables(root: Path, version: str, scenes: Iterable[Tables]) -> None:
    """Join the rows of all scenes and write the thirteen tables and the map, each atomically.

    Args:
        root: the data set's folder.
        version: name of the table folder, e.g. ``"v1.0-mixo"``.
        scenes: results of :func:`scene_tables`, in the order wanted.

    Raises:
        OutputError: a file cannot be written.
    """
    joined: dict[str, dict[str, Row]] = {name: {} for name in SCENE_TABLES}
    for tables in scenes:
        for name, rows in tables.items():
            joined[name].update((row["token"], row) for row in rows)
    finished: Tables = {name: list(rows.values()) for name, rows in joined.items()}
    finished["map"] = [
        {
            "category": "semantic_prior",
            "token": token("map", version),
            "filename": MAP_FILE,
            "log_tokens": [row["token"] for row in finished["log"]],
        }
    ]
    finished.update((name, []) for name in EMPTY_TABLES)
    write_bytes(root / MAP_FILE, _BLANK_PNG)
    for name, rows in finished.items():
        write_json(root / version / f"{name}.json", rows)


def write_can_bus(root: Path, scene_name: str, messages: Mapping[str, Sequence[Row]]) -> None:
    """Write ``can_bus/<scene>_<message>.json`` for every message, each atomically.

    Raises:
        OutputError: a file cannot be written.
    """
    for name, rows in messages.items():
        write_json(root / "can_bus" / f"{scene_name}_{name}.json", rows)


def write_json(path: Path, content: Any) -> None:
    """Write JSON atomically, folders included.

    Raises:
        OutputError: the file cannot be written.
    """
    write_bytes(path, json.dumps(content, separators=(",", ":")).encode())


def _add_camera(
    tables: Tables, root: Path, scene: Scene, channel: str, reel: CameraReel, samples: Sequence[str]
) -> None:
    """Rows of one camera: sensor, calibration, images and their poses."""
    keyframes = np.flatnonzero(reel.is_keyframe)
    if len(keyframes) != len(samples) or np.any(np.diff(reel.timestamp_us) <= 0):
        raise DatasetError(
            f"{scene.name} {channel}: expected {len(samples)} key frames and increasing times, "
            f"got {len(keyframes)} key frames"
        )
    calibration = reel.calibration
    sensor_token = token("sensor", channel)
    calibration_token = token("calibrated_sensor", scene.log, scene.name, channel)
    tables["sensor"].append({"token": sensor_token, "channel": channel, "modality": "camera"})
    tables["calibrated_sensor"].append(
        {
            "token": calibration_token,
            "sensor_token": sensor_token,
            "translation": calibration.translation_m.tolist(),
            "rotation": quaternion_wxyz_from_rotation(calibration.rotation_ego_from_camera).tolist(),
            "camera_intrinsic": calibration.intrinsic.tolist(),
        }
    )
    count = len(reel.timestamp_us)
    chain = ["", *(token("sample_data", scene.log, channel, time) for time in reel.timestamp_us.tolist()), ""]
    # A sweep belongs to the key frame that follows it; what comes after the last one belongs to the last.
    following = np.minimum(np.searchsorted(keyframes, np.arange(count)), len(samples) - 1)
    rotations = quaternion_wxyz_from_yaw(reel.yaw_rad)
    for i in range(count):
        tables["sample_data"].append(
            {
                "token": chain[i + 1],
                "sample_token": samples[following[i]],
                "ego_pose_token": chain[i + 1],
                "calibrated_sensor_token": calibration_token,
                "timestamp": int(reel.timestamp_us[i]),
                "fileformat": "jpg",
                "is_key_frame": bool(reel.is_keyframe[i]),
                "height": calibration.height,
                "width": calibration.width,
                "filename": reel.image_paths[i].relative_to(root).as_posix(),
                "prev": chain[i],
                "next": chain[i + 2],
            }
        )
        tables["ego_pose"].append(
            {
                "token": chain[i + 1],
                "timestamp": int(reel.timestamp_us[i]),
                "rotation": rotations[i].tolist(),
                "translation": [float(reel.x_m[i]), float(reel.y_m[i]), 0.0],
            }
        )


def _date(log: str) -> str:
    """The date in a log name such as n015-2018-07-24-11-22-45+0800."""
    return "-".join(log.split("-")[1:4])
