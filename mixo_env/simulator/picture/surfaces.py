"""What stays the same along a row of pixels that show one patch, so that it is computed once per run.

All quantities are linear in the column of pixels; what the row adds is in their constants already.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import float32

from mixo_env.compiled import inlined
from mixo_env.simulator.city.mesh import CUT_OUT, GROUND, SHADE, SOLID
from mixo_env.simulator.picture.views import (
    BLUE,
    EMISSION,
    FACING,
    GRAIN_PER_U,
    GRAIN_PER_V,
    GRAIN_STRENGTH,
    GRAIN_U,
    GRAIN_V,
    GREEN,
    MATERIAL,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    RED,
    SIDES,
    TEXTURE,
    U_COLUMN,
    U_CONSTANT,
    U_ROW,
    V_COLUMN,
    V_CONSTANT,
    V_ROW,
    W_COLUMN,
    W_CONSTANT,
    W_ROW,
    Float32s,
    Float64s,
    Int32s,
    View,
)

_EMITTED = 4.0  # lamps behind glass against what they light
_SIDEWAYS, _UPWARD = 0.82, 0.18  # the sky's light that falls on a wall; how much more falls on a roof
_WET = 0.5  # of its light that soaked ground loses
_BEND_PX = 0.8  # four times the error that is allowed, see below


class Surface(NamedTuple):
    """u = texel column/z, v = texel row/z and w = 1/z over a row: constant, per column, and per row (for footprints).

    Attributes:
        bend: square of the longest span, per depth: linear interpolation over n pixels errs by n^2 / 4 |w1 / w| pixels.
    """

    u0: float
    u1: float
    u2: float
    v0: float
    v1: float
    v2: float
    w0: float
    w1: float
    w2: float
    bend: float


class Look(NamedTuple):
    """How the patch looks in this light.

    Attributes:
        texture: number in the atlas.
        on_ground: whether its sunlight is read from the picture of the ground.
        grain_per_u, grain_per_v: texels of the fine grain per texel.
        grain_u, grain_v: its offsets.
        strength: of the grain.
        facing: sunlight on it where nothing is in the way.
        normal_x, normal_y, normal_z: outward.
        red, green, blue: tint, with the colour of the light.
        emission: light that its texture's fourth channel emits.
        ambient: light from the sky.
    """

    texture: int
    on_ground: bool
    grain_per_u: float
    grain_per_v: float
    grain_u: float
    grain_v: float
    strength: float
    facing: float
    normal_x: float
    normal_y: float
    normal_z: float
    red: np.float32
    green: np.float32
    blue: np.float32
    emission: float
    ambient: float


class Rays(NamedTuple):
    """Map direction of the pixels of a row, one metre deep: constant ``d`` and step ``s`` per column."""

    d0: float
    d1: float
    d2: float
    s0: float
    s1: float
    s2: float


class Sweep(NamedTuple):
    """Where a row of the surface is seen at the end of the exposure: x, y and z over the depth now, as for ``Rays``."""

    x0: float
    y0: float
    z0: float
    x1: float
    y1: float
    z1: float


@inlined
def surface_in(plane: Float64s, row: int) -> Surface:
    """A row of ``Seen.plane`` along one row of pixels."""
    u1, v1, w1 = plane[U_COLUMN], plane[V_COLUMN], plane[W_COLUMN]
    u2, v2, w2 = plane[U_ROW], plane[V_ROW], plane[W_ROW]
    u0, v0, w0 = plane[U_CONSTANT] + u2 * row, plane[V_CONSTANT] + v2 * row, plane[W_CONSTANT] + w2 * row
    bend = _BEND_PX / (abs(w1) + 1e-12)  # not infinite where the depth is the same all along
    return Surface(u0, u1, u2, v0, v1, v2, w0, w1, w2, bend)


@inlined
def look_of(style: Float32s, mark: Int32s, light: Any) -> Look:
    """Rows of ``Seen.style`` and ``Seen.mark`` in a light (a record of ``LIGHT``)."""
    material = mark[MATERIAL]
    # Leaves keep their fourth channel for their outline.
    emission = 0.0 if mark[SIDES] & CUT_OUT != 0 else _EMITTED * light.lamps * style[EMISSION]
    facing = style[FACING] * light.sun
    if material == SHADE:
        facing = 0.0
    ambient = light.ambient * (_SIDEWAYS + _UPWARD * style[NORMAL_Z])
    if material != SOLID:
        ambient *= 1.0 - _WET * light.wetness
    return Look(
        mark[TEXTURE],
        material == GROUND,
        style[GRAIN_PER_U],
        style[GRAIN_PER_V],
        style[GRAIN_U],
        style[GRAIN_V],
        style[GRAIN_STRENGTH],
        facing,
        style[NORMAL_X],
        style[NORMAL_Y],
        style[NORMAL_Z],
        float32(style[RED] * light.red),
        float32(style[GREEN] * light.green),
        float32(style[BLUE] * light.blue),
        emission,
        ambient,
    )


@inlined
def rays_in(view: View, dy: float) -> Rays:
    """Rays of the row whose pixels look ``dy`` down per metre of depth."""
    rotation, fx, cx = view.rotation, view.fx, view.cx
    s0, s1, s2 = rotation[0, 0] / fx, rotation[0, 1] / fx, rotation[0, 2] / fx
    d0 = rotation[2, 0] + rotation[1, 0] * dy - s0 * cx
    d1 = rotation[2, 1] + rotation[1, 1] * dy - s1 * cx
    d2 = rotation[2, 2] + rotation[1, 2] * dy - s2 * cx
    return Rays(d0, d1, d2, s0, s1, s2)


@inlined
def sweep_in(m: Float64s, view: View, dy: float, surface: Surface) -> Sweep:
    """A row of a surface carried by the motion ``m`` of its body, a row of ``Shot.motion``."""
    fx, cx, w0, w1 = view.fx, view.cx, surface.w0, surface.w1
    return Sweep(
        m[1] * dy + m[2] - m[0] * cx / fx + m[9] * w0,
        m[4] * dy + m[5] - m[3] * cx / fx + m[10] * w0,
        m[7] * dy + m[8] - m[6] * cx / fx + m[11] * w0,
        m[0] / fx + m[9] * w1,
        m[3] / fx + m[10] * w1,
        m[6] / fx + m[11] * w1,
    )
