"""The mirror of the wet road, found in the picture itself.

What stands on the road is seen a second time, upside down, where its points reflected in the ground would be seen.
Cells of 2 x 2 pixels are carried there; where several arrive, the nearest surface is the one that the road shows. As a
surface at one distance is mirrored at its own scale, few cells of the road stay empty. How far a cell is displaced is
kept to the pixel: cells stand still in the picture, and a pattern of theirs would look like something that the car
carries along.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import float32, int32

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.city.mesh import GROUND, SOLID
from mixo_env.simulator.picture.spans import whole
from mixo_env.simulator.picture.views import (
    MATERIAL,
    W_COLUMN,
    W_CONSTANT,
    W_ROW,
    Float32s,
    Int32s,
    Int64s,
    Point,
    Seen,
    UInt8s,
    View,
)

_FIELD = (1 << 21) - 1  # one colour of a packed radiance
_HALVES = (0xFFFFF << 42) | (0xFFFFF << 21) | 0xFFFFF  # all three, without the bit that a shift moves in from the next
_RIPPLE_ROWS = 3  # the road shows the mean of two places so far apart
_PUDDLE_TEXELS_PER_M = 9.0  # the noise of the clouds repeats every 57 metres of road
_NOISE_SIDE = 512  # of the clouds
_ROUGH, _MEAN_CLEAR = 0.35, 0.71  # share of the mirrored light that a rough road keeps, and that far puddles blur to
_CLEAR_M = 12.0  # farther away single puddles blur
_FADING_ROWS = 32.0  # of the picture, at its top: an edge where the mirror ends would stand still in the picture
_STRETCH = 64  # cells within which the share of mirrored light is linear
_STILL, _GRAZING = 0.02, 0.98  # water mirrors a fiftieth of what falls straight down on it, all that grazes it


class Grid(NamedTuple):
    """Cells of 2 x 2 pixels over a picture, as floats for loops in SIMD: their rows and columns, and of pixels."""

    height: np.float32
    width: np.float32
    down: np.float32
    across: np.float32


class Lens(NamedTuple):
    """The camera in single precision: lens, and the vertical in camera coordinates."""

    fx: np.float32
    fy: np.float32
    cx: np.float32
    cy: np.float32
    up_x: np.float32
    up_y: np.float32
    up_z: np.float32


class Ray(NamedTuple):
    """Rays of a run of cells: x and y of the first, step of x, d . up of the first and its step."""

    x: np.float32
    y: np.float32
    step: np.float32
    rise: np.float32
    steeper: np.float32


class Ground(NamedTuple):
    """Where the rays of a run of cells go over the noise of the puddles, in its texels.

    Attributes:
        x, y: of the first ray, per metre of depth.
        x_step, y_step: from cell to cell.
        camera_x, camera_y: where the rays start.
    """

    x: np.float32
    y: np.float32
    x_step: np.float32
    y_step: np.float32
    camera_x: np.float32
    camera_y: np.float32


class Carried(NamedTuple):
    """Mirror images of a run of cells.

    Attributes:
        places: index of the cell where the image is; that after the last if outside.
        sources: index of the pixel that the upper left pixel of that cell shows.
    """

    places: Int32s
    sources: Int32s


class Shown(NamedTuple):
    """What the pixels of a run show of the mirror image: index of the pixel that they mirror, and share of 255."""

    places: Int32s
    parts: Int32s


@inlined
def mixed(first: int, second: int, share: int | np.int64) -> int | np.int64:
    """Packed radiance: share / 255 of the second, the rest of the first."""
    keep = share ^ 255  # written so that the compiler sees factors of 32 bits: SIMD multiplies those at once
    red, green, blue = first & _FIELD, first >> 21 & _FIELD, first >> 42 & _FIELD
    red = (red * keep + red + (second & _FIELD) * share) >> 8
    green = (green * keep + green + (second >> 21 & _FIELD) * share) >> 8
    blue = (blue * keep + blue + (second >> 42 & _FIELD) * share) >> 8
    return red | green << 21 | blue << 42


@inlined
def _carried(
    inverse: Float32s,
    drop: Float32s,
    ray: Ray,
    lens: Lens,
    grid: Grid,
    first: tuple[np.float32, np.float32],
    out: Carried,
) -> None:
    """Where a run of cells is mirrored, and what the cell there has to show.

    With d the ray of a cell, 1/z its depth, ``drop`` the camera's height over the ground and ``up`` the vertical, the
    cell is t = drop / z + d . up over the ground per unit of depth, and its mirror image lies along d - 2 t up.

    Args:
        inverse: 1/z of their first pixels.
        drop: in metres.
        ray: of the cells.
        lens: of the camera.
        grid: of the cells.
        first: column and row of the first cell.
        out: what is found.
    """
    x, y, step, rise, steeper = ray
    fx, fy, cx, cy, up_x, up_y, up_z = lens
    height, width, down, across = grid
    left, lower = float32(2.0) * first[0], float32(2.0) * first[1] + float32(1.0)
    half, one, two = float32(0.5), float32(1.0), float32(2.0)
    for i in range(out.places.shape[0]):  # whole numbers as floats, exact below 2^24: those run in SIMD
        # Where the image lies.
        n = float32(int32(i))
        twice = two * (drop[i] * inverse[i] + rise + steeper * n)
        scale = one / (one - twice * up_z)
        column, row = (x + step * n - twice * up_x) * scale * fx + cx, (y - twice * up_y) * scale * fy + cy
        inside = (twice > float32(0.0)) & (scale > float32(0.0))
        inside &= (column > -half) & (column < two * across - half) & (row > -half) & (row < two * down - half)
        to_column, to_row = np.floor((column + half) * half), np.floor((row + half) * half)
        out.places[i] = np.int32(to_row * across + to_column if inside else down * across)
        # What is shown there, to the pixel.
        aside, over = np.floor(column - two * to_column), np.floor(row - two * to_row)  # -1, 0 or 1 pixel off the cell
        from_column = min(max(left + two * n - aside, float32(0.0)), width - two)
        from_row = min(max(lower + over, one), height - one)
        out.sources[i] = np.int32(from_row * width + from_column if inside else float32(0.0))


@inlined
def _claim(bits: Int32s, carried: Carried, images: Int64s) -> None:
    """Let cells claim their places; the nearest wins. A claim is 1/z above the index of the pixel to show.

    ``bits`` are those of 1/z, which grow as it does; there are as many cells.
    """
    for i in range(bits.shape[0]):
        claim, place = np.int64(bits[i]) << 32 | np.int64(carried.sources[i]), np.uintp(carried.places[i])
        images[place] = max(images[place], claim)


@inlined
def _take(images: Int64s, two_rows: int, shown: Int32s) -> np.int32:
    """What the cells of a run show: what claimed them, else what is two rows over what the cell above shows.

    ``shown`` holds what the cells above show, -1 for nothing, and takes the result. Returns the largest.
    """
    most = np.int32(-1)
    for i in range(shown.shape[0]):
        claim, follow = images[i], shown[i]
        follow = follow - two_rows if follow > two_rows + two_rows else follow
        shown[i] = np.int32(claim & 0x7FFFFFFF) if claim >= 0 else follow
        most = max(most, shown[i])
    return most


@inlined
def _puddles(inverse: Float32s, ground: Ground, noise: UInt8s, where: Int32s, clear: Float32s) -> None:
    """How clear the mirror is in a run of cells: puddles lie in the map like the noise; far ones blur."""
    x, y, x_step, y_step, px, py = ground
    for i in range(where.shape[0]):
        z, n = float32(1.0) / inverse[2 * i], float32(int32(i))
        u, v = px + z * (x + x_step * n), py + z * (y + y_step * n)
        where[i] = (int32(np.floor(v)) & int32(511)) << int32(9) | int32(np.floor(u)) & int32(511)
    for i in range(where.shape[0]):
        water = float32(_ROUGH) + float32((1.0 - _ROUGH) * 2.0 / 255.0) * float32(noise[np.uintp(where[i])])
        near = min(float32(_CLEAR_M) * inverse[2 * i], float32(1.0))
        clear[i] = float32(_MEAN_CLEAR) + near * (min(water, float32(1.0)) - float32(_MEAN_CLEAR))


@inlined
def _shares(share: np.float32, change: np.float32, shown: Int32s, clear: Float32s, width: int, shares: Int32s) -> None:
    """Share of 255 that each cell of a run shows of what it mirrors; what is seen at the top of the picture fades."""
    per_pixel, top = float32(1.0 / (_FADING_ROWS * width)), float32((_RIPPLE_ROWS + 1) / _FADING_ROWS)
    for i in range(shares.shape[0]):
        inside = min(max(float32(shown[i]) * per_pixel - top, float32(0.0)), float32(1.0))
        shares[i] = np.int32((share + change * float32(int32(i))) * clear[i] * inside)


@inlined
def _spread(shown: Int32s, shares: Int32s, pixels: Shown) -> None:
    """What the pixels of a row show, and how much of it, from what the cells of a run do."""
    places, parts = pixels.places, pixels.parts
    for i in range(shown.shape[0]):
        places[2 * i], places[2 * i + 1] = shown[i], shown[i] + int32(1)
    for i in range(shown.shape[0]):
        parts[2 * i], parts[2 * i + 1] = shares[i], shares[i]


@inlined
def _blend(
    flat: Int64s, shift: tuple[int, int], k: int, pixels: Shown, owner: Int32s, road: Int64s, out: Int64s
) -> None:
    """Mix what they show into a run of pixels of the road, those of patch ``k``; the others stay.

    ``shift`` is from the row of the cells to that of the pixels, and how far above the second place lies.
    """
    offset, ripple = shift
    for i in range(out.shape[0]):
        at = max(pixels.places[i] + offset, int32(0))
        here, above = np.uintp(at), np.uintp(max(at - ripple, int32(0)))
        # A mask that changes nothing, but tells the compiler that the factors of ``mixed`` are short.
        part = np.int64(pixels.parts[i]) & 255 if owner[i] == k else np.int64(0)
        out[i] = mixed(road[i], (flat[here] >> 1 & _HALVES) + (flat[above] >> 1 & _HALVES), part)


@inlined
def _put(values: Int64s, row: Int64s) -> None:
    """Write a run; :func:`_blend` must not, since it reads from the same picture."""
    for i in range(values.shape[0]):
        row[i] = values[i]


@inlined
def _still_water(x: float, y: float, up: Point) -> float:
    """Share of light that still water mirrors in the direction (x, y, 1) (Fresnel, after Schlick)."""
    grazing = 1.0 - min(abs(x * up[0] + y * up[1] + up[2]) / np.sqrt(x * x + y * y + 1.0), 1.0)
    squared = grazing * grazing
    return _STILL + _GRAZING * squared * squared * grazing


@inlined
def _end_of_run(owner: Int32s, begin: int, across: int) -> int:
    """First cell after ``begin`` that shows another patch; ``owner`` of the pixels of its first row."""
    end, k = begin + 1, owner[2 * begin]
    while end < across and owner[np.uintp(2 * end)] == k:
        end += 1
    return end


@compiled_unchecked
def _carry(seen: Seen, view: View, height_m: float, images: Int64s) -> int:
    """Carry everything that stands and the sky to where the road mirrors it; the first line of cells with ground.

    ``height_m`` is that of the camera over the ground below it. Lines go from the bottom of the picture to its top, so
    that the ground under a thing is seen before the thing.
    """
    height, width = seen.owner.shape
    down, across = (height + 1) // 2, (width + 1) // 2
    grid = Grid(float32(height), float32(width), float32(down), float32(across))
    rotation, fx, fy, cx, cy = view.rotation, view.fx, view.fy, view.cx, view.cy
    up = rotation[0, 2], rotation[1, 2], rotation[2, 2]
    lens = Lens(
        float32(fx), float32(fy), float32(cx), float32(cy), float32(up[0]), float32(up[1]), float32(up[2])
    )  # fmt: skip
    step, steeper = 2.0 / fx, 2.0 * up[0] / fx
    room = whole(across + 7)  # a run may be computed that far beyond its end
    drop = np.full(room, height_m, np.float32)  # height over the ground that was seen last in each column
    places, sources = np.empty(room, np.int32), np.empty(room, np.int32)
    near = np.zeros(room, np.float32)
    bits = near.view(np.int32)
    top = down
    for line in range(down - 1, -1, -1):
        row, begin = 2 * line, 0
        near[:across] = seen.depth[row, ::2]
        y = (row + 0.5 - cy) / fy
        while begin < across:
            k, end = seen.owner[row, 2 * begin], _end_of_run(seen.owner[row], begin, across)
            run = end - begin
            x = (2 * begin + 0.5 - cx) / fx
            rise = x * up[0] + y * up[1] + up[2]
            if k >= 0 and seen.mark[k, MATERIAL] == GROUND:
                plane = seen.plane[k]
                inverse = plane[W_CONSTANT] + plane[W_COLUMN] * (2 * begin + 0.5) + plane[W_ROW] * (row + 0.5)
                drop[begin:end] = -rise / inverse
                top = line
            elif k < 0 or seen.mark[k, MATERIAL] == SOLID:
                ray = Ray(float32(x), float32(y), float32(step), float32(rise), float32(steeper))
                first, to = (float32(begin), float32(line)), begin + whole(run)
                carried = Carried(places[: to - begin], sources[: to - begin])
                _carried(near[begin:to], drop[begin:to], ray, lens, grid, first, carried)
                _claim(bits[begin:end], carried, images)
            begin = end
    return top


@inlined
def _ground(x: float, y: float, view: View, start: tuple[np.float32, np.float32]) -> Ground:
    """Where the ray (x, y, 1) and those beside it go over the puddles, from the texel ``start``."""
    rotation, per_m = view.rotation, _PUDDLE_TEXELS_PER_M
    step = 2.0 / view.fx
    return Ground(
        float32((x * rotation[0, 0] + y * rotation[1, 0] + rotation[2, 0]) * per_m),
        float32((x * rotation[0, 1] + y * rotation[1, 1] + rotation[2, 1]) * per_m),
        float32(rotation[0, 0] * step * per_m),
        float32(rotation[0, 1] * step * per_m),
        start[0],
        start[1],
    )


@compiled_unchecked
def _show(radiance: Int64s, seen: Seen, view: View, noise: UInt8s, wetness: float, images: Int64s, top: int) -> None:
    """Blend what was carried there into the ground, from its first line ``top`` to the bottom of the picture."""
    height, width = seen.owner.shape
    down, across = (height + 1) // 2, (width + 1) // 2
    flat, up = radiance.reshape(height * width), (view.rotation[0, 2], view.rotation[1, 2], view.rotation[2, 2])
    px, py = view.position_m[0] * _PUDDLE_TEXELS_PER_M, view.position_m[1] * _PUDDLE_TEXELS_PER_M
    start = float32(px % float(_NOISE_SIDE)), float32(py % float(_NOISE_SIDE))
    two_rows, ripple = int32(2 * width), int32(_RIPPLE_ROWS * width)
    shown, where = np.full(across, -1, np.int32), np.empty(across, np.int32)
    clear, shares = np.empty(across, np.float32), np.empty(across, np.int32)
    places, parts, wet = np.empty(2 * across, np.int32), np.empty(2 * across, np.int32), np.empty(2 * across, np.int64)
    for line in range(top, down):
        row, begin = 2 * line, 0
        y = (row + 0.5 - view.cy) / view.fy
        while begin < across:
            k, end = seen.owner[row, 2 * begin], _end_of_run(seen.owner[row], begin, across)
            if k < 0 or seen.mark[k, MATERIAL] != GROUND:
                shown[begin:end] = -1
                begin = end
                continue
            end = min(end, begin + _STRETCH)
            run, x, last = end - begin, (2 * begin + 0.5 - view.cx) / view.fx, (2 * end + 0.5 - view.cx) / view.fx
            # What each cell mirrors.
            most = _take(images[line * across + begin : line * across + end], two_rows, shown[begin:end])
            if most <= two_rows + two_rows:  # all of it left the picture
                begin = end
                continue
            # How much of it: water in the way, and the angle.
            _puddles(seen.depth[row, 2 * begin :], _ground(x, y, view, start), noise, where[:run], clear[:run])
            share, end_share = 255.0 * wetness * _still_water(x, y, up), 255.0 * wetness * _still_water(last, y, up)
            change = (end_share - share) / run
            _shares(float32(share), float32(change), shown[begin:end], clear[:run], width, shares[:run])
            # Both rows of pixels of the cells.
            left, right = 2 * begin, min(2 * end, width)
            pixels = Shown(places[: 2 * run], parts[: 2 * run])
            _spread(shown[begin:end], shares[:run], pixels)
            for lower in range(min(2, height - row)):
                road, shift = radiance[row + lower, left:right], (int32(-lower * width), ripple)
                whose = seen.owner[row + lower, left:right]
                _blend(flat, shift, k, pixels, whose, road, wet[: right - left])
                _put(wet[: right - left], road)
            begin = end


@compiled_unchecked
def mirror_road(
    radiance: Int64s, seen: Seen, view: View, height_m: float, clouds: UInt8s, wetness: float, images: Int64s
) -> None:
    """Blend into the road what it mirrors.

    Args:
        radiance: ``(h, w)`` as ``shade`` leaves it; changed in place.
        seen: of ``DepthBuffers``.
        view: of the camera.
        height_m: of the camera over the ground below it.
        clouds: ``(512, 512)`` noise that says where water stands.
        wetness: 0..1.
        images: ``(cells + 1,)`` working memory: which cell's image lies in which cell.
    """
    images[:] = -1
    top = _carry(seen, view, height_m, images)
    _show(radiance, seen, view, clouds.reshape(_NOISE_SIDE * _NOISE_SIDE), wetness, images, top)
