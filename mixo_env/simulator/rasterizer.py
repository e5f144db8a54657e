"""Which patch is seen at each pixel, and how deep: a z-buffer of 1/z filled span by span.

For a patch p + s u + t v in camera coordinates and the ray d = (X, Y, 1) of a pixel, Cramer's rule gives
s/z = (v x p).d / det, t/z = (p x u).d / det and 1/z = (u x v).d / det with det = (u x v).p. All three are linear in
the pixel's column and row: perspective is exact, patches need no cutting at the image plane, and the derivatives that
choose the reduction of the texture are known in closed form.

Groups of patches are drawn from near to far in a few shells. Before each shell, groups that lie behind what is already
drawn are dropped: in a street most of the city is hidden by the first row of houses.
"""

from __future__ import annotations

import numpy as np
from numba import float32, int32
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.mesh import CUT_OUT, TWO_SIDED, PatchSet

NEAR_M = 0.2
"""Nothing nearer to the camera plane is drawn."""

SHELLS_M = (20.0, 50.0)
"""Distances at which hidden groups are looked for again."""

_TILE = 8
_EMPTY = 1e-14
_SMALL_CARD_PX = 8.0  # every second leaf card smaller than this is left out
_OPAQUE = np.uint32(110 << 24)  # coverage, the highest byte, above 110 of 255


@compiled_unchecked
def _visible_groups(groups, rotation, position, lens, width, height, far, nearest, number, tiles):
    """Groups whose bounding sphere meets the view and covers at least a pixel.

    Args:
        groups: ``(g, 4)`` spheres.
        rotation: ``(3, 3)`` camera from map.
        position: ``(3,)`` camera centre.
        lens: fx, fy, cx, cy.
        width: of the picture.
        height: of the picture.
        far: limit in metres.
        nearest: ``(g,)`` out: smallest distance along the optical axis.
        number: ``(g,)`` out: number of the group.
        tiles: ``(g, 4)`` out: first and last column, first and last row of tiles that the sphere can touch.

    Returns:
        How many.
    """
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    left, right, up, down = cx / fx, (width - cx) / fx, cy / fy, (height - cy) / fy
    slant_left, slant_right = np.sqrt(1.0 + left * left), np.sqrt(1.0 + right * right)
    slant_up, slant_down = np.sqrt(1.0 + up * up), np.sqrt(1.0 + down * down)
    count = 0
    for g in range(groups.shape[0]):
        dx, dy, dz = groups[g, 0] - position[0], groups[g, 1] - position[1], groups[g, 2] - position[2]
        r = groups[g, 3]
        z = rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz
        if z < NEAR_M - r or z > far + r or 2.0 * r * fx < z:
            continue
        x = rotation[0, 0] * dx + rotation[0, 1] * dy + rotation[0, 2] * dz
        if x < -z * left - r * slant_left or x > z * right + r * slant_right:
            continue
        y = rotation[1, 0] * dx + rotation[1, 1] * dy + rotation[1, 2] * dz
        if y < -z * up - r * slant_up or y > z * down + r * slant_down:
            continue
        nearest[count] = z - r
        number[count] = g
        tiles[count, 0], tiles[count, 1], tiles[count, 2], tiles[count, 3] = 0, width - 1, 0, height - 1
        if z - r > NEAR_M:
            near, deep = z - r, z + r
            tiles[count, 0] = max(0, int((x - r) / (deep if x > r else near) * fx + cx))
            tiles[count, 1] = min(width - 1, int((x + r) / (near if x > -r else deep) * fx + cx) + 1)
            tiles[count, 2] = max(0, int((y - r) / (deep if y > r else near) * fy + cy))
            tiles[count, 3] = min(height - 1, int((y + r) / (near if y > -r else deep) * fy + cy) + 1)
        for j in range(4):
            tiles[count, j] //= _TILE
        count += 1
    return count


