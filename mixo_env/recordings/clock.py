"""The causal clock: which images belong to one firing round, and when a step closes.

The cameras of the nuScenes rig fire one after another, when the lidar passes their field of view, up to 43 ms apart and
on a 50 ms grid with gaps (intervals of 100, 100, 50 ms, now and then a dropped frame). Images of one turn of the lidar
form a *round*; step k closes at t_k, the time of the last image of round k.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.selections import CAMERA_OFFSET_US, LIDAR_PERIOD_US

IntArray = NDArray[np.int64]

NONE = -1
"""In tables of image numbers and image times: the camera did not fire in this round."""


@dataclass(frozen=True)
class Rounds:
    """Firing rounds of one scene, from the first one in which every camera fired.

    Attributes:
        cameras: in column order.
        image: ``(rounds, cameras)`` index into each camera's own images, ``NONE`` where it did not fire.
        image_time_us: ``(rounds, cameras)`` exposure time, ``NONE`` where it did not fire.
        closing_camera: ``(rounds,)`` column of the camera that fired last.
        closing_time_us: ``(rounds,)`` its exposure time: t_k.
    """

    cameras: tuple[str, ...]
    image: IntArray
    image_time_us: IntArray
    closing_camera: IntArray
    closing_time_us: IntArray

    def __len__(self) -> int:
        """Number of rounds."""
        return len(self.closing_time_us)

    @property
    def fired(self) -> NDArray[np.bool_]:
        """``(rounds, cameras)``: the camera delivered an image in the round."""
        return self.image != NONE


def firing_rounds(timestamps_us: Mapping[str, IntArray]) -> Rounds:
    """Group the images of all cameras by the turn of the lidar that triggered them.

    With each channel's nominal offset subtracted (0 for an unknown one), the images of a turn coincide within a few
    milliseconds and turns are 50 ms apart, so a gap of more than half the grid separates two rounds; stamp errors and
    dropped frames do no harm.

    Args:
        timestamps_us: channel -> ``(n,)`` exposure times of its images in time order.

    Raises:
        DatasetError: if a camera has no image or times that do not increase, if a camera fires twice within one turn,
            if rounds overlap in time, or if the cameras never all fire in one round.
    """
    cameras = tuple(timestamps_us)
    for channel, times in timestamps_us.items():
        if len(times) == 0 or np.any(np.diff(times) <= 0):
            raise DatasetError(f"{channel}: expected image times that increase, got {len(times)} images out of order")
    camera = np.repeat(np.arange(len(cameras)), [len(times) for times in timestamps_us.values()])
    image = np.concatenate([np.arange(len(times)) for times in timestamps_us.values()])
    time = np.concatenate(list(timestamps_us.values()))
    nominal = time - np.array([CAMERA_OFFSET_US.get(channel, 0) for channel in cameras])[camera]

    order = np.argsort(nominal, kind="stable")
    turn = np.empty_like(order)
    turn[order] = np.cumsum(np.diff(nominal[order], prepend=nominal[order[0]]) > LIDAR_PERIOD_US // 2)
    shape = (int(turn.max()) + 1, len(cameras))
    images, times = np.full(shape, NONE), np.full(shape, NONE)
    images[turn, camera] = image
    times[turn, camera] = time
    if np.count_nonzero(images != NONE) != len(image):
        raise DatasetError(
            f"a camera fired twice within {LIDAR_PERIOD_US // 1000} ms: expected nuScenes timing (12 Hz)"
        )

    closing = times.max(axis=1)
    opening = np.where(images == NONE, np.iinfo(np.int64).max, times).min(axis=1)
    if np.any(opening[1:] <= closing[:-1]):
        raise DatasetError("firing rounds overlap in time: expected the stagger of the nuScenes rig")
    complete = np.flatnonzero((images != NONE).all(axis=1))
    if len(complete) == 0:
        raise DatasetError(f"no firing round in which all of {', '.join(cameras)} delivered an image")
    start = complete[0]
    return Rounds(cameras, images[start:], times[start:], times[start:].argmax(axis=1), closing[start:])
