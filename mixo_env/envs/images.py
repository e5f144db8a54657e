"""The camera images behind a recording's steps, when the nuScenes folder that was recorded is at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError, RecordingError
from mixo_env.nuscenes.images import read_jpeg
from mixo_env.recordings.collection import Recordings

THUMBNAIL = (64, 112, 3)
"""Height, width and channels of the images in ``observation="pixels"``: 1600 x 900 to within a pixel."""

TOLERANCE_US = 1_000
"""Largest difference between a recorded image time and the table's; the recorded offset is float32."""


class SceneImages:
    """Finds and reads the image of every camera at every row of a recording.

    Attributes:
        cameras: whose images.
    """

    def __init__(self, recordings: Recordings, dataroot: str | Path, cameras: tuple[str, ...]) -> None:
        """Open the folder; scenes are looked up when they are first played."""
        from mixo_env.nuscenes.tables import open_dataset

        self.cameras = cameras
        self._recordings = recordings
        self._dataset = open_dataset(Path(dataroot))
        self._paths: dict[int, dict[str, list[Path | None]]] = {}

    def paths(self, scene: int, row: int) -> dict[str, Path | None]:
        """Image of each camera that belongs to ``row`` of a scene; None where the camera delivered none."""
        if scene not in self._paths:
            self._paths[scene] = self._find(scene)
        return {camera: found[row] for camera, found in self._paths[scene].items()}

    def read(self, path: Path | None, shape: tuple[int, int, int] = THUMBNAIL) -> NDArray[np.uint8]:
        """One image as RGB ``(height, width, 3)``, scaled to ``shape``; black without a path."""
        import cv2
        import simplejpeg

        if path is None:
            return np.zeros(shape, np.uint8)
        height, width, _ = shape
        try:
            image = simplejpeg.decode_jpeg(read_jpeg(path), "RGB", fastdct=True, min_height=height, min_width=width)
        except (DatasetError, ValueError) as error:
            raise RecordingError(f"{path} cannot be read as JPEG ({error}): check dataroot") from None
        return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def _find(self, scene: int) -> dict[str, list[Path | None]]:
        name, rows = self._recordings.scenes[scene].name, self._recordings.rows(scene)
        found = {}
        for camera in self.cameras:
            track = self._dataset.reel(name, camera)
            offset = rows[f"{camera}.image_time_offset_s"].astype(np.float64)
            fired = np.isfinite(offset)
            wanted = rows["timestamp_us"] + np.round(1e6 * np.where(fired, offset, 0.0)).astype(np.int64)
            nearest = np.abs(track.timestamp_us[None, :] - wanted[:, None]).argmin(axis=1)
            missed = fired & (np.abs(track.timestamp_us[nearest] - wanted) > TOLERANCE_US)
            if missed.any():
                raise RecordingError(
                    f"{name}: {camera} has no image at {wanted[missed][0]} us in this folder: dataroot must be the "
                    "folder that was recorded"
                )
            found[camera] = [track.image_paths[i] if seen else None for i, seen in zip(nearest, fired, strict=True)]
        return found