@compiled_unchecked
def _farthest(depth, out):
    """Smallest 1/z of every tile of ``_TILE`` x ``_TILE`` pixels."""
    height, width = depth.shape
    line = np.empty(width, np.float32)
    for tile_row in range(out.shape[0]):
        line[:] = depth[tile_row * _TILE]
        for y in range(tile_row * _TILE + 1, min((tile_row + 1) * _TILE, height)):
            row = depth[y]
            for x in range(width):
                line[x] = row[x] if row[x] < line[x] else line[x]
        for column in range(out.shape[1]):
            least = line[column * _TILE]
            for x in range(column * _TILE + 1, min((column + 1) * _TILE, width)):
                least = min(least, line[x])
            out[tile_row, column] = least


@compiled_unchecked
def _not_hidden(farthest, nearest, tiles, chosen):
    """Those of ``chosen`` (indices into the lists of ``_visible_groups``) that may be seen."""
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
def _rows(corner, fy, cy, height):
    """First and last pixel row that the polygon's part before the camera can touch."""
    lowest, highest = 1e9, -1e9
    for j in range(4):
        k = (j + 1) % 4
        here, there = corner[j, 2], corner[k, 2]
        if here > NEAR_M:
            row = corner[j, 1] / here * fy + cy
            lowest, highest = min(lowest, row), max(highest, row)
        if (here > NEAR_M) != (there > NEAR_M):
            f = (NEAR_M - here) / (there - here)
            row = (corner[j, 1] + f * (corner[k, 1] - corner[j, 1])) / NEAR_M * fy + cy
            lowest, highest = min(lowest, row), max(highest, row)
    return max(0, int(np.ceil(max(lowest, 0.0)))), int(np.floor(min(highest, height - 1.0)))


@inlined
def _fill(depths, owners, row, begin, end, start, step, slot):
    """Keep the nearer of what is there and a span whose 1/z begins at ``start``; unconditional stores run in SIMD."""
    depth, owner = depths[row, begin : end + 1], owners[row, begin : end + 1]
    first, slope, number = float32(start), float32(step), int32(slot)
    for i in range(depth.shape[0]):
        w, before = first + slope * float32(i), depth[i]
        nearer = w > before
        depth[i] = w if nearer else before
        owner[i] = number if nearer else owner[i]


@inlined
def _fill_cut_out(plane, slot, row, begin, end, number, texels, table, depth, owner, where):
    """Like the plain fill, but only where the texture covers; one reduction per row."""
    p0, p1, p2 = plane[slot, 0] + plane[slot, 2] * row, plane[slot, 1], plane[slot, 2]
    q0, q1, q2 = plane[slot, 3] + plane[slot, 5] * row, plane[slot, 4], plane[slot, 5]
    w0, w1, w2 = plane[slot, 6] + plane[slot, 8] * row, plane[slot, 7], plane[slot, 8]
    middle = 0.5 * (begin + end)
    iz = 1.0 / (w0 + w1 * middle)
    u, v = (p0 + p1 * middle) * iz, (q0 + q1 * middle) * iz
    ratio = max(abs(p1 - u * w1) + abs(q1 - v * w1), abs(p2 - u * w2) + abs(q2 - v * w2)) * iz
    level, reduce = 0, 1.0
    while ratio > 1.4 and level < 6:
        ratio *= 0.5
        reduce *= 0.5
        level += 1
    start, log_w, log_h = table[number, level, 0], table[number, level, 1], table[number, level, 2]
    texel = reduce, log_w, (1 << log_w) - 1, (1 << log_h) - 1
    across = p0, p1, q0, q1, w0, w1
    depths, owners = depth[row, begin : end + 1], owner[row, begin : end + 1]
    _keep_covered(across, begin, texel, texels[start:], slot, where[: end + 1 - begin], depths, owners)


@inlined
def _keep_covered(across, begin, texel, texels, slot, where, depth, owner):
    """The loops of :func:`_fill_cut_out`, without branches so that they run in SIMD; ``where`` is working memory."""
    p0, p1, q0, q1, w0, w1 = across
    reduce, log_w, mask_w, mask_h = texel
    for i in range(where.shape[0]):
        column = begin + i
        iz = reduce / (w0 + w1 * column)
        tu, tv = int(np.floor((p0 + p1 * column) * iz)), int(np.floor((q0 + q1 * column) * iz))
        where[i] = ((tv & mask_h) << log_w) + (tu & mask_w)
    number = int32(slot)
    for i in range(where.shape[0]):
        w, before = float32(w0 + w1 * (begin + i)), depth[i]
        seen = (w > before) & (texels[np.uintp(where[i])] > _OPAQUE)
        depth[i] = w if seen else before
        owner[i] = number if seen else owner[i]


