"""Where the sun does not reach: a picture of the ground, and a height field of the houses' shadow above it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

EXTENT_M = 1024.0
"""Both maps cover the square of this side around the origin."""

PICTURE_TEXELS_PER_M = 4.0
FIELD_TEXELS_PER_M = 2.0


class Shadows:
    """Collects what throws shadows, then gives both maps.

    Args:
        sun: ``(3,)`` unit vector towards the sun, above the horizon.
    """

    def __init__(self, sun: NDArray[np.float64]) -> None:
        self.sun = sun
        self._shift = -sun[:2] / sun[2]  # metres on the ground per metre of height
        side = int(EXTENT_M * PICTURE_TEXELS_PER_M)
        self._picture = np.full((side, side), 255, np.uint8)
        side = int(EXTENT_M * FIELD_TEXELS_PER_M)
        self._height = np.zeros((side, side), np.float32)

    def _fill(self, outline: NDArray[np.float64]) -> None:
        points = (outline + 0.5 * EXTENT_M) * PICTURE_TEXELS_PER_M - 0.5
        cv2.fillConvexPoly(self._picture, np.round(points * 16).astype(np.int32), 0, cv2.LINE_AA, 4)

    def prism(self, outline: NDArray[np.float64], height_m: float, floor_m: float = 0.0, field: bool = False) -> None:
        """Shadow of a convex upright body over the ground plan ``outline`` (n, 2).

        Args:
            outline: map frame, metres.
            height_m: of its top.
            floor_m: of its underside.
            field: whether it also shades walls and vehicles.
        """
        points = np.vstack([outline + self._shift * floor_m, outline + self._shift * height_m])
        self._fill(cv2.convexHull(points.astype(np.float32))[:, 0].astype(np.float64))
        if field:
            low = ((outline.min(axis=0) + 0.5 * EXTENT_M) * FIELD_TEXELS_PER_M).round().astype(int)
            high = ((outline.max(axis=0) + 0.5 * EXTENT_M) * FIELD_TEXELS_PER_M).round().astype(int)
            tile = self._height[low[1] : high[1], low[0] : high[0]]
            np.maximum(tile, np.float32(height_m), out=tile)

    def crown(self, x_m: float, y_m: float, z_m: float, radius_m: float, rng: np.random.Generator) -> None:
        """Dappled shadow of a tree."""
        centres = (x_m, y_m) + self._shift * z_m + rng.normal(0.0, 0.5 * radius_m, (26, 2))
        texels = np.round(((centres + 0.5 * EXTENT_M) * PICTURE_TEXELS_PER_M - 0.5) * 16).astype(int).tolist()
        radii = (rng.uniform(0.2, 0.5, 26) * PICTURE_TEXELS_PER_M * 16).astype(int).tolist()
        for texel, radius in zip(texels, radii, strict=True):
            cv2.circle(self._picture, texel, radius, 0, -1, cv2.LINE_AA, 4)

    def picture(self) -> NDArray[np.uint8]:
        """Sunlight on the ground, 0..255, ``(side, side)`` indexed [y, x] from the south-west corner."""
        return cv2.GaussianBlur(self._picture, (3, 3), 0.7).astype(np.uint8)

    def field(self) -> NDArray[np.float32]:
        """Height in metres below which a point lies in a house's shadow, ``(side, side)`` indexed [y, x].

        The largest of h(p + k d) - k e over k steps d towards the sun, each of which the shadow's edge sinks by e.
        Doubling the reach log2(n) times gives all n steps.
        """
        flat = float(np.linalg.norm(self.sun[:2]))
        towards = self.sun[:2] / flat * FIELD_TEXELS_PER_M * 0.5  # steps of half a metre
        sink = 0.5 * float(self.sun[2]) / flat
        field = self._height.copy()
        reach = 1
        while reach * sink < float(self._height.max()):
            dx, dy = np.round(reach * towards).astype(int).tolist()
            side = len(field)
            ys, xs = slice(max(0, -dy), side - max(0, dy)), slice(max(0, -dx), side - max(0, dx))
            ahead = field[max(0, dy) : side + min(0, dy), max(0, dx) : side + min(0, dx)] - np.float32(reach * sink)
            reached = field.copy()
            reached[ys, xs] = np.maximum(field[ys, xs], ahead)
            field = reached
            reach *= 2
        return field
