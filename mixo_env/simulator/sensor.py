"""From radiance to the picture: motion blur, exposure, vignette, noise, gamma."""

from __future__ import annotations

import numpy as np
from numba import float32, njit

LONGEST_BLUR_PX = 48.0
MOST_SAMPLES = 6
NOISE_SIDE = 1024
_SHARE = np.array([0.0] + [65536.0 / n for n in range(1, MOST_SAMPLES + 1)], np.float32)
_WHITE = 1.4  # exposed radiance that becomes white; highlights bend towards it
_BEND = float32(0.35)
_RISE = float32((1.0 + 0.35 * _WHITE - _WHITE) / _WHITE**2)
_EDGE = float32(1.15)  # ratio of depths at an edge
_FIELD = (1 << 21) - 1


@njit(cache=True, error_model="numpy")
def spread_motion(depth, owner, flow):
    """Let near surfaces that move sideways smear over what is behind them.

    ``expose`` averages along each pixel's own motion, so a pole that passes before a distant wall would only be eaten
    at its edges. The wall's pixels that the pole sweeps (half its motion to either side) take the pole's motion.

    Args:
        depth: ``(h, w)`` float32 1/z.
        owner: ``(h, w)`` number of the surface.
        flow: ``(2, h, w)`` float32, changed in place.
    """
    height, width = depth.shape
    for y in range(height):
        for x in range(width - 1):
            if owner[y, x] == owner[y, x + 1]:
                continue
            here, there = depth[y, x], depth[y, x + 1]
            if here > there * _EDGE:
                first, sense, near = x + 1, 1, x
            elif there > here * _EDGE:
                first, sense, near = x, -1, x + 1
            else:
                continue
            du, dv, limit = flow[0, y, near], flow[1, y, near], depth[y, near] / _EDGE
            for i in range(int(min(abs(du), float32(LONGEST_BLUR_PX)) * float32(0.5) + float32(0.5))):
                column = first + sense * i
                if column < 0 or column >= width or depth[y, column] > limit or abs(flow[0, y, column]) > abs(du):
                    break
                flow[0, y, column], flow[1, y, column] = du, dv


@njit(cache=True, error_model="numpy")
def _nearest(flat, x, y, width, right, bottom):
    """Radiance at (x, y) in 1/65536 pixels, at the border the nearest one."""
    return flat[np.uintp((min(max(y, 0), bottom) >> 16) * width + (min(max(x, 0), right) >> 16))]


@njit(cache=True, error_model="numpy")
def _smear(radiance, flow, y, words, scales):
    """Average row ``y`` along each pixel's motion: sums into ``words``, their divisors into ``scales``."""
    height, width = radiance.shape
    flat = radiance.reshape(height * width)
    right, bottom = (width << 16) - 1, (height << 16) - 1
    for x in range(width):
        du, dv = flow[0, y, x], flow[1, y, x]
        length = max(abs(du), abs(dv))
        if length <= float32(1.0):
            continue
        if length > float32(LONGEST_BLUR_PX):
            du *= float32(LONGEST_BLUR_PX) / length
            dv *= float32(LONGEST_BLUR_PX) / length
        samples = min(int(length + float32(1.2)), MOST_SAMPLES)
        share = _SHARE[samples]
        # Positions in 1/65536 pixels; the first sample lies half a step after the start of the exposure.
        ax, ay = int(du * share), int(dv * share)
        px = (x << 16) + 32768 - (ax * (samples - 1) >> 1)
        py = (y << 16) + 32768 - (ay * (samples - 1) >> 1)
        qx, qy = px + ax * (samples - 1), py + ay * (samples - 1)
        # The sums are written out: as a loop the compiler would gather four samples where two are wanted.
        if py >> 16 == qy >> 16 and min(px, qx) >= 0 and max(px, qx) <= right and 0 <= py <= bottom:
            base = (py >> 16) * width
            word = flat[np.uintp(base + (px >> 16))] + flat[np.uintp(base + (qx >> 16))]
            if samples > 2:
                word += flat[np.uintp(base + ((px + ax) >> 16))]
            if samples > 3:
                word += flat[np.uintp(base + ((px + 2 * ax) >> 16))]
            if samples > 4:
                word += flat[np.uintp(base + ((px + 3 * ax) >> 16))]
            if samples > 5:
                word += flat[np.uintp(base + ((px + 4 * ax) >> 16))]
        else:
            word = _nearest(flat, px, py, width, right, bottom) + _nearest(flat, qx, qy, width, right, bottom)
            if samples > 2:
                word += _nearest(flat, px + ax, py + ay, width, right, bottom)
            if samples > 3:
                word += _nearest(flat, px + 2 * ax, py + 2 * ay, width, right, bottom)
            if samples > 4:
                word += _nearest(flat, px + 3 * ax, py + 3 * ay, width, right, bottom)
            if samples > 5:
                word += _nearest(flat, px + 4 * ax, py + 4 * ay, width, right, bottom)
        words[x] = word
        scales[x] *= share * float32(1.0 / 65536.0)


@njit(cache=True, error_model="numpy")
def expose(radiance, flow, vignette, noise, offset, gain, shot, read, out):
    """Average along each pixel's motion, then expose, add noise and encode.

    Args:
        radiance: ``(h, w)`` int64 as ``shade`` leaves it.
        flow: ``(2, h, w)`` float32, motion during the exposure in pixels, along columns and along rows.
        vignette: ``(h, w)`` float32 share of light that reaches the pixel.
        noise: ``(NOISE_SIDE, n)`` float32 unit normal numbers, n >= 3 w + NOISE_SIDE.
        offset: ``(h, 2)`` row and first column of the noise of each image row.
        gain: exposure per unit of the integer radiance.
        shot: noise variance per exposed radiance.
        read: noise variance in the dark.
        out: ``(h, w, 3)`` uint8.
    """
    height, width = radiance.shape
    words, scales, line = np.empty(width, np.int64), np.empty(width, np.float32), np.empty(3 * width, np.float32)
    gain, shot, read = float32(gain), float32(shot), float32(read)
    for y in range(height):
        words[:] = radiance[y]
        for x in range(width):
            scales[x] = gain * vignette[y, x]
        _smear(radiance, flow, y, words, scales)
        for x in range(width):
            line[3 * x] = scales[x] * float32(words[x] & _FIELD)
            line[3 * x + 1] = scales[x] * float32((words[x] >> 21) & _FIELD)
            line[3 * x + 2] = scales[x] * float32(words[x] >> 42)
        grain = noise[offset[y, 0], offset[y, 1] : offset[y, 1] + 3 * width]
        target = out[y].reshape(3 * width)
        for i in range(3 * width):  # without branches, so that it runs in SIMD
            value = line[i]
            value += np.sqrt(shot * value + read) * grain[i]
            value = max(value, float32(0.0))
            value = value * (float32(1.0) + value * _RISE) / (float32(1.0) + value * _BEND)
            target[i] = np.uint8(min(float32(255.0) * np.sqrt(value) + float32(0.5), float32(255.0)))
