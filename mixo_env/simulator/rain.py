"""What rain adds to a finished radiance image: the mirror of the wet road and the spray behind vehicles."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixo_env.simulator.compiling import INLINED
from mixo_env.simulator.mesh import GROUND, SOLID
from mixo_env.simulator.vehicles import VEHICLE_KINDS, VehicleState

_FIELD = (1 << 21) - 1
_RUN = 8
_FIRST_REACH_M = 25.0
_LEAST_SHARE = 3  # of 256; less mirror is not seen


@njit(cache=True, error_model="numpy")
def mirror_road(radiance, owner, depth, mark, rotation, position, lens, clouds, sky, wetness):
    """Blend into the road what it mirrors, found in the picture itself.

    The mirrored ray leaves the road at P in the direction d' (d with its vertical part reversed). The picture is read
    where P + s d' is seen; s is first a guess, then such that the depth agrees with the surface seen there. Eight
    neighbouring pixels share one search.

    Args:
        radiance: ``(h, w)`` int64 as ``shade`` leaves it; changed in place.
        owner: of ``DepthBuffers``.
        depth: of ``DepthBuffers``.
        mark: of ``DepthBuffers``.
        rotation: ``(3, 3)`` camera from map.
        position: ``(3,)`` of the camera.
        lens: fx, fy, cx, cy.
        clouds: ``(512, 512)`` bytes of noise that says where water stands.
        sky: packed radiance for rays that leave the picture.
        wetness: 0..1.
    """
    height, width = owner.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    up0, up1, up2 = rotation[0, 2], rotation[1, 2], rotation[2, 2]
    for row in range(height):
        dy = (row - cy) / fy
        x = 0
        while x < width:
            k = owner[row, x]
            if k < 0 or mark[k, 1] != GROUND:  # what lies under vehicles mirrors only their dark undersides
                x += 1
                continue
            end = x + 1
            while end < min(x + _RUN, width) and owner[row, end] == k:
                end += 1
            middle = 0.5 * (x + end - 1)
            z = 1.0 / depth[row, (x + end - 1) // 2]
            dx = (middle - cx) / fx
            rise = dx * up0 + dy * up1 + up2
            norm = 1.0 / np.sqrt(dx * dx + dy * dy + 1.0)
            grazing = 1.0 - min(abs(rise * norm), 1.0)
            fresnel = 0.02 + 0.98 * grazing**5
            rx, ry, rz = dx - 2.0 * rise * up0, dy - 2.0 * rise * up1, 1.0 - 2.0 * rise * up2
            # Where water stands the mirror is clear, elsewhere the road's roughness scatters most of it.
            wx = position[0] + z * (rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0])
            wy = position[1] + z * (rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1])
            water = clouds[int(wy * 9.0) & 511, int(wx * 9.0) & 511] * (1.0 / 255.0)
            share = int(256.0 * wetness * fresnel * (0.35 + 0.65 * min(2.0 * water, 1.0)))
            if share < _LEAST_SHARE:
                x = end
                continue
            reach = _FIRST_REACH_M
            column, line = -1, -1
            for _ in range(2):
                hz = z + reach * rz
                if hz < 0.5:
                    column = -1
                    break
                column, line = (
                    int((z * dx + reach * rx) / hz * fx + cx + 0.5),
                    int((z * dy + reach * ry) / hz * fy + cy + 0.5),
                )
                if column < 0 or column >= width or line < 0 or line >= height:
                    column = -1
                    break
                seen = depth[line, column]
                reach = 200.0 if seen <= 0.0 else max((1.0 / seen - z) / rz, 0.3)
            for i in range(x, end):
                other = sky
                if column >= 0:
                    c = min(max(column + i - (x + end - 1) // 2, 0), width - 1)
                    seen_by = owner[line, c]
                    if seen_by >= 0 and mark[seen_by, 1] != SOLID:
                        continue  # the mirrored ray passed below something: nothing in the picture shows its underside
                    # A smear upwards stands for the ripples.
                    other = (radiance[line, c] >> 1 & _HALF) + (radiance[max(line - 3, 0), c] >> 1 & _HALF)
                radiance[row, i] = _mixed(radiance[row, i], other, share)
            x = end


_HALF = (0xFFFFF << 42) | (0xFFFFF << 21) | 0xFFFFF


@njit(**INLINED)
def _mixed(first, second, share):
    """Packed radiance: share / 256 of the second, the rest of the first."""
    r = ((first & _FIELD) * (256 - share) + (second & _FIELD) * share) >> 8
    g = ((first >> 21 & _FIELD) * (256 - share) + (second >> 21 & _FIELD) * share) >> 8
    b = ((first >> 42) * (256 - share) + (second >> 42) * share) >> 8
    return r | g << 21 | b << 42


@njit(cache=True, error_model="numpy")
def add_spray(radiance, depth, puffs, lens, clouds, colour):
    """Blend soft clouds of fine water into the picture.

    Args:
        radiance: as in ``mirror_road``.
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
                radiance[row, column] = _mixed(radiance[row, column], colour, int(256.0 * share))


def spray_puffs(
    vehicles: Sequence[VehicleState],
    rotation: NDArray[np.float64],
    position_m: NDArray[np.float64],
    wetness: float,
) -> NDArray[np.float64]:
    """Puffs behind the wheels of moving vehicles for :func:`add_spray`, growing with speed and age.

    Args:
        vehicles: near the camera.
        rotation: ``(3, 3)`` camera from map.
        position_m: ``(3,)`` of the camera.
        wetness: 0..1.
    """
    puffs = []
    for vehicle in vehicles:
        thrown = wetness * min(max(vehicle.speed_mps - 3.0, 0.0) / 12.0, 1.0)
        if thrown <= 0.0:
            continue
        size = VEHICLE_KINDS[vehicle.kind]
        c, s = math.cos(vehicle.yaw_rad), math.sin(vehicle.yaw_rad)
        for age in range(4):
            for side in (-1.0, 1.0):
                back = 0.5 * size.length_m - 0.4 + 0.9 * age
                aside = side * 0.42 * size.width_m
                x, y = vehicle.x_m - back * c - aside * s, vehicle.y_m - back * s + aside * c
                radius = (0.5 + 0.3 * age) * (0.7 + 0.3 * size.height_m)
                drift = 31.0 * (vehicle.x_m + vehicle.y_m) + 57.0 * age + 20.0 * side
                puffs.append((x, y, 0.35 + 0.16 * age, radius, 0.4 * thrown * 0.8**age, drift % 512.0))
    out = np.array(puffs).reshape(-1, 6)
    out[:, :3] = (out[:, :3] - position_m) @ rotation.T
    return out[np.argsort(-out[:, 2], kind="stable")]
