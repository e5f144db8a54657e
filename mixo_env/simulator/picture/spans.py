"""What shading the sky and shading surfaces share: short spans of a row of pixels, and what they read and write."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import float32, int32
from numpy.typing import NDArray

from mixo_env.compiled import inlined
from mixo_env.simulator.picture.views import (
    Daylight,
    Float32s,
    Float64s,
    Int32s,
    Int64s,
    Lamps,
    Seen,
    Textures,
    UInt32s,
    View,
)

SPAN = 32
"""Longest run of pixels that shares one reduction of the texture."""

RADIANCE_TOP = (1 << 18) - 1
"""Largest radiance of a pixel: eight of them fit into a field of 21 bits."""

ONE = 65536.0
"""Texel coordinates and factors in fixed point: 16 bits of fraction leave 15 for the texel."""

GRAIN_UNIT = 1.0 / (255.0 * 256.0)
"""Full scale of ``read_grain``."""

INVERSE = np.array([0.0] + [1.0 / i for i in range(1, SPAN + 1)])
"""1 / n for the lengths of spans; 0 for a span of one pixel, which has no step. Division would cost more."""


class Run(NamedTuple):
    """Pixels of a row from ``begin`` to before ``stop``, which show one patch or the sky."""

    row: int
    begin: int
    stop: int


class Span(NamedTuple):
    """A few pixels of a run.

    Attributes:
        x, last: first and last column.
        steps: from the first to the last; ``inverse`` is 1 / steps.
        z_first, z_last, z: depth at both ends and the mean.
        u, v: texel at the first pixel.
        du, dv: texels from pixel to pixel.
    """

    x: int
    last: int
    steps: int
    inverse: float
    z_first: float
    z_last: float
    z: float
    u: float
    v: float
    du: float
    dv: float


class Shot(NamedTuple):
    """All that decides a picture before the sensor.

    Attributes:
        seen: of ``DepthBuffers``.
        camera: where it stands and how it looks.
        light: ``(1,)`` of ``LIGHT``.
        textures: of the world.
        daylight: where the sun shines.
        lamps: what shines at night.
        motion: ``(bodies, 12)`` rotation by rows and translation from camera coordinates at the middle of the exposure
            to those at its end, per rigid body; body 0 is the world.
    """

    seen: Seen
    camera: View  # Numba takes any attribute called "view" for the method of arrays
    light: NDArray[np.void]
    textures: Textures
    daylight: Daylight
    lamps: Lamps
    motion: Float64s


class Canvas(NamedTuple):
    """The result of shading.

    Attributes:
        radiance: ``(h, w)`` three 21-bit fields, red lowest, each at most ``RADIANCE_TOP``.
        flow: ``(2, h, w)`` motion during the exposure in pixels, along columns and along rows.
    """

    radiance: Int64s
    flow: Float32s


class Memory(NamedTuple):
    """Working memory for one span.

    Attributes:
        red_blue: sums of the texture's red in the lower 16 bits, of its blue in the upper.
        green_alpha: the same of green and the fourth channel.
        factors: light on each pixel.
        specks: fine grain.
        where: ``(6, SPAN)`` places of texels.
    """

    red_blue: UInt32s
    green_alpha: UInt32s
    factors: Float32s
    specks: Float32s
    where: Int32s


@inlined
def whole(length: int) -> int:
    """Pixels to compute for a span: up to seven more than it has, so that SIMD leaves no rest.

    What they write beyond the span, the next span of the row writes again.
    """
    return (length + 7) & ~7


@inlined
def ramps(
    along: float, along_step: float, down: float, down_step: float, flow_along: Float32s, flow_down: Float32s
) -> None:
    """Write a motion that changes evenly along a span."""
    u, du, v, dv = float32(along), float32(along_step), float32(down), float32(down_step)
    for i in range(flow_along.shape[0]):
        flow_along[i] = u + du * float32(int32(i))  # of 64 bits they would convert at half the speed
        flow_down[i] = v + dv * float32(int32(i))
