"""Radiance and image motion of every pixel from the patches that the rasteriser found.

Pixels are shaded in short spans that show the same patch. Perspective is exact at both ends of a span and linear
within; a span is cut so short that this misplaces the texture by less than 0.15 pixels. The reduction of the texture,
haze and lamp light are chosen once per span.
"""

from __future__ import annotations

import numpy as np
from numba import float32

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.mesh import CUT_OUT, GROUND, SHADE, SOLID
from mixo_env.simulator.sampling import (
    CELL_SHIFT,
    HALF_EXTENT_M,
    PICTURE_MASK,
    above_shadow,
    add_texels,
    bytes_at,
    lamp_light,
    level,
    read_grain,
)
from mixo_env.simulator.sensor import spread_motion
from mixo_env.simulator.shadows import PICTURE_TEXELS_PER_M
from mixo_env.simulator.textures import DETAIL_SIDE

SPAN = 32
"""Longest run of pixels that shares one reduction of the texture."""

MOST_TAPS = 3
"""Samples along the long axis of a pixel's footprint on a slanted surface."""

RADIANCE_TOP = (1 << 18) - 1
"""Largest radiance of a pixel: eight of them fit into a field of 21 bits."""

_INVERSE = np.array([0.0] + [1.0 / i for i in range(1, SPAN + 1)])
_POWER = np.array([2.0**-i for i in range(12)])
_U16, _LOW = np.uint32(16), np.uint32(0xFFFF)
_ONE = 65536.0  # texel coordinates and factors in fixed point
_HALF = 32768
_GRAIN_UNIT = 1.0 / (255.0 * 256.0)
_BYTE_UNIT = 1.0 / (255.0 * _ONE)
_DETAIL_LOG = DETAIL_SIDE.bit_length() - 1
_SKY_LOG = 9
_EVEN_SPAN_TEXELS = 6.0
_OFF_WALL_M = 0.8  # shadows are looked up this far off a surface, or every wall would shade itself


@inlined
def _ramps(along, along_step, down, down_step, flow_along, flow_down):
    """Write a motion that changes evenly along a span."""
    u, du, v, dv = float32(along), float32(along_step), float32(down), float32(down_step)
    for i in range(flow_along.shape[0]):
        flow_along[i] = u + du * float32(i)
        flow_down[i] = v + dv * float32(i)


@inlined
def _sky_point(x, row, camera, turn):
    """One pixel of the sky.

    Returns:
        Texel on the plane of clouds (2), how high it looks (0 at the horizon, 1 overhead), and its motion (2).
    """
    rotation, lens = camera[0], camera[2]
    dx, dy = (x - lens[2]) / lens[0], (row - lens[3]) / lens[1]
    wx = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0]
    wy = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1]
    wz = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2]
    norm = 1.0 / np.sqrt(wx * wx + wy * wy + wz * wz)
    up = max(wz * norm, 0.0)
    scale = 60.0 * norm / (up + 0.12)
    z = 1.0 / (turn[6] * dx + turn[7] * dy + turn[8])
    u = (turn[0] * dx + turn[1] * dy + turn[2]) * z * lens[0] + lens[2]
    v = (turn[3] * dx + turn[4] * dy + turn[5]) * z * lens[1] + lens[3]
    return wx * scale, wy * scale, min(2.0 * up, 1.0), 2.0 * (u - x), 2.0 * (v - row)


@inlined
def _blend_sky(high, rise, contrast, tones, specks, out):
    """Packed radiance of a span of sky: haze below, zenith above, clouds a little brighter than the haze is red."""
    haze0, haze1, haze2, top0, top1, top2 = tones
    white, most = float32(1.25) * haze0, float32(RADIANCE_TOP)
    for i in range(out.shape[0]):
        cloud = contrast * specks[i]
        share = (high + rise * float32(i)) * (float32(1.0) - cloud)
        keep, glow = float32(1.0) - cloud - share, white * cloud
        r, g = haze0 * keep + top0 * share + glow, haze1 * keep + top1 * share + glow
        b = haze2 * keep + top2 * share + glow
        out[i] = np.int64(min(r, most)) | np.int64(min(g, most)) << 21 | np.int64(min(b, most)) << 42


