"""The needed columns of a nuScenes version as flat arrays: every camera image of every scene with its own ego pose.

One pass over each table. Lidar and radar rows are dropped as they come, nothing is kept as dictionaries, and rows are
ordered by scene, camera and *time*: ``prev``/``next`` chains are not needed and not trusted.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.geometry import yaw_from_quaternion_wxyz
from mixo_env.nuscenes.json_rows import read_rows

TABLES = ("scene", "log", "sample", "sensor", "calibrated_sensor", "sample_data", "ego_pose")
"""Tables that odometry needs, of the thirteen."""


class _SceneRow(msgspec.Struct, gc=False):
    token: str
    name: str
    description: str
    log_token: str
    nbr_samples: int


class _LogRow(msgspec.Struct, gc=False):
    token: str
    logfile: str
    vehicle: str
    location: str


class _SampleRow(msgspec.Struct, gc=False):
    token: str
    scene_token: str


class _SensorRow(msgspec.Struct, gc=False):
    token: str
    channel: str
    modality: str


class _CalibratedSensorRow(msgspec.Struct, gc=False):
    token: str
    sensor_token: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    camera_intrinsic: list[list[float]]


class _SampleDataRow(msgspec.Struct, gc=False):
    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    filename: str
    timestamp: int
    is_key_frame: bool
    width: int
    height: int


class _EgoPoseRow(msgspec.Struct, gc=False):
    token: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


class SceneRecord(msgspec.Struct, frozen=True):
    """One row of the scene table joined with its log."""

    name: str
    description: str
    log: str
    vehicle: str
    location: str
    keyframes: int


class CalibrationRecord(msgspec.Struct, frozen=True):
    """One row of the calibration table of a camera, at one image size, as written in the files."""

    channel: str
    translation_m: tuple[float, float, float]
    rotation_wxyz: tuple[float, float, float, float]
    intrinsic: list[list[float]]
    width: int
    height: int


@dataclass(frozen=True)
class ImageIndex:
    """All camera images of a version, ordered by scene, channel and time.

    Attributes:
        scenes: in ascending order of name.
        channels: cameras of the sensor table, in alphabetical order.
        calibrations: referred to by ``calibration``.
        filename_patterns: file names; where the image's timestamp stands in them, a tab stands instead.
        offset: ``(scenes * channels + 1,)``; images of scene i and channel c are
            ``offset[i * channels + c] : offset[i * channels + c + 1]``.
        timestamp_us: ``(n,)`` Unix microseconds, ascending within a scene and camera.
        x_m, y_m, yaw_rad: ``(n,)`` ego pose of each image (map frame); NaN where the pose row is missing.
        quaternion_norm: ``(n,)`` length of the pose quaternion: 1 in sound data.
        is_keyframe: ``(n,)`` bool.
        calibration: ``(n,)`` index into ``calibrations``.
        filename_pattern: ``(n,)`` index into ``filename_patterns``.
    """

    scenes: tuple[SceneRecord, ...]
    channels: tuple[str, ...]
    calibrations: tuple[CalibrationRecord, ...]
    filename_patterns: tuple[str, ...]
    offset: NDArray[np.int64]
    timestamp_us: NDArray[np.int64]
    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    yaw_rad: NDArray[np.float64]
    quaternion_norm: NDArray[np.float32]
    is_keyframe: NDArray[np.bool_]
    calibration: NDArray[np.int32]
    filename_pattern: NDArray[np.int32]

    def images(self, scene: int, channel: int) -> slice:
        """Rows of one camera in one scene."""
        group = scene * len(self.channels) + channel
        return slice(int(self.offset[group]), int(self.offset[group + 1]))

    def filename(self, row: int) -> str:
        """File name of one image, relative to the root of the data set."""
        head, separator, tail = self.filename_patterns[self.filename_pattern[row]].partition("\t")
        return f"{head}{self.timestamp_us[row]}{tail}" if separator else head


def build_index(version_folder: Path) -> ImageIndex:
    """Read the tables in ``version_folder``.

    Raises:
        DatasetError: a table is missing or broken, or a row refers to a token that does not exist.
    """
    scenes, scene_of_sample = _read_scenes(version_folder)
    channel_of_calibrated_sensor, sensors, channels = _read_cameras(version_folder)

    # One entry per camera image, in file order.
    group, timestamp_us, is_keyframe, calibration, pattern, pose_slot = (array("q") for _ in range(6))
    slot_of_pose: dict[str, int] = {}
    pattern_index: dict[str, int] = {}
    calibration_index: dict[tuple[str, int, int], int] = {}
    for row in read_rows(version_folder / "sample_data.json", _SampleDataRow):
        channel = channel_of_calibrated_sensor.get(row.calibrated_sensor_token)
        if channel is None:
            raise _dangling(version_folder, "sample_data", "calibrated_sensor", row.calibrated_sensor_token)
        if channel < 0:
            continue
        scene = scene_of_sample.get(row.sample_token)
        if scene is None:
            raise _dangling(version_folder, "sample_data", "sample", row.sample_token)
        group.append(scene * len(channels) + channel)
        timestamp_us.append(row.timestamp)
        is_keyframe.append(row.is_key_frame)
        calibration_key = (row.calibrated_sensor_token, row.width, row.height)
        calibration.append(calibration_index.setdefault(calibration_key, len(calibration_index)))
        pattern_text = row.filename.replace(str(row.timestamp), "\t", 1)
        pattern.append(pattern_index.setdefault(pattern_text, len(pattern_index)))
        pose_slot.append(slot_of_pose.setdefault(row.ego_pose_token, len(slot_of_pose)))

    pose = _read_poses(version_folder, slot_of_pose)[np.array(pose_slot, dtype=np.int64)]
    group_array = np.array(group, dtype=np.int64)
    time_array = np.array(timestamp_us, dtype=np.int64)
    order = np.lexsort((time_array, group_array))
    return ImageIndex(
        scenes=scenes,
        channels=channels,
        calibrations=tuple(
            CalibrationRecord(
                channel=channels[channel_of_calibrated_sensor[token]],
                translation_m=sensors[token].translation,
                rotation_wxyz=sensors[token].rotation,
                intrinsic=sensors[token].camera_intrinsic,
                width=width,
                height=height,
            )
            for token, width, height in calibration_index
        ),
        filename_patterns=tuple(pattern_index),
        offset=np.searchsorted(group_array[order], np.arange(len(scenes) * len(channels) + 1)),
        timestamp_us=time_array[order],
        x_m=pose[order, 0],
        y_m=pose[order, 1],
        yaw_rad=pose[order, 2],
        quaternion_norm=pose[order, 3].astype(np.float32),
        is_keyframe=np.array(is_keyframe, dtype=np.bool_)[order],
        calibration=np.array(calibration, dtype=np.int32)[order],
        filename_pattern=np.array(pattern, dtype=np.int32)[order],
    )


def _read_scenes(folder: Path) -> tuple[tuple[SceneRecord, ...], dict[str, int]]:
    """Scenes by ascending name, and sample token -> position of its scene."""
    logs = {log.token: log for log in read_rows(folder / "log.json", _LogRow)}
    rows = sorted(read_rows(folder / "scene.json", _SceneRow), key=lambda scene: scene.name)
    records = []
    for row in rows:
        log = logs.get(row.log_token)
        if log is None:
            raise _dangling(folder, "scene", "log", row.log_token)
        records.append(
            SceneRecord(row.name, row.description, log.logfile, log.vehicle, log.location, keyframes=row.nbr_samples)
        )
    position = {row.token: index for index, row in enumerate(rows)}
    scene_of_sample = {}
    for sample in read_rows(folder / "sample.json", _SampleRow):
        if sample.scene_token not in position:
            raise _dangling(folder, "sample", "scene", sample.scene_token)
        scene_of_sample[sample.token] = position[sample.scene_token]
    return tuple(records), scene_of_sample


def _read_cameras(folder: Path) -> tuple[dict[str, int], dict[str, _CalibratedSensorRow], tuple[str, ...]]:
    """Calibrated-sensor token -> channel position (-1: not a camera), rows by token, channel names."""
    sensors = {sensor.token: sensor for sensor in read_rows(folder / "sensor.json", _SensorRow)}
    channels = tuple(sorted({sensor.channel for sensor in sensors.values() if sensor.modality == "camera"}))
    rows, channel_of = {}, {}
    for row in read_rows(folder / "calibrated_sensor.json", _CalibratedSensorRow):
        sensor = sensors.get(row.sensor_token)
        if sensor is None:
            raise _dangling(folder, "calibrated_sensor", "sensor", row.sensor_token)
        is_camera = sensor.modality == "camera"
        channel_of[row.token] = channels.index(sensor.channel) if is_camera else -1
        if is_camera:
            rows[row.token] = row
    return channel_of, rows, channels


def _read_poses(folder: Path, slot_of_pose: dict[str, int]) -> NDArray[np.float64]:
    """``(slots, 4)``: x, y, yaw and quaternion length of the poses asked for; NaN where the table has none."""
    translation = np.full((len(slot_of_pose), 2), np.nan)
    rotation = np.full((len(slot_of_pose), 4), np.nan)
    for row in read_rows(folder / "ego_pose.json", _EgoPoseRow):
        slot = slot_of_pose.get(row.token)
        if slot is not None:
            translation[slot] = row.translation[:2]
            rotation[slot] = row.rotation
    norm = np.linalg.norm(rotation, axis=1)
    return np.column_stack([translation, yaw_from_quaternion_wxyz(rotation), norm])


def _dangling(folder: Path, table: str, target: str, token: str) -> DatasetError:
    return DatasetError(
        f"{folder / table}.json refers to {target} {token!r}, which {target}.json does not hold: "
        "the tables are not of one version, unpack the metadata again"
    )
