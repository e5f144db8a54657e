"""The shape of the land: bent streets and hills, and which crossings are roundabouts.

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

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.city.roundabout import Crossing, roundabouts_of
from mixo_env.simulator.city.streets import BLOCK_M, HALF_CITY_BLOCKS

FloatArray = NDArray[np.float64]

EDGE_M = (HALF_CITY_BLOCKS + 1) * BLOCK_M
"""Beyond this the land goes on as it is at the edge, straight and level."""

STEEPEST = 0.052
"""Largest slope of p and q together; what bends add to it leaves every grade below 6 %."""

_HILL_M = (260.0, 480.0)  # wavelengths
_LONG_BEND_M, _LONG_SLOPE = (420.0, 700.0), (0.03, 0.11)  # of long bends: wavelength and d(aside)/d(along)
_ACROSS = 0.06  # both families of streets together bend by no more than this and the above where they cross
_SHIFT_SHARE, _SHIFT_M = 0.3, (2.5, 6.0)  # blocks whose streets step aside on their way, and by how much
_SHIFT_FROM, _SHIFT_TO = 0.18, 0.82  # of the way from crossing to crossing: those stay straight
_ROUNDS = 10
_BLOCKS = HALF_CITY_BLOCKS + 1


@dataclass(frozen=True)
class Profile:
    """A smooth function of one coordinate: waves, and steps between crossings.

    Attributes:
        waves: ``(n, 3)`` amplitude [m], wave number [1/m], phase.
        steps: ``(2 * (HALF_CITY_BLOCKS + 1),)`` rise [m] within each block, or empty.
    """

    waves: FloatArray
    steps: FloatArray

    @property
    def curve(self) -> Curve:
        """As the compiled loops take it."""
        return self.waves, self.steps

    def at(self, t: FloatArray) -> FloatArray:
        """Value."""
        return _values(np.ravel(t).astype(np.float64), self.waves, self.steps).reshape(np.shape(t))

    def slope(self, t: FloatArray) -> FloatArray:
        """Derivative, 0 beyond the edge."""
        return _slopes(np.ravel(t).astype(np.float64), self.waves, self.steps).reshape(np.shape(t))


@inlined
def _part(t: float) -> tuple[int, float]:
    """Number of the block, and how much of its step is behind."""
    blocks = t / BLOCK_M + _BLOCKS
    block = min(max(int(np.floor(blocks)), 0), 2 * _BLOCKS - 1)
    return block, min(max((blocks - block - _SHIFT_FROM) / (_SHIFT_TO - _SHIFT_FROM), 0.0), 1.0)


@compiled_unchecked
def _value(t: float, waves: FloatArray, steps: FloatArray) -> float:
    t = min(max(t, -EDGE_M), EDGE_M)
    value = 0.0
    for n in range(len(waves)):
        value += waves[n, 0] * np.sin(waves[n, 1] * t + waves[n, 2])
    if len(steps) > 0:
        block, part = _part(t)
        value += np.sum(steps[:block])
        value += steps[block] * part**4 * (35.0 - 84.0 * part + 70.0 * part**2 - 20.0 * part**3)
    return value


@compiled_unchecked
def _values(t: FloatArray, waves: FloatArray, steps: FloatArray) -> FloatArray:
    out = np.empty(len(t))
    for i in range(len(t)):
        out[i] = _value(t[i], waves, steps)
    return out


@compiled_unchecked
def _slope(t: float, waves: FloatArray, steps: FloatArray) -> float:
    slope = 0.0
    if abs(t) <= EDGE_M:
        for n in range(len(waves)):
            slope += waves[n, 0] * waves[n, 1] * np.cos(waves[n, 1] * t + waves[n, 2])
        if len(steps) > 0:
            block, part = _part(t)
            slope += steps[block] * 140.0 * (part * (1.0 - part)) ** 3 / ((_SHIFT_TO - _SHIFT_FROM) * BLOCK_M)
    return slope


@compiled_unchecked
def _slopes(t: FloatArray, waves: FloatArray, steps: FloatArray) -> FloatArray:
    out = np.empty(len(t))
    for i in range(len(t)):
        out[i] = _slope(t[i], waves, steps)
    return out


Curve = tuple[FloatArray, FloatArray]
"""Waves and steps of a ``Profile``."""


@compiled_unchecked
def _point_on_grid(x: float, y: float, aside_x: Curve, aside_y: Curve) -> tuple[float, float]:
    """U and v of a point on the map; each round leaves a tenth of the error or less."""
    u, v = x, y
    for _ in range(_ROUNDS):
        u, v = x - _value(v, aside_x[0], aside_x[1]), y - _value(u, aside_y[0], aside_y[1])
    return u, v


@compiled_unchecked
def _on_grid(x: FloatArray, y: FloatArray, aside_x: Curve, aside_y: Curve) -> tuple[FloatArray, FloatArray]:
    us, vs = np.empty(len(x)), np.empty(len(x))
    for i in range(len(x)):
        us[i], vs[i] = _point_on_grid(x[i], y[i], aside_x, aside_y)
    return us, vs


@compiled_unchecked
def _ground(points: FloatArray, aside_x: Curve, aside_y: Curve, height_u: Curve, height_v: Curve) -> FloatArray:
    """See :meth:`Land.below`."""
    out = np.empty((len(points), 7))
    for i in range(len(points)):
        u, v = _point_on_grid(points[i, 0], points[i, 1], aside_x, aside_y)
        a, b = _slope(v, aside_x[0], aside_x[1]), _slope(u, aside_y[0], aside_y[1])
        p, q = _slope(u, height_u[0], height_u[1]), _slope(v, height_v[0], height_v[1])
        out[i, 0] = _value(u, height_u[0], height_u[1]) + _value(v, height_v[0], height_v[1])
        out[i, 1], out[i, 2] = (p - b * q) / (1.0 - a * b), (q - a * p) / (1.0 - a * b)
        out[i, 3], out[i, 4], out[i, 5], out[i, 6] = u, v, a, b
    return out


@dataclass(frozen=True)
class Land:
    """See the module.

    Attributes:
        aside_x, aside_y: a and b.
        height_u, height_v: p and q.
        roundabouts: crossings with an island.
    """

    aside_x: Profile
    aside_y: Profile
    height_u: Profile
    height_v: Profile
    roundabouts: frozenset[Crossing] = frozenset()

    def map(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x, y on the map of points of the grid."""
        return u + self.aside_x.at(v), v + self.aside_y.at(u)

    def height(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Z of points of the grid."""
        return self.height_u.at(u) + self.height_v.at(v)

    def points(self, points: FloatArray) -> FloatArray:
        """``(..., 3)`` points on the map of points of the grid, whose z counts from the ground."""
        u, v = points[..., 0], points[..., 1]
        return np.stack([*self.map(u, v), points[..., 2] + self.height(u, v)], axis=-1)

    def grid(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """u, v of points on the map."""
        flat = np.ravel(x).astype(np.float64), np.ravel(y).astype(np.float64)
        u, v = _on_grid(*flat, self.aside_x.curve, self.aside_y.curve)
        return u.reshape(np.shape(x)), v.reshape(np.shape(y))

    def below(self, points: FloatArray) -> FloatArray:
        """The ground below a few points, in one call: a picture asks for tens, and each call costs more than a point.

        Args:
            points: ``(n, 2 or more)`` x and y on the map first.

        Returns:
            ``(n, 7)`` height, dz/dx and dz/dy as of ``rise``, u and v as of ``grid``, dx/dv and dy/du as of ``bend``.
        """
        return _ground(points, self.aside_x.curve, self.aside_y.curve, self.height_u.curve, self.height_v.curve)

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
"""Straight streets on a plane without roundabouts: grid and map are the same."""


def land_of(seed: int) -> Land:
    """The land of one city."""
    rng = np.random.default_rng([seed, 7])
    slopes = np.array([rng.uniform(*_LONG_SLOPE), rng.uniform(0.0, _ACROSS)])
    bends = [
        Profile(_waves(rng, [slope], _LONG_BEND_M), _steps(rng))
        for slope in (slopes if rng.uniform() < 0.5 else slopes[::-1])
    ]
    steep, split = STEEPEST * rng.uniform() ** 0.8, rng.uniform(0.0, 0.5 * np.pi)
    hills = [
        Profile(_waves(rng, [0.7 * part * steep, 0.3 * part * steep], _HILL_M), np.zeros(0))
        for part in (np.cos(split), np.sin(split))
    ]
    return Land(bends[0], bends[1], hills[0], hills[1], roundabouts_of(seed))


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
