"""Which patch is seen at each pixel, and how deep: a z-buffer of 1/z filled span by span.

For a patch p + s u + t v in camera coordinates and the ray d = (X, Y, 1) of a pixel, Cramer's rule gives
s/z = (v x p).d / det, t/z = (p x u).d / det and 1/z = (u x v).d / det with det = (u x v).p. All three are linear in
the pixel's column and row: perspective is exact, patches need no cutting at the image plane, and the derivatives that
choose the reduction of the texture are known in closed form.

Groups of patches are drawn from near to far in a few shells. Before each shell, groups that lie behind what is already
drawn are dropped: in a street most of the city is hidden by the first row of houses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import float32, int32
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.city.mesh import CUT_OUT, TWO_SIDED, PatchSet
from mixo_env.simulator.picture.culling import (
    NEAR_M,
    TILE,
    Found,
    farthest,
    find_groups,
    meets_view,
    not_hidden,
    signed_volume,
    turned,
)
from mixo_env.simulator.picture.spans import whole
from mixo_env.simulator.picture.views import (
    SIDES,
    TEXTURE,
    U_COLUMN,
    U_CONSTANT,
    U_ROW,
    V_COLUMN,
    V_CONSTANT,
    V_ROW,
    W_COLUMN,
    W_CONSTANT,
    W_ROW,
    Float32s,
    Float64s,
    Int32s,
    Int64s,
    Point,
    Seen,
    Textures,
    UInt32s,
    View,
)

SHELLS_M = (20.0, 50.0)
"""Distances at which hidden groups are looked for again."""

_EMPTY = 1e-14  # a half-plane whose edge is steeper than this covers whole rows or none
_EDGE_ON = 1e-9  # cubic metres: the camera lies in the plane of the patch
_SMALLEST_PX = 0.6  # radius; smaller patches would only flicker
_SMALL_CARD_PX = 8.0  # every second leaf card smaller than this is left out
_OPAQUE = np.uint32(110 << 24)  # coverage, the highest byte, above 110 of 255
_COARSEST = 6  # reduction in which leaves are looked at: in coarser ones none are left
_SLOTS = 16384  # to begin with; more are made when a view needs them


class Work(NamedTuple):
    """Working memory of :func:`_draw`.

    Attributes:
        corner: ``(4, 3)`` of a patch, camera coordinates.
        half_plane: ``(6, 3)`` constant + per column * x + per row * y >= 0 inside.
        crossing: ``(6, 2)`` column at which each of them begins or ends: constant + per row * y.
        where: ``(w,)`` texels along a row, and up to seven more.
    """

    corner: Float64s
    half_plane: Float64s
    crossing: Float64s
    where: Int32s


class Ratios(NamedTuple):
    """s/z, t/z and w = 1/z of a patch over the picture: each at pixel (0, 0), per column and per row."""

    s0: float
    s1: float
    s2: float
    t0: float
    t1: float
    t2: float
    w0: float
    w1: float
    w2: float


class Span(NamedTuple):
    """Pixels ``begin`` to ``end`` of a row, both included."""

    row: int
    begin: int
    end: int


@inlined
def _rows(corner: Float64s, fy: float, cy: float, height: int) -> tuple[int, int]:
    """First and last pixel row that the polygon's part before the camera can touch."""
    lowest, highest = 1e9, -1e9
    for j in range(4):
        k = (j + 1) % 4
        here, there = corner[j, 2], corner[k, 2]
        if here > NEAR_M:
            row = corner[j, 1] / here * fy + cy
            lowest, highest = min(lowest, row), max(highest, row)
        if (here > NEAR_M) != (there > NEAR_M):  # where the edge comes out of the near plane
            f = (NEAR_M - here) / (there - here)
            row = (corner[j, 1] + f * (corner[k, 1] - corner[j, 1])) / NEAR_M * fy + cy
            lowest, highest = min(lowest, row), max(highest, row)
    return max(0, int(np.ceil(max(lowest, 0.0)))), int(np.floor(min(highest, height - 1.0)))


@inlined
def _fill(depths: Float32s, owners: Int32s, span: Span, start: float, step: float, slot: int) -> None:
    """Keep the nearer of what is there and a span whose 1/z begins at ``start``; unconditional stores run in SIMD."""
    depth, owner = depths[span.row, span.begin : span.end + 1], owners[span.row, span.begin : span.end + 1]
    first, slope, number = float32(start), float32(step), int32(slot)
    for i in range(depth.shape[0]):
        w, before = first + slope * float32(int32(i)), depth[i]
        nearer = w > before
        depth[i] = w if nearer else before
        owner[i] = number if nearer else owner[i]


