"""The island of a mini-roundabout: a striped kerb, paving, a round hedge and a red and white board to every arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.land import FLAT
from mixo_env.simulator.city.laying import ground_aligned
from mixo_env.simulator.city.materials import KERB_M, STRIPES_SIDE, Materials
from mixo_env.simulator.city.mesh import Mesh, Surface, Vector, joined, mesh_of, placed, quad
from mixo_env.simulator.city.roundabout import ISLAND_M

HEDGE_M, HEDGE_TOP_M = 1.2, 0.85
"""Radius of the hedge and height of its top."""

_HALF_SIDES = 8  # a circle is a polygon of twice as many sides
_FOOT_M = -0.1  # walls reach into the ground, which is flat between kerbs and not quite so below the island
_BOARD_M = (1.1, 0.3, 0.75)  # width, bottom and top


def outline(radius_m: float) -> NDArray[np.float64]:
    """``(n, 2)`` corners of the polygon, anticlockwise."""
    angle = np.pi * (np.arange(2 * _HALF_SIDES) - 0.5) / _HALF_SIDES
    return radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def island(materials: Materials) -> Mesh:
    """The island around the origin, which lies on the ground."""
    paving = replace(materials.concrete, tint=(1.12, 1.1, 1.05))
    hedge = materials.hedges[0]
    wide, bottom, top = _BOARD_M
    per_m = 2.0 * STRIPES_SIDE / wide  # red and white twice over
    board = replace(materials.barrier, texels_per_m=(per_m, per_m))
    front = quad(board, (HEDGE_M + 0.12, -0.5 * wide, top), (0.0, wide, 0.0), (0.0, 0.0, bottom - top))
    return joined(
        [
            _wall(materials.kerbs[1], ISLAND_M, _FOOT_M, KERB_M),
            _disc(paving, ISLAND_M, KERB_M),
            _wall(hedge, HEDGE_M, KERB_M, HEDGE_TOP_M),
            _disc(hedge, HEDGE_M, HEDGE_TOP_M),
            *(placed(mesh_of([front]), 0.0, 0.0, 0.5 * np.pi * arm) for arm in range(4)),
        ]
    )


def _wall(surface: Surface, radius_m: float, low_m: float, high_m: float) -> Mesh:
    corners = outline(radius_m)
    edges = np.roll(corners, -1, axis=0) - corners
    length_m = float(np.hypot(*edges[0]))
    patches = []
    for number, ((x, y), (dx, dy)) in enumerate(zip(corners.tolist(), edges.tolist(), strict=True)):
        start = (surface.texels_per_m[0] * length_m * number, 0.0)  # the texture runs on from side to side
        patches.append(quad(surface, (x, y, high_m), (dx, dy, 0.0), (0.0, 0.0, low_m - high_m), start))
    return mesh_of(patches)


def _disc(surface: Surface, radius_m: float, z_m: float) -> Mesh:
    """A level polygon, cut into parallelograms.

    Its lower border, half of its sides in order of their direction, becomes the upper one by exchanging neighbours
    until the order is reversed; every exchange sweeps one parallelogram (the classical tiling of a zonogon).
    """
    corners = outline(radius_m)
    edges = (np.roll(corners, -1, axis=0) - corners)[:_HALF_SIDES]
    order = list(range(_HALF_SIDES))
    patches = []
    for last in range(_HALF_SIDES - 1, 0, -1):
        for k in range(last):
            x, y = (corners[0] + edges[order[:k]].sum(axis=0)).tolist()
            first, second = (_level(edges[order[n]]) for n in (k, k + 1))
            patches.append(quad(surface, (x, y, z_m), second, first))
            order[k], order[k + 1] = order[k + 1], order[k]
    return ground_aligned(mesh_of(patches), surface.texels_per_m[0], FLAT)


def _level(edge: NDArray[np.float64]) -> Vector:
    x, y = edge.tolist()
    return x, y, 0.0
