"""The spray behind vehicles in rain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import float32, int32

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.picture.fleet import HEIGHT, SPEED, YAW, X, Y
from mixo_env.simulator.picture.mirror import mixed
from mixo_env.simulator.picture.views import Float32s, Float64s, Int32s, Int64s, UInt8s, View

_NO_SPRAY_MPS = 3.0  # slower wheels throw nothing up
_FULL_SPRAY_MPS = 12.0  # so much faster, and there is no more of it
_PUFFS = 4  # behind every wheel of the rear axle, from young to old
_NEAREST_M = 0.6  # a puff around the lens would cover the whole picture
_NOISE_TEXELS = 90.0  # across a puff's radius: its raggedness keeps its size on the road
_NOISE_SIDE = 512  # of the clouds
_RAGGED = 0.6  # share of a puff that the noise cuts out at most


class Puff(NamedTuple):
    """One soft ball of fine water; a row of :func:`spray_puffs`.

    Attributes:
        x, y, z: camera coordinates in metres.
        radius: in metres.
        opacity: at its middle, 0..1.
        shift: into the noise, so that no two puffs look alike.
    """

    x: float
    y: float
    z: float
    radius: float
    opacity: float
    shift: float


class PuffRow(NamedTuple):
    """What is behind a puff, and memory for what it does there.

    Attributes:
        depth: 1/z.
        where: column of the noise.
        shares: hidden by the puff, of 256.
    """

    depth: Float32s
    where: Int32s
    shares: Float32s


@compiled_unchecked
def add_spray(radiance: Int64s, depth: Float32s, puffs: Float64s, view: View, clouds: UInt8s, colour: int) -> None:
    """Blend soft clouds of fine water into the picture.

    Args:
        radiance: ``(h, w)`` as ``shade`` leaves it; changed in place.
        depth: ``(h, w)`` 1/z.
        puffs: ``(n, 6)`` rows as in :class:`Puff`; farthest first.
        view: of the camera.
        clouds: ``(512, 512)`` noise that makes them ragged.
        colour: packed radiance of the water.
    """
    width = depth.shape[1]
    noise = clouds.reshape(_NOISE_SIDE * _NOISE_SIDE)
    seen = PuffRow(depth, np.empty(width, np.int32), np.empty(width, np.float32))
    for n in range(puffs.shape[0]):
        x, y, z, radius, opacity, shift = puffs[n]
        if z >= _NEAREST_M:
            _blend_puff(radiance, seen, Puff(x, y, z, radius, opacity, shift), view, noise, colour)


@inlined
def _blend_puff(radiance: Int64s, seen: PuffRow, puff: Puff, view: View, noise: UInt8s, colour: int) -> None:
    """One puff of :func:`add_spray`: opaque in the middle, nothing at its edge."""
    depth, where, shares = seen
    height, width = depth.shape
    u, v = puff.x / puff.z * view.fx + view.cx, puff.y / puff.z * view.fy + view.cy
    size = puff.radius / puff.z * view.fx
    texel = _NOISE_TEXELS / max(size, 1.0)
    step = float32(1.0 / size), float32(texel)
    for row in range(max(0, int(np.ceil(v - size))), min(height, int(np.floor(v + size)) + 1)):
        b = (row - v) / size
        rest = 1.0 - b * b
        half = size * np.sqrt(max(rest, 0.0))
        begin, end = max(0, int(np.ceil(u - half))), min(width, int(np.floor(u + half)) + 1)
        if begin >= end:
            continue
        n, line = end - begin, int((row - v) * texel + puff.shift) & (_NOISE_SIDE - 1)
        first = float32((begin - u) / size), float32((begin - u) * texel + 2.0 * puff.shift)
        _thickness(PuffRow(depth[row, begin:end], where[:n], shares[:n]), first, step, float32(rest), puff)
        _mix(noise[line * _NOISE_SIDE :], where[:n], shares[:n], colour, radiance[row, begin:end])


@inlined
def _thickness(
    run: PuffRow,
    first: tuple[np.float32, np.float32],
    step: tuple[np.float32, np.float32],
    rest: np.float32,
    puff: Puff,
) -> None:
    """How much of the light a run of pixels of a puff hides, of 256, and which column of the noise lies there.

    Args:
        run: of pixels.
        first: column from the middle of the puff in its radii, and in the noise, of the first pixel.
        step: the same from pixel to pixel.
        rest: 1 - the square of the row from the middle in radii.
        puff: that it is.
    """
    inverse, where, shares = run
    near, per_m, most = float32(puff.z), float32(1.0 / puff.radius), float32(256.0 * puff.opacity)
    for i in range(shares.shape[0]):
        n = float32(int32(i))
        a = first[0] + step[0] * n
        inside = max(rest - a * a, float32(0.0))
        # Fades into what stands inside the puff; the sky (depth 0) is behind all of it.
        behind = (float32(1.0) / inverse[i] - near) * per_m + float32(1.0)
        shares[i] = most * inside * inside * min(max(behind, float32(0.0)), float32(1.0))
        where[i] = np.int32(first[1] + step[1] * n) & int32(_NOISE_SIDE - 1)


@inlined
def _mix(noise: UInt8s, where: Int32s, shares: Float32s, colour: int, out: Int64s) -> None:
    """Mix the ragged water into a run of pixels."""
    least, per_level = float32(1.0 - _RAGGED), float32(_RAGGED / 255.0)
    for i in range(shares.shape[0]):
        shares[i] *= least + per_level * float32(noise[np.uintp(where[i])])
    for i in range(shares.shape[0]):
        out[i] = mixed(out[i], colour, np.int64(np.int32(shares[i])))


@compiled_unchecked
def spray_puffs(states: Float64s, size_m: Float64s, view: View, wetness: float) -> Float64s:
    """Puffs behind the wheels of moving vehicles for :func:`add_spray`, growing with speed and age.

    Args:
        states: of ``moving_states``, vehicles near the camera.
        size_m: ``(n, 3)`` length, width, height.
        view: of the camera.
        wetness: 0..1.

    Returns:
        ``(m, 6)`` rows as in :class:`Puff`, farthest first.
    """
    out = np.empty((2 * _PUFFS * len(states), 6))
    rotation, position_m = view.rotation, view.position_m
    count = 0
    for n in range(len(states)):
        x, y, c, s, speed = states[n, X], states[n, Y], np.cos(states[n, YAW]), np.sin(states[n, YAW]), states[n, SPEED]
        length, width, height = size_m[n, 0], size_m[n, 1], size_m[n, 2]
        if speed <= _NO_SPRAY_MPS:
            continue
        thrown = wetness * min((speed - _NO_SPRAY_MPS) / _FULL_SPRAY_MPS, 1.0)
        for age in range(_PUFFS):  # the older, the farther behind, the higher, the larger and the thinner
            back = 0.5 * length - 0.4 + 0.9 * age
            for side in (-1.0, 1.0):
                aside = side * 0.42 * width  # wheels stand a little inside the body
                dx, dy = x - back * c - aside * s - position_m[0], y - back * s + aside * c - position_m[1]
                dz = states[n, HEIGHT] + 0.35 + 0.16 * age - position_m[2]
                for axis in range(3):
                    out[count, axis] = rotation[axis, 0] * dx + rotation[axis, 1] * dy + rotation[axis, 2] * dz
                out[count, 3] = (0.5 + 0.3 * age) * (0.7 + 0.3 * height)
                out[count, 4] = 0.4 * thrown * 0.8**age
                out[count, 5] = (31.0 * (x + y) + 57.0 * age + 20.0 * side) % 512.0
                count += 1
    return out[:count][np.argsort(-out[:count, 2], kind="mergesort")]