@inlined
def _sky_run(row, begin, stop, camera, light, textures, motion, memory, out, flow):
    """Clouds on a plane between clear sky and haze; they move with the camera's rotation only."""
    sky, turn, specks, where = textures[4], motion[0], memory[3], memory[4]
    tones = (
        float32(light[3]), float32(light[4]), float32(light[5]),
        float32(light[6]), float32(light[7]), float32(light[8]),
    )  # fmt: skip
    x = begin
    while x < stop:
        end = min(x + SPAN, stop)
        inverse = _INVERSE[end - 1 - x]
        u, v, high, fu, fv = _sky_point(x, row, camera, turn)
        eu, ev, ehigh, efu, efv = _sky_point(end - 1, row, camera, turn)
        gu, gv = int(u * _ONE), int(v * _ONE)
        du, dv = int((eu - u) * inverse * _ONE), int((ev - v) * inverse * _ONE)
        ehigh, efu, efv = (ehigh - high) * inverse, (efu - fu) * inverse, (efv - fv) * inverse
        read_grain(sky, _SKY_LOG, gu, gv, du, dv, where, specks[: _whole(end - x)])
        contrast = float32(light[9] * _GRAIN_UNIT)
        _blend_sky(float32(high), float32(ehigh), contrast, tones, specks[: end - x], out[row, x:end])
        _ramps(fu, efu, fv, efv, flow[0, row, x:end], flow[1, row, x:end])
        x = end


@inlined
def _whole(length):
    """Pixels to compute for a span: up to seven more than it has, so that SIMD leaves no rest.

    What they write beyond the span, the next span of the row writes again.
    """
    return (length + 7) & ~7


@inlined
def _fetch(texels, shape, steps, taps, where, red_blue, green_alpha):
    """Texture along a span: the sum of ``taps`` samples for every pixel."""
    u, v, step_u, step_v, tap_u, tap_v = steps
    for tap in range(taps):
        keep = np.uint32(0) if tap == 0 else np.uint32(0xFFFFFFFF)
        add_texels(texels, shape, u + tap * tap_u, v + tap * tap_v, step_u, step_v, where, keep, red_blue, green_alpha)


@inlined
def _glow(light, emission, scale, unit, green_alpha, factors):
    """Light of a span in even light whose texture shines by itself."""
    for i in range(factors.shape[0]):
        factors[i] = (light + emission * np.int32(green_alpha[i] >> _U16) * scale) * unit


@inlined
def _apply_grain(base, gain, specks, factors):
    """Multiply ``factors`` by the square of the fine grain along a span."""
    for i in range(factors.shape[0]):
        speck = base + specks[i] * gain
        factors[i] *= speck * speck


@inlined
def _colour(red_blue, green_alpha, factors, tint0, tint1, tint2, haze0, haze1, haze2, out):
    """Packed radiance of a span: squares of the texture's sums times tint and light, plus haze."""
    top = float32(RADIANCE_TOP)
    for i in range(out.shape[0]):
        factor = factors[i]
        r, b = float32(np.int32(red_blue[i] & _LOW)), float32(np.int32(red_blue[i] >> _U16))
        g = float32(np.int32(green_alpha[i] & _LOW))
        r, g, b = haze0 + r * r * (tint0 * factor), haze1 + g * g * (tint1 * factor), haze2 + b * b * (tint2 * factor)
        red, green, blue = np.int32(min(r, top)), np.int32(min(g, top)), np.int32(min(b, top))
        out[i] = np.int64(red) | np.int64(green) << 21 | np.int64(blue) << 42