@inlined
def _copy(source, q, target, slot):
    for j in range(source.shape[1]):
        target[slot, j] = source[q, j]


@compiled_unchecked
def _draw(
    order, group_start, geometry, texel, look, tag, rotation, position, lens, far, texels, table, depth, owner,
    plane, style, mark, slot,
):  # fmt: skip
    """Draw the patches of the groups ``order``; see :func:`draw_patches` for the arrays. Returns the next free slot."""
    height, width = depth.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    slant_x = np.sqrt(1.0 + max(cx / fx, (width - cx) / fx) ** 2)
    slant_y = np.sqrt(1.0 + max(cy / fy, (height - cy) / fy) ** 2)
    corner = np.empty((4, 3))
    crossing = np.empty((6, 2))
    where = np.empty(width, np.int32)
    half_plane = np.empty((6, 3))  # constant + per column * x + per row * y >= 0
    for g in order:
        for q in range(group_start[g], group_start[g + 1]):
            dx, dy, dz = geometry[q, 0] - position[0], geometry[q, 1] - position[1], geometry[q, 2] - position[2]
            u0, u1, u2 = geometry[q, 3], geometry[q, 4], geometry[q, 5]
            v0, v1, v2 = geometry[q, 6], geometry[q, 7], geometry[q, 8]
            shape = tag[q, 0]
            # Which side is seen, in map coordinates: half of all patches end here.
            det = (u1 * v2 - u2 * v1) * dx + (u2 * v0 - u0 * v2) * dy + (u0 * v1 - u1 * v0) * dz
            if abs(det) < 1e-9 or (det < 0.0 and shape & (TWO_SIDED | CUT_OUT) == 0):
                continue
            ax, ay, az = abs(u0) + abs(v0), abs(u1) + abs(v1), abs(u2) + abs(v2)
            radius = 0.5 * np.sqrt(ax * ax + ay * ay + az * az)
            mx, my, mz = dx + 0.5 * (u0 + v0), dy + 0.5 * (u1 + v1), dz + 0.5 * (u2 + v2)
            z = rotation[2, 0] * mx + rotation[2, 1] * my + rotation[2, 2] * mz
            if z < NEAR_M - radius or z > far + radius or radius * fx < 0.6 * z:
                continue
            if shape & CUT_OUT != 0 and q % 2 == 1 and radius * fx < _SMALL_CARD_PX * z:
                continue
            x = rotation[0, 0] * mx + rotation[0, 1] * my + rotation[0, 2] * mz
            if x < -z * cx / fx - radius * slant_x or x > z * (width - cx) / fx + radius * slant_x:
                continue
            y = rotation[1, 0] * mx + rotation[1, 1] * my + rotation[1, 2] * mz
            if y < -z * cy / fy - radius * slant_y or y > z * (height - cy) / fy + radius * slant_y:
                continue
            px = rotation[0, 0] * dx + rotation[0, 1] * dy + rotation[0, 2] * dz
            py = rotation[1, 0] * dx + rotation[1, 1] * dy + rotation[1, 2] * dz
            pz = rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz
            ux = rotation[0, 0] * u0 + rotation[0, 1] * u1 + rotation[0, 2] * u2
            uy = rotation[1, 0] * u0 + rotation[1, 1] * u1 + rotation[1, 2] * u2
            uz = rotation[2, 0] * u0 + rotation[2, 1] * u1 + rotation[2, 2] * u2
            vx = rotation[0, 0] * v0 + rotation[0, 1] * v1 + rotation[0, 2] * v2
            vy = rotation[1, 0] * v0 + rotation[1, 1] * v1 + rotation[1, 2] * v2
            vz = rotation[2, 0] * v0 + rotation[2, 1] * v1 + rotation[2, 2] * v2
            corner[0, 0], corner[0, 1], corner[0, 2] = px, py, pz
            corner[1, 0], corner[1, 1], corner[1, 2] = px + ux, py + uy, pz + uz
            corner[2, 0], corner[2, 1], corner[2, 2] = px + ux + vx, py + uy + vy, pz + uz + vz
            corner[3, 0], corner[3, 1], corner[3, 2] = px + vx, py + vy, pz + vz
            first, last = _rows(corner, fy, cy, height)
            if first > last:
                continue

            i = 1.0 / det
            s1, s2, s0 = (vy * pz - vz * py) * i / fx, (vz * px - vx * pz) * i / fy, (vx * py - vy * px) * i
            t1, t2, t0 = (py * uz - pz * uy) * i / fx, (pz * ux - px * uz) * i / fy, (px * uy - py * ux) * i
            w1, w2, w0 = (uy * vz - uz * vy) * i / fx, (uz * vx - ux * vz) * i / fy, (ux * vy - uy * vx) * i
            s0, t0, w0 = s0 - s1 * cx - s2 * cy, t0 - t1 * cx - t2 * cy, w0 - w1 * cx - w2 * cy
            half_plane[0, 0], half_plane[0, 1], half_plane[0, 2] = s0, s1, s2
            half_plane[1, 0], half_plane[1, 1], half_plane[1, 2] = t0, t1, t2
            half_plane[2, 0], half_plane[2, 1], half_plane[2, 2] = w0 - 1.0 / far, w1, w2
            half_plane[3, 0], half_plane[3, 1], half_plane[3, 2] = 1.0 / NEAR_M - w0, -w1, -w2
            half_plane[4, 0], half_plane[4, 1], half_plane[4, 2] = w0 - s0, w1 - s1, w2 - s2
            half_plane[5, 0], half_plane[5, 1], half_plane[5, 2] = w0 - t0, w1 - t1, w2 - t2
            for e in range(6):  # the column at which each half-plane begins or ends, linear in the row
                inverse = -1.0 / half_plane[e, 1] if abs(half_plane[e, 1]) > _EMPTY else 1.0
                crossing[e, 0], crossing[e, 1] = half_plane[e, 0] * inverse, half_plane[e, 2] * inverse
            taken = False
            for row in range(first, last + 1):
                low, high = 0.0, width - 1.0
                for e in range(6):
                    bound = crossing[e, 0] + crossing[e, 1] * row
                    if half_plane[e, 1] > _EMPTY:
                        low = max(low, bound)
                    elif half_plane[e, 1] < -_EMPTY:
                        high = min(high, bound)
                    elif bound < 0.0:
                        high = -1.0
                begin, end = int(np.ceil(low)), int(np.floor(high))
                if begin > end:
                    continue
                if not taken:
                    taken = True
                    # Texel column/z and row/z are sums of s/z, t/z and 1/z.
                    for j in range(2):
                        a, b, c = texel[q, 3 * j], texel[q, 3 * j + 1], texel[q, 3 * j + 2]
                        plane[slot, 3 * j] = a * s0 + b * t0 + c * w0
                        plane[slot, 3 * j + 1] = a * s1 + b * t1 + c * w1
                        plane[slot, 3 * j + 2] = a * s2 + b * t2 + c * w2
                    plane[slot, 6], plane[slot, 7], plane[slot, 8] = w0, w1, w2
                    _copy(look, q, style, slot)
                    _copy(tag, q, mark, slot)
                if shape & CUT_OUT != 0:
                    _fill_cut_out(plane, slot, row, begin, end, tag[q, 2], texels, table, depth, owner, where)
                    continue
                _fill(depth, owner, row, begin, end, w0 + w2 * row + w1 * begin, w1, slot)
            if taken:
                slot += 1
    return slot


