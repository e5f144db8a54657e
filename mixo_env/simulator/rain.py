"""The spray behind vehicles in rain."""

from __future__ import annotations

import numpy as np

from mixo_env.compiled import compiled_unchecked
from mixo_env.simulator.mirror import mixed

_NO_SPRAY_MPS = 3.0


@compiled_unchecked
def add_spray(radiance, depth, puffs, lens, clouds, colour):
    """Blend soft clouds of fine water into the picture.

    Args:
        radiance: ``(h, w)`` int64 as ``shade`` leaves it; changed in place.
        depth: ``(h, w)`` 1/z.
        puffs: ``(n, 6)`` camera coordinates and radius in metres, opacity, offset into the noise; farthest first.
        lens: fx, fy, cx, cy.
        clouds: noise that makes them ragged.
        colour: packed radiance of the water.
    """
    height, width = depth.shape
    for n in range(puffs.shape[0]):
        px, py, pz, radius, opacity, shift = puffs[n]
        if pz < 0.6:
            continue
        u, v, size = px / pz * lens[0] + lens[2], py / pz * lens[1] + lens[3], radius / pz * lens[0]
        texel = 90.0 / max(size, 1.0)
        for row in range(max(0, int(v - size)), min(height, int(v + size) + 1)):
            for column in range(max(0, int(u - size)), min(width, int(u + size) + 1)):
                a, b = (column - u) / size, (row - v) / size
                inside = 1.0 - a * a - b * b
                if inside <= 0.0:
                    continue
                seen = depth[row, column]
                behind = (
                    1.0 if seen <= 0.0 else (1.0 / seen - pz) / radius + 1.0
                )  # fades into what stands inside the puff
                if behind <= 0.0:
                    continue
                ragged = clouds[int((row - v) * texel + shift) & 511, int((column - u) * texel + 2.0 * shift) & 511] * (
                    1.0 / 255.0
                )
                share = opacity * inside * inside * (0.4 + 0.6 * ragged) * min(behind, 1.0)
                radiance[row, column] = mixed(radiance[row, column], colour, int(256.0 * share))


@compiled_unchecked
def spray_puffs(states, size_m, rotation, position_m, wetness):
    """Puffs behind the wheels of moving vehicles for :func:`add_spray`, growing with speed and age.

    Args:
        states: of ``moving_states``, vehicles near the camera.
        size_m: ``(n, 3)`` length, width, height.
        rotation: ``(3, 3)`` camera from map.
        position_m: ``(3,)`` of the camera.
        wetness: 0..1.
    """
    out = np.empty((8 * len(states), 6))
    count = 0
    for n in range(len(states)):
        x, y, c, s, speed = states[n, 0], states[n, 1], np.cos(states[n, 2]), np.sin(states[n, 2]), states[n, 3]
        length, width, height = size_m[n, 0], size_m[n, 1], size_m[n, 2]
        if speed <= _NO_SPRAY_MPS:
            continue
        thrown = wetness * min((speed - _NO_SPRAY_MPS) / 12.0, 1.0)
        for age in range(4):
            back = 0.5 * length - 0.4 + 0.9 * age
            for side in (-1.0, 1.0):
                aside = side * 0.42 * width
                dx, dy = x - back * c - aside * s - position_m[0], y - back * s + aside * c - position_m[1]
                dz = 0.35 + 0.16 * age - position_m[2]
                for axis in range(3):
                    out[count, axis] = rotation[axis, 0] * dx + rotation[axis, 1] * dy + rotation[axis, 2] * dz
                out[count, 3] = (0.5 + 0.3 * age) * (0.7 + 0.3 * height)
                out[count, 4] = 0.4 * thrown * 0.8**age
                out[count, 5] = (31.0 * (x + y) + 57.0 * age + 20.0 * side) % 512.0
                count += 1
    return out[:count][np.argsort(-out[:count, 2], kind="mergesort")]
