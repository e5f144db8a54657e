"""The needed columns of a nuScenes version as flat arrays: every camera image of every scene with its own ego pose.

One pass over each table. Lidar and radar rows are dropped as they come, nothing is kept as dictionaries, and rows are
ordered by scene, camera and *time*: ``prev``/``next`` chains are not needed and not trusted.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.geometry import yaw_from_quaternion_wxyz
from mixo_env.nuscenes.json_rows import broken, read_blocks
from mixo_env.nuscenes.limits import Component, Coordinate, Count, Pixels, Side, TimeUs
from mixo_env.nuscenes.names import check_channel, check_name, check_path, check_text

TABLES = ("scene", "log", "sample", "sensor", "calibrated_sensor", "sample_data", "ego_pose")
"""Tables that odometry needs, of the thirteen."""


class _SceneRow(msgspec.Struct, gc=False):
    token: str
    name: str
    description: str
    log_token: str
    nbr_samples: Count


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
    translation: tuple[Component, Component, Component]
    rotation: tuple[Component, Component, Component, Component]
    camera_intrinsic: list[list[Pixels]]


class _SampleDataRow(msgspec.Struct, gc=False):
    token: str
    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    filename: str
    timestamp: TimeUs
    is_key_frame: bool
    width: Side
    height: Side


class _EgoPoseRow(msgspec.Struct, gc=False):
    token: str
    timestamp: TimeUs
    translation: tuple[Coordinate, Coordinate, Coordinate]
    rotation: tuple[Component, Component, Component, Component]


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
        tilt_rad: ``(n,)`` angle between the ego's z axis and the map's: next to 0 in sound data.
        pose_delay_s: ``(n,)`` time of the pose row minus that of the image: 0 in sound data.
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
    tilt_rad: NDArray[np.float32]
    pose_delay_s: NDArray[np.float32]
    is_keyframe: NDArray[np.bool_]
    calibration: NDArray[np.int32]
    filename_pattern: NDArray[np.int32]

    def check(self, where: str) -> None:
        """See that the columns fit each other and that no name leads out of the folder.

        Raises:
            DatasetError: they do not.
        """
        count = len(self.timestamp_us)
        columns = (self.x_m, self.y_m, self.yaw_rad, self.quaternion_norm, self.tilt_rad, self.pose_delay_s)
        columns += (self.is_keyframe, self.calibration, self.filename_pattern)
        groups = len(self.scenes) * len(self.channels)
        fits = all(column.shape == (count,) for column in columns) and self.offset.shape == (groups + 1,)
        fits = fits and self.offset[0] == 0 and self.offset[-1] == count and bool(np.all(np.diff(self.offset) >= 0))
        for column, names in (
            (self.calibration, self.calibrations),
            (self.filename_pattern, self.filename_patterns),
        ):
            fits = fits and (not count or bool(column.min() >= 0 and column.max() < len(names)))
        if not fits:
            raise DatasetError(f"{where}: its columns do not fit each other")
        for scene in self.scenes:
            check_name(where, scene.name)
        for channel in self.channels:
            check_channel(where, channel)
        for pattern in self.filename_patterns:
            check_path(where, pattern.replace("\t", "0", 1))

    def images(self, scene: int, channel: int) -> slice:
        """Rows of one camera in one scene."""
        group = scene * len(self.channels) + channel
        return slice(int(self.offset[group]), int(self.offset[group + 1]))

    def filenames(self, rows: NDArray[np.int64]) -> list[str]:
        """File names of some images, relative to the root of the data set."""
        parts = self._filename_parts
        named = zip(self.filename_pattern[rows].tolist(), self.timestamp_us[rows].tolist(), strict=True)
        return [f"{parts[n][0]}{time}{parts[n][2]}" if parts[n][1] else parts[n][0] for n, time in named]

    @cached_property
    def _filename_parts(self) -> list[tuple[str, str, str]]:
        """What stands before the time, a tab if there is one, and what stands behind."""
        return [pattern.partition("\t") for pattern in self.filename_patterns]


def build_index(version_folder: Path) -> ImageIndex:
    """Read the tables in ``version_folder``.

    Raises:
        DatasetError: a table is missing, empty or broken, holds a token twice or a name that leads out of the folder,
            or a row refers to a token that does not exist.
    """
    scenes, scene_of_sample = _read_scenes(version_folder)
    channel_of_calibrated_sensor, sensors, channels = _read_cameras(version_folder)

    # One entry per camera image, in file order.
    group, timestamp_us, is_keyframe, calibration, pattern, pose_hash = (array("q") for _ in range(6))
    pattern_index: dict[str, int] = {}
    calibration_index: dict[tuple[str, int, int], int] = {}
    table = version_folder / "sample_data.json"
    for row in _unique(table, _SampleDataRow):
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
        text = row.filename.replace(str(row.timestamp), "\t", 1)
        if text not in pattern_index:
            check_path(f"{table}, row {row.token!r}", row.filename)
            pattern_index[text] = len(pattern_index)
        pattern.append(pattern_index[text])
        pose_hash.append(hash(row.ego_pose_token))

    wanted, slots = np.unique(np.array(pose_hash, dtype=np.int64), return_inverse=True)
    group_array, time_array = (np.array(values, dtype=np.int64) for values in (group, timestamp_us))
    order = np.lexsort((time_array, group_array))
    pose = _read_poses(version_folder, wanted).at(slots[order])
    return ImageIndex(
        scenes=scenes,
        channels=channels,
        calibrations=tuple(
            _calibration(channels[channel_of_calibrated_sensor[token]], sensors[token], width, height)
            for token, width, height in calibration_index
        ),
        filename_patterns=tuple(pattern_index),
        offset=np.searchsorted(group_array[order], np.arange(len(scenes) * len(channels) + 1)),
        timestamp_us=time_array[order],
        x_m=pose.x_m,
        y_m=pose.y_m,
        yaw_rad=pose.yaw_rad,
        quaternion_norm=pose.quaternion_norm,
        tilt_rad=pose.tilt_rad,
        pose_delay_s=(1e-6 * (pose.timestamp_us - time_array[order])).astype(np.float32),
        is_keyframe=np.array(is_keyframe, dtype=np.bool_)[order],
        calibration=np.array(calibration, dtype=np.int32)[order],
        filename_pattern=np.array(pattern, dtype=np.int32)[order],
    )


def _calibration(channel: str, sensor: _CalibratedSensorRow, width: int, height: int) -> CalibrationRecord:
    return CalibrationRecord(
        channel=channel,
        translation_m=sensor.translation,
        rotation_wxyz=sensor.rotation,
        intrinsic=sensor.camera_intrinsic,
        width=width,
        height=height,
    )


def _read_scenes(folder: Path) -> tuple[tuple[SceneRecord, ...], dict[str, int]]:
    """Scenes by ascending name, and sample token -> position of its scene."""
    table = folder / "log.json"
    logs = {log.token: log for log in _unique(table, _LogRow)}
    for log in logs.values():
        for kind, text in (("log", log.logfile), ("vehicle", log.vehicle), ("location", log.location)):
            check_text(f"{table}, row {log.token!r}", kind, text)
    table = folder / "scene.json"
    rows = sorted(_unique(table, _SceneRow), key=lambda scene: scene.name)
    if not rows:
        raise broken(table, "it holds no scenes")
    records, names = [], set()
    for row in rows:
        check_name(f"{table}, row {row.token!r}", row.name)
        # Two names that differ in case only are one file on many disks.
        if row.name.casefold() in names:
            raise broken(table, f"two scenes are named {row.name!r}")
        names.add(row.name.casefold())
        log = logs.get(row.log_token)
        if log is None:
            raise _dangling(folder, "scene", "log", row.log_token)
        records.append(
            SceneRecord(row.name, row.description, log.logfile, log.vehicle, log.location, keyframes=row.nbr_samples)
        )
    position = {row.token: index for index, row in enumerate(rows)}
    scene_of_sample = {}
    table = folder / "sample.json"
    for sample in _unique(table, _SampleRow):
        if sample.scene_token not in position:
            raise _dangling(folder, "sample", "scene", sample.scene_token)
        scene_of_sample[sample.token] = position[sample.scene_token]
    return tuple(records), scene_of_sample


def _read_cameras(folder: Path) -> tuple[dict[str, int], dict[str, _CalibratedSensorRow], tuple[str, ...]]:
    """Calibrated-sensor token -> channel position (-1: not a camera), rows by token, channel names."""
    table = folder / "sensor.json"
    sensors = {sensor.token: sensor for sensor in _unique(table, _SensorRow)}
    channels = tuple(sorted({sensor.channel for sensor in sensors.values() if sensor.modality == "camera"}))
    if not channels:
        raise broken(table, "it holds no cameras")
    for channel in channels:
        check_channel(str(table), channel)
    rows, channel_of = {}, {}
    table = folder / "calibrated_sensor.json"
    for row in _unique(table, _CalibratedSensorRow):
        sensor = sensors.get(row.sensor_token)
        if sensor is None:
            raise _dangling(folder, "calibrated_sensor", "sensor", row.sensor_token)
        is_camera = sensor.modality == "camera"
        channel_of[row.token] = channels.index(sensor.channel) if is_camera else -1
        if is_camera:
            rows[row.token] = row
    return channel_of, rows, channels


class _Poses(NamedTuple):
    """Columns of the poses asked for, ``(n,)`` each; NaN where the table has none."""

    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    yaw_rad: NDArray[np.float64]
    quaternion_norm: NDArray[np.float32]
    tilt_rad: NDArray[np.float32]
    timestamp_us: NDArray[np.int64]

    def at(self, rows: NDArray[np.int64]) -> _Poses:
        """Some of the rows, in another order."""
        return _Poses(
            self.x_m[rows],
            self.y_m[rows],
            self.yaw_rad[rows],
            self.quaternion_norm[rows],
            self.tilt_rad[rows],
            self.timestamp_us[rows],
        )


def _read_poses(folder: Path, wanted: NDArray[np.int64]) -> _Poses:
    """Poses of the rows whose hashed tokens are ``wanted`` (increasing), in that order.

    Millions of tokens as text would fill half a gigabyte; that their hashes differ is checked with the tokens.
    """
    values = np.full((len(wanted), 6), np.nan)
    timestamp_us = np.zeros(len(wanted), np.int64)
    table = folder / "ego_pose.json"
    hashes = []
    for rows in read_blocks(table, _EgoPoseRow):
        hashes.append(np.array([hash(row.token) for row in rows], dtype=np.int64))
        slot = np.searchsorted(wanted, hashes[-1])
        found = np.flatnonzero(wanted[np.minimum(slot, len(wanted) - 1)] == hashes[-1]) if len(wanted) else []
        if len(found):
            chosen = [rows[i] for i in found]
            values[slot[found]] = [(*row.translation[:2], *row.rotation) for row in chosen]
            timestamp_us[slot[found]] = [row.timestamp for row in chosen]
    _check_unique(table, np.concatenate(hashes))
    rotation = values[:, 2:]
    with np.errstate(invalid="ignore", divide="ignore"):
        norm = np.linalg.norm(rotation, axis=1)
        _, x, y, _ = (rotation / norm[:, None]).T
        tilt = np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))
    yaw = yaw_from_quaternion_wxyz(rotation)
    return _Poses(
        values[:, 0],
        values[:, 1],
        yaw,
        norm.astype(np.float32),
        tilt.astype(np.float32),
        timestamp_us,
    )


_Row = TypeVar("_Row", _SceneRow, _LogRow, _SampleRow, _SensorRow, _CalibratedSensorRow, _SampleDataRow)


def _unique(table: Path, row_type: type[_Row]) -> Iterator[_Row]:
    """The rows of a table; after the last one, their tokens are checked to differ."""
    hashes = array("q")
    for rows in read_blocks(table, row_type):
        hashes.extend([hash(row.token) for row in rows])
        yield from rows
    _check_unique(table, np.array(hashes, dtype=np.int64))


def _check_unique(table: Path, hashes: NDArray[np.int64]) -> None:
    """See that no token stands in a table twice.

    Eight bytes a token are 20 MB for the largest table. That two of its 2.6 million tokens share a hash by accident has
    a chance of one in five millions.
    """
    ordered = np.sort(hashes)
    repeated = ordered[1:][ordered[1:] == ordered[:-1]]
    if len(repeated):
        first, second = np.flatnonzero(hashes == repeated[0])[:2]
        raise broken(table, f"{len(repeated)} tokens stand there twice, first in rows {first} and {second}")


def _dangling(folder: Path, table: str, target: str, token: str) -> DatasetError:
    return DatasetError(
        f"{folder / table}.json refers to {target} {token!r}, which {target}.json does not hold: "
        "the tables are not of one version, unpack the metadata again"
    )