@compiled_unchecked
def _draw_sets(sets, rotation, position, lens, far, texels, table, depth, owner, tiles, plane, style, mark):
    """Draw all that can be seen; see :meth:`DepthBuffers.draw_patches`.

    Returns:
        0, or the number of slots that are needed where ``plane`` has fewer; then nothing was drawn.
    """
    height, width = depth.shape
    groups = 0
    for patches in sets:
        groups += len(patches[0])
    nearest, number, touched = np.empty(groups), np.empty(groups, np.int64), np.empty((groups, 4), np.int64)
    order, bounds = np.empty(groups, np.int64), np.zeros(len(sets) + 1, np.int64)
    slots = 0
    for n, patches in enumerate(sets):
        first, group_start = bounds[n], patches[1]
        found = first + _visible_groups(
            patches[0], rotation, position, lens, width, height, far, nearest[first:], number[first:], touched[first:]
        )
        order[first:found] = first + np.argsort(nearest[first:found], kind="mergesort")
        for i in range(first, found):
            slots += group_start[number[i] + 1] - group_start[number[i]]
        bounds[n + 1] = found
    if slots > len(plane):
        return slots
    depth[:] = 0.0
    owner[:] = -1
    begin, slot = bounds[:-1].copy(), 0
    for shell in range(len(SHELLS_M) + 1):
        if shell > 0:
            _farthest(depth, tiles)
        limit = SHELLS_M[shell] if shell < len(SHELLS_M) else np.inf
        for n, (_, group_start, geometry, texel, look, tag) in enumerate(sets):
            end = begin[n]
            while end < bounds[n + 1] and nearest[order[end]] < limit:
                end += 1
            chosen = order[begin[n] : end]
            begin[n] = end
            if shell > 0:
                chosen = _not_hidden(tiles, nearest, touched, chosen)
            slot = _draw(
                number[chosen], group_start, geometry, texel, look, tag, rotation, position, lens, far, texels, table,
                depth, owner, plane, style, mark, slot,
            )  # fmt: skip
    return 0