@inlined
def _shade_run(row, begin, stop, k, seen, camera, light, textures, daylight, night, motion, memory, out, flow):
    """Shade the pixels ``begin`` to ``stop`` of a row, all of slot ``k``; see :func:`shade`."""
    reds, greens, scratch, noise, where = memory
    _, plane, style, mark, _ = seen
    rotation, position, lens, far = camera
    texels, table, detail, detail_start, _, ground_scale, grain_levels = textures
    sunlight, sun_cells, field = daylight
    lamps, lamp_origin, beam = night
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    sun, density, glow, wetness = light[1], light[2], light[10], light[11]
    dy = (row - cy) / fy
    sx, sy, sz = rotation[0, 0] / fx, rotation[0, 1] / fx, rotation[0, 2] / fx  # map ray per column
    d0 = rotation[2, 0] + rotation[1, 0] * dy - sx * cx
    d1 = rotation[2, 1] + rotation[1, 1] * dy - sy * cx
    d2 = rotation[2, 2] + rotation[1, 2] * dy - sz * cx
    to_picture = PICTURE_TEXELS_PER_M / ground_scale
    at_picture = HALF_EXTENT_M * PICTURE_TEXELS_PER_M - 0.5
    u1, v1, w1 = plane[k, 1], plane[k, 4], plane[k, 7]
    u2, v2, w2 = plane[k, 2], plane[k, 5], plane[k, 8]
    u0, v0, w0 = plane[k, 0] + u2 * row, plane[k, 3] + v2 * row, plane[k, 6] + w2 * row
    ratio_u, ratio_v, grain_u, grain_v = style[k, 4], style[k, 5], style[k, 6], style[k, 7]
    strength, facing = style[k, 8], style[k, 9] * sun
    n0, n1, n2 = style[k, 10], style[k, 11], style[k, 12]
    o0, o1, o2 = _OFF_WALL_M * n0, _OFF_WALL_M * n1, _OFF_WALL_M * n2
    material, number = mark[k, 1], mark[k, 2]
    on_ground = material == GROUND
    tint0 = float32(style[k, 0] * light[12])
    tint1 = float32(style[k, 1] * light[13])
    tint2 = float32(style[k, 2] * light[14])
    emission = 0.0 if mark[k, 0] & CUT_OUT != 0 else 4.0 * glow * style[k, 3]
    if material == SHADE:
        facing = 0.0
    level_light = light[0] * (0.82 + 0.18 * n2)
    if material != SOLID:
        level_light *= 1.0 - 0.5 * wetness  # wet ground is dark
    # Where the surface is seen at the end of the exposure: numerators linear in the column.
    m = motion[mark[k, 3]]
    mx0 = m[1] * dy + m[2] - m[0] * cx / fx + m[9] * w0
    my0 = m[4] * dy + m[5] - m[3] * cx / fx + m[10] * w0
    mz0 = m[7] * dy + m[8] - m[6] * cx / fx + m[11] * w0
    mx1, my1, mz1 = m[0] / fx + m[9] * w1, m[3] / fx + m[10] * w1, m[6] / fx + m[11] * w1
    # Linear interpolation over n pixels errs by n^2 / 4 |w1 / w| pixels.
    bend = 0.6 / (abs(w1) + 1e-12)
    sun_at_end, x = 0.0, begin
    while x < stop:
        w = w0 + w1 * x
        iz = 1.0 / w
        longest = max(4, int(min(np.sqrt(w * bend), float(SPAN))))
        end = min(x + longest, stop)
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
        rung = level(wide * share)
        reduce = _POWER[rung] * _ONE
        start, log_w = table[number, rung, 0], table[number, rung, 1]
        mask_u, mask_v = (1 << log_w) - 1, (1 << table[number, rung, 2]) - 1
        ju, jv = ju * share, jv * share
        fine = level(max(abs(ju * ratio_u), abs(jv * ratio_v)))

        # Light that is the same for the whole span.
        air = 1.0 / (1.0 + z * density * (1.0 + 0.5 * z * density))
        fade = max(z / far * 4.0 - 3.0, 0.0)
        air *= 1.0 - fade * fade
        haze0, haze1 = float32(light[3] * (1.0 - air)), float32(light[4] * (1.0 - air))
        haze2 = float32(light[5] * (1.0 - air))
        steady = level_light
        q0, q1, q2 = d0 + sx * x, d1 + sy * x, d2 + sz * x
        p0, p1, p2 = position[0] + q0 * iz + o0, position[1] + q1 * iz + o1, position[2] + q2 * iz + o2
        if glow > light[0]:  # by day lamps shine, but light nothing
            rx = (0.5 * (x + last) - cx) / fx * z
            steady += glow * lamp_light(lamps, lamp_origin[0], lamp_origin[1], beam, p0, p1, p2, n2, rx, dy * z, z)
        sunny, varied = 1.0, False
        e0 = e1 = e2 = 0.0
        g0 = g1 = ge0 = ge1 = 0
        if facing > 0.0:
            if on_ground:
                pu, pv = u * to_picture + at_picture, v * to_picture + at_picture
                eu, ev = du * to_picture, dv * to_picture
                cell = sun_cells[(int(pv) & PICTURE_MASK) >> CELL_SHIFT, (int(pu) & PICTURE_MASK) >> CELL_SHIFT]
                there = sun_cells[
                    (int(pv + ev * steps) & PICTURE_MASK) >> CELL_SHIFT,
                    (int(pu + eu * steps) & PICTURE_MASK) >> CELL_SHIFT,
                ]
                sunny = cell * (1.0 / 255.0)
                varied = cell != there or cell == 1 or (abs(eu) + abs(ev)) * steps > _EVEN_SPAN_TEXELS
                if varied:
                    g0, g1, ge0, ge1 = int(pu * _ONE), int(pv * _ONE), int(eu * _ONE), int(ev * _ONE)
            else:
                e0 = position[0] + (q0 + sx * steps) * iz_end + o0
                e1 = position[1] + (q1 + sy * steps) * iz_end + o1
                e2 = position[2] + (q2 + sz * steps) * iz_end + o2
                sunny = above_shadow(field, p0, p1, p2) if x == begin else sun_at_end
                sun_at_end = above_shadow(field, e0, e1, e2)
                varied = sunny != sun_at_end
                e0, e1, e2 = (e0 - p0) * inverse, (e1 - p1) * inverse, (e2 - p2) * inverse
        bright = steady + facing * sunny

        back = 0.5 * (taps - 1)
        tu, tv = int((u - back * ju) * reduce) - _HALF, int((v - back * jv) * reduce) - _HALF
        tap_u, tap_v, step_u, step_v = int(ju * reduce), int(jv * reduce), int(du * reduce), int(dv * reduce)
        small = _POWER[fine] * _ONE
        gu, gv = int((u * ratio_u + grain_u) * small) - _HALF, int((v * ratio_v + grain_v) * small) - _HALF
        grain_step_u, grain_step_v = int(du * ratio_u * small), int(dv * ratio_v * small)
        fine_start, fine_log = detail_start[fine], _DETAIL_LOG - fine
        scale = share * (1.0 / 255.0)
        unit = scale * scale * air
        grain_gain, grain_base = float32(strength * _GRAIN_UNIT), float32(1.0 - 0.5 * strength)
        # Each step is a loop of its own over the span: the arithmetic of the last two then runs in SIMD.
        wide_span = _whole(end - x)
        red_blue, green_alpha, factors, specks = (
            reds[:wide_span],
            greens[:wide_span],
            scratch[:wide_span],
            noise[:wide_span],
        )
        steps_of_texture = tu, tv, step_u, step_v, tap_u, tap_v
        _fetch(texels[start:], (log_w, mask_u, mask_v), steps_of_texture, taps, where, red_blue, green_alpha)
        if emission > 0.0 and not varied:
            _glow(bright, emission, scale, unit, green_alpha, factors)
        elif varied:
            for i in range(end - x):
                if on_ground:
                    sunny = bytes_at(sunlight, PICTURE_MASK, g0 + i * ge0, g1 + i * ge1) * _BYTE_UNIT
                else:
                    sunny = above_shadow(field, p0 + e0 * i, p1 + e1 * i, p2 + e2 * i)
                emitted = emission * np.int64(green_alpha[i] >> _U16) * scale
                factors[i] = (steady + facing * sunny + emitted) * unit
        else:
            factors[:] = bright * unit
        if fine < grain_levels and strength > 0.0:
            read_grain(detail[fine_start:], fine_log, gu, gv, grain_step_u, grain_step_v, where, specks)
            _apply_grain(grain_base, grain_gain, specks, factors)
        _colour(red_blue, green_alpha, factors, tint0, tint1, tint2, haze0, haze1, haze2, out[row, x : x + wide_span])

        back = 2.0 / max(mz0 + mz1 * x, 1e-4)
        mu, mv = (mx0 + mx1 * x) * back * fx + 2.0 * (cx - x), (my0 + my1 * x) * back * fy + 2.0 * (cy - row)
        back = 2.0 / max(mz0 + mz1 * last, 1e-4)
        nu = ((mx0 + mx1 * last) * back * fx + 2.0 * (cx - last) - mu) * inverse
        nv = ((my0 + my1 * last) * back * fy + 2.0 * (cy - row) - mv) * inverse
        _ramps(mu, nu, mv, nv, flow[0, row, x : x + wide_span], flow[1, row, x : x + wide_span])
        x = end


