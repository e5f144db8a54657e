"""The mirror of the wet road, found in the picture itself.

What stands on the road is seen a second time, upside down, where its points reflected in the ground would be seen.
Cells of 2 x 2 pixels are carried there; where several arrive, the nearest surface is the one that the road shows. As a
surface at one distance is mirrored at its own scale, few cells of the road stay empty. How far a cell is displaced is
kept to the pixel: cells stand still in the picture, and a pattern of theirs would look like something that the car
carries along.
"""

from __future__ import annotations

import numpy as np
from numba import float32, int32

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.mesh import GROUND, SOLID

_FIELD = (1 << 21) - 1
_HALVES = (0xFFFFF << 42) | (0xFFFFF << 21) | 0xFFFFF
_RIPPLE_ROWS = 3  # the road shows the mean of two places so far apart
_PUDDLE_TEXELS_PER_M = 9.0
_ROUGH, _MEAN_CLEAR = 0.35, 0.71  # share of the mirrored light that a rough road keeps, and that far puddles blur to
_CLEAR_M = 12.0  # farther away single puddles blur
_FADING_ROWS = 32.0  # of the picture, at its top: an edge where the mirror ends would stand still in the picture
_STRETCH = 64  # cells within which the share of mirrored light is linear


@inlined
def mixed(first, second, share):
    """Packed radiance: share / 255 of the second, the rest of the first."""
    keep = share ^ 255  # written so that the compiler sees factors of 32 bits: SIMD multiplies those at once
    red, green, blue = first & _FIELD, first >> 21 & _FIELD, first >> 42 & _FIELD
    red = (red * keep + red + (second & _FIELD) * share) >> 8
    green = (green * keep + green + (second >> 21 & _FIELD) * share) >> 8
    blue = (blue * keep + blue + (second >> 42 & _FIELD) * share) >> 8
    return red | green << 21 | blue << 42


@inlined
def _carried(inverse, drop, ray, up, lens, shape, first, places, shown):
    """Where a run of cells is mirrored, and what the cell there has to show.

    With d the ray of a cell, 1/z its depth, ``drop`` the camera's height over the ground and ``up`` the vertical, the
    cell is t = drop / z + d . up over the ground per unit of depth, and its mirror image lies along d - 2 t up.

    Args:
        inverse: 1/z of their first pixels.
        drop: in metres.
        ray: x and y of the middle of the first cell, step of x from cell to cell, d . up and its step.
        up: in camera coordinates.
        lens: fx, fy, cx, cy.
        shape: height and width of the picture, rows and columns of cells.
        first: column and row of the first cell.
        places: out: index of the cell where the image is; that after the last if outside.
        shown: out: index of the pixel that the upper left pixel of that cell shows.
    """
    x, y, step, rise, steeper = ray
    fx, fy, cx, cy = lens
    height, width, down, across = shape
    left, lower = float32(2.0) * first[0], float32(2.0) * first[1] + float32(1.0)
    half, one, two = float32(0.5), float32(1.0), float32(2.0)
    for i in range(places.shape[0]):  # whole numbers as floats, exact below 2^24: those run in SIMD
        n = float32(i)
        twice = two * (drop[i] * inverse[i] + rise + steeper * n)
        scale = one / (one - twice * up[2])
        column, row = (x + step * n - twice * up[0]) * scale * fx + cx, (y - twice * up[1]) * scale * fy + cy
        inside = (twice > float32(0.0)) & (scale > float32(0.0))
        inside &= (column > -half) & (column < two * across - half) & (row > -half) & (row < two * down - half)
        to_column, to_row = np.floor((column + half) * half), np.floor((row + half) * half)
        places[i] = np.int32(to_row * across + to_column if inside else down * across)
        aside, over = np.floor(column - two * to_column), np.floor(row - two * to_row)  # -1, 0 or 1 pixel off the cell
        from_column = min(max(left + two * n - aside, float32(0.0)), width - two)
        from_row = min(max(lower + over, one), height - one)
        shown[i] = np.int32(from_row * width + from_column if inside else float32(0.0))


@inlined
def _claim(bits, places, shown, images):
    """Let cells claim their places; the nearest wins. A claim is 1/z above the index of the pixel to show."""
    for i in range(places.shape[0]):
        claim, place = np.int64(bits[i]) << 32 | np.int64(shown[i]), np.uintp(places[i])
        images[place] = max(images[place], claim)


