"""The shape of the land: bent streets and hills.

Streets, houses and routes are planned on a flat grid of straight streets. The land carries a point (u, v) of the grid
to the map:

    S(u, v) = (u + a(v),  v + b(u),  p(u) + q(v)),

the sum of a curve that depends on u alone and one that depends on v alone (a translation surface). Four corners of any
rectangle along the grid then lie in one plane and form a parallelogram, the only primitive of the renderer: a mesh of
the land has no cracks, however long its pieces are. Streets along x bend by b, those along y by a; heights add up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.streets import BLOCK_M, HALF_CITY_BLOCKS

FloatArray = NDArray[np.float64]

EDGE_M = (HALF_CITY_BLOCKS + 1) * BLOCK_M
"""Beyond this the land goes on as it is at the edge, straight and level."""

STEEPEST = 0.052
"""Largest slope of p and q together; what bends add to it leaves every grade below 6 %."""

_HILL_M = (260.0, 480.0)  # wavelengths
_LONG_BEND_M, _LONG_SLOPE = (420.0, 700.0), (0.03, 0.11)  # of long bends: wavelength and d(aside)/d(along)
_ACROSS = 0.06  # both families of streets together bend by no more than this and the above where they cross
_SHIFT_SHARE, _SHIFT_M = 0.25, (3.0, 8.0)  # blocks whose streets step aside on their way, and by how much
_SHIFT_FROM, _SHIFT_TO = 0.24, 0.76  # of the way from crossing to crossing: those stay straight
_NEWTON = 12


@dataclass(frozen=True)
class Profile:
    """A smooth function of one coordinate: waves, and steps between crossings.

    Attributes:
        waves: ``(n, 3)`` amplitude [m], wave number [1/m], phase.
        steps: ``(2 * (HALF_CITY_BLOCKS + 1),)`` rise [m] within each block, or empty.
    """

    waves: FloatArray
    steps: FloatArray

    def at(self, t: FloatArray) -> FloatArray:
        """Value."""
        t = np.clip(t, -EDGE_M, EDGE_M)
        value = np.zeros_like(t)
        for amplitude, number, phase in self.waves:
            value += amplitude * np.sin(number * t + phase)
        if len(self.steps):
            block, part = self._part(t)
            value += np.concatenate([[0.0], np.cumsum(self.steps)])[block]
            value += self.steps[block] * part**4 * (35.0 - 84.0 * part + 70.0 * part**2 - 20.0 * part**3)
        return value

    def slope(self, t: FloatArray) -> FloatArray:
        """Derivative, 0 beyond the edge."""
        inside = np.abs(t) <= EDGE_M
        t = np.clip(t, -EDGE_M, EDGE_M)
        slope = np.zeros_like(t)
        for amplitude, number, phase in self.waves:
            slope += amplitude * number * np.cos(number * t + phase)
        if len(self.steps):
            block, part = self._part(t)
            slope += self.steps[block] * 140.0 * (part * (1.0 - part)) ** 3 / ((_SHIFT_TO - _SHIFT_FROM) * BLOCK_M)
        return np.where(inside, slope, 0.0)

    def _part(self, t: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Number of the block, and how much of its step is behind."""
        blocks = t / BLOCK_M + HALF_CITY_BLOCKS + 1
        block = np.clip(np.floor(blocks).astype(np.int64), 0, len(self.steps) - 1)
        return block, np.clip((blocks - block - _SHIFT_FROM) / (_SHIFT_TO - _SHIFT_FROM), 0.0, 1.0)


@dataclass(frozen=True)
class Land:
    """See the module.

    Attributes:
        aside_x, aside_y: a and b.
        height_u, height_v: p and q.
    """

    aside_x: Profile
    aside_y: Profile
    height_u: Profile
    height_v: Profile

    def map(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x, y on the map of points of the grid."""
        return u + self.aside_x.at(v), v + self.aside_y.at(u)

    def height(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """z of points of the grid."""
        return self.height_u.at(u) + self.height_v.at(v)

    def points(self, points: FloatArray) -> FloatArray:
        """``(..., 3)`` points on the map of points of the grid, whose z counts from the ground."""
        u, v = points[..., 0], points[..., 1]
        return np.stack([*self.map(u, v), points[..., 2] + self.height(u, v)], axis=-1)

    def grid(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """u, v of points on the map; each step leaves a tenth of the error."""
        u, v = x, y
        for _ in range(_NEWTON):
            u, v = x - self.aside_x.at(v), y - self.aside_y.at(u)
        return u, v

    def bend(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """dx/dv and dy/du: how the grid lies on the map; dx/du and dy/dv are 1."""
        return self.aside_x.slope(v), self.aside_y.slope(u)

    def rise(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """dz/dx and dz/dy on the map."""
        a, b = self.bend(u, v)
        p, q = self.height_u.slope(u), self.height_v.slope(v)
        return (p - b * q) / (1.0 - a * b), (q - a * p) / (1.0 - a * b)

    def heading(self, u: FloatArray, v: FloatArray, heading_rad: FloatArray) -> FloatArray:
        """Heading on the map of a heading in the grid, not wrapped."""
        a, b = self.bend(u, v)
        c, s = np.cos(heading_rad), np.sin(heading_rad)
        x, y = c + a * s, s + b * c
        return heading_rad + np.arctan2(c * y - s * x, c * x + s * y)


_NONE = Profile(np.zeros((0, 3)), np.zeros(0))

FLAT = Land(_NONE, _NONE, _NONE, _NONE)
"""Straight streets on a plane: grid and map are the same."""


def land_of(seed: int) -> Land:
    """The land of one city."""
    rng = np.random.default_rng([seed, 7])
    slopes = np.array([rng.uniform(*_LONG_SLOPE), rng.uniform(0.0, _ACROSS)])
    bends = [
        Profile(_waves(rng, [slope], _LONG_BEND_M), _steps(rng)) for slope in (slopes if rng.uniform() < 0.5 else slopes[::-1])
    ]
    steep, split = STEEPEST * rng.uniform() ** 0.8, rng.uniform(0.0, 0.5 * np.pi)
    hills = [
        Profile(_waves(rng, [0.7 * part * steep, 0.3 * part * steep], _HILL_M), np.zeros(0))
        for part in (np.cos(split), np.sin(split))
    ]
    return Land(bends[0], bends[1], hills[0], hills[1])


def _waves(rng: np.random.Generator, slopes: list[float], wavelength_m: tuple[float, float]) -> FloatArray:
    """Waves with these largest slopes."""
    waves = []
    for slope in slopes:
        number = 2.0 * np.pi / rng.uniform(*wavelength_m)
        waves.append((slope / number, number, rng.uniform(0.0, 2.0 * np.pi)))
    return np.array(waves)


def _steps(rng: np.random.Generator) -> FloatArray:
    count = 2 * (HALF_CITY_BLOCKS + 1)
    rises = rng.uniform(*_SHIFT_M, count) * rng.choice([-1.0, 1.0], count)
    return np.where(rng.uniform(size=count) < _SHIFT_SHARE, rises, 0.0)
