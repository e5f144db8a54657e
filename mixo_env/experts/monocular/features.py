"""Corners with descriptors of one image."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.corners import HALF_WIDTHS, PATTERN, describe, grid_corners

_CELL_PX = 32
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
            smooth = np.asarray(cv2.GaussianBlur(layer, (7, 7), 2.0), np.uint8)
            angle, descriptor = describe(layer, smooth, corners, HALF_WIDTHS, PATTERN)
            ratio = np.array([image.shape[1] / layer.shape[1], image.shape[0] / layer.shape[0]])
            position = ((corners[:, :2] + 0.5) * ratio - 0.5).astype(np.float32)
            found.append(Features(position, descriptor, np.full(len(corners), level, np.int32), angle))
        if not found:
            return no_features()
        return Features(*(np.concatenate([getattr(part, field.name) for part in found]) for field in fields(Features)))

    def _corners(self, layer: NDArray[np.uint8], quota: int) -> NDArray[np.int32]:
        """At most ``quota`` corners ``(n, 4)`` of one level: the best of every cell first, then the second best, ..."""
        cells = layer.size / _CELL_PX**2
        corners = grid_corners(layer, self._high, self._low, _CELL_PX, math.ceil(quota / cells))
        best = np.lexsort((-corners[:, 2], corners[:, 3]))[:quota]
        return corners[np.sort(best)]