@inlined
def _take(images, two_rows, shown):
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
def _puddles(inverse, ground, noise, where, clear):
    """How clear the mirror is in a run of cells: puddles lie in the map like the noise; far ones blur."""
    x, y, x_step, y_step, px, py = ground
    for i in range(where.shape[0]):
        z, n = float32(1.0) / inverse[2 * i], float32(i)
        u, v = px + z * (x + x_step * n), py + z * (y + y_step * n)
        where[i] = (int32(np.floor(v)) & int32(511)) << int32(9) | int32(np.floor(u)) & int32(511)
    for i in range(where.shape[0]):
        water = float32(_ROUGH) + float32((1.0 - _ROUGH) * 2.0 / 255.0) * float32(noise[np.uintp(where[i])])
        near = min(float32(_CLEAR_M) * inverse[2 * i], float32(1.0))
        clear[i] = float32(_MEAN_CLEAR) + near * (min(water, float32(1.0)) - float32(_MEAN_CLEAR))


@inlined
def _shares(share, change, shown, clear, width, shares):
    """Share of 255 that each cell of a run shows of what it mirrors; what is seen at the top of the picture fades."""
    per_pixel, top = float32(1.0 / (_FADING_ROWS * width)), float32((_RIPPLE_ROWS + 1) / _FADING_ROWS)
    for i in range(shares.shape[0]):
        inside = min(max(float32(shown[i]) * per_pixel - top, float32(0.0)), float32(1.0))
        shares[i] = np.int32((share + change * float32(i)) * clear[i] * inside)


@inlined
def _spread(shown, shares, places, parts):
    """What the pixels of a row show, and how much of it, from what the cells of a run do."""
    for i in range(shown.shape[0]):
        places[2 * i], places[2 * i + 1] = shown[i], shown[i] + int32(1)
    for i in range(shown.shape[0]):
        parts[2 * i], parts[2 * i + 1] = shares[i], shares[i]


@inlined
def _blend(flat, offset, ripple, k, places, parts, owner, road, out):
    """Mix what they show into a run of pixels of the road, those of patch ``k``; the others stay."""
    for i in range(out.shape[0]):
        at = max(places[i] + offset, int32(0))
        here, above = np.uintp(at), np.uintp(max(at - ripple, int32(0)))
        part = np.int64(parts[i]) if owner[i] == k else np.int64(0)
        out[i] = mixed(road[i], (flat[here] >> 1 & _HALVES) + (flat[above] >> 1 & _HALVES), part)


@inlined
def _put(values, row):
    """Write a run; :func:`_blend` must not, since it reads from the same picture."""
    for i in range(values.shape[0]):
        row[i] = values[i]


@inlined
def _still_water(x, y, up):
    """Share of light that still water mirrors in the direction (x, y, 1) (Fresnel, after Schlick)."""
    grazing = 1.0 - min(abs(x * up[0] + y * up[1] + up[2]) / np.sqrt(x * x + y * y + 1.0), 1.0)
    squared = grazing * grazing
    return 0.02 + 0.98 * squared * squared * grazing


@inlined
def _end_of_run(owner, begin, across):
    """First cell after ``begin`` that shows another patch; ``owner`` of the pixels of its first row."""
    end = begin + 1
    while end < across and owner[2 * end] == owner[2 * begin]:
        end += 1
    return end


