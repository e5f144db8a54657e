"""From radiance to the picture: motion blur, exposure, vignette, noise, gamma."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import float32

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.picture.views import Float32s, Int8s, Int32s, Int64s, UInt8s

LONGEST_BLUR_PX = 48.0
"""Longer motion is cut: what moves so far is a smear either way."""

MOST_SAMPLES = 6
"""Along a pixel's motion. Their sum must fit a field of 21 bits: each is below 2^18."""

NOISE_SIDE = 1024
"""Rows of the table of noise; every row of a picture starts at a random place in it."""

NOISE_UNIT = 1.0 / 32.0
"""Step of the table of noise in standard deviations: bytes are read in a quarter of the time of floats."""

_SHARE = np.array([0.0] + [65536.0 / n for n in range(1, MOST_SAMPLES + 1)], np.float32)
_WHITE = 1.4  # exposed radiance that becomes white; highlights bend towards it
_BEND = float32(0.35)  # how early
_RISE = float32((1.0 + 0.35 * _WHITE - _WHITE) / _WHITE**2)  # so that the curve is 1 at _WHITE
_EDGE = float32(1.15)  # ratio of depths at an edge: a slanted surface changes less from pixel to pixel
_FIELD = (1 << 21) - 1  # one colour of a packed radiance
_STRETCH = 16  # pixels that are smeared as a whole: two SIMD registers of eight, or four of four
_COARSE = 16  # motion is compared in sixteenths of a pixel
_ALIKE = 12  # of those: motions that differ by less than a pixel smear alike to the eye
_MOVES_PX = 1.0  # less motion than this within the exposure blurs nothing


class Sensor(NamedTuple):
    """What the sensor does to light.

    Attributes:
        vignette: ``(h, w)`` share of light that reaches the pixel.
        noise: ``(NOISE_SIDE, n)`` normal numbers in steps of ``NOISE_UNIT``, n >= 3 w + NOISE_SIDE.
        shot: noise variance per exposed radiance of green.
        read: noise variance in the dark.
    """

    vignette: Float32s
    noise: Int8s
    shot: float
    read: float


def noise_table(columns: int) -> Int8s:
    """Normal numbers for :class:`Sensor`."""
    normal = np.random.default_rng(20).standard_normal((NOISE_SIDE, columns), np.float32)
    return np.clip(np.rint(normal / NOISE_UNIT), -127, 127).astype(np.int8)


