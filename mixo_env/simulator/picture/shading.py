"""Radiance and image motion of every pixel from the patches that the rasteriser found.

Pixels are shaded in short spans that show the same patch. Perspective is exact at both ends of a span and linear
within; a span is cut so short that this misplaces the texture by less than 0.2 pixels. The reduction of the texture,
haze and lamp light are chosen once per span.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import float32

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.city.textures import DETAIL_SIDE
from mixo_env.simulator.picture.sampling import (
    PICTURE_MASK,
    Size,
    Walk,
    above_shadow,
    add_texels,
    bytes_at,
    lamp_light,
    level,
    read_grain,
)
from mixo_env.simulator.picture.sensor import spread_motion
from mixo_env.simulator.picture.sky import shade_sky
from mixo_env.simulator.picture.spans import (
    GRAIN_UNIT,
    INVERSE,
    ONE,
    RADIANCE_TOP,
    SPAN,
    Canvas,
    Memory,
    Run,
    Shot,
    Span,
    ramps,
    whole,
)
from mixo_env.simulator.picture.sunlight import Sun, no_sun, sun_on_ground, sun_on_wall
from mixo_env.simulator.picture.surfaces import Look, Surface, Sweep, look_of, rays_in, surface_in, sweep_in
from mixo_env.simulator.picture.views import BODY, Float32s, Int64s, Point, Textures, UInt32s, View

_SHORTEST = 4  # pixels: shorter spans cost more than they hold
_POWER = np.array([2.0**-i for i in range(12)])  # scale of each reduction
_U16, _LOW = np.uint32(16), np.uint32(0xFFFF)
_HALF = 32768  # texels' centres lie at halves
_BYTE_UNIT = 1.0 / (255.0 * ONE)  # full scale of ``bytes_at``
_DETAIL_LOG = DETAIL_SIDE.bit_length() - 1
_OFF_WALL_M = 0.8  # shadows are looked up this far off a surface, or every wall would shade itself
_MINOR = 0.4  # max + 0.4 min is the length of a vector to 8 %, without a root
_SLANTED = 1.41  # texels a pixel, below which one sample is enough
_SHARPEST = 0.7  # texels: a footprint thinner than this is as good as this
_NEAREST_M = 1e-4  # what the motion carries behind the camera is taken to be here


class Footprint(NamedTuple):
    """What a pixel in the middle of a span covers of the texture.

    Attributes:
        taps: samples along its long axis; ``share`` is 1 / taps.
        u, v: texels from sample to sample.
        reduction: of the texture, chosen by its short axis.
        grain: reduction of the fine grain.
    """

    taps: int
    share: float
    u: float
    v: float
    reduction: int
    grain: int


class Haze(NamedTuple):
    """Share of light that the air leaves, and what it adds."""

    air: float
    red: np.float32
    green: np.float32
    blue: np.float32


@inlined
def _span(s: Surface, x: int, stop: int) -> Span:
    """The span that begins at ``x``: as long as linear interpolation is good enough."""
    w = s.w0 + s.w1 * x
    z = 1.0 / w
    longest = max(_SHORTEST, int(min(np.sqrt(w * s.bend), float(SPAN))))
    last = min(x + longest, stop) - 1
    steps = last - x
    inverse = INVERSE[steps]
    u, v = (s.u0 + s.u1 * x) * z, (s.v0 + s.v1 * x) * z
    z_last = 1.0 / (s.w0 + s.w1 * last)
    du, dv = ((s.u0 + s.u1 * last) * z_last - u) * inverse, ((s.v0 + s.v1 * last) * z_last - v) * inverse
    return Span(x, last, steps, inverse, z, z_last, 0.5 * (z + z_last), u, v, du, dv)


@inlined
def _footprint(s: Surface, span: Span, look: Look, most_taps: int) -> Footprint:
    """Derivatives of the texel in column and row; the long axis is sampled, the short axis chooses the reduction."""
    z = span.z
    um, vm = span.u + 0.5 * span.du * span.steps, span.v + 0.5 * span.dv * span.steps
    ux, vx = (s.u1 - um * s.w1) * z, (s.v1 - vm * s.w1) * z
    uy, vy = (s.u2 - um * s.w2) * z, (s.v2 - vm * s.w2) * z
    ax, bx, ay, by = abs(ux), abs(vx), abs(uy), abs(vy)
    across, along = max(ax, bx) + _MINOR * min(ax, bx), max(ay, by) + _MINOR * min(ay, by)
    if across > along:
        wide, thin, ju, jv = across, along, ux, vx
    else:
        wide, thin, ju, jv = along, across, uy, vy
    taps = 1
    if wide > _SLANTED:
        taps = max(1, min(most_taps, int(wide / max(thin, _SHARPEST) + 0.5)))
    share = INVERSE[taps]
    ju, jv = ju * share, jv * share
    grain = level(max(abs(ju * look.grain_per_u), abs(jv * look.grain_per_v)))
    return Footprint(taps, share, ju, jv, level(wide * share), grain)


@inlined
def _haze(z: float, shot: Shot) -> Haze:
    """The air between: e to minus the way, by the first terms of its series; at the limit of sight nothing is left."""
    light = shot.light[0]
    density = light.haze_per_m
    air = 1.0 / (1.0 + z * density * (1.0 + 0.5 * z * density))
    fade = max(z / shot.camera.far_m * 4.0 - 3.0, 0.0)  # within the last quarter of it
    air *= 1.0 - fade * fade
    return Haze(
        air,
        float32(light.haze_red * (1.0 - air)),
        float32(light.haze_green * (1.0 - air)),
        float32(light.haze_blue * (1.0 - air)),
    )


@inlined
def _off_surface(ray: Point, z: float, view: View, look: Look) -> Point:
    """Map position a little off the surface that is seen along ``ray`` at depth ``z``."""
    position = view.position_m
    return (
        position[0] + ray[0] * z + _OFF_WALL_M * look.normal_x,
        position[1] + ray[1] * z + _OFF_WALL_M * look.normal_y,
        position[2] + ray[2] * z + _OFF_WALL_M * look.normal_z,
    )


@inlined
def _read_texture(textures: Textures, number: int, span: Span, foot: Footprint, part: Memory) -> None:
    """Texture along a span: the sum of ``taps`` samples for every pixel."""
    table, reduce = textures.table, _POWER[foot.reduction] * ONE
    start, log_w = table[number, foot.reduction, 0], table[number, foot.reduction, 1]
    size = Size(log_w, (1 << log_w) - 1, (1 << table[number, foot.reduction, 2]) - 1)
    back = 0.5 * (foot.taps - 1)  # samples lie about the middle of the pixel
    u, v = int((span.u - back * foot.u) * reduce) - _HALF, int((span.v - back * foot.v) * reduce) - _HALF
    tap_u, tap_v, step_u, step_v = (
        int(foot.u * reduce), int(foot.v * reduce), int(span.du * reduce), int(span.dv * reduce),
    )  # fmt: skip
    texels = textures.texels[start:]
    for tap in range(foot.taps):
        keep = np.uint32(0) if tap == 0 else np.uint32(0xFFFFFFFF)
        walk = Walk(u + tap * tap_u, v + tap * tap_v, step_u, step_v)
        add_texels(texels, size, walk, part.where, keep, part.red_blue, part.green_alpha)


@inlined
def _glow(light: float, emission: float, scale: float, unit: float, green_alpha: UInt32s, factors: Float32s) -> None:
    """Light of a span in even light whose texture shines by itself."""
    for i in range(factors.shape[0]):
        factors[i] = (light + emission * np.int32(green_alpha[i] >> _U16) * scale) * unit


@inlined
def _light_each(
    count: int, steady: float, sun: Sun, look: Look, scales: tuple[float, float], shot: Shot, part: Memory
) -> None:
    """Light of ``count`` pixels on which the sun shines differently."""
    scale, unit = scales
    walk, daylight = sun.walk, shot.daylight
    for i in range(count):
        if look.on_ground:
            at_u, at_v = walk.u + i * walk.step_u, walk.v + i * walk.step_v
            sunny = bytes_at(daylight.picture, PICTURE_MASK, at_u, at_v) * _BYTE_UNIT
        else:
            x, y, z = sun.x + sun.step_x * i, sun.y + sun.step_y * i, sun.z + sun.step_z * i
            sunny = above_shadow(daylight.field, x, y, z)
        emitted = look.emission * np.int64(part.green_alpha[i] >> _U16) * scale
        part.factors[i] = (steady + look.facing * sunny + emitted) * unit


@inlined
def _light_all(
    span: Span, steady: float, sun: Sun, look: Look, scales: tuple[float, float], shot: Shot, part: Memory
) -> None:
    """Factors between the squared sums of the texture and the light that arrives from each pixel of a span."""
    scale, unit = scales
    bright = steady + look.facing * sun.share
    if look.emission > 0.0 and not sun.varied:
        _glow(bright, look.emission, scale, unit, part.green_alpha, part.factors)
    elif sun.varied:
        _light_each(span.last + 1 - span.x, steady, sun, look, scales, shot, part)
    else:
        part.factors[:] = bright * unit


@inlined
def _apply_grain(base: np.float32, gain: np.float32, specks: Float32s, factors: Float32s) -> None:
    """Multiply ``factors`` by the square of the fine grain along a span."""
    for i in range(factors.shape[0]):
        speck = base + specks[i] * gain
        factors[i] *= speck * speck


@inlined
def _roughen(textures: Textures, look: Look, span: Span, grain: int, part: Memory) -> None:
    """Fine grain along a span, in its reduction ``grain``."""
    small = _POWER[grain] * ONE
    u = int((span.u * look.grain_per_u + look.grain_u) * small) - _HALF
    v = int((span.v * look.grain_per_v + look.grain_v) * small) - _HALF
    walk = Walk(u, v, int(span.du * look.grain_per_u * small), int(span.dv * look.grain_per_v * small))
    tile = textures.detail[textures.detail_start[grain] :]
    read_grain(tile, _DETAIL_LOG - grain, walk, part.where, part.specks)
    # Half of full scale is neutral.
    _apply_grain(float32(1.0 - 0.5 * look.strength), float32(look.strength * GRAIN_UNIT), part.specks, part.factors)


@inlined
def _colour(part: Memory, look: Look, haze: Haze, out: Int64s) -> None:
    """Packed radiance of a span: squares of the texture's sums times tint and light, plus haze."""
    red_blue, green_alpha, factors = part.red_blue, part.green_alpha, part.factors
    tint0, tint1, tint2, haze0, haze1, haze2 = look.red, look.green, look.blue, haze.red, haze.green, haze.blue
    top = float32(RADIANCE_TOP)
    for i in range(out.shape[0]):
        factor = factors[i]
        r, b = float32(np.int32(red_blue[i] & _LOW)), float32(np.int32(red_blue[i] >> _U16))
        g = float32(np.int32(green_alpha[i] & _LOW))
        r, g, b = haze0 + r * r * (tint0 * factor), haze1 + g * g * (tint1 * factor), haze2 + b * b * (tint2 * factor)
        red, green, blue = np.int32(min(r, top)), np.int32(min(g, top)), np.int32(min(b, top))
        out[i] = np.int64(red) | np.int64(green) << 21 | np.int64(blue) << 42


