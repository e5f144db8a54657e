"""What cannot be seen and need not be drawn: beside the picture, too far, too small, or hidden behind nearer things.

Whole groups of patches are looked at first, by their bounding spheres, then the patches of those that are left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.city.mesh import PatchSet
from mixo_env.simulator.picture.views import Bools, Float32s, Float64s, Int64s, Point, View

NEAR_M = 0.2
"""Nothing nearer to the camera plane is drawn."""

TILE = 8
"""Side in pixels of the squares in which hidden groups are looked for: a row of one fills a SIMD register."""


class Found(NamedTuple):
    """Groups that meet the view.

    Attributes:
        nearest: smallest distance along the optical axis, metres.
        number: of the group.
        tiles: ``(g, 4)`` first and last column, first and last row of tiles that its sphere can touch.
    """

    nearest: Float64s
    number: Int64s
    tiles: Int64s


@inlined
def turned(rotation: Float64s, x: float, y: float, z: float) -> Point:
    """A vector of the map in camera coordinates."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


class Frustum(NamedTuple):
    """What a picture shows, as sideways over depth at its four edges, and 1 / cosine of the angle of each."""

    left: float
    right: float
    up: float
    down: float
    slant_left: float
    slant_right: float
    slant_up: float
    slant_down: float


@inlined
def _frustum(view: View, shape: tuple[int, int]) -> Frustum:
    """Of a camera whose pictures have ``shape``, height and width."""
    height, width = shape
    left, right, up, down = (
        view.cx / view.fx,
        (width - view.cx) / view.fx,
        view.cy / view.fy,
        (height - view.cy) / view.fy,
    )
    return Frustum(
        left, right, up, down,
        np.sqrt(1.0 + left * left), np.sqrt(1.0 + right * right), np.sqrt(1.0 + up * up), np.sqrt(1.0 + down * down),
    )  # fmt: skip


@inlined
def _meets(centre: Point, r: float, view: View, edges: Frustum) -> bool:
    """Whether a sphere in camera coordinates meets the view and covers at least a pixel."""
    x, y, z = centre
    # Behind, beyond sight or too small; then beside the picture.
    if z < NEAR_M - r or z > view.far_m + r or 2.0 * r * view.fx < z:
        return False
    if x < -z * edges.left - r * edges.slant_left or x > z * edges.right + r * edges.slant_right:
        return False
    return not (y < -z * edges.up - r * edges.slant_up or y > z * edges.down + r * edges.slant_down)


@inlined
def _centre(sphere: Float64s, view: View) -> Point:
    """Of a row of ``PatchSet.groups``, in camera coordinates."""
    position = view.position_m
    return turned(view.rotation, sphere[0] - position[0], sphere[1] - position[1], sphere[2] - position[2])


@compiled_unchecked
def spheres_in_view(groups: Float64s, view: View, shape: tuple[int, int]) -> Bools:
    """Which bounding spheres meet the view and cover at least a pixel.

    Args:
        groups: ``(g, 4)`` spheres.
        view: of the camera.
        shape: height and width of the picture.
    """
    edges, out = _frustum(view, shape), np.empty(len(groups), np.bool_)
    for g in range(len(groups)):
        out[g] = _meets(_centre(groups[g], view), groups[g, 3], view, edges)
    return out


@compiled_unchecked
def _visible_groups(groups: Float64s, view: View, shape: tuple[int, int], found: Found) -> int:
    """Groups whose bounding sphere meets the view and covers at least a pixel.

    Args:
        groups: ``(g, 4)`` spheres.
        view: of the camera.
        shape: height and width of the picture.
        found: out, room for all groups.

    Returns:
        How many.
    """
    edges, count = _frustum(view, shape), 0
    for g in range(groups.shape[0]):
        r, centre = groups[g, 3], _centre(groups[g], view)
        if not _meets(centre, r, view, edges):
            continue
        found.nearest[count] = centre[2] - r
        found.number[count] = g
        _touched(view, shape, centre, r, found.tiles[count])
        count += 1
    return count


@inlined
def _touched(view: View, shape: tuple[int, int], centre: Point, r: float, tiles: Int64s) -> None:
    """Tiles that a sphere can touch: all if it reaches the camera's plane."""
    height, width = shape
    x, y, z = centre
    tiles[0], tiles[1], tiles[2], tiles[3] = 0, width - 1, 0, height - 1
    if z - r > NEAR_M:
        # Either side is seen at the distance, near or far, that puts it farther out.
        near, deep = z - r, z + r
        tiles[0] = max(0, int((x - r) / (deep if x > r else near) * view.fx + view.cx))
        tiles[1] = min(width - 1, int((x + r) / (near if x > -r else deep) * view.fx + view.cx) + 1)
        tiles[2] = max(0, int((y - r) / (deep if y > r else near) * view.fy + view.cy))
        tiles[3] = min(height - 1, int((y + r) / (near if y > -r else deep) * view.fy + view.cy) + 1)
    for j in range(4):
        tiles[j] //= TILE