class DepthBuffers:
    """What is seen at each pixel of one picture size; filled anew by every :func:`draw_patches`.

    Args:
        depth: memory for the depths, ``(h, w)`` float32.
        owner: memory for the owners, ``(h, w)`` int32.

    Attributes:
        depth: ``(h, w)`` float32 1/z, 0 where nothing is seen.
        owner: ``(h, w)`` int32 slot of the patch that is seen, -1 for the sky.
        plane: ``(slots, 9)`` texel column/z, texel row/z and 1/z as constant, per column and per row of pixels.
        style: ``(slots, 13)`` ``PatchSet.look`` of the slot's patch.
        mark: ``(slots, 4)`` ``PatchSet.tag`` of the slot's patch.
    """

    def __init__(self, depth: NDArray[np.float32], owner: NDArray[np.int32]) -> None:
        self.depth: NDArray[np.float32] = depth
        self.owner: NDArray[np.int32] = owner
        height, width = depth.shape
        self._tiles = np.empty((-(-height // _TILE), -(-width // _TILE)), np.float32)
        self._resize(16384)

    def _resize(self, slots: int) -> None:
        self.plane = np.empty((slots, 9))
        self.style = np.empty((slots, 13), np.float32)
        self.mark = np.empty((slots, 4), np.int32)

    def draw_patches(
        self,
        sets: tuple[PatchSet, ...],
        rotation: NDArray[np.float64],
        position_m: NDArray[np.float64],
        lens: NDArray[np.float64],
        far_m: float,
        texels: NDArray[np.uint32],
        table: NDArray[np.int64],
    ) -> None:
        """Draw all that can be seen.

        Args:
            sets: patches; a camera sees the nearest of all sets.
            rotation: ``(3, 3)`` camera from map.
            position_m: ``(3,)`` camera centre, map frame.
            lens: fx, fy, cx, cy in pixels; pixel centres at whole numbers.
            far_m: nothing farther than this is drawn.
            texels: of the atlas (cut-out patches look at their coverage).
            table: of the atlas.
        """
        arrays = tuple((p.groups, p.group_start, p.geometry, p.texel, p.look, p.tag) for p in sets)
        view = rotation, position_m, lens, far_m, texels, table, self.depth, self.owner, self._tiles
        while slots := _draw_sets(arrays, *view, self.plane, self.style, self.mark):
            self._resize(2 * slots)
