"""The picture through drops on the glass: light is blended before the sensor, or into a finished picture."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numba import float32, int32
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.picture.developed import image_of, radiance_of
from mixo_env.simulator.picture.drops import Drops
from mixo_env.simulator.picture.mirror import mixed
from mixo_env.simulator.picture.views import Float32s, Float64s, Int32s, Int64s, UInt8s

_TABLE = 256  # samples of the covered share over the distance from a drop's centre
_SHARPNESS = 32  # steps of sharp radius over pupil; 8 is the largest that is told apart
_CELL = 8  # the surroundings that a drop shows are read from a picture so much smaller
_VERY_SOFT_PX = 24.0  # an opening whose disc has this radius blurs blocks of 4 x 4 pixels, any other 2 x 2
_FAINT = 4  # of 255: nobody sees less
_FIELD = (1 << 21) - 1  # one colour of a packed radiance
_SIDE = 5  # cells along the side of the square over which the surroundings are averaged


class Veil(NamedTuple):
    """What a set of drops does to a picture; as drops are soft, one value for a block of pixels.

    Attributes:
        shift: blocks are 2^shift pixels wide and high.
        share: ``(h, w)`` of the light that passes a drop, 0..255.
        cell: ``(h, w)`` the cell of the surroundings that is seen there.
    """

    shift: int
    share: UInt8s
    cell: Int32s


def drops_veil(drops: Drops, time_s: float, height: int, width: int) -> Veil:
    """The veil of the drops that are there at ``time_s``, for pictures of ``height`` x ``width``."""
    there = drops.at(time_s)
    shift = 2 if width * drops.pupil > _VERY_SOFT_PX else 1
    shape = -(-height >> shift), -(-width >> shift)
    veil = Veil(shift, np.zeros(shape, np.uint8), np.zeros(shape, np.int32))
    if len(there):
        sharp = np.clip(np.rint(_SHARPNESS / drops.pupil * there[:, 2]), 1, 8 * _SHARPNESS).astype(np.int64)
        cells = max(height // _CELL, 1), max(width // _CELL, 1)
        _lay(width * there, width * drops.pupil, sharp, _all_covered(), veil, cells)
    return veil


@cache
def _all_covered() -> NDArray[np.float32]:
    """``_covered`` of every sharpness, ``(sharpnesses + 1, _TABLE)``; the first row is not used."""
    return np.stack([_covered(max(number, 1)) for number in range(8 * _SHARPNESS + 1)])


def _covered(sharpness: int) -> NDArray[np.float32]:
    """Share of the pupil's disc P that a drop's disc R covers, over distance / (R + P) from 0 to 1.

    The overlap of two circles at a distance, over the area of the second; R / P = sharpness / ``_SHARPNESS``.
    """
    r = sharpness / _SHARPNESS
    d = np.linspace(0.0, r + 1.0, _TABLE)
    inside = d <= abs(r - 1.0)
    apart = np.where(inside, 1.0, d)
    first = np.arccos(np.clip((apart**2 + r**2 - 1.0) / (2.0 * apart * r), -1.0, 1.0))
    second = np.arccos(np.clip((apart**2 + 1.0 - r**2) / (2.0 * apart), -1.0, 1.0))
    lens = r**2 * (first - 0.5 * np.sin(2.0 * first)) + second - 0.5 * np.sin(2.0 * second)
    return np.where(inside, min(r, 1.0) ** 2, lens / np.pi).astype(np.float32)


@compiled_unchecked
def _lay(
    drops: Float64s, pupil: float, sharpness: Int64s, tables: Float32s, veil: Veil, cells: tuple[int, int]
) -> None:
    """Lay drops (x, y, radius in pixels), whose ``_covered`` are in ``tables``, over each other into ``veil``."""
    shift, share, cell = veil
    rows, columns = cells
    scale = 0.5**shift
    height, width = share.shape
    most, place = np.zeros(share.shape, np.float32), np.empty(width, np.int32)
    for n in range(drops.shape[0]):
        # In blocks, whose centres lie right of and below their first pixel's.
        x, y = scale * (drops[n, 0] + 0.5) - 0.5, scale * (drops[n, 1] + 0.5) - 0.5
        sharp = scale * drops[n, 2]
        reach = sharp + scale * pupil
        # Upside down: the whole height of the picture within the drop, less where the blur mixes it.
        turned = -0.5 * rows / reach * (sharp / reach)
        u0, v0 = min(max(x / width, 0.25), 0.75) * columns, min(max(y / height, 0.35), 0.65) * rows
        for row in range(max(0, int(np.ceil(y - reach))), min(height, int(y + reach) + 1)):
            half = np.sqrt(max(reach * reach - (row - y) ** 2, 0.0))
            begin, end = max(0, int(np.ceil(x - half))), min(width, int(x + half) + 1)
            if begin >= end:
                continue
            _places(float32(begin - x), float32((row - y) ** 2), float32((_TABLE - 1) / reach), place[begin:end])
            v = min(max(int(v0 + turned * (row - y)), 0), rows - 1)
            for column in range(begin, end):
                covered = tables[sharpness[n], np.uintp(place[column])]
                if covered > most[row, column]:  # the cell of the drop that covers most
                    most[row, column] = covered
                    u = min(max(int(u0 + turned * (column - x)), 0), columns - 1)
                    cell[row, column] = v * columns + u
                free = (float32(255.0) - float32(share[row, column])) * (float32(1.0) - covered)
                share[row, column] = np.uint8(np.int32(float32(255.5) - free))


@inlined
def _places(aside: np.float32, over: np.float32, per_block: np.float32, out: Int32s) -> None:
    """Places in a table of ``_covered`` along a row of blocks, the first ``aside`` from the drop's centre.

    ``over`` is the square of the row's distance from it, ``per_block`` how many places a block is.
    """
    for i in range(out.shape[0]):
        far = aside + float32(i)
        place = np.int32(np.sqrt(far * far + over) * per_block + float32(0.5))
        out[i] = min(place, int32(_TABLE - 1))


@compiled_unchecked
def _surroundings(radiance: Int64s) -> Int64s:
    """The picture in cells of ``_CELL`` pixels, packed and averaged over ``_SIDE`` x ``_SIDE`` of them."""
    height, width = radiance.shape
    rows, columns = max(height // _CELL, 1), max(width // _CELL, 1)
    small, lines, out = (
        np.empty((rows, columns), np.int64),
        np.zeros((rows, columns), np.int64),
        np.empty(rows * columns, np.int64),
    )
    first, second = _CELL // 4, 3 * _CELL // 4
    for i in range(rows):
        up, low = radiance[min(i * _CELL + first, height - 1)], radiance[min(i * _CELL + second, height - 1)]
        for j in range(columns):
            # The mean of two fields is taken before the sum, so that no field overflows.
            a, b = min(j * _CELL + first, width - 1), min(j * _CELL + second, width - 1)
            total = up[a] + up[b] + low[a] + low[b]
            small[i, j] = (total & _FIELD) >> 2 | (total >> 21 & _FIELD) >> 2 << 21 | (total >> 42) >> 2 << 42
    half = _SIDE // 2
    for i in range(rows):
        for j in range(columns):
            for k in range(-half, half + 1):
                lines[i, j] += small[i, min(max(j + k, 0), columns - 1)]
    share = _SIDE * _SIDE
    for i in range(rows):
        for j in range(columns):
            red = green = blue = 0
            for k in range(-half, half + 1):
                word = lines[min(max(i + k, 0), rows - 1), j]
                red, green, blue = red + (word & _FIELD), green + (word >> 21 & _FIELD), blue + (word >> 42)
            out[i * columns + j] = red // share | green // share << 21 | blue // share << 42
    return out


@compiled_unchecked
def see_through(radiance: Int64s, veil: Veil) -> None:
    """Blend what drops show into ``(h, w)`` packed radiance, in place."""
    shift, share, cell = veil
    around = _surroundings(radiance)
    height, width = radiance.shape
    blocks = share.shape[1]
    shown, parts = np.empty(blocks << shift, np.int64), np.empty(blocks << shift, np.int64)
    for line in range(share.shape[0]):
        shares, block = share[line], 0
        while block < blocks:
            if shares[block] < _FAINT:
                block += 1
                continue
            # Blocks in a row that show something, then all their pixels.
            begin = block
            while block < blocks and shares[block] >= _FAINT:
                block += 1
            _widen(around, cell[line, begin:block], shares[begin:block], shift, shown, parts)
            left, right = begin << shift, min(block << shift, width)
            for row in range(line << shift, min((line + 1) << shift, height)):
                _blend(shown[: right - left], parts[: right - left], radiance[row, left:right])


@inlined
def _widen(around: Int64s, cell: Int32s, share: UInt8s, shift: int, shown: Int64s, parts: Int64s) -> None:
    """What each pixel along a run of blocks shows, and how much of it."""
    for i in range(cell.shape[0]):
        word, part = around[np.uintp(cell[i])], np.int64(share[i])
        for at in range(i << shift, (i + 1) << shift):
            shown[at], parts[at] = word, part


@inlined
def _blend(shown: Int64s, parts: Int64s, out: Int64s) -> None:
    """Mix what drops show into a run of pixels."""
    for i in range(out.shape[0]):
        out[i] = mixed(out[i], shown[i], parts[i] & 255)


def add_drops(image: NDArray[np.uint8], drops: Drops, time_s: float) -> NDArray[np.uint8]:
    """A finished picture ``(h, w, 3)`` as it would have been seen through the drops of one instant.

    Args:
        image: bytes, square roots of light (gamma 2); left as it is.
        drops: of ``drops_on``.
        time_s: instant, in the scene's time.
    """
    radiance = radiance_of(image)
    see_through(radiance, drops_veil(drops, time_s, *image.shape[:2]))
    return image_of(radiance)
