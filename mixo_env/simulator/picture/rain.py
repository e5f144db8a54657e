"""The spray behind vehicles in rain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixo_env.compiled import compiled_unchecked
from mixo_env.simulator.picture.fleet import HEIGHT, SPEED, YAW, X, Y
from mixo_env.simulator.picture.mirror import mixed
from mixo_env.simulator.picture.views import Float32s, Float64s, Int64s, UInt8s, View

_NO_SPRAY_MPS = 3.0  # slower wheels throw nothing up
_FULL_SPRAY_MPS = 12.0  # so much faster, and there is no more of it
_PUFFS = 4  # behind every wheel of the rear axle, from young to old
_NEAREST_M = 0.6  # a puff around the lens would cover the whole picture
_NOISE_TEXELS = 90.0  # across a puff's radius: its raggedness keeps its size on the road
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


@compiled_unchecked
def add_spray(radiance: Int64s, depth: Float32s, puffs: Float64s, view: View, clouds: UInt8s, colour: int) -> None:
    """Blend soft clouds of fine water into the picture.

    Args:
        radiance: ``(h, w)`` as ``shade`` leaves it; changed in place.
        depth: ``(h, w)`` 1/z.
        puffs: ``(n, 6)`` rows as in :class:`Puff`; farthest first.
        view: of the camera.
        clouds: noise that makes them ragged.
        colour: packed radiance of the water.
    """
    for n in range(puffs.shape[0]):
        x, y, z, radius, opacity, shift = puffs[n]
        if z >= _NEAREST_M:
            _blend_puff(radiance, depth, Puff(x, y, z, radius, opacity, shift), view, clouds, colour)


@compiled_unchecked
def _blend_puff(radiance: Int64s, depth: Float32s, puff: Puff, view: View, clouds: UInt8s, colour: int) -> None:
    """One puff of :func:`add_spray`: opaque in the middle, nothing at its edge."""
    height, width = depth.shape
    px, py, pz, radius = puff.x, puff.y, puff.z, puff.radius
    u, v, size = px / pz * view.fx + view.cx, py / pz * view.fy + view.cy, radius / pz * view.fx
    texel = _NOISE_TEXELS / max(size, 1.0)
    for row in range(max(0, int(v - size)), min(height, int(v + size) + 1)):
        for column in range(max(0, int(u - size)), min(width, int(u + size) + 1)):
            a, b = (column - u) / size, (row - v) / size
            inside = 1.0 - a * a - b * b
            if inside <= 0.0:
                continue
            seen = depth[row, column]
            # Fades into what stands inside the puff; the sky (depth 0) is behind all of it.
            behind = 1.0 if seen <= 0.0 else (1.0 / seen - pz) / radius + 1.0
            if behind <= 0.0:
                continue
            down, across = (row - v) * texel + puff.shift, (column - u) * texel + 2.0 * puff.shift
            ragged = clouds[int(down) & 511, int(across) & 511] * (1.0 / 255.0)
            share = puff.opacity * inside * inside * (1.0 - _RAGGED + _RAGGED * ragged) * min(behind, 1.0)
            radiance[row, column] = mixed(radiance[row, column], colour, int(256.0 * share))


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