@compiled_unchecked
def mirror_road(radiance, owner, depth, plane, mark, rotation, position, lens, clouds, wetness, images):
    """Blend into the road what it mirrors.

    Args:
        radiance: ``(h, w)`` int64 as ``shade`` leaves it; changed in place.
        owner: of ``DepthBuffers``.
        depth: of ``DepthBuffers``.
        plane: of ``DepthBuffers``.
        mark: of ``DepthBuffers``.
        rotation: ``(3, 3)`` camera from map.
        position: ``(3,)`` of the camera.
        lens: fx, fy, cx, cy.
        clouds: ``(512, 512)`` bytes of noise that says where water stands.
        wetness: 0..1.
        images: ``(cells + 1,)`` int64 working memory.
    """
    height, width = owner.shape
    down, across = (height + 1) // 2, (width + 1) // 2
    shape = float32(height), float32(width), float32(down), float32(across)
    flat, noise = radiance.reshape(height * width), clouds.reshape(512 * 512)
    up = rotation[0, 2], rotation[1, 2], rotation[2, 2]
    up32 = float32(up[0]), float32(up[1]), float32(up[2])
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    lens32 = float32(fx), float32(fy), float32(cx), float32(cy)
    step, steeper = 2.0 / fx, 2.0 * up[0] / fx
    drop = np.full(across, position[2], np.float32)  # height over the ground that was seen last in each column
    places, sources = np.empty(across, np.int32), np.empty(across, np.int32)
    images[: down * across + 1] = -1
    near = np.empty(across, np.float32)
    bits = near.view(np.int32)
    top = down  # first line with ground
    for line in range(down - 1, -1, -1):
        row, begin = 2 * line, 0
        near[:] = depth[row, ::2]
        y = (row + 0.5 - cy) / fy
        while begin < across:
            k, end = owner[row, 2 * begin], _end_of_run(owner[row], begin, across)
            run = end - begin
            x = (2 * begin + 0.5 - cx) / fx
            rise = x * up[0] + y * up[1] + up[2]
            if k >= 0 and mark[k, 1] == GROUND:
                inverse = plane[k, 6] + plane[k, 7] * (2 * begin + 0.5) + plane[k, 8] * (row + 0.5)
                drop[begin:end] = -rise / inverse
                top = line
            elif k < 0 or mark[k, 1] == SOLID:
                ray = float32(x), float32(y), float32(step), float32(rise), float32(steeper)
                first = float32(begin), float32(line)
                _carried(
                    near[begin:end], drop[begin:end], ray, up32, lens32, shape, first, places[:run],
                    sources[:run],
                )  # fmt: skip
                _claim(bits[begin:end], places[:run], sources[:run], images)
            begin = end

    per_m = _PUDDLE_TEXELS_PER_M
    px, py = float32(position[0] * per_m % 512.0), float32(position[1] * per_m % 512.0)
    x_step, y_step = float32(rotation[0, 0] * step * per_m), float32(rotation[0, 1] * step * per_m)
    two_rows, ripple = int32(2 * width), int32(_RIPPLE_ROWS * width)
    shown, where = np.full(across, -1, np.int32), places
    clear, shares = np.empty(across, np.float32), sources
    pixels, parts = np.empty(2 * across, np.int32), np.empty(2 * across, np.int32)
    wet = np.empty(2 * across, np.int64)
    for line in range(top, down):
        row, begin = 2 * line, 0
        y = (row + 0.5 - cy) / fy
        while begin < across:
            k, end = owner[row, 2 * begin], _end_of_run(owner[row], begin, across)
            if k < 0 or mark[k, 1] != GROUND:
                shown[begin:end] = -1
                begin = end
                continue
            end = min(end, begin + _STRETCH)
            run, x, last = end - begin, (2 * begin + 0.5 - cx) / fx, (2 * end + 0.5 - cx) / fx
            lowest = _take(images[line * across + begin : line * across + end], two_rows, shown[begin:end])
            if lowest <= two_rows + two_rows:  # all of it left the picture
                begin = end
                continue
            wx = float32((x * rotation[0, 0] + y * rotation[1, 0] + rotation[2, 0]) * per_m)
            wy = float32((x * rotation[0, 1] + y * rotation[1, 1] + rotation[2, 1]) * per_m)
            ground = wx, wy, x_step, y_step, px, py
            _puddles(depth[row, 2 * begin :], ground, noise, where[:run], clear[:run])
            share, end_share = 255.0 * wetness * _still_water(x, y, up), 255.0 * wetness * _still_water(last, y, up)
            change = (end_share - share) / run
            _shares(float32(share), float32(change), shown[begin:end], clear[:run], width, shares[:run])
            left, right = 2 * begin, min(2 * end, width)
            _spread(shown[begin:end], shares[:run], pixels[: 2 * run], parts[: 2 * run])
            for lower in range(min(2, height - row)):
                road, offset = radiance[row + lower, left:right], int32(-lower * width)
                whose = owner[row + lower, left:right]
                _blend(flat, offset, ripple, k, pixels, parts, whose, road, wet[: right - left])
                _put(wet[: right - left], road)
            begin = end
