"""Corners with descriptors of one image."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.corners import CELL_PX, descriptors, grid_corners, orientations

_SMOOTHING = cv2.getGaussianKernel(7, 2.0)  # twice as fast as cv2.GaussianBlur, the same but for rounding
_SMALLEST_SIDE = 64  # [px] below this no corner has room for its 31 px patch on a second pyramid level


@dataclass(frozen=True)
class Features:
    """``n`` corners of one image, in working pixels.

    Attributes:
        position_px: ``(n, 2)`` float32; x right, y down; the centre of the top left pixel is (0, 0).
        descriptor: ``(n, 4)`` uint64, 256 bits.
        level: ``(n,)`` int32, pyramid level.
        angle_rad: ``(n,)`` float32, direction of the intensity centroid.
    """

    position_px: NDArray[np.float32]
    descriptor: NDArray[np.uint64]
    level: NDArray[np.int32]
    angle_rad: NDArray[np.float32]

    def __len__(self) -> int:
        """Number of corners."""
        return len(self.position_px)


def no_features() -> Features:
    """Features of an image that shows nothing."""
    return Features(
        np.empty((0, 2), np.float32), np.empty((0, 4), np.uint64), np.empty(0, np.int32), np.empty(0, np.float32)
    )


class FeatureDetector:
    """ORB features, spread evenly: grid-wise FAST on a pyramid, threshold lowered where a cell is poor."""

    def __init__(self, config: MonocularConfig) -> None:
        self._levels, self._scale = config.levels, config.scale_factor
        self._high, self._low = config.fast_threshold, config.fast_threshold_low
        share = self._scale ** -(2.0 * np.arange(self._levels))  # corners per level go with its area
        self._quota = np.rint(config.features * share / share.sum()).astype(int)

    def detect(self, image: NDArray[np.uint8]) -> Features:
        """Features of a grey image ``(height, width)`` at working resolution."""
        found: list[Features] = []
        layer = image
        for level, quota in enumerate(self._quota):
            scale = self._scale**level
            size = (round(image.shape[1] / scale), round(image.shape[0] / scale))
            if min(size) < _SMALLEST_SIDE:
                break
            if level > 0:
                layer = np.asarray(cv2.resize(layer, size, interpolation=cv2.INTER_LINEAR), np.uint8)
            corners = self._corners(layer, int(quota))
            if not len(corners):
                continue
            smooth = np.asarray(cv2.sepFilter2D(layer, -1, _SMOOTHING, _SMOOTHING), np.uint8)
            angle = orientations(layer, corners)
            descriptor = descriptors(smooth, corners, angle)
            ratio = np.array([image.shape[1] / layer.shape[1], image.shape[0] / layer.shape[0]])
            position = ((corners[:, :2] + 0.5) * ratio - 0.5).astype(np.float32)
            found.append(Features(position, descriptor, np.full(len(corners), level, np.int32), angle))
        if not found:
            return no_features()
        return Features(*(np.concatenate([getattr(part, field.name) for part in found]) for field in fields(Features)))

    def _corners(self, layer: NDArray[np.uint8], quota: int) -> NDArray[np.int32]:
        """At most ``quota`` corners ``(n, 3)`` of one level, spread evenly."""
        cells = layer.size / CELL_PX**2
        return grid_corners(layer, self._high, self._low, math.ceil(quota / cells), quota)