@compiled_unchecked
def shade(seen, camera, light, textures, daylight, night, motion, out, flow):
    """Fill ``out`` with linear radiance and ``flow`` with the way each pixel's surface moves during the exposure.

    Args:
        seen: owner, plane, style, mark and depth of ``DepthBuffers``.
        camera: rotation ``(3, 3)`` camera from map, position ``(3,)``, lens (fx, fy, cx, cy) and the limit of sight in
            metres.
        light: ``(15,)`` ambient, sun, haze per metre, haze colour (3), zenith colour (3), clouds, lamps, wetness,
            colour (3); radiance in units of the integer result.
        textures: texels and table of the atlas, fine grain and the first entry of each of its reductions, the
            sky, the texels per metre of the ground, and the ``grain_levels`` of the weather.
        daylight: picture of the sunlight on the ground, its ``even_cells``, and the height of the houses' shadow.
        night: light of lamps on the ground (one value a metre, a power of two wide), map position of its corner, and
            ``(8,)`` rows x and y of ego from camera with their translation, for the car's own head lights.
        motion: ``(bodies, 12)`` rotation by rows and translation from camera coordinates at the middle of the exposure
            to those at its end, per rigid body; body 0 is the world.
        out: ``(h, w)`` int64, three 21-bit fields of radiance, red lowest, each at most ``RADIANCE_TOP``.
        flow: ``(2, h, w)`` float32 pixels, along columns and along rows.
    """
    owner, depth = seen[0], seen[4]
    memory = (
        np.empty(SPAN, np.uint32), np.empty(SPAN, np.uint32), np.empty(SPAN, np.float32), np.empty(SPAN, np.float32),
        np.empty((6, SPAN), np.int32),
    )  # fmt: skip
    height, width = owner.shape
    ends = np.empty(width, np.int32)
    for row in range(height):
        x = runs = 0
        while x < width:
            k = owner[row, x]
            end = x + 1
            while end < width and owner[row, end] == k:
                end += 1
            if k < 0:
                _sky_run(row, x, end, camera, light, textures, motion, memory, out, flow)
            else:
                _shade_run(row, x, end, k, seen, camera, light, textures, daylight, night, motion, memory, out, flow)
            ends[runs] = end - 1
            runs += 1
            x = end
        spread_motion(depth[row], ends[: runs - 1], flow[0, row], flow[1, row])
