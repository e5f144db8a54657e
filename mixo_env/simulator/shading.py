"""Radiance and image motion of every pixel from the patches that the rasteriser found.

Pixels are shaded in short spans that show the same patch. Perspective is exact at both ends of a span and linear within; a span
is cut so short that this misplaces the texture by less than 0.15 pixels. The reduction of the texture, haze and lamp
light are chosen once per span. Four 16-bit lanes of one integer filter the four channels of a texture at once.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixo_env.simulator.mesh import CUT_OUT, GROUND, SHADE
from mixo_env.simulator.shadows import EXTENT_M, FIELD_TEXELS_PER_M, PICTURE_TEXELS_PER_M
from mixo_env.simulator.textures import DETAIL_SIDE

SPAN = 16
"""Longest run of pixels that shares one reduction of the texture."""

MOST_TAPS = 4
"""Samples along the long axis of a pixel's footprint on a slanted surface."""

_INVERSE = np.array([0.0] + [1.0 / i for i in range(1, SPAN + 1)])
_POWER = np.array([2.0**-i for i in range(12)])
_U8, _U16, _U32, _U48 = np.uint64(8), np.uint64(16), np.uint64(32), np.uint64(48)
_LANES, _LANE = np.uint64(0x00FF00FF00FF00FF), np.uint64(0xFFFF)
_HALF_M = 0.5 * EXTENT_M
_PICTURE_MASK = int(EXTENT_M * PICTURE_TEXELS_PER_M) - 1
_FIELD_MASK = int(EXTENT_M * FIELD_TEXELS_PER_M) - 1
_LAMP_MASK = int(EXTENT_M) - 1
_DETAIL_LOG = DETAIL_SIDE.bit_length() - 1
_LAST_DETAIL = 5
_OFF_WALL_M = 0.8
_ONE = 65536.0
_GRAIN_UNIT = 1.0 / (255.0 * 65536.0)
_TOP = (1 << 18) - 1
_LIGHT_BITS, _TINT_BITS = 20, 8
_CELL_SHIFT = 3
_EVEN_SPAN_TEXELS = 6.0


@njit(cache=True, error_model="numpy")
def _bilinear4(texels, start, log_w, mask_u, mask_v, u, v):
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


@njit(cache=True, error_model="numpy")
def _bilinear1(image, u, v, mask):
    """One channel of a square repeating image at (u, v)."""
    floor_u, floor_v = np.floor(u), np.floor(v)
    a, b = u - floor_u, v - floor_v
    u0, v0 = int(floor_u) & mask, int(floor_v) & mask
    u1, v1 = (u0 + 1) & mask, (v0 + 1) & mask
    upper = image[np.uintp(v0), np.uintp(u0)] * (1.0 - a) + image[np.uintp(v0), np.uintp(u1)] * a
    lower = image[np.uintp(v1), np.uintp(u0)] * (1.0 - a) + image[np.uintp(v1), np.uintp(u1)] * a
    return upper * (1.0 - b) + lower * b


@njit(cache=True, error_model="numpy")
def _grain(detail, start, log, u, v):
    """Fine grain at (u, v) in 1/65536 texels of a reduction 2^log wide; 0..255 * 65536."""
    mask = (1 << log) - 1
    a, b = (u >> 8) & 255, (v >> 8) & 255
    word = np.int64(detail[np.uintp(start + (((v >> 16) & mask) << log) + ((u >> 16) & mask))])
    columns = (word & 0x00FF00FF) * (256 - a) + ((word >> 8) & 0x00FF00FF) * a
    return (columns & 0xFFFF) * (256 - b) + (columns >> 16) * b


@njit(cache=True, error_model="numpy")
def _sun_on_ground(sunlight, u, v):
    """Picture of the sunlight on the ground at (u, v) in 1/65536 texels; 0..255 * 65536."""
    a, b = (u >> 8) & 255, (v >> 8) & 255
    u0, v0 = (u >> 16) & _PICTURE_MASK, (v >> 16) & _PICTURE_MASK
    u1, v1 = (u0 + 1) & _PICTURE_MASK, (v0 + 1) & _PICTURE_MASK
    upper = (
        np.int64(sunlight[np.uintp(v0), np.uintp(u0)]) * (256 - a) + np.int64(sunlight[np.uintp(v0), np.uintp(u1)]) * a
    )
    lower = (
        np.int64(sunlight[np.uintp(v1), np.uintp(u0)]) * (256 - a) + np.int64(sunlight[np.uintp(v1), np.uintp(u1)]) * a
    )
    return upper * (256 - b) + lower * b


