"""Radiance and image motion of every pixel from the patches that the rasteriser found.

Pixels are shaded in spans of at most eight that show the same patch. Perspective is exact at both ends of a span and linear
within; the reduction of the texture, haze and lamp light are chosen once per span. Four 16-bit lanes of one integer filter the
four channels of a texture at once.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mixo_env.simulator.mesh import CUT_OUT, GROUND, SHADE
from mixo_env.simulator.shadows import EXTENT_M, FIELD_TEXELS_PER_M, PICTURE_TEXELS_PER_M
from mixo_env.simulator.textures import DETAIL_SIDE

SPAN = 8
"""Longest run of pixels that shares one mip level; perspective is exact at its ends."""

MOST_TAPS = 4
"""Samples along the long axis of a pixel's footprint on a slanted surface."""

_INVERSE = np.array([0.0] + [1.0 / i for i in range(1, SPAN + 1)])
_POWER = np.array([2.0**-i for i in range(12)])
_U8, _U16, _U32, _U48 = np.uint64(8), np.uint64(16), np.uint64(32), np.uint64(48)
_PAIRS, _LANES, _LANE = np.uint64(0x0000FFFF0000FFFF), np.uint64(0x00FF00FF00FF00FF), np.uint64(0xFFFF)
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
_CUT, _DRY, _UNDER = CUT_OUT, GROUND, SHADE


@njit(cache=True, error_model="numpy")
def _spread(texel):
    """Four bytes in one 32-bit word -> four 16-bit lanes of a 64-bit word."""
    word = np.uint64(texel)
    word = (word | (word << _U16)) & _PAIRS
    return (word | (word << _U8)) & _LANES


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
        _spread(texels[np.uintp(here + u0)]) * np.uint64(w00)
        + _spread(texels[np.uintp(here + u1)]) * np.uint64(w01)
        + _spread(texels[np.uintp(below + u0)]) * np.uint64(w10)
        + _spread(texels[np.uintp(below + u1)]) * np.uint64(w11)
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
def _sky_span(row, begin, end, d, sx, sy, sz, light, sky, motion, lens, dy, out, flow):
    """Clouds on a plane between clear sky and haze; moves with the camera's rotation only."""
    dx0, dx1, dx2 = d
    for x in range(begin, end):
        wx, wy, wz = dx0 + sx * x, dx1 + sy * x, dx2 + sz * x
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
        z = 1.0 / (motion[0, 6] * dx + motion[0, 7] * dy + motion[0, 8])
        flow[row, x, 0] = 2.0 * ((motion[0, 0] * dx + motion[0, 1] * dy + motion[0, 2]) * z * lens[0] + lens[2] - x)
        flow[row, x, 1] = 2.0 * ((motion[0, 3] * dx + motion[0, 4] * dy + motion[0, 5]) * z * lens[1] + lens[3] - row)


@njit(cache=True, error_model="numpy")
def _moved(motion, body, dx, dy, iz, lens):
    """Where the point at depth ``iz`` on the ray (dx, dy, 1) is seen at the end of the exposure, in pixels."""
    x, y = dx * iz, dy * iz
    z = 1.0 / max(motion[body, 6] * x + motion[body, 7] * y + motion[body, 8] * iz + motion[body, 11], 0.2)
    u = (motion[body, 0] * x + motion[body, 1] * y + motion[body, 2] * iz + motion[body, 9]) * z * lens[0] + lens[2]
    v = (motion[body, 3] * x + motion[body, 4] * y + motion[body, 5] * iz + motion[body, 10]) * z * lens[1] + lens[3]
    return u, v


