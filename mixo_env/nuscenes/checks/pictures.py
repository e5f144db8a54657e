"""Checks of images: the files, their sizes, their names, their times."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from mixo_env.nuscenes.checks.evidence import Evidence, Finding
from mixo_env.nuscenes.images import describe_broken, image_fault, too_many_broken
from mixo_env.nuscenes.scene import CameraReel
from mixo_env.nuscenes.selections import LIDAR_PERIOD_US

GRID_TOLERANCE_US = 5_000
"""Image intervals lie on the lidar's 50 ms grid within this."""

LONGEST_IMAGE_GAP_S = 1.0

# The exposure time in the file name, as the published data set writes it.
_STAMP = re.compile(r"__(\d{16})\.jpg$")


def image_files(evidence: Evidence) -> Iterator[Finding]:
    """Images are there, whole JPEGs, of the size of the tables: all but a few, which cost their steps."""
    for camera, reel in evidence.reels.items():
        width, height = reel.calibration.width, reel.calibration.height
        faults = {
            position: fault
            for position, (path, there) in enumerate(_with_folders(reel.image_files()))
            if (fault := image_fault(path, width, height) if there else "missing") is not None
        }
        hint = ": only key frames are unpacked? see --key-frames" if _no_sweeps(faults, reel) else ""
        if list(faults.values()) == ["missing"] * len(reel.image_paths):
            hint = ": none is unpacked? see --no-images of `mixo record`"
        for text in describe_broken(camera, faults, reel.image_paths):
            yield Finding("images", text + hint, is_problem=too_many_broken(faults, len(reel.image_paths)))


def _with_folders(files: list[str]) -> Iterator[tuple[str, bool]]:
    """Every file, and whether its folder is there: without, there is nothing to open, as with tables alone."""
    there: dict[str, bool] = {}
    for file in files:
        folder = file.rpartition(os.sep)[0]
        if folder not in there:
            there[folder] = not _is_missing(folder)
        yield file, there[folder]


def _is_missing(folder: str) -> bool:
    """Nothing is there; what is there and cannot be read is another matter."""
    try:
        Path(folder).stat()
    except FileNotFoundError:
        return True
    except OSError:
        pass
    return False


def _no_sweeps(faults: Mapping[int, str], reel: CameraReel) -> bool:
    """Whether just the images between key frames are missing."""
    between = np.flatnonzero(~reel.is_keyframe).tolist()
    missing = [position for position, fault in faults.items() if fault == "missing"]
    return bool(between) and missing == between and "sweeps" in reel.image_paths[between[0]].parts


def image_gaps(evidence: Evidence) -> Iterator[Finding]:
    """No camera pauses for long or misses an end of the scene; intervals lie on the lidar's grid."""
    first = min((reel.timestamp_us[0] for reel in evidence.reels.values()), default=0)
    last = max((reel.timestamp_us[-1] for reel in evidence.reels.values()), default=0)
    for camera, reel in evidence.reels.items():
        late, early = 1e-6 * (reel.timestamp_us[0] - first), 1e-6 * (last - reel.timestamp_us[-1])
        if max(late, early) > LONGEST_IMAGE_GAP_S:
            yield Finding(
                "image-gap",
                f"{camera}: begins {late:.1f} s after the first camera and ends {early:.1f} s before the last",
            )
        interval_us = np.diff(reel.timestamp_us)
        if not len(interval_us):
            yield Finding("image-gap", f"{camera}: one image only; a scene has about 12 a second")
            continue
        if interval_us.max() > 1e6 * LONGEST_IMAGE_GAP_S:
            yield Finding(
                "image-gap",
                f"{camera}: no image for {1e-6 * interval_us.max():.1f} s; "
                f"at most {LONGEST_IMAGE_GAP_S:g} s is expected",
            )
        off = np.abs(interval_us - LIDAR_PERIOD_US * np.round(interval_us / LIDAR_PERIOD_US)) > GRID_TOLERANCE_US
        if off.any():
            yield Finding(
                "image-gap",
                f"{camera}: {np.count_nonzero(off)} of {len(interval_us)} intervals are off the 50 ms grid",
                is_problem=False,
            )


def keyframes(evidence: Evidence) -> Iterator[Finding]:
    """Every camera has one key frame a sample."""
    for camera, reel in evidence.reels.items():
        if (count := int(reel.is_keyframe.sum())) != evidence.info.keyframes:
            yield Finding("key-frames", f"{camera}: {count} key frames; the scene table says {evidence.info.keyframes}")


def image_names(evidence: Evidence) -> Iterator[Finding]:
    """The time in a file's name, where there is one, is that of its row; no file stands for two images."""
    for camera, reel in evidence.reels.items():
        files = reel.image_files()
        wrong = [
            file
            for file, time in zip(files, reel.timestamp_us.tolist(), strict=True)
            if not file.endswith(f"__{time}.jpg") and (match := _STAMP.search(file)) and int(match[1]) != time
        ]
        if wrong:
            yield Finding(
                "image-time",
                f"{camera}: {len(wrong)} images have another time in their name than in the tables, first "
                f"{wrong[0].rpartition(os.sep)[2]}: were times or names exchanged?",
            )
        if repeated := len(files) - len(set(files)):
            yield Finding("image-time", f"{camera}: {repeated} files stand in the tables more than once")
        if strangers := _of_another_camera(camera, files):
            yield Finding("image-time", f"{camera}: {len(strangers)} files lie in another folder, first {strangers[0]}")


def _of_another_camera(camera: str, files: list[str]) -> list[str]:
    """Files in a folder named after another camera; folders that are not named so say nothing."""
    own = f"{os.sep}{camera}"
    ends = (file.rsplit(os.sep, 2)[1:] for file in files if not file.rpartition(os.sep)[0].endswith(own))
    return ["/".join(parts) for parts in ends if parts[0].startswith("CAM_")]