@inlined
def _fill_cut_out(seen: Seen, slot: int, span: Span, number: int, textures: Textures, where: Int32s) -> None:
    """Like the plain fill, but only where the texture covers; one reduction per row."""
    plane, table, row, begin, end = seen.plane[slot], textures.table, span.row, span.begin, span.end
    p0, p1, p2 = plane[U_CONSTANT] + plane[U_ROW] * row, plane[U_COLUMN], plane[U_ROW]
    q0, q1, q2 = plane[V_CONSTANT] + plane[V_ROW] * row, plane[V_COLUMN], plane[V_ROW]
    w0, w1, w2 = plane[W_CONSTANT] + plane[W_ROW] * row, plane[W_COLUMN], plane[W_ROW]
    # Texels per pixel in the middle of the span choose the reduction.
    middle = 0.5 * (begin + end)
    iz = 1.0 / (w0 + w1 * middle)
    u, v = (p0 + p1 * middle) * iz, (q0 + q1 * middle) * iz
    ratio = max(abs(p1 - u * w1) + abs(q1 - v * w1), abs(p2 - u * w2) + abs(q2 - v * w2)) * iz
    level, reduce = 0, 1.0
    while ratio > 1.4 and level < _COARSEST:
        ratio *= 0.5
        reduce *= 0.5
        level += 1
    start, log_w, log_h = table[number, level, 0], table[number, level, 1], table[number, level, 2]
    size = reduce, log_w, (1 << log_w) - 1, (1 << log_h) - 1
    across = p0, p1, q0, q1, w0, w1
    _find_texels(across, begin, size, where[: whole(end + 1 - begin)])
    depths, owners = seen.depth[row, begin : end + 1], seen.owner[row, begin : end + 1]
    _keep_covered((w0, w1), begin, textures.texels[start:], slot, where[: end + 1 - begin], depths, owners)


@inlined
def _find_texels(
    across: tuple[float, float, float, float, float, float],
    begin: int,
    size: tuple[float, int, int, int],
    where: Int32s,
) -> None:
    """Texels along a span; without branches, as the next function, so that both run in SIMD.

    Args:
        across: constant and step per column of texel column/z, texel row/z and 1/z.
        begin: first column.
        size: scale of the reduction, log2 of its width, width - 1 and height - 1.
        where: out.
    """
    p0, p1, q0, q1, w0, w1 = across
    reduce, log_w, mask_w, mask_h = size
    for i in range(where.shape[0]):
        column = begin + i
        iz = reduce / (w0 + w1 * column)
        tu, tv = int(np.floor((p0 + p1 * column) * iz)), int(np.floor((q0 + q1 * column) * iz))
        where[i] = ((tv & mask_h) << log_w) + (tu & mask_w)


@inlined
def _keep_covered(
    inverse: tuple[float, float],
    begin: int,
    texels: UInt32s,
    slot: int,
    where: Int32s,
    depth: Float32s,
    owner: Int32s,
) -> None:
    """Put slot ``slot`` into a span where it is nearer and its texel covers; ``inverse`` is the span's 1/z."""
    w0, w1 = inverse
    number = int32(slot)
    for i in range(where.shape[0]):
        w, before = float32(w0 + w1 * (begin + i)), depth[i]
        seen = (w > before) & (texels[np.uintp(where[i])] > _OPAQUE)
        depth[i] = w if seen else before
        owner[i] = number if seen else owner[i]


@inlined
def _in_camera(g: Float64s, view: View, corner: Float64s) -> tuple[Point, Point, Point]:
    """Origin and edges of a patch in camera coordinates; writes its corners in a round."""
    position = view.position_m
    p = turned(view.rotation, g[0] - position[0], g[1] - position[1], g[2] - position[2])
    u = turned(view.rotation, g[3], g[4], g[5])
    v = turned(view.rotation, g[6], g[7], g[8])
    for axis in range(3):
        corner[0, axis] = p[axis]
        corner[1, axis] = p[axis] + u[axis]
        corner[2, axis] = p[axis] + u[axis] + v[axis]
        corner[3, axis] = p[axis] + v[axis]
    return p, u, v


