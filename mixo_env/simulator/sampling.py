"""Reading textures, shadow maps and lamp maps at one point: the innermost loops of the renderer.

Texel coordinates are whole numbers in units of 1/65536 texel where a loop steps along them.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixo_env.simulator.compiling import INLINED
from mixo_env.simulator.shadows import EXTENT_M, FIELD_TEXELS_PER_M, PICTURE_TEXELS_PER_M

CELL_SHIFT = 3
"""``even_cells`` looks at squares of 2^CELL_SHIFT texels."""

HALF_EXTENT_M = 0.5 * EXTENT_M
PICTURE_MASK = int(EXTENT_M * PICTURE_TEXELS_PER_M) - 1

_FIELD_MASK = int(EXTENT_M * FIELD_TEXELS_PER_M) - 1
_U8 = np.uint64(8)
_LANES = np.uint64(0x00FF00FF00FF00FF)


@njit(**INLINED)
def bilinear4(texels, start, log_w, mask_u, mask_v, u, v):
    """Four channels of a texture at texel coordinates (u, v) in 1/65536, as lanes of 0..255."""
    a, b = (u >> 8) & 255, (v >> 8) & 255
    u0, v0 = (u >> 16) & mask_u, (v >> 16) & mask_v
    u1 = (u0 + 1) & mask_u
    here, below = start + (v0 << log_w), start + (((v0 + 1) & mask_v) << log_w)
    w11 = (a * b) >> 8
    w01, w10, w00 = a - w11, b - w11, 256 - a - b + w11
    lanes = (
        texels[np.uintp(here + u0)] * np.uint64(w00)
        + texels[np.uintp(here + u1)] * np.uint64(w01)
        + texels[np.uintp(below + u0)] * np.uint64(w10)
        + texels[np.uintp(below + u1)] * np.uint64(w11)
    )
    return (lanes >> _U8) & _LANES


@njit(**INLINED)
def bilinear1(image, u, v, mask):
    """One channel of a square repeating image at (u, v)."""
    floor_u, floor_v = np.floor(u), np.floor(v)
    a, b = u - floor_u, v - floor_v
    u0, v0 = int(floor_u) & mask, int(floor_v) & mask
    u1, v1 = (u0 + 1) & mask, (v0 + 1) & mask
    upper = image[np.uintp(v0), np.uintp(u0)] * (1.0 - a) + image[np.uintp(v0), np.uintp(u1)] * a
    lower = image[np.uintp(v1), np.uintp(u0)] * (1.0 - a) + image[np.uintp(v1), np.uintp(u1)] * a
    return upper * (1.0 - b) + lower * b


@njit(**INLINED)
def grain(tiles, start, log, u, v):
    """Fine grain at (u, v) in 1/65536 texels of the tile, 2^log wide, that begins at ``start``; 0..255 * 256."""
    mask = (1 << log) - 1
    a, b = (u >> 12) & 15, (v >> 12) & 15
    u0, v0 = (u >> 16) & mask, (v >> 16) & mask
    u1 = (u0 + 1) & mask
    here, below = start + (v0 << log), start + (((v0 + 1) & mask) << log)
    upper = np.int64(tiles[np.uintp(here + u0)]) * (16 - a) + np.int64(tiles[np.uintp(here + u1)]) * a
    lower = np.int64(tiles[np.uintp(below + u0)]) * (16 - a) + np.int64(tiles[np.uintp(below + u1)]) * a
    return upper * (16 - b) + lower * b


@njit(**INLINED)
def bytes_at(image, mask, u, v):
    """One channel of a square repeating image of bytes at (u, v) in 1/65536 texels; 0..255 * 65536."""
    a, b = (u >> 8) & 255, (v >> 8) & 255
    u0, v0 = (u >> 16) & mask, (v >> 16) & mask
    u1, v1 = (u0 + 1) & mask, (v0 + 1) & mask
    upper = np.int64(image[np.uintp(v0), np.uintp(u0)]) * (256 - a) + np.int64(image[np.uintp(v0), np.uintp(u1)]) * a
    lower = np.int64(image[np.uintp(v1), np.uintp(u0)]) * (256 - a) + np.int64(image[np.uintp(v1), np.uintp(u1)]) * a
    return upper * (256 - b) + lower * b


@njit(**INLINED)
def level(ratio):
    """Reduction whose texels match ``ratio`` texels a pixel: round(log2(ratio))."""
    return (
        (ratio > 1.41)
        + (ratio > 2.83)
        + (ratio > 5.66)
        + (ratio > 11.3)
        + (ratio > 22.6)
        + (ratio > 45.2)
        + (ratio > 90.5)
        + (ratio > 181.0)
        + (ratio > 362.0)
        + (ratio > 724.0)
    )


@njit(**INLINED)
def above_shadow(field, x, y, z):
    """Share of the sun that houses leave at a point: four soft comparisons, interpolated."""
    u, v = (x + HALF_EXTENT_M) * FIELD_TEXELS_PER_M - 0.5, (y + HALF_EXTENT_M) * FIELD_TEXELS_PER_M - 0.5
    floor_u, floor_v = np.floor(u), np.floor(v)
    a, b = u - floor_u, v - floor_v
    u0, v0 = int(floor_u) & _FIELD_MASK, int(floor_v) & _FIELD_MASK
    u1, v1 = (u0 + 1) & _FIELD_MASK, (v0 + 1) & _FIELD_MASK
    c00 = min(max(2.0 * (z - field[np.uintp(v0), np.uintp(u0)]), 0.0), 1.0)
    c01 = min(max(2.0 * (z - field[np.uintp(v0), np.uintp(u1)]), 0.0), 1.0)
    c10 = min(max(2.0 * (z - field[np.uintp(v1), np.uintp(u0)]), 0.0), 1.0)
    c11 = min(max(2.0 * (z - field[np.uintp(v1), np.uintp(u1)]), 0.0), 1.0)
    return (c00 * (1.0 - a) + c01 * a) * (1.0 - b) + (c10 * (1.0 - a) + c11 * a) * b


@njit(**INLINED)
def lamp_light(lamps, corner_x, corner_y, beam, x, y, z, up, rx, ry, rz):
    """Light of street lamps and of the car's own head lights.

    Args:
        lamps: light on the ground, one value a metre.
        corner_x: map position of its corner, metres.
        corner_y: the same.
        beam: ``(8,)`` see :func:`shade`.
        x: map position a little off the surface, metres.
        y: the same.
        z: height, metres.
        up: upward part of the surface's normal.
        rx: the same point in camera coordinates, metres.
        ry: the same.
        rz: the same.
    """
    # The map holds the light on the ground; walls get less, and hardly any above the lamps.
    upright = 1.0 if up > 0.7 else 0.65
    mask = lamps.shape[0] - 1
    total = 0.6 * upright * min(max(2.2 - 0.25 * z, 0.12), 1.0)
    total *= bilinear1(lamps, x - corner_x - 0.5, y - corner_y - 0.5, mask)
    ahead = beam[0] * rx + beam[1] * ry + beam[2] * rz + beam[3] - 3.7
    if ahead > 0.5:
        aside = beam[4] * rx + beam[5] * ry + beam[6] * rz + beam[7]
        angle = aside / ahead
        above = max(z - 0.9, 0.0)
        cut = 1.0 + 40.0 * above * above / ahead
        total += 45.0 / (ahead * ahead + aside * aside + 40.0) * np.exp(-5.0 * angle * angle) / cut
    return total


def even_cells(sunlight: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Where the picture of sunlight is even, for eight by eight texels each: 0 shade, 255 sun, 1 both."""
    size = 1 << CELL_SHIFT
    around = np.ones((size + 3, size + 3), np.uint8)  # with the neighbours that interpolation can touch
    low = cv2.erode(sunlight, around)[size // 2 :: size, size // 2 :: size]
    high = cv2.dilate(sunlight, around)[size // 2 :: size, size // 2 :: size]
    return np.where(high < 3, 0, np.where(low > 252, 255, 1)).astype(np.uint8)