@njit(cache=True, error_model="numpy")
def _level(ratio):
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


@njit(cache=True, error_model="numpy")
def _above_shadow(field, x, y, z):
    """Share of the sun that houses leave at a point: four soft comparisons, interpolated."""
    u, v = (x + _HALF_M) * FIELD_TEXELS_PER_M - 0.5, (y + _HALF_M) * FIELD_TEXELS_PER_M - 0.5
    floor_u, floor_v = np.floor(u), np.floor(v)
    a, b = u - floor_u, v - floor_v
    u0, v0 = int(floor_u) & _FIELD_MASK, int(floor_v) & _FIELD_MASK
    u1, v1 = (u0 + 1) & _FIELD_MASK, (v0 + 1) & _FIELD_MASK
    c00 = min(max(2.0 * (z - field[np.uintp(v0), np.uintp(u0)]), 0.0), 1.0)
    c01 = min(max(2.0 * (z - field[np.uintp(v0), np.uintp(u1)]), 0.0), 1.0)
    c10 = min(max(2.0 * (z - field[np.uintp(v1), np.uintp(u0)]), 0.0), 1.0)
    c11 = min(max(2.0 * (z - field[np.uintp(v1), np.uintp(u1)]), 0.0), 1.0)
    return (c00 * (1.0 - a) + c01 * a) * (1.0 - b) + (c10 * (1.0 - a) + c11 * a) * b


@njit(cache=True, error_model="numpy")
def _sky_span(row, begin, end, d0, d1, d2, sx, sy, sz, light, sky, turn, lens, dy, out, flow):
    """Clouds on a plane between clear sky and haze; they move with the camera's rotation only."""
    for x in range(begin, end):
        wx, wy, wz = d0 + sx * x, d1 + sy * x, d2 + sz * x
        norm = 1.0 / np.sqrt(wx * wx + wy * wy + wz * wz)
        up = max(wz * norm, 0.0)
        scale = 60.0 * norm / (up + 0.12)
        cloud = light[9] * _bilinear1(sky, wx * scale, wy * scale, 511) * (1.0 / 255.0)
        high = min(2.0 * up, 1.0)
        word = 0
        for c in range(3):
            clear = light[3 + c] + (light[6 + c] - light[3 + c]) * high
            word |= min(int(clear + (1.25 * light[3] - clear) * cloud), _TOP) << 21 * c
        out[row, x] = word
        dx = (x - lens[2]) / lens[0]
        z = 1.0 / (turn[6] * dx + turn[7] * dy + turn[8])
        flow[row, x, 0] = 2.0 * ((turn[0] * dx + turn[1] * dy + turn[2]) * z * lens[0] + lens[2] - x)
        flow[row, x, 1] = 2.0 * ((turn[3] * dx + turn[4] * dy + turn[5]) * z * lens[1] + lens[3] - row)


@njit(cache=True, error_model="numpy")
def _lamp_light(lamps, corner_x, corner_y, beam, x, y, z, up, rx, ry, rz):
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
    total *= _bilinear1(lamps, x - corner_x - 0.5, y - corner_y - 0.5, mask)
    ahead = beam[0] * rx + beam[1] * ry + beam[2] * rz + beam[3] - 3.7
    if ahead > 0.5:
        aside = beam[4] * rx + beam[5] * ry + beam[6] * rz + beam[7]
        angle = aside / ahead
        above = max(z - 0.9, 0.0)
        cut = 1.0 + 40.0 * above * above / ahead
        total += 45.0 / (ahead * ahead + aside * aside + 40.0) * np.exp(-5.0 * angle * angle) / cut
    return total