@inlined
def _ratios(p: Point, u: Point, v: Point, det: float, view: View) -> Ratios:
    """Cramer's rule of the module's text, written out in columns and rows of pixels."""
    px, py, pz = p
    ux, uy, uz = u
    vx, vy, vz = v
    fx, fy, cx, cy = view.fx, view.fy, view.cx, view.cy
    i = 1.0 / det
    s1, s2, s0 = (vy * pz - vz * py) * i / fx, (vz * px - vx * pz) * i / fy, (vx * py - vy * px) * i
    t1, t2, t0 = (py * uz - pz * uy) * i / fx, (pz * ux - px * uz) * i / fy, (px * uy - py * ux) * i
    w1, w2, w0 = (uy * vz - uz * vy) * i / fx, (uz * vx - ux * vz) * i / fy, (ux * vy - uy * vx) * i
    # The ray of pixel (0, 0) is not the optical axis.
    s0, t0, w0 = s0 - s1 * cx - s2 * cy, t0 - t1 * cx - t2 * cy, w0 - w1 * cx - w2 * cy
    return Ratios(s0, s1, s2, t0, t1, t2, w0, w1, w2)


@inlined
def _half_planes(r: Ratios, far_m: float, work: Work) -> None:
    """The patch in the picture as the intersection of six half-planes, and where each cuts a row of pixels."""
    half_plane, crossing = work.half_plane, work.crossing
    # s >= 0, t >= 0, near enough, far enough, s <= 1, t <= 1; all times 1/z.
    half_plane[0, 0], half_plane[0, 1], half_plane[0, 2] = r.s0, r.s1, r.s2
    half_plane[1, 0], half_plane[1, 1], half_plane[1, 2] = r.t0, r.t1, r.t2
    half_plane[2, 0], half_plane[2, 1], half_plane[2, 2] = r.w0 - 1.0 / far_m, r.w1, r.w2
    half_plane[3, 0], half_plane[3, 1], half_plane[3, 2] = 1.0 / NEAR_M - r.w0, -r.w1, -r.w2
    half_plane[4, 0], half_plane[4, 1], half_plane[4, 2] = r.w0 - r.s0, r.w1 - r.s1, r.w2 - r.s2
    half_plane[5, 0], half_plane[5, 1], half_plane[5, 2] = r.w0 - r.t0, r.w1 - r.t1, r.w2 - r.t2
    for e in range(6):
        inverse = -1.0 / half_plane[e, 1] if abs(half_plane[e, 1]) > _EMPTY else 1.0
        crossing[e, 0], crossing[e, 1] = half_plane[e, 0] * inverse, half_plane[e, 2] * inverse


@inlined
def _columns(work: Work, row: int, width: int) -> tuple[int, int]:
    """First and last column of a row inside all half-planes; the last is before the first if there is none."""
    half_plane, crossing = work.half_plane, work.crossing
    low, high = 0.0, width - 1.0
    for e in range(6):
        bound = crossing[e, 0] + crossing[e, 1] * row
        if half_plane[e, 1] > _EMPTY:
            low = max(low, bound)
        elif half_plane[e, 1] < -_EMPTY:
            high = min(high, bound)
        elif bound < 0.0:  # the whole row is outside
            high = -1.0
    return int(np.ceil(low)), int(np.floor(high))


@inlined
def _take_slot(patches: PatchSet, q: int, r: Ratios, seen: Seen, slot: int) -> None:
    """Note patch ``q`` as seen. Texel column/z and row/z are sums of s/z, t/z and 1/z."""
    plane = seen.plane[slot]
    for j in range(2):
        a, b, c = patches.texel[q, 3 * j], patches.texel[q, 3 * j + 1], patches.texel[q, 3 * j + 2]
        plane[3 * j] = a * r.s0 + b * r.t0 + c * r.w0
        plane[3 * j + 1] = a * r.s1 + b * r.t1 + c * r.w1
        plane[3 * j + 2] = a * r.s2 + b * r.t2 + c * r.w2
    plane[W_CONSTANT], plane[W_COLUMN], plane[W_ROW] = r.w0, r.w1, r.w2
    for j in range(seen.style.shape[1]):
        seen.style[slot, j] = patches.look[q, j]
    for j in range(seen.mark.shape[1]):
        seen.mark[slot, j] = patches.tag[q, j]