@compiled_unchecked
def find_groups(
    sets: tuple[PatchSet, ...], view: View, shape: tuple[int, int], found: Found, order: Int64s, bounds: Int64s
) -> int:
    """Groups that meet the view, nearest first within each set, and how many patches they have.

    Args:
        sets: patches.
        view: of the camera.
        shape: height and width of the picture.
        found: out, the groups of one set after those of the other.
        order: out, indices into ``found`` from near to far.
        bounds: ``(sets + 1,)`` out, where the groups of each set begin in both.
    """
    slots = 0
    for n, patches in enumerate(sets):
        first = bounds[n]
        rest = Found(found.nearest[first:], found.number[first:], found.tiles[first:])
        stop = first + _visible_groups(patches.groups, view, shape, rest)
        order[first:stop] = first + np.argsort(found.nearest[first:stop], kind="mergesort")
        for i in range(first, stop):
            slots += int(patches.group_start[found.number[i] + 1] - patches.group_start[found.number[i]])
        bounds[n + 1] = stop
    return slots


@compiled_unchecked
def farthest(depth: Float32s, out: Float32s) -> None:
    """Smallest 1/z of every tile of ``TILE`` x ``TILE`` pixels."""
    height, width = depth.shape
    line = np.empty(width, np.float32)
    for tile_row in range(out.shape[0]):
        line[:] = depth[tile_row * TILE]
        for y in range(tile_row * TILE + 1, min((tile_row + 1) * TILE, height)):
            row = depth[y]
            for x in range(width):
                line[x] = row[x] if row[x] < line[x] else line[x]
        for column in range(out.shape[1]):
            least = line[column * TILE]
            for x in range(column * TILE + 1, min((column + 1) * TILE, width)):
                least = min(least, line[x])
            out[tile_row, column] = least


@compiled_unchecked
def not_hidden(farthest: Float32s, found: Found, chosen: Int64s) -> Int64s:
    """Those of ``chosen`` (indices into ``found``) that may be seen: nearer than what some tile shows everywhere."""
    nearest, tiles = found.nearest, found.tiles
    kept = np.empty_like(chosen)
    count = 0
    for i in chosen:
        seen = nearest[i] <= NEAR_M
        row = tiles[i, 2]
        while row <= tiles[i, 3] and not seen:
            for column in range(tiles[i, 0], tiles[i, 1] + 1):
                if farthest[row, column] * nearest[i] < 1.0:
                    seen = True
                    break
            row += 1
        if seen:
            kept[count] = i
            count += 1
    return kept[:count]


@inlined
def signed_volume(g: Float64s, position: Float64s) -> float:
    """(u x v).p of a patch: its sign tells which side is seen, and no rotation changes it."""
    dx, dy, dz = g[0] - position[0], g[1] - position[1], g[2] - position[2]
    u0, u1, u2 = g[3], g[4], g[5]
    v0, v1, v2 = g[6], g[7], g[8]
    return (u1 * v2 - u2 * v1) * dx + (u2 * v0 - u0 * v2) * dy + (u0 * v1 - u1 * v0) * dz


@inlined
def meets_view(g: Float64s, view: View, shape: tuple[int, int], slant: tuple[float, float], least_px: float) -> bool:
    """Whether a patch's bounding sphere meets the view and its radius is seen as ``least_px`` pixels or more.

    Args:
        g: row of ``PatchSet.geometry``.
        view: of the camera.
        shape: height and width of the picture.
        slant: 1 / cosine of the largest angle to the optical axis, along columns and along rows.
        least_px: smaller patches are left out.
    """
    height, width = shape
    slant_x, slant_y = slant
    fx, fy, cx, cy, position = view.fx, view.fy, view.cx, view.cy, view.position_m
    dx, dy, dz = g[0] - position[0], g[1] - position[1], g[2] - position[2]
    u0, u1, u2 = g[3], g[4], g[5]
    v0, v1, v2 = g[6], g[7], g[8]
    ax, ay, az = abs(u0) + abs(v0), abs(u1) + abs(v1), abs(u2) + abs(v2)  # no diagonal is longer
    radius = 0.5 * np.sqrt(ax * ax + ay * ay + az * az)
    x, y, z = turned(view.rotation, dx + 0.5 * (u0 + v0), dy + 0.5 * (u1 + v1), dz + 0.5 * (u2 + v2))
    if z < NEAR_M - radius or z > view.far_m + radius or radius * fx < least_px * z:
        return False
    if x < -z * cx / fx - radius * slant_x or x > z * (width - cx) / fx + radius * slant_x:
        return False
    return not (y < -z * cy / fy - radius * slant_y or y > z * (height - cy) / fy + radius * slant_y)
