"""How much of the sun reaches the pixels of a span: looked up at its ends, and in between only where those differ."""

from __future__ import annotations

from typing import NamedTuple

from mixo_env.compiled import inlined
from mixo_env.simulator.city.shadows import PICTURE_TEXELS_PER_M
from mixo_env.simulator.picture.sampling import CELL_SHIFT, HALF_EXTENT_M, PICTURE_MASK, Walk, above_shadow
from mixo_env.simulator.picture.spans import ONE, Span
from mixo_env.simulator.picture.views import Daylight, Float32s, Point

_EVEN_SPAN_TEXELS = 6.0  # of the picture of sunlight: a longer span may cross a whole cell


class Sun(NamedTuple):
    """How the sun shines on a span.

    Attributes:
        share: of it on the first pixel.
        varied: whether it has to be looked up for each pixel.
        at_end: share on the last pixel of a wall.
        walk: of the pixels over the picture of sunlight, if on the ground.
        x, y, z: of the first pixel a little off the surface, map frame; ``step_*`` the way to the next, if not.
    """

    share: float
    varied: bool
    at_end: float
    walk: Walk
    x: float
    y: float
    z: float
    step_x: float
    step_y: float
    step_z: float


@inlined
def no_sun() -> Sun:
    """For surfaces on which it does not fall."""
    return Sun(1.0, False, 0.0, Walk(0, 0, 0, 0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def sun_on_ground(daylight: Daylight, span: Span, texels_per_m: float) -> Sun:
    """From the picture of sunlight; cells of it that are even need no look at every pixel."""
    to_picture = PICTURE_TEXELS_PER_M / texels_per_m
    at_picture = HALF_EXTENT_M * PICTURE_TEXELS_PER_M - 0.5
    u, v = span.u * to_picture + at_picture, span.v * to_picture + at_picture
    du, dv = span.du * to_picture, span.dv * to_picture
    cells, steps = daylight.cells, span.steps
    cell = cells[(int(v) & PICTURE_MASK) >> CELL_SHIFT, (int(u) & PICTURE_MASK) >> CELL_SHIFT]
    there = cells[
        (int(v + dv * steps) & PICTURE_MASK) >> CELL_SHIFT,
        (int(u + du * steps) & PICTURE_MASK) >> CELL_SHIFT,
    ]
    varied = cell != there or cell == 1 or (abs(du) + abs(dv)) * steps > _EVEN_SPAN_TEXELS
    walk = Walk(int(u * ONE), int(v * ONE), int(du * ONE), int(dv * ONE))
    return Sun(cell * (1.0 / 255.0), varied, 0.0, walk, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def sun_on_wall(field: Float32s, span: Span, first: Point, last: Point, before: float) -> Sun:
    """From the height of the houses' shadow at both ends; ``before`` is the share at the first, -1 if not known."""
    share = above_shadow(field, first[0], first[1], first[2]) if before < 0.0 else before
    at_end = above_shadow(field, last[0], last[1], last[2])
    inverse = span.inverse
    dx, dy, dz = (last[0] - first[0]) * inverse, (last[1] - first[1]) * inverse, (last[2] - first[2]) * inverse
    return Sun(share, share != at_end, at_end, Walk(0, 0, 0, 0), first[0], first[1], first[2], dx, dy, dz)
