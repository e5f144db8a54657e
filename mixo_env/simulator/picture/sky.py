"""The sky: clouds on a plane between clear sky and haze. They move with the camera's rotation only."""

from __future__ import annotations

import numpy as np
from numba import float32, int32

from mixo_env.compiled import inlined
from mixo_env.simulator.picture.sampling import Walk, read_grain
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
    ramps,
    whole,
)
from mixo_env.simulator.picture.views import Float32s, Float64s, Int64s, View

_SKY_LOG = 9  # log2 of the side of the tile of clouds
_TEXELS = 60.0  # of the clouds per height of their plane above the camera
_CURVE = 0.12  # the plane bends down to the horizon, or clouds there would shrink to nothing and flicker
_ZENITH = 2.0  # the colour of the zenith is reached 30 degrees over the horizon
_WHITE = 1.25  # clouds against the haze

Tones = tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]
"""Radiance of haze and of the zenith, red first."""


@inlined
def _sky_point(x: int, row: int, view: View, turn: Float64s) -> tuple[float, float, float, float, float]:
    """One pixel of the sky.

    Returns:
        Texel on the plane of clouds (2), how high it looks (0 at the horizon, 1 overhead), and its motion (2).
    """
    rotation = view.rotation
    dx, dy = (x - view.cx) / view.fx, (row - view.cy) / view.fy
    # Direction in the map.
    wx = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0]
    wy = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1]
    wz = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2]
    norm = 1.0 / np.sqrt(wx * wx + wy * wy + wz * wz)
    up = max(wz * norm, 0.0)
    scale = _TEXELS * norm / (up + _CURVE)
    # Where the pixel is at the end of the exposure; it moved as far before its middle.
    z = 1.0 / (turn[6] * dx + turn[7] * dy + turn[8])
    u = (turn[0] * dx + turn[1] * dy + turn[2]) * z * view.fx + view.cx
    v = (turn[3] * dx + turn[4] * dy + turn[5]) * z * view.fy + view.cy
    return wx * scale, wy * scale, min(_ZENITH * up, 1.0), 2.0 * (u - x), 2.0 * (v - row)


@inlined
def _blend_sky(
    high: np.float32, rise: np.float32, contrast: np.float32, tones: Tones, specks: Float32s, out: Int64s
) -> None:
    """Packed radiance of a span of sky: haze below, zenith above, clouds a little brighter than the haze is red."""
    haze0, haze1, haze2, top0, top1, top2 = tones
    white, most = float32(_WHITE) * haze0, float32(RADIANCE_TOP)
    for i in range(out.shape[0]):
        cloud = contrast * specks[i]
        share = (high + rise * float32(int32(i))) * (float32(1.0) - cloud)
        keep, glow = float32(1.0) - cloud - share, white * cloud
        r, g = haze0 * keep + top0 * share + glow, haze1 * keep + top1 * share + glow
        b = haze2 * keep + top2 * share + glow
        out[i] = np.int64(min(r, most)) | np.int64(min(g, most)) << 21 | np.int64(min(b, most)) << 42


@inlined
def shade_sky(run: Run, shot: Shot, memory: Memory, out: Canvas) -> None:
    """Shade the pixels of ``run``, all of the sky; see ``shading.shade``."""
    row, begin, stop = run
    light, turn, specks = shot.light[0], shot.motion[0], memory.specks
    tones = (
        float32(light.haze_red), float32(light.haze_green), float32(light.haze_blue),
        float32(light.zenith_red), float32(light.zenith_green), float32(light.zenith_blue),
    )  # fmt: skip
    contrast = float32(light.clouds * GRAIN_UNIT)
    x = begin
    while x < stop:
        # Exact at both ends of the span, linear between.
        end = min(x + SPAN, stop)
        inverse = INVERSE[end - 1 - x]
        u, v, high, fu, fv = _sky_point(x, row, shot.camera, turn)
        eu, ev, ehigh, efu, efv = _sky_point(end - 1, row, shot.camera, turn)
        walk = Walk(int(u * ONE), int(v * ONE), int((eu - u) * inverse * ONE), int((ev - v) * inverse * ONE))
        ehigh, efu, efv = (ehigh - high) * inverse, (efu - fu) * inverse, (efv - fv) * inverse
        read_grain(shot.textures.sky, _SKY_LOG, walk, memory.where, specks[: whole(end - x)])
        _blend_sky(float32(high), float32(ehigh), contrast, tones, specks[: end - x], out.radiance[row, x:end])
        ramps(fu, efu, fv, efv, out.flow[0, row, x:end], out.flow[1, row, x:end])
        x = end
