"""The cameras of one drive from the nuScenes folder that was recorded: mounting, small images, corners found again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.images import SceneImages
from mixo_env.experts.monocular.camera import MountedCamera, mount
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.front_end import Frame, OrbFrontEnd
from mixo_env.experts.monocular.pair import PairSolver
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.steps import readable

WIDTH_PX = 400
"""Of the small images; their height keeps the proportions."""

QUALITY = 80
"""Of their JPEG."""


@dataclass(frozen=True)
class Look:
    """What a camera saw at one step.

    Attributes:
        row: of the drive.
        jpeg: the small image.
        matches: ``(k, 2, 2)`` float32 where corners were in the camera's last image and where they are in this one
            [px of the small image; its upper left corner is (0, 0)].
    """

    row: int
    jpeg: bytes
    matches: NDArray[np.float32]


class Rig:
    """Cameras of one drive.

    Attributes:
        calibrations: camera -> how it is made and mounted.
        has_images: the first image is there; a folder may hold the tables alone.
    """

    def __init__(self, drive: Recordings, dataroot: Path) -> None:
        """Find the one scene of ``drive`` in a folder.

        Raises:
            ConfigurationError, DatasetError: for a folder that is none, or lacks the scene.
            RecordingError: for one that is not the folder that was recorded.
        """
        scene = drive.scenes[0].name
        dataset, cameras = open_dataset(dataroot), drive.manifest.cameras
        self.calibrations = {camera: dataset.reel(scene, camera).calibration for camera in cameras}
        self._drive, self._images = drive, SceneImages(drive, dataroot, cameras)
        known = {field.name for field in fields(MonocularConfig)}
        recorded = drive.manifest.parameters.get("monocular", {})
        self._config = MonocularConfig(**{name: value for name, value in recorded.items() if name in known})
        paths = [path for row in range(drive.scenes[0].rows) for path in self._images.paths(0, row).values() if path]
        self.has_images = bool(paths) and paths[0].is_file()

    def size_px(self, camera: str) -> tuple[int, int]:
        """Width and height of the small images."""
        calibration = self.calibrations[camera]
        return WIDTH_PX, round(WIDTH_PX * calibration.height / calibration.width)

    def looks(self, camera: str) -> Iterator[Look]:
        """Every image of a camera that can be read, with the corners its odometry's front end finds again.

        The front end, its settings and the search window are the recorded odometry's; motion is not looked at, so
        wrong matches are among them.
        """
        import simplejpeg

        calibration = self.calibrations[camera]
        mounted, finder = mount(calibration, self._config.max_pixels), _Finder(self._config)
        solver = PairSolver(mounted, self._config, finder)
        time_s, distance_m = self._drive["time_s"], self._drive["distance_m"].astype(np.float64)
        travelled_m = np.nancumsum(distance_m)
        width, height = self.size_px(camera)
        before: tuple[Frame, int] | None = None
        for row in range(self._drive.scenes[0].rows):
            path = self._images.paths(0, row)[camera]
            grey = None if path is None else readable(path, calibration, mounted.halvings)
            if path is None or grey is None or isinstance(grey, str):
                continue
            frame, found = solver.frame(mounted.shrink(grey)), np.zeros((0, 2, 2), np.float32)
            if before is not None and time_s[row] - time_s[before[1]] <= self._config.max_gap_s:
                gap_s, way_m = time_s[row] - time_s[before[1]], travelled_m[row] - travelled_m[before[1]]
                solver.compare(before[0], frame, float(gap_s), float(way_m))
                found = _small(finder.found, mounted, width)
            before = frame, row
            small = self._images.read(path, (height, width, 3))
            yield Look(row, simplejpeg.encode_jpeg(small, quality=QUALITY), found)


class _Finder(OrbFrontEnd):
    """The front end, which keeps where the last two frames matched: ``(k, 2, 2)`` working px."""

    def __init__(self, config: MonocularConfig) -> None:
        super().__init__(config)
        self.found = np.zeros((0, 2, 2), np.float32)

    def match(self, first: Frame, second: Frame, radius_px: float) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
        """As the front end."""
        i, j = super().match(first, second, radius_px)
        self.found = np.stack([first.position_px[i], second.position_px[j]], axis=1)
        return i, j


def _small(working_px: NDArray[np.float32], camera: MountedCamera, width: int) -> NDArray[np.float32]:
    """From the middle of a working pixel to the small image's corner."""
    return ((working_px + 0.5) * (width / camera.working_shape[1])).astype(np.float32)