@njit(cache=True, error_model="numpy")
def shade(
    owner,
    plane,
    style,
    mark,
    rotation,
    position,
    lens,
    far,
    light,
    texels,
    table,
    detail,
    detail_start,
    sky,
    sunlight,
    field,
    lamps,
    lamp_origin,
    beam,
    motion,
    ground_scale,
    out,
    flow,
):
    """Fill ``out`` with linear radiance and ``flow`` with the way each pixel's surface moves during the exposure.

    Args:
        owner, plane, style, mark: of ``draw_groups``.
        rotation, position, lens, far: as in ``draw_groups``.
        light: ``(15,)`` ambient, sun, haze per metre, haze colour (3), zenith colour (3), clouds, lamps, wetness, colour (3).
        texels, table: of the atlas.
        detail, detail_start: packed fine grain.
        sky, sunlight, field: see ``World``.
        lamps: light of lamps on the ground, one value a metre, a power of two wide.
        lamp_origin: ``(2,)`` map position of the corner of ``lamps``, metres.
        beam: ``(8,)`` rows x and y of ego from camera and its translation, for the car's own head lights.
        motion: ``(bodies, 12)`` rotation by rows and translation from camera coordinates at the middle of the exposure to those
            at its end, per rigid body; body 0 is the world.
        ground_scale: texels per metre of the ground texture.
        out: ``(h, w)`` int64, three 21-bit fields of radiance, red lowest, each at most 2^18 - 1 so that eight can be summed.
        flow: ``(h, w, 2)`` float32 pixels.
    """
    height, width = owner.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    ambient, sun, density, glow = light[0], light[1], light[2], light[10]
    sx, sy, sz = rotation[0, 0] / fx, rotation[0, 1] / fx, rotation[0, 2] / fx  # map ray per column
    lamp_mask = lamps.shape[0] - 1
    to_picture = PICTURE_TEXELS_PER_M / ground_scale
    at_picture = _HALF_M * PICTURE_TEXELS_PER_M - 0.5
    for row in range(height):
        dy = (row - cy) / fy
        d0 = rotation[2, 0] + rotation[1, 0] * dy - sx * cx
        d1 = rotation[2, 1] + rotation[1, 1] * dy - sy * cx
        d2 = rotation[2, 2] + rotation[1, 2] * dy - sz * cx
        before = -1
        x = 0
        while x < width:
            k = owner[row, x]
            end = x + 1
            most = min(x + SPAN, width)
            while end < most and owner[row, end] == k:
                end += 1
            if k < 0:
                _sky_span(row, x, end, (d0, d1, d2), sx, sy, sz, light, sky, motion, lens, dy, out, flow)
                x = end
                continue
            if k != before:
                before = k
                u1, v1, w1 = plane[k, 1], plane[k, 4], plane[k, 7]
                u2, v2, w2 = plane[k, 2], plane[k, 5], plane[k, 8]
                u0, v0, w0 = plane[k, 0] + u2 * row, plane[k, 3] + v2 * row, plane[k, 6] + w2 * row
                tint0, tint1, tint2 = style[k, 0] * light[12], style[k, 1] * light[13], style[k, 2] * light[14]
                emission = style[k, 3]
                ratio_u, ratio_v, grain_u, grain_v, strength = (
                    style[k, 4],
                    style[k, 5],
                    style[k, 6],
                    style[k, 7],
                    style[k, 8],
                )
                facing, n0, n1, n2 = style[k, 9] * sun, style[k, 10], style[k, 11], style[k, 12]
                shape, material, number, body = mark[k, 0], mark[k, 1], mark[k, 2], mark[k, 3]
                if shape & _CUT != 0:
                    emission = 0.0
                if material == _UNDER:
                    facing = 0.0
                damp = 1.0 if material == 0 else 1.0 - 0.5 * light[11]  # wet ground is dark
            last = end - 1
            inverse = _INVERSE[last - x]
            iz = 1.0 / (w0 + w1 * x)
            u, v = (u0 + u1 * x) * iz, (v0 + v1 * x) * iz
            iz_end = 1.0 / (w0 + w1 * last)
            du, dv = ((u0 + u1 * last) * iz_end - u) * inverse, ((v0 + v1 * last) * iz_end - v) * inverse
            z = 0.5 * (iz + iz_end)
            um, vm = u + 0.5 * du * (last - x), v + 0.5 * dv * (last - x)

            # Footprint of a pixel on the texture: its long axis is sampled, its short axis chooses the reduction.
            ux, vx = (u1 - um * w1) * z, (v1 - vm * w1) * z
            uy, vy = (u2 - um * w2) * z, (v2 - vm * w2) * z
            ax, bx, ay, by = abs(ux), abs(vx), abs(uy), abs(vy)
            across, along = max(ax, bx) + 0.4 * min(ax, bx), max(ay, by) + 0.4 * min(ay, by)
            if across > along:
                long, short, ju, jv = across, along, ux, vx
            else:
                long, short, ju, jv = along, across, uy, vy
            taps = 1
            if long > 1.41:
                taps = max(1, min(MOST_TAPS, int(long / max(short, 0.7) + 0.5)))
            share = _INVERSE[taps]
            level = _level(long * share)
            reduce = _POWER[level]
            start, log_w, log_h = table[number, level, 0], table[number, level, 1], table[number, level, 2]
            ju, jv = ju * share, jv * share
            fine = _level(max(abs(ju * ratio_u), abs(jv * ratio_v)))

            # Light that is the same for the whole span.
            air = 1.0 / (1.0 + z * density * (1.0 + 0.5 * z * density))
            fade = max(z / far * 4.0 - 3.0, 0.0)
            air *= 1.0 - fade * fade
            # (light and haze arrive scaled to integer radiance, see RADIANCE_UNIT)
            haze0, haze1, haze2 = light[3] * (1.0 - air), light[4] * (1.0 - air), light[5] * (1.0 - air)
            level_light = ambient * (0.82 + 0.18 * n2) * damp
            q0, q1, q2 = d0 + sx * x, d1 + sy * x, d2 + sz * x
            p0, p1, p2 = position[0] + q0 * iz, position[1] + q1 * iz, position[2] + q2 * iz
            if glow > 0.0:
                # The map holds the light on the ground; walls get less, and hardly any above the lamps.
                upright = 1.0 if n2 > 0.7 else 0.65
                level_light += (
                    glow
                    * 0.6
                    * upright
                    * min(max(2.2 - 0.25 * p2, 0.12), 1.0)
                    * _bilinear1(
                        lamps, p0 + 0.8 * n0 - lamp_origin[0] - 0.5, p1 + 0.8 * n1 - lamp_origin[1] - 0.5, lamp_mask
                    )
                )
                dx = (0.5 * (x + last) - cx) / fx * z
                ahead = beam[0] * dx + beam[1] * dy * z + beam[2] * z + beam[3] - 3.7
                aside = beam[4] * dx + beam[5] * dy * z + beam[6] * z + beam[7]
                if ahead > 0.5:
                    angle = aside / ahead
                    level_light += (
                        glow
                        * 45.0
                        / (ahead * ahead + aside * aside + 40.0)
                        * np.exp(-5.0 * angle * angle)
                        / (1.0 + max(p2 - 0.9, 0.0) ** 2 * 40.0 / ahead)
                    )
            sunny = 1.0
            soft = False
            ip0 = ip1 = ie0 = ie1 = 0
            e0 = e1 = e2 = 0.0
            if facing > 0.0 and material != _DRY:
                e0, e1, e2 = (
                    position[0] + (q0 + sx * (last - x)) * iz_end,
                    position[1] + (q1 + sy * (last - x)) * iz_end,
                    position[2] + (q2 + sz * (last - x)) * iz_end,
                )
                sunny = _above_shadow(field, p0 + _OFF_WALL_M * n0, p1 + _OFF_WALL_M * n1, p2 + _OFF_WALL_M * n2)
                there = _above_shadow(field, e0 + _OFF_WALL_M * n0, e1 + _OFF_WALL_M * n1, e2 + _OFF_WALL_M * n2)
                soft = sunny != there
                e0, e1, e2 = (e0 - p0) * inverse, (e1 - p1) * inverse, (e2 - p2) * inverse

            tu, tv = (u - 0.5 * (taps - 1) * ju) * reduce - 0.5, (v - 0.5 * (taps - 1) * jv) * reduce - 0.5
            tu, tv, tap_u, tap_v = int(tu * _ONE), int(tv * _ONE), int(ju * reduce * _ONE), int(jv * reduce * _ONE)
            step_u, step_v = int(du * reduce * _ONE), int(dv * reduce * _ONE)
            mask_u, mask_v = (1 << log_w) - 1, (1 << log_h) - 1
            small = _POWER[fine] * _ONE
            gu, gv = int((u * ratio_u + grain_u) * small) - 32768, int((v * ratio_v + grain_v) * small) - 32768
            grain_step_u, grain_step_v = int(du * ratio_u * small), int(dv * ratio_v * small)
            fine_start, fine_log = detail_start[fine], _DETAIL_LOG - fine
            if material == _DRY:
                ip0, ip1 = int((u * to_picture + at_picture) * _ONE), int((v * to_picture + at_picture) * _ONE)
                ie0, ie1 = int(du * to_picture * _ONE), int(dv * to_picture * _ONE)
            scale = share * (1.0 / 255.0)
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
                tone = scale
                if fine < _LAST_DETAIL:
                    tone *= 1.0 + (_grain(detail, fine_start, fine_log, gu, gv) * _GRAIN_UNIT - 0.5) * strength
                    gu += grain_step_u
                    gv += grain_step_v
                if material == _DRY:
                    sunny = _sun_on_ground(sunlight, ip0, ip1) * _GRAIN_UNIT
                    ip0 += ie0
                    ip1 += ie1
                elif soft:
                    i = column - x
                    sunny = _above_shadow(
                        field,
                        p0 + e0 * i + _OFF_WALL_M * n0,
                        p1 + e1 * i + _OFF_WALL_M * n1,
                        p2 + e2 * i + _OFF_WALL_M * n2,
                    )
                lit = level_light + facing * sunny
                if emission > 0.0 and glow > 0.0:
                    lit += glow * emission * 4.0 * np.int64(lanes >> _U48) * scale
                lit *= tone * tone * air
                r, g, b = np.int64(lanes & _LANE), np.int64((lanes >> _U16) & _LANE), np.int64((lanes >> _U32) & _LANE)
                r, g, b = (
                    int(r * r * tint0 * lit + haze0),
                    int(g * g * tint1 * lit + haze1),
                    int(b * b * tint2 * lit + haze2),
                )
                out[row, column] = min(r, _TOP) | min(g, _TOP) << 21 | min(b, _TOP) << 42
            dx = (x - cx) / fx
            mu, mv = _moved(motion, body, dx, dy, iz, lens)
            mu, mv = 2.0 * (mu - x), 2.0 * (mv - row)
            nu, nv = _moved(motion, body, dx + (last - x) / fx, dy, iz_end, lens)
            nu, nv = (2.0 * (nu - last) - mu) * inverse, (2.0 * (nv - row) - mv) * inverse
            for column in range(x, end):
                flow[row, column, 0] = mu
                flow[row, column, 1] = mv
                mu += nu
                mv += nv
            x = end
