"""Which patch is seen at each pixel, and how deep: a z-buffer of 1/z filled span by span.

For a patch p + s u + t v in camera coordinates and the ray d = (X, Y, 1) of a pixel, Cramer's rule gives
s/z = (v x p).d / det, t/z = (p x u).d / det and 1/z = (u x v).d / det with det = (u x v).p. All three are linear in the pixel's
column and row: perspective is exact, patches need no cutting at the image plane, and the derivatives that choose the
reduction of the texture are known in closed form.
"""

from __future__ import annotations

import numpy as np
from numba import float32, njit
from numpy.typing import NDArray

from mixo_env.simulator.mesh import CUT_OUT, TRIANGLE, TWO_SIDED

NEAR_M = 0.2
"""Nothing nearer to the camera plane is drawn."""

_ALPHA_SHIFT = 24
_EMPTY = 1e-14


@njit(cache=True, error_model="numpy")
def visible_groups(groups, rotation, position, lens, width, height, far, out_depth, out_group):
    """Groups whose bounding sphere meets the view and covers at least a pixel; their depths and numbers, returns how many."""
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    left, right, up, down = cx / fx, (width - cx) / fx, cy / fy, (height - cy) / fy
    slant_left, slant_right = np.sqrt(1.0 + left * left), np.sqrt(1.0 + right * right)
    slant_up, slant_down = np.sqrt(1.0 + up * up), np.sqrt(1.0 + down * down)
    count = 0
    for g in range(groups.shape[0]):
        dx, dy, dz = groups[g, 0] - position[0], groups[g, 1] - position[1], groups[g, 2] - position[2]
        radius = groups[g, 3]
        z = rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz
        if z < NEAR_M - radius or z > far + radius or 2.0 * radius * fx < z:
            continue
        x = rotation[0, 0] * dx + rotation[0, 1] * dy + rotation[0, 2] * dz
        if x < -z * left - radius * slant_left or x > z * right + radius * slant_right:
            continue
        y = rotation[1, 0] * dx + rotation[1, 1] * dy + rotation[1, 2] * dz
        if y < -z * up - radius * slant_up or y > z * down + radius * slant_down:
            continue
        out_depth[count] = z - radius
        out_group[count] = g
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def draw_groups(
    order,
    group_start,
    geometry,
    texel,
    tag,
    look,
    rotation,
    position,
    lens,
    far,
    texels,
    table,
    depth,
    owner,
    plane,
    style,
    mark,
    slot,
):
    """Draw the patches of the groups ``order`` into ``depth`` and ``owner``.

    Args:
        order: numbers of the groups, nearest first.
        group_start, geometry, texel, tag, look: of a ``PatchSet``.
        rotation: ``(3, 3)`` camera from map.
        position: ``(3,)`` camera centre, map frame, metres.
        lens: fx, fy, cx, cy in pixels; pixel centres at whole numbers.
        far: nothing farther than this many metres is drawn.
        texels, table: of the atlas.
        depth: ``(h, w)`` float32 1/z, 0 where nothing is seen; updated.
        owner: ``(h, w)`` int32 slot seen at the pixel, -1 for the sky; updated.
        plane: ``(slots, 9)`` float64 out: texel column/z, texel row/z and 1/z as constant, per column and per row of pixels.
        style, mark: ``(slots, 13)`` and ``(slots, 4)`` out: ``look`` and ``tag`` of the slot's patch.
        slot: first free slot.

    Returns:
        The next free slot. Only patches that cover a pixel centre take one.
    """
    height, width = depth.shape
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    left, right, up, down = cx / fx, (width - cx) / fx, cy / fy, (height - cy) / fy
    slant_x = np.sqrt(1.0 + max(left, right) ** 2)
    slant_y = np.sqrt(1.0 + max(up, down) ** 2)
    corner = np.empty((4, 3))
    edge = np.empty((6, 3))  # half-planes: constant + per column * x + per row * y >= 0
    for index in range(order.shape[0]):
        g = order[index]
        for q in range(group_start[g], group_start[g + 1]):
            dx, dy, dz = geometry[q, 0] - position[0], geometry[q, 1] - position[1], geometry[q, 2] - position[2]
            u0, u1, u2 = geometry[q, 3], geometry[q, 4], geometry[q, 5]
            v0, v1, v2 = geometry[q, 6], geometry[q, 7], geometry[q, 8]
            shape = tag[q, 0]
            # The plane's side first, in map coordinates: half of all patches end here.
            normal0, normal1, normal2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
            det = normal0 * dx + normal1 * dy + normal2 * dz
            if abs(det) < 1e-9 or (det < 0.0 and shape & (TWO_SIDED | CUT_OUT) == 0):
                continue
            ax, ay, az = abs(u0) + abs(v0), abs(u1) + abs(v1), abs(u2) + abs(v2)
            radius = 0.5 * np.sqrt(ax * ax + ay * ay + az * az)
            mx, my, mz = dx + 0.5 * (u0 + v0), dy + 0.5 * (u1 + v1), dz + 0.5 * (u2 + v2)
            z = rotation[2, 0] * mx + rotation[2, 1] * my + rotation[2, 2] * mz
            if z < NEAR_M - radius or z > far + radius or radius * fx < 0.4 * z:
                continue
            x = rotation[0, 0] * mx + rotation[0, 1] * my + rotation[0, 2] * mz
            if x < -z * left - radius * slant_x or x > z * right + radius * slant_x:
                continue
            y = rotation[1, 0] * mx + rotation[1, 1] * my + rotation[1, 2] * mz
            if y < -z * up - radius * slant_y or y > z * down + radius * slant_y:
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
            triangle = shape & TRIANGLE != 0

            # Rows that the part in front of the camera can touch.
            corner[0, 0], corner[0, 1], corner[0, 2] = px, py, pz
            corner[1, 0], corner[1, 1], corner[1, 2] = px + ux, py + uy, pz + uz
            corners = 3
            if triangle:
                corner[2, 0], corner[2, 1], corner[2, 2] = px + vx, py + vy, pz + vz
            else:
                corners = 4
                corner[2, 0], corner[2, 1], corner[2, 2] = px + ux + vx, py + uy + vy, pz + uz + vz
                corner[3, 0], corner[3, 1], corner[3, 2] = px + vx, py + vy, pz + vz
            lowest, highest = 1e9, -1e9
            for j in range(corners):
                k = j + 1 if j + 1 < corners else 0
                za, zb = corner[j, 2], corner[k, 2]
                if za > NEAR_M:
                    row = corner[j, 1] / za * fy + cy
                    lowest, highest = min(lowest, row), max(highest, row)
                if (za > NEAR_M) != (zb > NEAR_M):
                    f = (NEAR_M - za) / (zb - za)
                    row = (corner[j, 1] + f * (corner[k, 1] - corner[j, 1])) / NEAR_M * fy + cy
                    lowest, highest = min(lowest, row), max(highest, row)
            first, last = max(0, int(np.ceil(max(lowest, 0.0)))), int(np.floor(min(highest, height - 1.0)))
            if first > last:
                continue

            i = 1.0 / det
            a0, a1, a2 = (vy * pz - vz * py) * i, (vz * px - vx * pz) * i, (vx * py - vy * px) * i
            b0, b1, b2 = (py * uz - pz * uy) * i, (pz * ux - px * uz) * i, (px * uy - py * ux) * i
            c0, c1, c2 = (uy * vz - uz * vy) * i, (uz * vx - ux * vz) * i, (ux * vy - uy * vx) * i
            s1, s2 = a0 / fx, a1 / fy
            t1, t2 = b0 / fx, b1 / fy
            w1, w2 = c0 / fx, c1 / fy
            s0, t0, w0 = a2 - s1 * cx - s2 * cy, b2 - t1 * cx - t2 * cy, c2 - w1 * cx - w2 * cy
            edge[0, 0], edge[0, 1], edge[0, 2] = s0, s1, s2
            edge[1, 0], edge[1, 1], edge[1, 2] = t0, t1, t2
            if triangle:
                edge[2, 0], edge[2, 1], edge[2, 2] = w0 - s0 - t0, w1 - s1 - t1, w2 - s2 - t2
                edge[3, 0], edge[3, 1], edge[3, 2] = 1.0, 0.0, 0.0
            else:
                edge[2, 0], edge[2, 1], edge[2, 2] = w0 - s0, w1 - s1, w2 - s2
                edge[3, 0], edge[3, 1], edge[3, 2] = w0 - t0, w1 - t1, w2 - t2
            edge[4, 0], edge[4, 1], edge[4, 2] = w0 - 1.0 / far, w1, w2
            edge[5, 0], edge[5, 1], edge[5, 2] = 1.0 / NEAR_M - w0, -w1, -w2
            # Texel coordinates over z share the form of s/z and t/z.
            m0, m1, m2, m3, m4, m5 = texel[q, 0], texel[q, 1], texel[q, 2], texel[q, 3], texel[q, 4], texel[q, 5]
            p0, p1, p2 = m0 * s0 + m1 * t0 + m2 * w0, m0 * s1 + m1 * t1 + m2 * w1, m0 * s2 + m1 * t2 + m2 * w2
            q0, q1, q2 = m3 * s0 + m4 * t0 + m5 * w0, m3 * s1 + m4 * t1 + m5 * w1, m3 * s2 + m4 * t2 + m5 * w2
            taken = False
            for row in range(first, last + 1):
                low, high = 0.0, width - 1.0
                for e in range(6):
                    slope, base = edge[e, 1], edge[e, 0] + edge[e, 2] * row
                    if slope > _EMPTY:
                        low = max(low, -base / slope)
                    elif slope < -_EMPTY:
                        high = min(high, -base / slope)
                    elif base < 0.0:
                        high = -1.0
                begin, end = int(np.ceil(low)), int(np.floor(high))
                if begin > end:
                    continue
                if not taken:
                    taken = True
                    plane[slot, 0], plane[slot, 1], plane[slot, 2] = p0, p1, p2
                    plane[slot, 3], plane[slot, 4], plane[slot, 5] = q0, q1, q2
                    plane[slot, 6], plane[slot, 7], plane[slot, 8] = w0, w1, w2
                    for j in range(style.shape[1]):
                        style[slot, j] = look[q, j]
                    for j in range(4):
                        mark[slot, j] = tag[q, j]
                w_row = w0 + w2 * row
                if shape & CUT_OUT != 0:
                    number = tag[q, 2]
                    p_row, q_row = p0 + p2 * row, q0 + q2 * row
                    middle = 0.5 * (begin + end)
                    iz = 1.0 / (w_row + w1 * middle)
                    across = abs((p1 - (p_row + p1 * middle) * iz * w1) * iz) + abs(
                        (q1 - (q_row + q1 * middle) * iz * w1) * iz
                    )
                    along = abs((p2 - (p_row + p1 * middle) * iz * w2) * iz) + abs(
                        (q2 - (q_row + q1 * middle) * iz * w2) * iz
                    )
                    ratio = max(across, along)
                    level, reduce = 0, 1.0
                    while ratio > 1.4 and level < 6:
                        ratio *= 0.5
                        reduce *= 0.5
                        level += 1
                    start, log_w, log_h = table[number, level, 0], table[number, level, 1], table[number, level, 2]
                    mask_w, mask_h = (1 << log_w) - 1, (1 << log_h) - 1
                    for column in range(begin, end + 1):
                        w = float32(w_row + w1 * column)
                        if w > depth[row, column]:
                            iz = reduce / (w_row + w1 * column)
                            tu = int(np.floor((p_row + p1 * column) * iz)) & mask_w
                            tv = int(np.floor((q_row + q1 * column) * iz)) & mask_h
                            if texels[start + (tv << log_w) + tu] >> _ALPHA_SHIFT > 110:
                                depth[row, column] = w
                                owner[row, column] = slot
                else:
                    for column in range(begin, end + 1):
                        w = float32(w_row + w1 * column)
                        if w > depth[row, column]:
                            depth[row, column] = w
                            owner[row, column] = slot
            if taken:
                slot += 1
    return slot


class DepthBuffers:
    """Working memory of one image size: z-buffer, owners and the slots of visible patches."""

    def __init__(self, height: int, width: int, slots: int) -> None:
        self.depth: NDArray[np.float32] = np.zeros((height, width), np.float32)
        self.owner: NDArray[np.int32] = np.zeros((height, width), np.int32)
        self.plane = np.empty((slots, 9))
        self.style = np.empty((slots, 13), np.float32)
        self.mark = np.empty((slots, 4), np.int32)