@inlined
def _flow_at(sweep: Sweep, column: int, row: int, view: View) -> tuple[float, float]:
    """Motion of a pixel during the exposure: twice that from its middle to its end."""
    fx, fy, cx, cy = view.fx, view.fy, view.cx, view.cy
    back = 2.0 / max(sweep.z0 + sweep.z1 * column, _NEAREST_M)
    along = (sweep.x0 + sweep.x1 * column) * back * fx + 2.0 * (cx - column)
    return along, (sweep.y0 + sweep.y1 * column) * back * fy + 2.0 * (cy - row)


@inlined
def _shade_run(run: Run, k: int, shot: Shot, memory: Memory, out: Canvas) -> None:
    """Shade the pixels of ``run``, all of slot ``k``; see :func:`shade`."""
    row, begin, stop = run
    seen, view, textures, light, lamps = shot.seen, shot.camera, shot.textures, shot.light[0], shot.lamps
    dy = (row - view.cy) / view.fy
    surface = surface_in(seen.plane[k], row)
    look = look_of(seen.style[k], seen.mark[k], light)
    rays = rays_in(view, dy)
    sweep = sweep_in(shot.motion[seen.mark[k, BODY]], view, dy, surface)
    sun_before, x = -1.0, begin
    while x < stop:
        # Where the span lies on the texture and in the map.
        span = _span(surface, x, stop)
        foot = _footprint(surface, span, look, textures.most_taps)
        ray = rays.d0 + rays.s0 * x, rays.d1 + rays.s1 * x, rays.d2 + rays.s2 * x
        point = _off_surface(ray, span.z_first, view, look)
        # Light that is the same for the whole span.
        haze = _haze(span.z, shot)
        steady = look.ambient
        if light.lamps > light.ambient:  # by day lamps shine, but light nothing
            ahead = (0.5 * (x + span.last) - view.cx) / view.fx * span.z
            steady += light.lamps * lamp_light(lamps, point, look.normal_z, (ahead, dy * span.z, span.z))
        # Sun.
        if look.facing <= 0.0:
            sun = no_sun()
        elif look.on_ground:
            sun = sun_on_ground(shot.daylight, span, textures.ground_texels_per_m)
        else:
            steps = span.steps
            last = ray[0] + rays.s0 * steps, ray[1] + rays.s1 * steps, ray[2] + rays.s2 * steps
            end = _off_surface(last, span.z_last, view, look)
            sun = sun_on_wall(shot.daylight.field, span, point, end, sun_before)
            sun_before = sun.at_end
        # Each step is a loop of its own over the span: the arithmetic of the last two then runs in SIMD.
        n = whole(span.last + 1 - x)
        part = Memory(memory.red_blue[:n], memory.green_alpha[:n], memory.factors[:n], memory.specks[:n], memory.where)
        _read_texture(textures, look.texture, span, foot, part)
        scale = foot.share * (1.0 / 255.0)
        _light_all(span, steady, sun, look, (scale, scale * scale * haze.air), shot, part)
        if foot.grain < textures.grain_levels and look.strength > 0.0:
            _roughen(textures, look, span, foot.grain, part)
        _colour(part, look, haze, out.radiance[row, x : x + n])
        # Motion.
        u, v = _flow_at(sweep, x, row, view)
        eu, ev = _flow_at(sweep, span.last, row, view)
        du, dv = (eu - u) * span.inverse, (ev - v) * span.inverse
        ramps(u, du, v, dv, out.flow[0, row, x : x + n], out.flow[1, row, x : x + n])
        x = span.last + 1


@compiled_unchecked
def shade(shot: Shot, out: Canvas) -> None:
    """Fill ``out`` with linear radiance and with the way each pixel's surface moves during the exposure."""
    owner, depth, flow = shot.seen.owner, shot.seen.depth, out.flow
    memory = Memory(
        np.empty(SPAN, np.uint32), np.empty(SPAN, np.uint32), np.empty(SPAN, np.float32), np.empty(SPAN, np.float32),
        np.empty((6, SPAN), np.int32),
    )  # fmt: skip
    height, width = owner.shape
    ends = np.empty(width, np.int32)
    for row in range(height):
        x = runs = 0
        while x < width:
            # Pixels that show the same patch.
            k = owner[row, x]
            end = x + 1
            while end < width and owner[np.uintp(row), np.uintp(end)] == k:
                end += 1
            run = Run(row, x, end)
            if k < 0:
                shade_sky(run, shot, memory, out)
            else:
                _shade_run(run, k, shot, memory, out)
            ends[runs] = end - 1
            runs += 1
            x = end
        spread_motion(depth[row], ends[: runs - 1], flow[0, row], flow[1, row])
