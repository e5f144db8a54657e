"""Reading textures, shadow maps and lamp maps at one point: the innermost loops of the renderer.

Texel coordinates are whole numbers in units of 1/65536 texel where a loop steps along them.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import float32, int32, uint32
from numpy.typing import NDArray

from mixo_env.compiled import inlined
from mixo_env.simulator.city.shadows import EXTENT_M, FIELD_TEXELS_PER_M, PICTURE_TEXELS_PER_M
from mixo_env.simulator.picture.views import Float32s, Int32s, Lamps, Point, UInt8s, UInt32s

CELL_SHIFT = 3
"""``even_cells`` looks at squares of 2^CELL_SHIFT texels: two metres, small beside the shadow of a house."""

HALF_EXTENT_M = 0.5 * EXTENT_M
PICTURE_MASK = int(EXTENT_M * PICTURE_TEXELS_PER_M) - 1  # sides are powers of two: what lies outside repeats the map

_FIELD_MASK = int(EXTENT_M * FIELD_TEXELS_PER_M) - 1
_U8, _U16 = np.uint32(8), np.uint32(16)  # typed, or Numba would widen every shift to 64 bits
_LOW, _PAIR = np.uint32(0xFFFF), np.uint32(0x00FF00FF)  # one half of a word; every second byte of it

_LEVEL_FROM = np.array([1.41, 2.83, 5.66, 11.3, 22.6, 45.2, 90.5, 181.0, 362.0, 724.0])  # one in each octave
_SOFT = 2.0  # per metre: the edge of a house's shadow is half a metre wide
_WALL_SHARE = 0.65  # of the light on the ground that an upright surface gets from a lamp above
_FLOOR_UP = 0.7  # upward part of the normal from which a surface counts as ground
_LAMP_SHARE = 0.6  # street lamps against head lights, by eye
_BEAM_START_M = 3.7  # head lights sit that far ahead of the ego frame, the rear axle
_BEAM_SHORTEST_M = 0.5  # nearer to the lamp than this, its own bonnet is not lit
_BEAM_HEIGHT_M = 0.9  # above the lamps the dipped beam is cut off
_BEAM_CUT = 40.0  # how sharply
_BEAM_POWER = 45.0  # by eye
_BEAM_SOFTENING_M2 = 40.0  # keeps the inverse square finite near the lamps
_BEAM_NARROW = 5.0  # the beam falls to 1/e at 24 degrees to either side


class Walk(NamedTuple):
    """Evenly spaced texels along a span, in units of 1/65536 texel: the first one, and the way to the next."""

    u: int
    v: int
    step_u: int
    step_v: int


class Size(NamedTuple):
    """Of one reduction of a texture, whose sides are powers of two: log2 of its width, width - 1 and height - 1."""

    log_w: int
    mask_u: int
    mask_v: int


@inlined
def add_texels(
    texels: UInt32s, size: Size, walk: Walk, where: Int32s, keep: np.uint32, red_blue: UInt32s, green_alpha: UInt32s
) -> None:
    """Add a texture, interpolated between four texels, along a span to the sums of its pixels.

    Two loops of 32-bit numbers, so that both run in SIMD; each product weighs two channels at once.

    Args:
        texels: of one reduction.
        size: of that.
        walk: where the pixels of the span are; what does not fit into 32 bits only repeats the texture.
        where: ``(6, SPAN)`` working memory.
        keep: all bits to add to the sums, none to begin them (what they held before is dropped).
        red_blue: sums of red in the lower 16 bits, of blue in the upper.
        green_alpha: the same of green and the fourth channel.
    """
    log_w, mask_u, mask_v = size.log_w, size.mask_u, size.mask_v
    u, v, along, down = int32(walk.u), int32(walk.v), int32(walk.step_u), int32(walk.step_v)
    here, right, below, across, shares_u, shares_v = where[0], where[1], where[2], where[3], where[4], where[5]
    # Where the four texels around each pixel are, and how far it is from the first one, in 1/256.
    for i in range(red_blue.shape[0]):
        x, y = u + int32(i) * along, v + int32(i) * down
        u0, v0 = (x >> 16) & mask_u, (y >> 16) & mask_v
        u1 = (u0 + 1) & mask_u
        upper, lower = v0 << log_w, ((v0 + 1) & mask_v) << log_w
        here[i], right[i], below[i], across[i] = upper + u0, upper + u1, lower + u0, lower + u1
        shares_u[i], shares_v[i] = (x >> 8) & 255, (y >> 8) & 255
    # Their weighted sum: weights add up to 256, so a channel of 8 bits stays within 16.
    for i in range(red_blue.shape[0]):
        a, b = uint32(shares_u[i]), uint32(shares_v[i])
        w11 = uint32(a * b) >> _U8
        w01, w10 = uint32(a - w11), uint32(b - w11)
        w00 = uint32(256 - a - w10)
        t00, t01 = texels[np.uintp(here[i])], texels[np.uintp(right[i])]
        t10, t11 = texels[np.uintp(below[i])], texels[np.uintp(across[i])]
        even = uint32((t00 & _PAIR) * w00 + (t01 & _PAIR) * w01 + (t10 & _PAIR) * w10 + (t11 & _PAIR) * w11)
        odd = uint32(
            (t00 >> _U8 & _PAIR) * w00
            + (t01 >> _U8 & _PAIR) * w01
            + (t10 >> _U8 & _PAIR) * w10
            + (t11 >> _U8 & _PAIR) * w11
        )
        red_blue[i] = (red_blue[i] & keep) + (even >> _U8 & _PAIR)
        green_alpha[i] = (green_alpha[i] & keep) + (odd >> _U8 & _PAIR)


@inlined
def bilinear1(image: Float32s, u: float, v: float, mask: int) -> float:
    """One channel of a square repeating image at (u, v)."""
    floor_u, floor_v = np.floor(u), np.floor(v)
    a, b = u - floor_u, v - floor_v
    u0, v0 = int(floor_u) & mask, int(floor_v) & mask
    u1, v1 = (u0 + 1) & mask, (v0 + 1) & mask
    upper = image[np.uintp(v0), np.uintp(u0)] * (1.0 - a) + image[np.uintp(v0), np.uintp(u1)] * a
    lower = image[np.uintp(v1), np.uintp(u0)] * (1.0 - a) + image[np.uintp(v1), np.uintp(u1)] * a
    return upper * (1.0 - b) + lower * b


@inlined
def read_grain(tile: UInt32s, log: int, walk: Walk, where: Int32s, out: Float32s) -> None:
    """Fine grain along a span, interpolated between four texels, 0..255 * 256.

    Args:
        tile: ``quads`` of a square tile.
        log: log2 of its side.
        walk: where the pixels of the span are.
        where: ``(6, SPAN)`` working memory.
        out: one number per pixel.
    """
    mask = (1 << log) - 1
    u, v, along, down = int32(walk.u), int32(walk.v), int32(walk.step_u), int32(walk.step_v)
    place, shares_u, shares_v = where[0], where[1], where[2]
    for i in range(out.shape[0]):
        x, y = u + int32(i) * along, v + int32(i) * down
        place[i] = (((y >> 16) & mask) << log) + ((x >> 16) & mask)
        shares_u[i], shares_v[i] = (x >> 12) & 15, (y >> 12) & 15
    for i in range(out.shape[0]):
        four, a, b = tile[np.uintp(place[i])], uint32(shares_u[i]), uint32(shares_v[i])
        # Upper and lower pair at once, in the two halves of the integer.
        pairs = uint32((four & _PAIR) * uint32(16 - a) + (four >> _U8 & _PAIR) * a)
        out[i] = float32(np.int32((pairs & _LOW) * uint32(16 - b) + (pairs >> _U16) * b))


@inlined
def bytes_at(image: UInt8s, mask: int, u: int, v: int) -> np.int64:
    """One channel of a square repeating image of bytes at (u, v) in 1/65536 texels; 0..255 * 65536."""
    a, b = (u >> 8) & 255, (v >> 8) & 255
    u0, v0 = (u >> 16) & mask, (v >> 16) & mask
    u1, v1 = (u0 + 1) & mask, (v0 + 1) & mask
    upper = np.int64(image[np.uintp(v0), np.uintp(u0)]) * (256 - a) + np.int64(image[np.uintp(v0), np.uintp(u1)]) * a
    lower = np.int64(image[np.uintp(v1), np.uintp(u0)]) * (256 - a) + np.int64(image[np.uintp(v1), np.uintp(u1)]) * a
    return upper * (256 - b) + lower * b


@inlined
def level(ratio: float) -> int:
    """Reduction whose texels match ``ratio`` texels a pixel: round(log2(ratio)), by comparison with 2^(n + 1/2).

    The exponent of the number says which of the comparisons is the one that matters.
    """
    exponent = min(max((np.float64(ratio).view(np.int64) >> 52) - 1023, 0), len(_LEVEL_FROM) - 1)
    return exponent + (ratio > _LEVEL_FROM[np.uintp(exponent)]) if ratio > _LEVEL_FROM[0] else 0


@inlined
def above_shadow(field: Float32s, x: float, y: float, z: float) -> float:
    """Share of the sun that houses leave at a point: four soft comparisons, interpolated."""
    u, v = (x + HALF_EXTENT_M) * FIELD_TEXELS_PER_M - 0.5, (y + HALF_EXTENT_M) * FIELD_TEXELS_PER_M - 0.5
    floor_u, floor_v = np.floor(u), np.floor(v)
    a, b = u - floor_u, v - floor_v
    u0, v0 = int(floor_u) & _FIELD_MASK, int(floor_v) & _FIELD_MASK
    u1, v1 = (u0 + 1) & _FIELD_MASK, (v0 + 1) & _FIELD_MASK
    c00 = min(max(_SOFT * (z - field[np.uintp(v0), np.uintp(u0)]), 0.0), 1.0)
    c01 = min(max(_SOFT * (z - field[np.uintp(v0), np.uintp(u1)]), 0.0), 1.0)
    c10 = min(max(_SOFT * (z - field[np.uintp(v1), np.uintp(u0)]), 0.0), 1.0)
    c11 = min(max(_SOFT * (z - field[np.uintp(v1), np.uintp(u1)]), 0.0), 1.0)
    return (c00 * (1.0 - a) + c01 * a) * (1.0 - b) + (c10 * (1.0 - a) + c11 * a) * b


@inlined
def lamp_light(lamps: Lamps, point: Point, up: float, ray: Point) -> float:
    """Light of street lamps and of the car's own head lights.

    Args:
        lamps: of the night.
        point: map position a little off the surface, metres.
        up: upward part of the surface's normal.
        ray: the same point in camera coordinates, metres.
    """
    x, y, z = point
    rx, ry, rz = ray
    ground = lamps.ground
    z -= ground[0] + ground[1] * x + ground[2] * y  # from here on over the ground
    window, corner, beam = lamps.window, lamps.corner, lamps.beam
    # The map holds the light on the ground; walls get less, and hardly any above the lamps.
    upright = 1.0 if up > _FLOOR_UP else _WALL_SHARE
    mask = window.shape[0] - 1
    total = _LAMP_SHARE * upright * min(max(2.2 - 0.25 * z, 0.12), 1.0)  # full up to 4.8 m, an eighth from 8.3 m on
    total *= bilinear1(window, x - corner[0] - 0.5, y - corner[1] - 0.5, mask)
    ahead = beam[0] * rx + beam[1] * ry + beam[2] * rz + beam[3] - _BEAM_START_M
    if ahead > _BEAM_SHORTEST_M:
        aside = beam[4] * rx + beam[5] * ry + beam[6] * rz + beam[7]
        angle = aside / ahead
        above = max(z - _BEAM_HEIGHT_M, 0.0)
        cut = 1.0 + _BEAM_CUT * above * above / ahead
        spread = ahead * ahead + aside * aside + _BEAM_SOFTENING_M2
        total += _BEAM_POWER / spread * np.exp(-_BEAM_NARROW * angle * angle) / cut
    return total


def even_cells(sunlight: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Where the picture of sunlight is even, for eight by eight texels each: 0 shade, 255 sun, 1 both."""
    size = 1 << CELL_SHIFT
    around = np.ones((size + 3, size + 3), np.uint8)  # with the neighbours that interpolation can touch
    low = cv2.erode(sunlight, around)[size // 2 :: size, size // 2 :: size]
    high = cv2.dilate(sunlight, around)[size // 2 :: size, size // 2 :: size]
    return np.where(high < 3, 0, np.where(low > 252, 255, 1)).astype(np.uint8)
