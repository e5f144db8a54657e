"""Thumbnails of a drive: one sheet a camera, a frame for every second row, cut apart by the page."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np

from mixo_env.envs.images import SceneImages
from mixo_env.recordings.collection import Recordings

WIDTH, HEIGHT, COLUMNS = 160, 90, 12
"""Of a frame [px], and frames side by side."""
EVERY = 2
"""Rows of the recording between frames."""
QUALITY = 45
"""Of the JPEG: sheets of four cameras take about 1 MB."""


def camera_sheets(recordings: Recordings, scene: str, dataroot: Path) -> dict[str, Any]:
    """Sheets of all cameras of a scene as data addresses, and how to cut them."""
    import simplejpeg

    index = [entry.name for entry in recordings.scenes].index(scene)
    images = SceneImages(recordings, dataroot, recordings.manifest.cameras)
    rows = range(0, recordings.scenes[index].rows, EVERY)
    found = {}
    for camera in images.cameras:
        paths = [images.paths(index, row)[camera] for row in rows]
        frames = [images.read(path, (HEIGHT, WIDTH, 3)) for path in paths]
        frames += [np.zeros((HEIGHT, WIDTH, 3), np.uint8)] * (-len(frames) % COLUMNS)
        lines = [np.concatenate(frames[k : k + COLUMNS], axis=1) for k in range(0, len(frames), COLUMNS)]
        sheet = np.ascontiguousarray(np.concatenate(lines, axis=0))
        jpeg = simplejpeg.encode_jpeg(sheet, quality=QUALITY, colorspace="RGB", colorsubsampling="420")
        found[camera] = "data:image/jpeg;base64," + base64.b64encode(jpeg).decode()
    return {"width": WIDTH, "height": HEIGHT, "columns": COLUMNS, "every": EVERY, "sheets": found}