@njit(cache=True, error_model="numpy")
def shade(
    owner, plane, style, mark, rotation, position, lens, far, light, texels, table, detail, detail_start, sky, sunlight,
    sun_cells, field, lamps, lamp_origin, beam, motion, ground_scale, out, flow,
):  # fmt: skip
    """Fill ``out`` with linear radiance and ``flow`` with the way each pixel's surface moves during the exposure.

    Args:
        owner: of ``DepthBuffers``.
        plane: of ``DepthBuffers``.
        style: of ``DepthBuffers``.
        mark: of ``DepthBuffers``.
        rotation: ``(3, 3)`` camera from map.
        position: ``(3,)`` camera centre, map frame.
        lens: fx, fy, cx, cy in pixels.
        far: nothing is seen beyond, metres.
        light: ``(15,)`` ambient, sun, haze per metre, haze colour (3), zenith colour (3), clouds, lamps, wetness,
            colour (3); radiance in units of the integer result.
        texels: of the atlas.
        table: of the atlas.
        detail: packed fine grain.
        detail_start: first entry of each of its reductions.
        sky: see ``World``.
        sunlight: see ``World``.
        sun_cells: ``(n, n)`` of ``even_cells``.
        field: ``World.shadow_height``.
        lamps: light of lamps on the ground, one value a metre, a power of two wide.
        lamp_origin: ``(2,)`` map position of the corner of ``lamps``, metres.
        beam: ``(8,)`` rows x and y of ego from camera and its translation, for the car's own head lights.
        motion: ``(bodies, 12)`` rotation by rows and translation from camera coordinates at the middle of the exposure
            to those at its end, per rigid body; body 0 is the world.
        ground_scale: texels per metre of the ground texture.
        out: ``(h, w)`` int64, three 21-bit fields of radiance, red lowest, each below 2^18 so that eight can be summed.
        flow: ``(h, w, 2)`` float32 pixels.
    """
    height, width = owner.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    ambient, sun, density, glow, wetness = light[0], light[1], light[2], light[10], light[11]
    sx, sy, sz = rotation[0, 0] / fx, rotation[0, 1] / fx, rotation[0, 2] / fx  # map ray per column
    to_picture = PICTURE_TEXELS_PER_M / ground_scale
    at_picture = _HALF_M * PICTURE_TEXELS_PER_M - 0.5
    for row in range(height):
        dy = (row - cy) / fy
        d0 = rotation[2, 0] + rotation[1, 0] * dy - sx * cx
        d1 = rotation[2, 1] + rotation[1, 1] * dy - sy * cx
        d2 = rotation[2, 2] + rotation[1, 2] * dy - sz * cx
        before = -2
        x = 0
        while x < width:
            k = owner[row, x]
            if k >= 0 and k != before:
                u1, v1, w1 = plane[k, 1], plane[k, 4], plane[k, 7]
                u2, v2, w2 = plane[k, 2], plane[k, 5], plane[k, 8]
                u0, v0, w0 = plane[k, 0] + u2 * row, plane[k, 3] + v2 * row, plane[k, 6] + w2 * row
                ratio_u, ratio_v, grain_u, grain_v = style[k, 4], style[k, 5], style[k, 6], style[k, 7]
                strength, facing = style[k, 8], style[k, 9] * sun
                n0, n1, n2 = style[k, 10], style[k, 11], style[k, 12]
                o0, o1, o2 = _OFF_WALL_M * n0, _OFF_WALL_M * n1, _OFF_WALL_M * n2
                material, number = mark[k, 1], mark[k, 2]
                on_ground = material == GROUND
                tint0 = int(style[k, 0] * light[12] * (1 << _TINT_BITS))
                tint1 = int(style[k, 1] * light[13] * (1 << _TINT_BITS))
                tint2 = int(style[k, 2] * light[14] * (1 << _TINT_BITS))
                emission = 0.0 if mark[k, 0] & CUT_OUT != 0 else 4.0 * glow * style[k, 3]
                if material == SHADE:
                    facing = 0.0
                level_light = ambient * (0.82 + 0.18 * n2)
                if material != 0:
                    level_light *= 1.0 - 0.5 * wetness  # wet ground is dark
                # Where the surface is seen at the end of the exposure: numerators linear in the column.
                m = motion[mark[k, 3]]
                mx0 = m[1] * dy + m[2] - m[0] * cx / fx + m[9] * w0
                my0 = m[4] * dy + m[5] - m[3] * cx / fx + m[10] * w0
                mz0 = m[7] * dy + m[8] - m[6] * cx / fx + m[11] * w0
                mx1, my1, mz1 = m[0] / fx + m[9] * w1, m[3] / fx + m[10] * w1, m[6] / fx + m[11] * w1
            before = k
            longest = SPAN
            if k >= 0:
                w = w0 + w1 * x
                iz = 1.0 / w
                longest = SPAN if w > 427.0 * abs(w1) else (8 if w > 107.0 * abs(w1) else 4)
            end, most = x + 1, min(x + longest, width)
            while end < most and owner[row, end] == k:
                end += 1
            if k < 0:
                _sky_span(row, x, end, d0, d1, d2, sx, sy, sz, light, sky, motion[0], lens, dy, out, flow)
                x = end
                continue
            last = end - 1
            steps = last - x
            inverse = _INVERSE[steps]
            u, v = (u0 + u1 * x) * iz, (v0 + v1 * x) * iz
            iz_end = 1.0 / (w0 + w1 * last)
            du, dv = ((u0 + u1 * last) * iz_end - u) * inverse, ((v0 + v1 * last) * iz_end - v) * inverse
            z = 0.5 * (iz + iz_end)
            um, vm = u + 0.5 * du * steps, v + 0.5 * dv * steps

            # Footprint of a pixel on the texture: its long axis is sampled, its short axis chooses the reduction.
            ux, vx = (u1 - um * w1) * z, (v1 - vm * w1) * z
            uy, vy = (u2 - um * w2) * z, (v2 - vm * w2) * z
            ax, bx, ay, by = abs(ux), abs(vx), abs(uy), abs(vy)
            across, along = max(ax, bx) + 0.4 * min(ax, bx), max(ay, by) + 0.4 * min(ay, by)
            if across > along:
                wide, thin, ju, jv = across, along, ux, vx
            else:
                wide, thin, ju, jv = along, across, uy, vy
            taps = 1
            if wide > 1.41:
                taps = max(1, min(MOST_TAPS, int(wide / max(thin, 0.7) + 0.5)))
            share = _INVERSE[taps]
            level = _level(wide * share)
            reduce = _POWER[level] * _ONE
            start, log_w = table[number, level, 0], table[number, level, 1]
            mask_u, mask_v = (1 << log_w) - 1, (1 << table[number, level, 2]) - 1
            ju, jv = ju * share, jv * share
            fine = _level(max(abs(ju * ratio_u), abs(jv * ratio_v)))

            # Light that is the same for the whole span.
            air = 1.0 / (1.0 + z * density * (1.0 + 0.5 * z * density))
            fade = max(z / far * 4.0 - 3.0, 0.0)
            air *= 1.0 - fade * fade
            haze0, haze1 = int(light[3] * (1.0 - air)), int(light[4] * (1.0 - air))
            haze2 = int(light[5] * (1.0 - air))
            steady = level_light
            q0, q1, q2 = d0 + sx * x, d1 + sy * x, d2 + sz * x
            p0, p1, p2 = position[0] + q0 * iz + o0, position[1] + q1 * iz + o1, position[2] + q2 * iz + o2
            if glow > 0.0:
                rx = (0.5 * (x + last) - cx) / fx * z
                steady += glow * _lamp_light(
                    lamps, lamp_origin[0], lamp_origin[1], beam, p0, p1, p2, n2, rx, dy * z, z
                )
            sunny, varied = 1.0, False
            e0 = e1 = e2 = 0.0
            g0 = g1 = ge0 = ge1 = 0
            if facing > 0.0:
                if on_ground:
                    pu, pv = u * to_picture + at_picture, v * to_picture + at_picture
                    eu, ev = du * to_picture, dv * to_picture
                    cell = sun_cells[
                        (int(pv) & _PICTURE_MASK) >> _CELL_SHIFT, (int(pu) & _PICTURE_MASK) >> _CELL_SHIFT
                    ]
                    there = sun_cells[
                        (int(pv + ev * steps) & _PICTURE_MASK) >> _CELL_SHIFT,
                        (int(pu + eu * steps) & _PICTURE_MASK) >> _CELL_SHIFT,
                    ]
                    sunny = cell * (1.0 / 255.0)
                    varied = cell != there or cell == 1 or (abs(eu) + abs(ev)) * steps > _EVEN_SPAN_TEXELS
                    if varied:
                        g0, g1, ge0, ge1 = int(pu * _ONE), int(pv * _ONE), int(eu * _ONE), int(ev * _ONE)
                else:
                    e0 = position[0] + (q0 + sx * steps) * iz_end + o0
                    e1 = position[1] + (q1 + sy * steps) * iz_end + o1
                    e2 = position[2] + (q2 + sz * steps) * iz_end + o2
                    sunny = _above_shadow(field, p0, p1, p2)
                    varied = sunny != _above_shadow(field, e0, e1, e2)
                    e0, e1, e2 = (e0 - p0) * inverse, (e1 - p1) * inverse, (e2 - p2) * inverse
            bright = steady + facing * sunny

            back = 0.5 * (taps - 1)
            tu, tv = int((u - back * ju) * reduce) - 32768, int((v - back * jv) * reduce) - 32768
            tap_u, tap_v, step_u, step_v = int(ju * reduce), int(jv * reduce), int(du * reduce), int(dv * reduce)
            small = _POWER[fine] * _ONE
            gu, gv = int((u * ratio_u + grain_u) * small) - 32768, int((v * ratio_v + grain_v) * small) - 32768
            grain_step_u, grain_step_v = int(du * ratio_u * small), int(dv * ratio_v * small)
            fine_start, fine_log = detail_start[fine], _DETAIL_LOG - fine
            scale = share * (1.0 / 255.0)
            unit = scale * scale * air * (1 << _LIGHT_BITS)
            for column in range(x, end):
                lanes = _bilinear4(texels, start, log_w, mask_u, mask_v, tu, tv)
                if taps > 1:  # written out: as a loop the compiler would gather four samples where two are wanted
                    lanes += _bilinear4(texels, start, log_w, mask_u, mask_v, tu + tap_u, tv + tap_v)
                    if taps > 2:
                        lanes += _bilinear4(texels, start, log_w, mask_u, mask_v, tu + 2 * tap_u, tv + 2 * tap_v)
                        if taps > 3:
                            lanes += _bilinear4(texels, start, log_w, mask_u, mask_v, tu + 3 * tap_u, tv + 3 * tap_v)
                tu += step_u
                tv += step_v
                tone = unit
                if fine < _LAST_DETAIL:
                    grain = 1.0 + (_grain(detail, fine_start, fine_log, gu, gv) * _GRAIN_UNIT - 0.5) * strength
                    tone *= grain * grain
                    gu += grain_step_u
                    gv += grain_step_v
                lit = bright
                if varied:
                    if on_ground:
                        sunny = _sun_on_ground(sunlight, g0, g1) * _GRAIN_UNIT
                        g0 += ge0
                        g1 += ge1
                    else:
                        i = column - x
                        sunny = _above_shadow(field, p0 + e0 * i, p1 + e1 * i, p2 + e2 * i)
                    lit = steady + facing * sunny
                if emission > 0.0:
                    lit += emission * np.int64(lanes >> _U48) * scale
                factor = int(lit * tone)
                r, g, b = np.int64(lanes & _LANE), np.int64((lanes >> _U16) & _LANE), np.int64((lanes >> _U32) & _LANE)
                r = haze0 + ((r * r * tint0 * factor) >> (_LIGHT_BITS + _TINT_BITS))
                g = haze1 + ((g * g * tint1 * factor) >> (_LIGHT_BITS + _TINT_BITS))
                b = haze2 + ((b * b * tint2 * factor) >> (_LIGHT_BITS + _TINT_BITS))
                out[row, column] = min(r, _TOP) | min(g, _TOP) << 21 | min(b, _TOP) << 42

            back = 2.0 / max(mz0 + mz1 * x, 1e-4)
            mu, mv = (mx0 + mx1 * x) * back * fx + 2.0 * (cx - x), (my0 + my1 * x) * back * fy + 2.0 * (cy - row)
            back = 2.0 / max(mz0 + mz1 * last, 1e-4)
            nu = ((mx0 + mx1 * last) * back * fx + 2.0 * (cx - last) - mu) * inverse
            nv = ((my0 + my1 * last) * back * fy + 2.0 * (cy - row) - mv) * inverse
            for column in range(x, end):
                i = column - x
                flow[row, column, 0] = mu + nu * i
                flow[row, column, 1] = mv + nv * i
            x = end


def even_cells(sunlight: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Where the picture of sunlight is even, for eight by eight texels each: 0 shade, 255 sun, 1 both."""
    size = 1 << _CELL_SHIFT
    around = np.ones((size + 3, size + 3), np.uint8)  # with the neighbours that interpolation can touch
    low = cv2.erode(sunlight, around)[size // 2 :: size, size // 2 :: size]
    high = cv2.dilate(sunlight, around)[size // 2 :: size, size // 2 :: size]
    return np.where(high < 3, 0, np.where(low > 252, 255, 1)).astype(np.uint8)
