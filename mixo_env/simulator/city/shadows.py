"""Where the sun does not reach: a picture of the ground, and a height field of the houses' shadow above it.

The picture lies on the street grid, as the texture of the ground does, and bends with it; the field lies on the map.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.land import FLAT, Land

EXTENT_M = 1024.0
"""Both maps cover the square of this side around the origin."""

PICTURE_TEXELS_PER_M = 4.0
FIELD_TEXELS_PER_M = 2.0


class Shadows:
    """Collects what throws shadows, then gives both maps.

    Args:
        sun: ``(3,)`` unit vector towards the sun, above the horizon.
        land: that the shadows fall on.
    """

    def __init__(self, sun: NDArray[np.float64], land: Land = FLAT) -> None:
        self.sun = sun
        self._land = land
        side = int(EXTENT_M * PICTURE_TEXELS_PER_M)
        self._picture = np.full((side, side), 255, np.uint8)
        side = int(EXTENT_M * FIELD_TEXELS_PER_M)
        self._height = _heights(land, side)

    def _fill(self, outline: NDArray[np.float64]) -> None:
        points = (outline + 0.5 * EXTENT_M) * PICTURE_TEXELS_PER_M - 0.5
        cv2.fillConvexPoly(self._picture, np.round(points * 16).astype(np.int32), 0, cv2.LINE_AA, 4)

    def prism(self, outline: NDArray[np.float64], height_m: float, floor_m: float = 0.0, field: bool = False) -> None:
        """Shadow of a convex upright body over the ground plan ``outline`` (n, 2).

        Args:
            outline: street grid, metres.
            height_m: of its top.
            floor_m: of its underside.
            field: whether it also shades walls and vehicles.
        """
        points = np.vstack([self._thrown(outline, floor_m), self._thrown(outline, height_m)])
        self._fill(cv2.convexHull(points.astype(np.float32))[:, 0].astype(np.float64))
        if field:
            plan = (np.stack(self._land.map(*outline.T), axis=1) + 0.5 * EXTENT_M) * FIELD_TEXELS_PER_M
            low = np.maximum(np.floor(plan.min(axis=0)).astype(int), 0)
            high = np.ceil(plan.max(axis=0)).astype(int)
            tile = self._height[low[1] : high[1], low[0] : high[0]]
            rows, columns = (low[i] + 0.5 + np.arange(tile.shape[1 - i]) for i in (1, 0))
            top = np.float32(height_m + float(self._land.height(*outline.mean(axis=0))))
            tile[_inside(plan, columns, rows) & (tile < top)] = top

    def _thrown(self, points: NDArray[np.float64], height_m: float) -> NDArray[np.float64]:
        """Where the shadow of points ``(n, 2)`` at that height over the grid falls on the grid."""
        if height_m == 0.0:
            return points
        rise_x, rise_y = self._land.rise(*points.T)
        per_m = 1.0 / (self.sun[2] - rise_x * self.sun[0] - rise_y * self.sun[1])
        x, y = self._land.map(*points.T)
        at = self._land.grid(x - height_m * per_m * self.sun[0], y - height_m * per_m * self.sun[1])
        return np.stack(at, axis=1)

    def crown(self, x_m: float, y_m: float, z_m: float, radius_m: float, rng: np.random.Generator) -> None:
        """Dappled shadow of a tree."""
        centres = self._thrown(np.array([[x_m, y_m]]), z_m) + rng.normal(0.0, 0.5 * radius_m, (26, 2))
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
        while reach * sink < float(np.ptp(self._height)):
            dx, dy = np.round(reach * towards).astype(int).tolist()
            side = len(field)
            ys, xs = slice(max(0, -dy), side - max(0, dy)), slice(max(0, -dx), side - max(0, dx))
            ahead = field[max(0, dy) : side + min(0, dy), max(0, dx) : side + min(0, dx)] - np.float32(reach * sink)
            reached = field.copy()
            reached[ys, xs] = np.maximum(field[ys, xs], ahead)
            field = reached
            reach *= 2
        return field


def _heights(land: Land, side: int) -> NDArray[np.float32]:
    """Height of the ground over the map; it is smooth, so a coarse raster is enough."""
    coarse = 256
    centres = (np.arange(coarse, dtype=np.float64) + 0.5) * (EXTENT_M / coarse) - 0.5 * EXTENT_M
    heights = land.height(*land.grid(*np.meshgrid(centres, centres))).astype(np.float32)
    return np.asarray(cv2.resize(heights, (side, side), interpolation=cv2.INTER_LINEAR), np.float32)


def _inside(outline: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points of the raster ``x`` by ``y`` lie in a convex outline, ``(len(y), len(x))``."""
    ends = np.roll(outline, -1, axis=0)
    area = np.sum(outline[:, 0] * ends[:, 1] - ends[:, 0] * outline[:, 1])
    inside = np.ones((len(y), len(x)), np.bool_)
    for (x0, y0), (x1, y1) in zip(outline, ends, strict=True):
        inside &= np.sign(area) * ((x1 - x0) * (y[:, None] - y0) - (y1 - y0) * (x[None, :] - x0)) >= 0.0
    return inside