def noise_offsets(seed: int, height: int) -> Int64s:
    """Row and first column of the table of noise for each row of a picture, ``(height, 2)``.

    Numbers of SplitMix64 (Steele, Lea and Flood 2014), which needs no generator to be made for every picture.
    """
    word = np.uint64(seed) + np.arange(1, height + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    word = (word ^ word >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ word >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
    halves = (word ^ word >> np.uint64(31)).view(np.uint32).reshape(height, 2)
    return (halves % np.uint32(NOISE_SIDE)).astype(np.int64)


@compiled_unchecked
def mean_radiance(radiance: Int64s) -> float:
    """Mean over a sparse grid of the lower two thirds of the picture: the sky may turn white, as in a car's camera."""
    some = radiance[len(radiance) // 3 :: 8, ::8]
    total = 0
    for row in some:
        for word in row:
            total += (word & _FIELD) + (word >> 21 & _FIELD) + (word >> 42)
    return total / some.size / 3.0


@inlined
def spread_motion(depth: Float32s, ends: Int32s, along: Float32s, down: Float32s) -> None:
    """Let near surfaces in a row of pixels that move sideways smear over what is behind them.

    ``expose`` averages along each pixel's own motion, so a pole that passes before a distant wall would only be eaten
    at its edges. The wall's pixels that the pole sweeps (half its motion to either side) take the pole's motion.

    Args:
        depth: ``(w,)`` float32 1/z.
        ends: columns after which another surface begins, from left to right.
        along: ``(w,)`` float32 motion along the row, changed in place.
        down: ``(w,)`` float32 motion along columns, changed in place.
    """
    width = depth.shape[0]
    for number in range(ends.shape[0]):
        # The nearer of the two surfaces moves into the other one.
        x = ends[number]
        here, there = depth[x], depth[x + 1]
        if here > there * _EDGE:
            first, sense, near = x + 1, 1, x
        elif there > here * _EDGE:
            first, sense, near = x, -1, x + 1
        else:
            continue
        # Half its motion to either side, until something as near or faster stands there.
        du, dv, limit = along[near], down[near], depth[near] / _EDGE
        for i in range(int(min(abs(du), float32(LONGEST_BLUR_PX)) * float32(0.5) + float32(0.5))):
            column = first + sense * i
            if column < 0 or column >= width or depth[column] > limit or abs(along[column]) > abs(du):
                break
            along[column], down[column] = du, dv


@inlined
def _nearest(flat: Int64s, x: int, y: int, width: int, right: int, bottom: int) -> int:
    """Radiance at (x, y) in 1/65536 pixels, at the border the nearest one."""
    return flat[np.uintp((min(max(y, 0), bottom) >> 16) * width + (min(max(x, 0), right) >> 16))]


@inlined
def _smear_pixels(
    flat: Int64s,
    shape: tuple[int, int],
    flow: Float32s,
    y: int,
    stretch: tuple[int, int],
    words: Int64s,
    scales: Float32s,
) -> None:
    """Average the pixels of row ``y`` from the first to before the second of ``stretch`` one by one."""
    height, width = shape
    right, bottom = (width << 16) - 1, (height << 16) - 1
    for x in range(stretch[0], stretch[1]):
        du, dv = flow[0, y, x], flow[1, y, x]
        length = max(abs(du), abs(dv))
        if length <= float32(_MOVES_PX):
            continue
        if length > float32(LONGEST_BLUR_PX):
            du *= float32(LONGEST_BLUR_PX) / length
            dv *= float32(LONGEST_BLUR_PX) / length
        samples = min(int(length + float32(1.2)), MOST_SAMPLES)  # less than a pixel apart, up to that many
        share = _SHARE[samples]
        # Positions in 1/65536 pixels; the first sample lies half a step after the start of the exposure.
        ax, ay = int(du * share), int(dv * share)
        px = (x << 16) + 32768 - (ax * (samples - 1) >> 1)
        py = (y << 16) + 32768 - (ay * (samples - 1) >> 1)
        word = 0
        for _ in range(samples):
            word += _nearest(flat, px, py, width, right, bottom)
            px += ax
            py += ay
        words[x] = word
        scales[x] *= share * float32(1.0 / 65536.0)


@inlined
def _step(at: int, width: int, ax: np.float32, ay: np.float32, steps: float) -> int:
    """Place in the flat picture ``steps`` times (ax, ay) from ``at``, to the nearest pixel."""
    along, down = int(np.floor(ax * steps + 0.5)), int(np.floor(ay * steps + 0.5))
    return at + down * width + along


@inlined
def _extremes(values: Int32s) -> tuple[int, int]:
    """Smallest and largest."""
    least = most = values[0]
    for i in range(values.shape[0]):
        least, most = min(least, values[i]), max(most, values[i])
    return least, most


@inlined
def _add_six(flat: Int64s, at: tuple[int, int, int, int, int, int], words: Int64s, scales: Float32s) -> None:
    """The mean of six stretches of the picture, which begin at ``at``: their sums and the divisor."""
    first, second, third = (
        flat[at[0] : at[0] + _STRETCH],
        flat[at[1] : at[1] + _STRETCH],
        flat[at[2] : at[2] + _STRETCH],
    )
    fourth, fifth, sixth = (
        flat[at[3] : at[3] + _STRETCH],
        flat[at[4] : at[4] + _STRETCH],
        flat[at[5] : at[5] + _STRETCH],
    )
    for i in range(words.shape[0]):
        words[i] = first[i] + second[i] + third[i] + fourth[i] + fifth[i] + sixth[i]
    for i in range(scales.shape[0]):
        scales[i] *= float32(1.0 / MOST_SAMPLES)


@inlined
def _coarsen(exact: Float32s, coarse: Int32s) -> None:
    """Motion as whole numbers, which compare faster; what leaves 1000 pixels is cut, so that it fits."""
    for x in range(coarse.shape[0]):
        coarse[x] = np.int32(min(max(exact[x], float32(-1000.0)), float32(1000.0)) * float32(_COARSE))


@inlined
def _smear(
    flat: Int64s, shape: tuple[int, int], flow: Float32s, y: int, words: Int64s, scales: Float32s, motion: Int32s
) -> None:
    """Average row ``y`` along each pixel's motion: sums into ``words``, their divisors into ``scales``.

    Most stretches of ``_STRETCH`` pixels move alike, to less than a pixel or an eighth of the motion: they are summed
    as a whole, which runs in SIMD. The others, at edges of things that move differently and at the border of the
    picture, go pixel by pixel.
    ``motion`` (2, w) is working memory.
    """
    height, width = shape
    _coarsen(flow[0, y], motion[0])
    _coarsen(flow[1, y], motion[1])
    along, down = motion[0], motion[1]
    for begin in range(0, width, _STRETCH):
        end = begin + _STRETCH
        if end > width:
            _smear_pixels(flat, shape, flow, y, (begin, width), words, scales)
            continue
        # How the stretch moves; most of a slow picture stands still.
        least_u, most_u = _extremes(along[begin:end])
        least_v, most_v = _extremes(down[begin:end])
        if max(max(-least_u, most_u), max(-least_v, most_v)) <= _COARSE:
            continue
        half = float32(0.5 / _COARSE)
        du, dv = float32(least_u + most_u) * half, float32(least_v + most_v) * half
        length = max(abs(du), abs(dv))
        # Pixel by pixel if it does not move alike, is cut, or takes samples from outside the picture.
        reach = int(0.5 * length) + 1
        if (
            max(most_u - least_u, most_v - least_v) > max(_ALIKE, int(2.0 * length))
            or length > float32(LONGEST_BLUR_PX)
            or begin < reach
            or end + reach > width
            or y < reach
            or y + reach >= height
        ):
            _smear_pixels(flat, shape, flow, y, (begin, end), words, scales)
            continue
        if length <= float32(_MOVES_PX):
            continue
        # Always the most samples, at whole pixels: a loop of fixed length without branches runs in SIMD.
        ax, ay = du * float32(1.0 / MOST_SAMPLES), dv * float32(1.0 / MOST_SAMPLES)
        at = y * width + begin
        s0, s1, s2 = _step(at, width, ax, ay, -2.5), _step(at, width, ax, ay, -1.5), _step(at, width, ax, ay, -0.5)
        s3, s4, s5 = _step(at, width, ax, ay, 0.5), _step(at, width, ax, ay, 1.5), _step(at, width, ax, ay, 2.5)
        _add_six(flat, (s0, s1, s2, s3, s4, s5), words[begin:end], scales[begin:end])


@inlined
def _begin_row(radiance: Int64s, vignette: Float32s, gain: np.float32, words: Int64s, scales: Float32s) -> None:
    """One sample a pixel, that of its own place."""
    for x in range(words.shape[0]):
        words[x] = radiance[x]
    for x in range(words.shape[0]):
        scales[x] = gain * vignette[x]


@inlined
def _field(words: Int64s, scales: Float32s, shift: int, out: Float32s) -> None:
    """Exposed radiance of one colour of a row."""
    for x in range(out.shape[0]):
        out[x] = scales[x] * float32(np.int32((words[x] >> shift) & _FIELD))


@inlined
def _deviation(values: Float32s, shot: np.float32, read: np.float32, out: Float32s) -> None:
    """Standard deviation of the noise, stronger where there is more light."""
    for x in range(out.shape[0]):
        out[x] = np.sqrt(shot * values[x] + read)


@inlined
def _encode(values: Float32s, grain: Int8s, deviation: Float32s, coded: UInt8s) -> None:
    """Exposed radiance with noise as bytes."""
    for x in range(values.shape[0]):
        value = max(values[x] + deviation[x] * float32(grain[x]), float32(0.0))
        # Highlights bend towards white; the root is the gamma of the encoding.
        value = value * (float32(1.0) + value * _RISE) / (float32(1.0) + value * _BEND)
        coded[x] = np.uint8(np.int32(min(float32(255.0) * np.sqrt(value) + float32(0.5), float32(255.0))))


class _Row(NamedTuple):
    """Working memory for a row of pixels.

    Attributes:
        words: ``(w,)`` sums of radiance.
        scales: ``(w,)`` factors between them and what is exposed.
        motion: ``(2, w)`` in sixteenths of a pixel.
        values: ``(w,)`` exposed radiance of one colour.
        deviation: ``(w,)`` of its noise.
        line: ``(3, w)`` bytes.
    """

    words: Int64s
    scales: Float32s
    motion: Int32s
    values: Float32s
    deviation: Float32s
    line: UInt8s


@inlined
def _interleave(red: UInt8s, green: UInt8s, blue: UInt8s, out: UInt8s) -> None:
    """Three rows of one colour become a row of pixels."""
    for x in range(red.shape[0]):
        out[3 * x], out[3 * x + 1], out[3 * x + 2] = red[x], green[x], blue[x]


@inlined
def _expose_rows(
    radiance: Int64s, flat: Int64s, flow: Float32s, offset: Int64s, gain: np.float32, sensor: Sensor, row: _Row,
    out: UInt8s,
) -> None:  # fmt: skip
    """All of :func:`expose` but making its working memory: nothing here counts references to arrays."""
    words, scales, motion, values, deviation, line = row
    width = radiance.shape[1]
    shot, read = float32(sensor.shot * NOISE_UNIT**2), float32(sensor.read * NOISE_UNIT**2)
    for y in range(radiance.shape[0]):
        # Light that falls on the row while the shutter is open.
        _begin_row(radiance[y], sensor.vignette[y], gain, words, scales)
        _smear(flat, radiance.shape, flow, y, words, scales, motion)
        # One deviation for all colours, that of green, by which the eye and a grey picture judge most of the light.
        _field(words, scales, 21, values)
        _deviation(values, shot, read, deviation)
        for channel in range(3):  # short loops without branches, so that each runs in SIMD
            first = offset[y, 1] + channel * width
            _field(words, scales, 21 * channel, values)
            _encode(values, sensor.noise[offset[y, 0], first : first + width], deviation, line[channel])
        _interleave(line[0], line[1], line[2], out[y])


@compiled_unchecked
def expose(radiance: Int64s, flow: Float32s, offset: Int64s, gain: float, sensor: Sensor, out: UInt8s) -> None:
    """Average along each pixel's motion, then expose, add noise and encode.

    Args:
        radiance: ``(h, w)`` as ``shade`` leaves it.
        flow: ``(2, h, w)`` motion during the exposure in pixels, along columns and along rows.
        offset: ``(h, 2)`` row and first column of the noise of each image row.
        gain: exposure per unit of the integer radiance.
        sensor: that sees it.
        out: ``(h, w, 3)``.
    """
    height, width = radiance.shape
    row = _Row(
        np.empty(width, np.int64), np.empty(width, np.float32), np.empty((2, width), np.int32),
        np.empty(width, np.float32), np.empty(width, np.float32), np.empty((3, width), np.uint8),
    )  # fmt: skip
    flat, lines = radiance.reshape(height * width), out.reshape(height, 3 * width)
    _expose_rows(radiance, flat, flow, offset, float32(gain), sensor, row, lines)
