"""Meshes of the straight, level street grid put on the land.

Three ways: what is part of the ground follows it piece by piece (:func:`laid`), a house follows the street but stays
level (:func:`levelled`), and what stands at one point is only moved and turned (:func:`standing`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.land import Land
from mixo_env.simulator.city.mesh import Mesh, joined, placed
from mixo_env.simulator.city.streets import BLOCK_M

PIECE_M = 7.3
"""What follows the land is cut into pieces of at most this; ten of them cross a block between its kerbs ..."""

WHOLE_M = 13.3
"""... but nothing up to this is cut: a road from kerb to kerb is one piece."""

FOUNDATION_M = 1.6
"""Walls of houses reach so far below the ground at their middle."""

_UPRIGHT_M = 1e-6  # horizontal extent of an upright edge, and height of a foot on the ground


def laid(mesh: Mesh, land: Land) -> Mesh:
    """Cut into pieces along both edges, every corner put on the land; edges run along the grid or straight up.

    A patch of several blocks lies beyond the edge of the city, where the land is straight: it is not cut.
    """
    along, down = (_pieces(np.hypot(mesh[edge][:, 0], mesh[edge][:, 1])) for edge in ("edge_u", "edge_v"))
    counts = np.stack([along, down], axis=1)
    parts = []
    for count in np.unique(counts, axis=0):
        chosen = (counts == count).all(axis=1)
        parts.append(_cut(mesh[chosen], int(count[0]), int(count[1])))
    return _bent(joined(parts), land, mesh_height=None)


def levelled(mesh: Mesh, land: Land, u_m: float, v_m: float) -> Mesh:
    """Bent with the streets, at the height of the ground at (u, v); walls that stand on the ground reach into it."""
    out = mesh.copy()
    foot = np.abs(mesh["origin"][:, 2] + mesh["edge_v"][:, 2]) < _UPRIGHT_M
    wall = foot & (mesh["edge_v"][:, 2] < 0.0)
    factor = np.where(wall, 1.0 - FOUNDATION_M / np.where(wall, mesh["edge_v"][:, 2], -1.0), 1.0)
    out["edge_v"] *= factor[:, None]
    out["texel"][:, 1] *= factor
    out["texel"][:, 4] *= factor
    return _bent(out, land, mesh_height=_height(land, u_m, v_m))


def standing(mesh: Mesh, land: Land, u_m: float, v_m: float, yaw_rad: float, scale: float = 1.0) -> Mesh:
    """A mesh at the origin put upright at (u, v), turned by ``yaw_rad`` against the grid."""
    x, y = land.map(*_point(u_m, v_m))
    yaw = float(land.heading(*_point(u_m, v_m), np.array(yaw_rad)))
    return placed(mesh, float(x), float(y), yaw, _height(land, u_m, v_m), scale)


def parked(mesh: Mesh, land: Land, u_m: float, v_m: float, yaw_rad: float) -> Mesh:
    """As :func:`standing`, but on the slope: what is beside the origin is as much higher as the ground there."""
    out = standing(mesh, land, u_m, v_m, yaw_rad)
    x, y = land.map(*_point(u_m, v_m))
    rise_x, rise_y = land.rise(*_point(u_m, v_m))
    out["origin"][:, 2] += rise_x * (out["origin"][:, 0] - x) + rise_y * (out["origin"][:, 1] - y)
    for edge in ("edge_u", "edge_v"):
        out[edge][:, 2] += rise_x * out[edge][:, 0] + rise_y * out[edge][:, 1]
    return out


def ground_aligned(patches: Mesh, texels_per_m: float, land: Land) -> Mesh:
    """Ground patches that lie anywhere on the map, their texture taken from the place of the grid below them."""
    out = patches.copy()
    origin, edges = patches["origin"], (patches["edge_u"], patches["edge_v"])
    u0, v0 = land.grid(origin[:, 0], origin[:, 1])
    (uu, vu), (uv, vv) = (land.grid(origin[:, 0] + edge[:, 0], origin[:, 1] + edge[:, 1]) for edge in edges)
    out["texel"] = texels_per_m * np.stack([uu - u0, uv - u0, u0, vu - v0, vv - v0, v0], axis=1)
    return out


def _bent(mesh: Mesh, land: Land, mesh_height: float | None) -> Mesh:
    """Every corner moved with the land; heights follow it too, or are raised by ``mesh_height``."""
    out = mesh.copy()
    corner = mesh["origin"]
    moved = {name: _moved(corner + mesh[name], land, mesh_height) for name in ("edge_u", "edge_v")}
    out["origin"] = _moved(corner, land, mesh_height)
    for name, end in moved.items():
        out[name] = end - out["origin"]
    return out


def _moved(points: NDArray[np.float64], land: Land, height: float | None) -> NDArray[np.float64]:
    if height is None:
        return land.points(points)
    x, y = land.map(points[:, 0], points[:, 1])
    return np.stack([x, y, points[:, 2] + height], axis=1)


def _pieces(length_m: NDArray[np.float64]) -> NDArray[np.int64]:
    pieces = np.ceil(length_m / PIECE_M - 1e-9).astype(np.int64)
    return np.where((length_m > BLOCK_M) | (length_m < WHOLE_M), 1, pieces)


def _cut(mesh: Mesh, along: int, down: int) -> Mesh:
    """Every patch as ``along`` by ``down`` equal ones."""
    if along * down == 1:
        return mesh
    out = np.repeat(mesh, along * down)
    i = np.tile(np.repeat(np.arange(along), down), len(mesh)) / along
    j = np.tile(np.tile(np.arange(down), along), len(mesh)) / down
    out["origin"] += i[:, None] * out["edge_u"] + j[:, None] * out["edge_v"]
    texel = out["texel"]
    texel[:, 2] += i * texel[:, 0] + j * texel[:, 1]
    texel[:, 5] += i * texel[:, 3] + j * texel[:, 4]
    texel[:, [0, 3]] /= along
    texel[:, [1, 4]] /= down
    out["edge_u"] /= along
    out["edge_v"] /= down
    return out


def _point(u_m: float, v_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.array(u_m), np.array(v_m)


def _height(land: Land, u_m: float, v_m: float) -> float:
    return float(land.height(*_point(u_m, v_m)))
