"""Image sequences with known motion, as benchmarks of odometry want them: from nuScenes folders, or one of KITTI."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.scene import CameraCalibration, CameraReel, Scene
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.steps import read_grey

FloatArray = NDArray[np.float64]

_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # ego from a camera that looks ahead
_KITTI_MOUNTING_M = (1.1, 0.0, 1.65)
_KITTI_INTERVAL_S = 0.10365  # the nominal 10 Hz of its camera are 9.65 Hz


class Reader(Protocol):
    """How the image files of a drive are read."""

    def __call__(self, path: Path, halvings: int = 0) -> NDArray[np.uint8]:
        """A file as ``(height, width)`` grey uint8; raises :class:`DatasetError` if it cannot be read."""
        ...


@dataclass(frozen=True)
class Drive:
    """One camera over one scene.

    Attributes:
        scene: its name.
        calibration: of the camera.
        image_paths: ``n`` files.
        timestamp_us: ``(n,)`` their times.
        turn_rad: ``(n - 1,)`` true yaw increments between consecutive images, left positive.
        path_m: ``(n - 1,)`` true path lengths.
        read: path -> grey image; by request halved so many times, where the file's decoder can do that on the way.
    """

    scene: str
    calibration: CameraCalibration
    image_paths: tuple[Path, ...]
    timestamp_us: NDArray[np.int64]
    turn_rad: FloatArray
    path_m: FloatArray
    read: Reader


def open_drives(root: Path, scenes: tuple[str, ...], cameras: tuple[str, ...]) -> Iterator[Drive]:
    """All drives of a folder.

    Args:
        root: nuScenes folder, real or simulated, or a KITTI sequence (``image_0``, ``calib.txt``, ``poses.txt``).
        scenes: names; empty for all. A KITTI sequence is one scene.
        cameras: channels. A KITTI sequence has one, CAM_FRONT.
    """
    if (root / "image_0").is_dir():
        yield _kitti(root)
        return
    dataset = open_dataset(root)
    for name in scenes or dataset.scene_names:
        scene = dataset.load(name, cameras)
        for reel in scene.cameras.values():
            turn, path = _motion(scene, reel)
            yield Drive(name, reel.calibration, tuple(reel.image_paths), reel.timestamp_us, turn, path, read_grey)


def _motion(scene: Scene, reel: CameraReel) -> tuple[FloatArray, FloatArray]:
    """Yaw increment and path length between consecutive images: exact from a simulator, else from the ego poses."""
    if scene.exact is None:
        return np.diff(np.unwrap(reel.yaw_rad)), np.hypot(np.diff(reel.x_m), np.diff(reel.y_m))
    exact, at = scene.exact, reel.timestamp_us
    path = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(exact.x_m), np.diff(exact.y_m)))])
    yaw = np.interp(at, exact.timestamp_us, np.unwrap(exact.yaw_rad))
    return np.diff(yaw), np.diff(np.interp(at, exact.timestamp_us, path))


def _kitti(folder: Path) -> Drive:
    """A KITTI odometry sequence: left grey camera, poses of that camera, mounting as published for the car."""
    images = tuple(sorted((folder / "image_0").glob("*.png")))
    pose = np.loadtxt(folder / "poses.txt").reshape(-1, 3, 4)
    if len(images) != len(pose):
        raise DatasetError(f"{folder} has {len(images)} images and {len(pose)} poses: give one pose per image")
    first_row = (folder / "calib.txt").read_text(encoding="ascii").splitlines()[0].removeprefix("P0:")
    intrinsic = np.array(first_row.split(), np.float64).reshape(3, 4)[:, :3]
    height, width = _read_png(images[0]).shape
    turn = _AXES @ np.swapaxes(pose[:-1, :, :3], 1, 2) @ pose[1:, :, :3] @ _AXES.T
    return Drive(
        folder.name,
        CameraCalibration("CAM_FRONT", intrinsic, _AXES, np.array(_KITTI_MOUNTING_M), width, height),
        images,
        np.rint(1e6 * _KITTI_INTERVAL_S * np.arange(1, len(images) + 1)).astype(np.int64),
        np.arctan2(turn[:, 1, 0], turn[:, 0, 0]),
        np.linalg.norm(np.diff(pose[:, :, 3], axis=0), axis=1),
        _read_png,
    )


def _read_png(path: Path, halvings: int = 0) -> NDArray[np.uint8]:
    """PNG decoders cannot halve on the way: the full size, whatever ``halvings`` says; the odometry halves it."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise DatasetError(f"{path} cannot be read as an image")
    return np.asarray(image, np.uint8)
