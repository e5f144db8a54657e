"""Surfaces made of flat patches, the only primitive of the renderer.

A patch is the parallelogram origin + s edge_u + t edge_v, 0 <= s, t <= 1. Seen from its front, edge_u points right and
edge_v down; the back is invisible unless the patch is two-sided. A mesh is an array of :data:`PATCH`, so that moving
and joining meshes are plain array operations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.textures import DETAIL_SIDE

TWO_SIDED, CUT_OUT = 1, 2
"""Bits of ``shape``. A cut-out patch is seen only where the fourth channel of its texture is above one half."""

SOLID, GROUND, SHADE = 0, 1, 2
"""Values of ``material``. GROUND takes its sunlight from the shadow picture and gets wet; SHADE is ground in shadow."""

PATCH = np.dtype(
    [
        ("origin", "f8", 3),  # m
        ("edge_u", "f8", 3),  # m
        ("edge_v", "f8", 3),  # m
        ("texel", "f8", 6),  # texel column = c0 s + c1 t + c2, texel row = c3 s + c4 t + c5
        ("detail", "f8", 5),  # detail texels per texel in both directions, offsets, strength
        ("tint", "f8", 3),  # factor on the reflected light
        ("emission", "f8"),  # factor on the light emitted at night
        ("shape", "i4"),
        ("material", "i4"),
        ("texture", "i4"),
    ]
)
Mesh = np.ndarray
"""Array ``(n,)`` of :data:`PATCH`."""

Patch = tuple[Any, ...]
"""One row of a mesh, in the order of :data:`PATCH`."""

Pair = tuple[float, float]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Surface:
    """How a patch looks.

    Attributes:
        texture: number in the atlas.
        texels_per_m: along edge_u and edge_v.
        tint: factor on the reflected light, per colour.
        detail_m: side of the fine-grain tile in metres.
        detail: strength of the fine grain.
        emission: factor on the light emitted at night.
        shape, material: see the constants.
    """

    texture: int
    texels_per_m: tuple[float, float]
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    detail_m: float = 2.5
    detail: float = 1.0
    emission: float = 0.0
    shape: int = 0
    material: int = SOLID


def quad(
    surface: Surface,
    origin: Vector,
    edge_u: Vector,
    edge_v: Vector,
    start: Pair = (0.0, 0.0),
    grain: Pair = (0.0, 0.0),
) -> Patch:
    """One patch; ``start`` is the texel at the origin, ``grain`` the same for the fine grain."""
    per_u, per_v = surface.texels_per_m
    per_m = DETAIL_SIDE / surface.detail_m
    return (
        origin,
        edge_u,
        edge_v,
        (per_u * math.hypot(*edge_u), 0.0, start[0], 0.0, per_v * math.hypot(*edge_v), start[1]),
        (per_m / per_u, per_m / per_v, *grain, surface.detail),
        surface.tint,
        surface.emission,
        surface.shape,
        surface.material,
        surface.texture,
    )


def box(
    walls: Surface,
    top: Surface | None,
    x: Pair,
    y: Pair,
    z: Pair,
    rng: np.random.Generator,
    start: Pair | None = None,
) -> list[Patch]:
    """Upright box without a floor: four walls and, if given, a top.

    Args:
        walls: how its sides look.
        top: how its top looks.
        x: extent in metres.
        y: extent in metres.
        z: extent in metres.
        rng: starts textures at random texels.
        start: texel at the upper left corner of every wall, if it is not to be random.
    """
    (x0, x1), (y0, y1), (z0, z1) = x, y, z
    wide, deep, down = x1 - x0, y1 - y0, (0.0, 0.0, z0 - z1)
    sides = (
        ((x0, y0, z1), (wide, 0.0, 0.0)),
        ((x1, y0, z1), (0.0, deep, 0.0)),
        ((x1, y1, z1), (-wide, 0.0, 0.0)),
        ((x0, y1, z1), (0.0, -deep, 0.0)),
    )
    texels = rng.uniform(0.0, DETAIL_SIDE, (5, 4)).tolist()
    patches = [
        quad(walls, corner, edge, down, start or (tu, tv), (gu, gv))
        for (corner, edge), (tu, tv, gu, gv) in zip(sides, texels, strict=False)
    ]
    if top is not None:
        tu, tv, gu, gv = texels[4]
        patches.append(quad(top, (x0, y1, z1), (wide, 0.0, 0.0), (0.0, -deep, 0.0), (tu, tv), (gu, gv)))
    return patches


def mesh_of(patches: Sequence[Patch]) -> Mesh:
    """The patches as one array."""
    return np.array(patches, PATCH)


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """All meshes in one array (``np.concatenate`` takes ages over named fields)."""
    out = np.empty(sum(len(mesh) for mesh in meshes), PATCH)
    start = 0
    for mesh in meshes:
        out[start : start + len(mesh)] = mesh
        start += len(mesh)
    return out


def placed(mesh: Mesh, x_m: float, y_m: float, yaw_rad: float, z_m: float = 0.0, scale: float = 1.0) -> Mesh:
    """The mesh scaled, turned by ``yaw_rad`` about z and moved to ``(x_m, y_m, z_m)``; textures stay glued to it."""
    out = mesh.copy()
    c, s = scale * math.cos(yaw_rad), scale * math.sin(yaw_rad)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, scale]])
    out["origin"] = mesh["origin"] @ turn + (x_m, y_m, z_m)
    out["edge_u"] = mesh["edge_u"] @ turn
    out["edge_v"] = mesh["edge_v"] @ turn
    return out


def normals(mesh: Mesh) -> NDArray[np.float64]:
    """Unit normals ``(n, 3)`` that point out of the visible side."""
    normal = np.cross(mesh["edge_v"], mesh["edge_u"])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)


class PatchSet(NamedTuple):
    """A mesh in the form that the renderer reads: plain contiguous arrays and groups that are culled together.

    Columns of ``look`` and ``tag`` have names in :mod:`mixo_env.simulator.picture.views`.

    Attributes:
        geometry: ``(n, 9)`` origin, edge_u, edge_v in metres, map frame.
        texel: ``(n, 6)`` as in :data:`PATCH`.
        look: ``(n, 13)`` float32: tint, emission, detail (5), share of the sun before shadows, outward normal (3).
        tag: ``(n, 4)`` int32: shape, material, texture, number of the rigid body (0 is the world).
        groups: ``(g, 4)`` bounding spheres x, y, z, radius in metres.
        group_start: ``(g + 1,)`` first patch of every group.
    """

    geometry: NDArray[np.float64]
    texel: NDArray[np.float64]
    look: NDArray[np.float32]
    tag: NDArray[np.int32]
    groups: NDArray[np.float64]
    group_start: NDArray[np.int64]


def packed(groups: Sequence[Mesh], sun: NDArray[np.float64], bodies: Sequence[int] | None = None) -> PatchSet:
    """Pack meshes, one group each.

    Args:
        groups: meshes in the map frame.
        sun: ``(3,)`` unit vector towards the sun.
        bodies: number of the rigid body of each group; all 0 if left out.
    """
    sizes = [len(group) for group in groups]
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    mesh = joined(groups)
    normal = normals(mesh)
    facing = normal @ sun
    two_sided = (mesh["shape"] & (TWO_SIDED | CUT_OUT)) != 0
    normal = np.where((two_sided & (facing < 0))[:, None], -normal, normal)
    facing = np.where(two_sided, np.abs(facing), np.maximum(facing, 0.0))
    body = np.repeat(np.zeros(len(groups), np.int32) if bodies is None else np.asarray(bodies, np.int32), sizes)
    look = np.column_stack([mesh["tint"], mesh["emission"], mesh["detail"], facing, normal])
    tag = np.column_stack([mesh["shape"], mesh["material"], mesh["texture"], body])
    corners = mesh["origin"][:, None] + np.stack(
        [np.zeros_like(mesh["edge_u"]), mesh["edge_u"], mesh["edge_v"], mesh["edge_u"] + mesh["edge_v"]], axis=1
    )
    spheres = np.empty((len(groups), 4))
    for i in range(len(groups)):
        points = corners[start[i] : start[i + 1]].reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        spheres[i] = (*(0.5 * (low + high)), 0.5 * float(np.linalg.norm(high - low)))
    return PatchSet(
        geometry=np.column_stack([mesh["origin"], mesh["edge_u"], mesh["edge_v"]]),
        texel=np.ascontiguousarray(mesh["texel"]),
        look=np.ascontiguousarray(look, np.float32),
        tag=np.ascontiguousarray(tag, np.int32),
        groups=spheres,
        group_start=start,
    )
