"""Open a nuScenes folder, real or simulated, and load its scenes as plain arrays.

    >>> dataset = open_dataset(Path("/data/nuscenes"))            # doctest: +SKIP
    >>> scene = dataset.load("scene-0061")                        # doctest: +SKIP

Opening reads the tables once and keeps a cache (:mod:`mixo_env.nuscenes.cache`); scenes are slices of it.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, DatasetError, unknown
from mixo_env.geometry import rotation_from_quaternion_wxyz
from mixo_env.nuscenes.cache import cached_index
from mixo_env.nuscenes.can_bus import read_can_bus, scenes_with_can_bus
from mixo_env.nuscenes.files import LARGEST_FILE_BYTES, open_file
from mixo_env.nuscenes.index import CalibrationRecord, ImageIndex
from mixo_env.nuscenes.limits import LONGEST_SCENE_S
from mixo_env.nuscenes.scene import CameraCalibration, CameraReel, ExactPoses, ImagePaths, Scene
from mixo_env.nuscenes.selections import CAMERAS, conditions_of

UNIT_QUATERNION_TOLERANCE = 1e-3


@dataclass(frozen=True)
class SceneInfo:
    """One scene as the tables describe it, without its images: enough to select scenes and to make folds."""

    name: str
    description: str
    log: str
    vehicle: str
    location: str
    conditions: tuple[str, ...]
    keyframes: int
    has_can_bus: bool


@dataclass(frozen=True)
class Dataset:
    """An opened nuScenes folder.

    Attributes:
        root: the folder that holds ``v1.0-*``, ``samples``, ``sweeps`` and ``can_bus``.
        version: name of the table folder, e.g. ``"v1.0-trainval"``.
        index: all camera images as flat arrays.
        keyframes_only: leave the images between key frames out, as if ``sweeps`` did not exist.
    """

    root: Path
    version: str
    index: ImageIndex
    keyframes_only: bool = False

    def __reduce__(self) -> tuple[Callable[[Path, str, bool], Dataset], tuple[Path, str, bool]]:
        """Another process opens the cache again instead of being sent the index, which is large."""
        return open_dataset, (self.root, self.version, self.keyframes_only)

    @property
    def scene_names(self) -> tuple[str, ...]:
        """All scenes in ascending order of name."""
        return tuple(self._position_of_scene)

    @property
    def channels(self) -> tuple[str, ...]:
        """All cameras of the sensor table."""
        return self.index.channels

    @cached_property
    def scenes(self) -> tuple[SceneInfo, ...]:
        """All scenes as described by the tables, in ascending order of name."""
        with_can_bus = scenes_with_can_bus(self.root / "can_bus")
        return tuple(
            SceneInfo(
                name=record.name,
                description=record.description,
                log=record.log,
                vehicle=record.vehicle,
                location=record.location,
                conditions=conditions_of(record.description),
                keyframes=record.keyframes,
                has_can_bus=record.name in with_can_bus,
            )
            for record in self.index.scenes
        )

    def load(self, name: str, cameras: tuple[str, ...] = CAMERAS) -> Scene:
        """Load one scene; image files are not looked at.

        Args:
            name: e.g. ``"scene-0061"``.
            cameras: channels, in the order wanted.

        Raises:
            ConfigurationError: no such scene or camera.
            DatasetError: the scene's rows are broken (no images of a camera, repeated times, missing poses, changing
                calibration), or a CAN bus file cannot be read.
        """
        record = self.index.scenes[self.position(name)]
        reels = {camera: self.reel(name, camera) for camera in cameras}
        return Scene(
            name=name,
            description=record.description,
            log=record.log,
            vehicle=record.vehicle,
            location=record.location,
            conditions=conditions_of(record.description),
            cameras=reels,
            can_bus=read_can_bus(self.root / "can_bus", name),
            exact=_read_exact(self.root / "exact" / f"{name}.npz"),
        )

    def position(self, name: str) -> int:
        """Position of a scene in ``index.scenes``.

        Raises:
            ConfigurationError: no such scene.
        """
        if name not in self._position_of_scene:
            names = self.scene_names
            if len(names) > 20:
                message = f"unknown scene {name!r}: {self.version} holds {len(names)}, {names[0]} to {names[-1]}"
                raise ConfigurationError(message)
            raise ConfigurationError(unknown("scene", name, names))
        return self._position_of_scene[name]

    def channel(self, camera: str) -> int:
        """Position of a camera in ``channels``.

        Raises:
            ConfigurationError: no such camera.
        """
        if camera not in self.channels:
            raise ConfigurationError(unknown("camera", camera, self.channels))
        return self.channels.index(camera)

    def rows(self, name: str, camera: str) -> NDArray[np.int64]:
        """Rows of ``index`` of one camera in one scene, in order of time.

        Raises:
            ConfigurationError: no such scene or camera.
        """
        images = self.index.images(self.position(name), self.channel(camera))
        rows = np.arange(images.start, images.stop)
        return rows[self.index.is_keyframe[images]] if self.keyframes_only else rows

    def distance_m(self, name: str) -> float:
        """Way of a scene in metres, by the poses of the camera that has most images; NaN where a pose is missing."""
        rows = max((self.rows(name, camera) for camera in self.channels), key=len)
        return float(np.hypot(np.diff(self.index.x_m[rows]), np.diff(self.index.y_m[rows])).sum())

    def has_images(self, camera: str) -> bool:
        """Whether the tables list images of a camera in any scene."""
        offset, step = self.index.offset, len(self.channels)
        position = self.channel(camera)
        return bool(np.any(np.diff(offset)[position::step] > 0))

    def has_folder(self, camera: str) -> bool:
        """Whether images of a camera were unpacked: there is a folder of its name."""
        return any((self.root / folder / camera).is_dir() for folder in ("samples", "sweeps"))

    def reel(self, name: str, camera: str) -> CameraReel:
        """All images of one camera in one scene; image files are not looked at.

        Raises:
            ConfigurationError: no such scene or camera.
            DatasetError: the rows are broken.
        """
        index, rows = self.index, self.rows(name, camera)
        label = f"{name} {camera}"
        if not len(rows):
            raise DatasetError(f"{label}: the tables list no images; expected about 12 a second")
        calibration = _calibration(label, [index.calibrations[i] for i in np.unique(index.calibration[rows])])
        time = index.timestamp_us[rows]
        if repeated := int(np.count_nonzero(np.diff(time) <= 0)):
            raise DatasetError(
                f"{label}: {repeated} images repeat the time of the one before; expected increasing times"
            )
        if (span_s := 1e-6 * float(time[-1] - time[0])) > LONGEST_SCENE_S:
            raise DatasetError(f"{label}: images span {span_s:.0f} s; a scene lasts 20 s, at most {LONGEST_SCENE_S:g}")
        norm_error = np.abs(index.quaternion_norm[rows] - 1.0)
        if not np.all(norm_error < UNIT_QUATERNION_TOLERANCE):  # also catches NaN
            missing = int(np.count_nonzero(np.isnan(norm_error)))
            broken = int(np.count_nonzero(norm_error >= UNIT_QUATERNION_TOLERANCE))
            raise DatasetError(
                f"{label}: {missing} images have no ego pose and {broken} one whose quaternion is not unit"
            )
        return CameraReel(
            calibration=calibration,
            timestamp_us=time,
            image_paths=ImagePaths(self.root, index.filenames(rows)),
            is_keyframe=index.is_keyframe[rows],
            x_m=index.x_m[rows],
            y_m=index.y_m[rows],
            yaw_rad=index.yaw_rad[rows],
        )

    @cached_property
    def _position_of_scene(self) -> dict[str, int]:
        return {record.name: position for position, record in enumerate(self.index.scenes)}


def open_dataset(root: Path, version: str | None = None, keyframes_only: bool = False) -> Dataset:
    """Open the nuScenes folder ``root``.

    Args:
        root: the folder that holds the version folder, ``samples`` and ``sweeps``.
        version: name of the version folder; needed only when there are several.
        keyframes_only: leave the images between key frames out, for folders without ``sweeps``.

    Raises:
        DatasetError: not a nuScenes folder, a table is missing or broken.
        ConfigurationError: the version is not there, or there are several and none is named.
    """
    root = Path(root).absolute()
    version = _find_version(root, version)
    return Dataset(root=root, version=version, index=cached_index(root, version), keyframes_only=keyframes_only)


def _find_version(root: Path, version: str | None) -> str:
    if not root.is_dir():
        raise DatasetError(f"{root} is not a folder: give the folder that holds v1.0-trainval, samples and sweeps")
    if (root / "sample_data.json").is_file():
        raise DatasetError(f"{root} is the folder of the tables: give the folder above it, {root.parent}")
    try:
        versions = sorted(path.name for path in root.iterdir() if (path / "sample_data.json").is_file())
    except OSError as error:
        raise DatasetError(f"{root} cannot be read: {error.strerror}") from None
    if version is not None:
        if Path(version).name != version:
            raise ConfigurationError(f"--version must be the name of a folder in {root}, got {version!r}")
        # A folder that is there but lacks tables gets the precise message of the reader.
        if version not in versions and not (root / version).is_dir():
            raise ConfigurationError(unknown("version", version, versions))
        return version
    if not versions:
        versions = sorted(path.name for path in root.glob("v1.0-*") if path.is_dir())
    if not versions:
        raise DatasetError(
            f"{root} is not a nuScenes folder: expected a folder like v1.0-trainval with the tables in it"
        )
    if len(versions) > 1:
        raise ConfigurationError(f"{root} holds several versions, {', '.join(versions)}: name one with --version")
    return versions[0]


def _calibration(label: str, records: list[CalibrationRecord]) -> CameraCalibration:
    """The one calibration of a camera in a scene; equal rows under several tokens are fine."""
    record = records[0]
    if any(other != record for other in records[1:]):
        raise DatasetError(f"{label}: the calibration changes within the scene; expected one per scene and camera")
    is_square = [len(row) for row in record.intrinsic] == [3, 3, 3]  # rows of the file may differ in length
    intrinsic = np.array(record.intrinsic if is_square else np.zeros((3, 3)), dtype=np.float64)
    if not np.all(np.isfinite(intrinsic)) or intrinsic[0, 0] <= 0 or intrinsic[1, 1] <= 0:
        raise DatasetError(
            f"{label}: camera_intrinsic must be a finite 3x3 matrix with focal lengths > 0, it is {record.intrinsic}"
        )
    rotation = np.array(record.rotation_wxyz)
    if not abs(np.linalg.norm(rotation) - 1.0) < UNIT_QUATERNION_TOLERANCE:
        raise DatasetError(f"{label}: the mounting's quaternion must have length 1, it is {record.rotation_wxyz}")
    return CameraCalibration(
        channel=record.channel,
        intrinsic=intrinsic,
        rotation_ego_from_camera=rotation_from_quaternion_wxyz(rotation),
        translation_m=np.array(record.translation_m),
        width=record.width,
        height=record.height,
    )


def _read_exact(path: Path) -> ExactPoses | None:
    """Noise-free truth beside a simulated scene; ``None`` for real data."""
    try:
        with open_file(path) as file, np.load(file, allow_pickle=False) as archive:
            # An archive of a few kilobytes can unpack to any size.
            if sum(entry.file_size for entry in archive.zip.infolist()) > LARGEST_FILE_BYTES:
                raise ValueError(f"it unpacks to more than {LARGEST_FILE_BYTES // 2**20} MB")
            exact = ExactPoses(
                timestamp_us=archive["timestamp_us"].astype(np.int64, casting="safe"),
                x_m=archive["x_m"].astype(np.float64),
                y_m=archive["y_m"].astype(np.float64),
                yaw_rad=archive["yaw_rad"].astype(np.float64),
            )
        columns = (exact.timestamp_us, exact.x_m, exact.y_m, exact.yaw_rad)
        if len({column.shape for column in columns}) > 1 or exact.timestamp_us.ndim != 1 or not len(exact.x_m):
            raise ValueError("its columns are not of one length")
        if np.any(np.diff(exact.timestamp_us) <= 0) or not all(np.isfinite(column).all() for column in columns):
            raise ValueError("its times do not increase, or a value is not finite")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, KeyError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{path} is not a file of exact poses ({error}): simulate the scene again") from error
    return exact
