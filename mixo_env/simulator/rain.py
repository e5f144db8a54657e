"""What rain adds to a finished radiance image: the mirror of the wet road and the spray behind vehicles."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mixo_env.simulator.compiling import INLINED
from mixo_env.simulator.mesh import GROUND
from mixo_env.simulator.vehicles import VEHICLE_KINDS, VehicleState

_FIELD = (1 << 21) - 1
_RUN, _ROWS = 8, 4  # pixels that share one search
_FIRST_REACH_M = 25.0
_LEAST_SHARE = 3  # of 256; less mirror is not seen
_NO_SPRAY_MPS = 3.0
_HALVES = (0xFFFFF << 42) | (0xFFFFF << 21) | 0xFFFFF


@njit(**INLINED)
def _mixed(first, second, share):
    """Packed radiance: share / 256 of the second, the rest of the first."""
    keep = share ^ 255  # written so that the compiler sees factors of 32 bits: SIMD multiplies those at once
    red, green, blue = first & _FIELD, first >> 21 & _FIELD, first >> 42 & _FIELD
    red = (red * keep + red + (second & _FIELD) * share) >> 8
    green = (green * keep + green + (second >> 21 & _FIELD) * share) >> 8
    blue = (blue * keep + blue + (second >> 42 & _FIELD) * share) >> 8
    return red | green << 21 | blue << 42


@njit(**INLINED)
def _mix_row(road, mirrored, shares):
    for i in range(road.shape[0]):
        road[i] = _mixed(road[i], mirrored[i], np.int64(shares[i]))


@njit(**INLINED)
def _take(here, k, seen, above, owner, share, mirrored, shares):
    """Note what those pixels that show the patch ``k`` mirror, and how much of it.

    A smear upwards (``above``) stands for the ripples. Where the mirrored ray meets the same patch again, the road
    stays; so does other ground in the stretch, for which no search was made.
    """
    for i in range(_RUN):
        mirrored[i] = (seen[i] >> 1 & _HALVES) + (above[i] >> 1 & _HALVES)
        shares[i] = share if (here[i] == k) & (owner[i] != k) else 0


@njit(**INLINED)
def _take_air(here, k, air, share, mirrored, shares):
    """The same where the mirrored ray leaves the picture."""
    for i in range(_RUN):
        mirrored[i] = air
        shares[i] = share if here[i] == k else 0


@njit(**INLINED)
def _first_ground(owner, mark):
    """First patch of the ground in a stretch of pixels, -1 if there is none."""
    for i in range(owner.shape[0]):
        if owner[i] >= 0 and mark[owner[i], 1] == GROUND:
            return owner[i]
    return np.int32(-1)


@njit(**INLINED)
def _mirrored(row, middle, z, depth, rotation, position, lens, clouds, wetness):
    """What the road at a pixel mirrors.

    Returns:
        Share of 255, row and column of it in the picture; row -1 if the ray leaves the picture.
    """
    height, width = depth.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    up0, up1, up2 = rotation[0, 2], rotation[1, 2], rotation[2, 2]
    dx, dy = (middle - cx) / fx, (row - cy) / fy
    rise = dx * up0 + dy * up1 + up2
    grazing = 1.0 - min(abs(rise) / np.sqrt(dx * dx + dy * dy + 1.0), 1.0)
    squared = grazing * grazing
    fresnel = 0.02 + 0.98 * squared * squared * grazing
    # Where water stands the mirror is clear, elsewhere the road's roughness scatters most of it.
    wx = position[0] + z * (rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0])
    wy = position[1] + z * (rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1])
    water = clouds[np.uintp(int(wy * 9.0) & 511), np.uintp(int(wx * 9.0) & 511)] * (2.0 / 255.0)
    share = int(255.0 * wetness * fresnel * (0.35 + 0.65 * min(water, 1.0)))
    if share < _LEAST_SHARE:
        return 0, -1, -1
    rx, ry, rz = dx - 2.0 * rise * up0, dy - 2.0 * rise * up1, 1.0 - 2.0 * rise * up2
    reach, column, line = _FIRST_REACH_M, -1, -1
    for guess in range(2):
        hz = z + reach * rz
        if hz < 0.5:
            return share, -1, -1
        inverse = 1.0 / hz
        column = int((z * dx + reach * rx) * inverse * fx + cx + 0.5)
        line = int((z * dy + reach * ry) * inverse * fy + cy + 0.5)
        if column < 0 or column >= width or line < 0 or line >= height:
            return share, -1, -1
        if guess == 0:
            seen = depth[np.uintp(line), np.uintp(column)]
            reach = 200.0 if seen <= 0.0 else max((1.0 / seen - z) / rz, 0.3)
    return (share if line < row - 2 else 0), line, column  # a ray so flat shows only the road itself


@njit(**INLINED)
def _mirror_rows(
    row, radiance, owner, depth, plane, mark, rotation, position, lens, clouds, air, wetness, line, shares
):
    """Mirror in ``row`` and the rows above; see :func:`mirror_road`. ``line`` and ``shares`` are working memory."""
    width = owner.shape[1]
    shares[:] = 0
    for x in range(0, width, _RUN):
        first = min(x, width - _RUN)
        last, middle = first + _RUN, first + 0.5 * (_RUN - 1)
        k = _first_ground(owner[row, first:last], mark)
        if k < 0:  # what lies under vehicles mirrors only their dark undersides
            continue
        z = 1.0 / (plane[k, 6] + plane[k, 7] * middle + plane[k, 8] * row)
        share, at, column = _mirrored(row, middle, z, depth, rotation, position, lens, clouds, wetness)
        if share == 0:
            continue
        left = min(max(column - _RUN // 2, 0), width - _RUN)
        right = left + _RUN
        for up in range(_ROWS):
            here, seen, weight = owner[row - up, first:last], line[up, first:last], shares[up, first:last]
            if at < 0:
                _take_air(here, k, air, share, seen, weight)
                continue
            _take(
                here, k, radiance[at + up, left:right], radiance[max(at + up - 3, 0), left:right],
                owner[at + up, left:right], share, seen, weight,
            )  # fmt: skip
    for up in range(_ROWS):
        _mix_row(radiance[row - up], line[up], shares[up])


@njit(cache=True, error_model="numpy")
def mirror_road(radiance, owner, depth, plane, mark, rotation, position, lens, clouds, air, wetness):
    """Blend into the road what it mirrors, found in the picture itself.

    The mirrored ray leaves the road at P in the direction d' (d with its vertical part reversed). The picture is read
    where P + s d' is seen; s is first a guess, then such that the depth agrees with the surface seen there. Eight
    neighbouring pixels of four rows share one search: in the mirror of something upright, one row down is one row up.

    Args:
        radiance: ``(h, w)`` int64 as ``shade`` leaves it; changed in place.
        owner: of ``DepthBuffers``.
        depth: of ``DepthBuffers``.
        plane: of ``DepthBuffers``.
        mark: of ``DepthBuffers``.
        rotation: ``(3, 3)`` camera from map.
        position: ``(3,)`` of the camera.
        lens: fx, fy, cx, cy.
        clouds: ``(512, 512)`` bytes of noise that says where water stands.
        air: packed radiance for rays that leave the picture.
        wetness: 0..1.
    """
    height, width = owner.shape
    tilt = rotation[0, 2] / lens[0]
    line, shares = np.zeros((_ROWS, width), np.int64), np.empty((_ROWS, width), np.uint8)
    for row in range(height - 1, _ROWS - 2, -_ROWS):
        level = (row - lens[3]) / lens[1] * rotation[1, 2] + rotation[2, 2]
        if min(level - lens[2] * tilt, level + (width - lens[2]) * tilt) > 0.0:
            break  # above the horizon
        _mirror_rows(
            row, radiance, owner, depth, plane, mark, rotation, position, lens, clouds, air, wetness, line, shares
        )


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
    kinds = [VEHICLE_KINDS[vehicle.kind] for vehicle in vehicles]
    moving = [
        (v.x_m, v.y_m, math.cos(v.yaw_rad), math.sin(v.yaw_rad), v.speed_mps, k.length_m, k.width_m, k.height_m)
        for v, k in zip(vehicles, kinds, strict=True)
        if v.speed_mps > _NO_SPRAY_MPS
    ]
    return _puffs(np.array(moving).reshape(-1, 8), rotation, position_m, wetness)


@njit(cache=True, error_model="numpy")
def _puffs(moving, rotation, position, wetness):
    out = np.empty((8 * len(moving), 6))
    n = 0
    for x, y, c, s, speed, length, width, height in moving:
        thrown = wetness * min((speed - _NO_SPRAY_MPS) / 12.0, 1.0)
        for age in range(4):
            back = 0.5 * length - 0.4 + 0.9 * age
            for side in (-1.0, 1.0):
                aside = side * 0.42 * width
                dx, dy = x - back * c - aside * s - position[0], y - back * s + aside * c - position[1]
                dz = 0.35 + 0.16 * age - position[2]
                for axis in range(3):
                    out[n, axis] = rotation[axis, 0] * dx + rotation[axis, 1] * dy + rotation[axis, 2] * dz
                out[n, 3] = (0.5 + 0.3 * age) * (0.7 + 0.3 * height)
                out[n, 4] = 0.4 * thrown * 0.8**age
                out[n, 5] = (31.0 * (x + y) + 57.0 * age + 20.0 * side) % 512.0
                n += 1
    return out[np.argsort(-out[:, 2], kind="mergesort")]