@inlined
def _draw(order: Int64s, patches: PatchSet, view: View, textures: Textures, seen: Seen, work: Work, slot: int) -> int:
    """Draw the patches of the groups ``order`` into the slots from ``slot`` on; returns the next free slot."""
    shape = height, width = seen.depth.shape
    fx, fy, cx, cy = view.fx, view.fy, view.cx, view.cy
    slant_x = np.sqrt(1.0 + max(cx / fx, (width - cx) / fx) ** 2)
    slant_y = np.sqrt(1.0 + max(cy / fy, (height - cy) / fy) ** 2)
    for n in range(order.shape[0]):
        g = order[n]
        for q in range(patches.group_start[g], patches.group_start[g + 1]):
            geometry, sides = patches.geometry[q], patches.tag[q, SIDES]
            cut_out = sides & CUT_OUT != 0
            # Half of all patches end here: their back is turned to the camera.
            det = signed_volume(geometry, view.position_m)
            if abs(det) < _EDGE_ON or (det < 0.0 and sides & (TWO_SIDED | CUT_OUT) == 0):
                continue
            # Most others are beside the picture or too small.
            least_px = _SMALL_CARD_PX if cut_out and q % 2 == 1 else _SMALLEST_PX
            if not meets_view(geometry, view, shape, (slant_x, slant_y), least_px):
                continue
            # Rows that it may reach.
            p, u, v = _in_camera(geometry, view, work.corner)
            first, last = _rows(work.corner, fy, cy, height)
            if first > last:
                continue
            # Texture and depth as linear functions of column and row; a slot as soon as a pixel is inside.
            ratios = _ratios(p, u, v, det, view)
            _half_planes(ratios, view.far_m, work)
            taken = False
            for row in range(first, last + 1):
                begin, end = _columns(work, row, width)
                if begin > end:
                    continue
                if not taken:
                    taken = True
                    _take_slot(patches, q, ratios, seen, slot)
                span = Span(row, begin, end)
                if cut_out:
                    _fill_cut_out(seen, slot, span, patches.tag[q, TEXTURE], textures, work.where)
                else:
                    start = ratios.w0 + ratios.w2 * row + ratios.w1 * begin
                    _fill(seen.depth, seen.owner, span, start, ratios.w1, slot)
            if taken:
                slot += 1
    return slot


@compiled_unchecked
def _draw_sets(sets: tuple[PatchSet, ...], view: View, textures: Textures, seen: Seen, tiles: Float32s) -> int:
    """Draw all that can be seen; see :meth:`DepthBuffers.draw_patches`.

    Returns:
        0, or the number of slots that are needed where ``seen`` has fewer; then nothing was drawn.
    """
    groups = 0
    for patches in sets:
        groups += len(patches.groups)
    found = Found(np.empty(groups), np.empty(groups, np.int64), np.empty((groups, 4), np.int64))
    order, bounds = np.empty(groups, np.int64), np.zeros(len(sets) + 1, np.int64)
    slots = find_groups(sets, view, seen.depth.shape, found, order, bounds)
    if slots > len(seen.plane):
        return slots
    seen.depth[:] = 0.0
    seen.owner[:] = -1
    width = seen.depth.shape[1]
    work = Work(np.empty((4, 3)), np.empty((6, 3)), np.empty((6, 2)), np.empty(whole(width), np.int32))
    begin, slot = bounds[:-1].copy(), 0
    for shell in range(len(SHELLS_M) + 1):
        if shell > 0:
            farthest(seen.depth, tiles)
        limit = SHELLS_M[shell] if shell < len(SHELLS_M) else np.inf
        for n, patches in enumerate(sets):
            # The groups of this shell, without those behind what the shells before it have drawn.
            end = begin[n]
            while end < bounds[n + 1] and found.nearest[order[end]] < limit:
                end += 1
            chosen = order[begin[n] : end]
            begin[n] = end
            if shell > 0:
                chosen = not_hidden(tiles, found, chosen)
            slot = _draw(found.number[chosen], patches, view, textures, seen, work, slot)
    return 0


class DepthBuffers:
    """What is seen at each pixel of one picture size; filled anew by every :func:`draw_patches`.

    Args:
        depth: memory for the depths, ``(h, w)``.
        owner: memory for the owners, ``(h, w)``.

    Attributes:
        seen: the result.
    """

    def __init__(self, depth: NDArray[np.float32], owner: NDArray[np.int32]) -> None:
        height, width = depth.shape
        self._tiles = np.empty((-(-height // TILE), -(-width // TILE)), np.float32)
        self.seen = _with_slots(_SLOTS, depth, owner)

    def draw_patches(self, sets: tuple[PatchSet, ...], view: View, textures: Textures) -> None:
        """Draw all that can be seen.

        Args:
            sets: patches; a camera sees the nearest of all sets.
            view: of the camera.
            textures: of the patches (cut-out patches look at their coverage).
        """
        while slots := _draw_sets(sets, view, textures, self.seen, self._tiles):
            self.seen = _with_slots(2 * slots, self.seen.depth, self.seen.owner)


def _with_slots(slots: int, depth: NDArray[np.float32], owner: NDArray[np.int32]) -> Seen:
    return Seen(depth, owner, np.empty((slots, 9)), np.empty((slots, 13), np.float32), np.empty((slots, 4), np.int32))
