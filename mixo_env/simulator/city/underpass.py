"""Underpasses: a bridge over the street in the middle of a block, under which daylight comes in at both ends only.

How much of the sky's light is left on the ground d metres inside a portal of height h: the view factor of the portal,
(1 - cos a) / 2 with tan a = h / d (two crossed strings, Hottel and Sarofim, "Radiative transfer", 1967), from both
ends, and a little that walls reflect. A camera that drives in sees too dark a picture until its exposure has followed,
and too bright a one when it comes out (``picture/exposure``).
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.land import FLAT, Land
from mixo_env.simulator.city.laying import ground_aligned, laid
from mixo_env.simulator.city.materials import KERB_M, Materials
from mixo_env.simulator.city.mesh import SHADE, Mesh, Patch, Surface, Vector, joined, mesh_of, placed, quad
from mixo_env.simulator.city.streets import BLOCK_M, HALF_ROAD_M, SIDEWALK_M

CLEARANCE_M, DECK_M = 4.6, 6.2
"""Height of the underside and of the parapet."""

_REFLECTED = 0.03  # share of the light that comes by way of walls
_WALL_M = SIDEWALK_M - 0.35  # inner face of the abutments
_STRIP_M = 1.0  # light is even over such a strip
_OVERLAY_M = 0.015  # above the ground, and above the sun shadows of vehicles, of which there are none inside


class Underpass(NamedTuple):
    """One bridge over the street along ``axis`` (0 = x, 1 = y), ``length_m`` long inside.

    Its middle lies at (x, y) of the street grid.
    """

    axis: int
    x_m: float
    y_m: float
    length_m: float


def underpass_at(seed: int, axis: int, street: int, block: int, share: float) -> Underpass | None:
    """The bridge over ``street`` of ``axis`` between its crossings ``block`` and ``block + 1``, if there is one.

    Args:
        seed: of the city.
        axis: 0 for streets along x, 1 along y.
        street: number of the street.
        block: number of the crossing before.
        share: of all such places that have one.
    """
    rng = np.random.default_rng([seed, 6, axis, street + 100, block + 100])
    if rng.random() >= share:
        return None
    along, across = (block + 0.5) * BLOCK_M, street * BLOCK_M
    x, y = (along, across) if axis == 0 else (across, along)
    return Underpass(axis, x, y, float(rng.uniform(14.0, 28.0)))


def sky_share(inside_m: NDArray[np.float64], length_m: float) -> NDArray[np.float64]:
    """Share of the sky's light on the ground ``inside_m`` metres behind the first portal; 1 outside."""
    total = np.full(np.shape(inside_m), _REFLECTED)
    for distance in (inside_m, length_m - inside_m):
        total += 0.5 * (1.0 - np.cos(np.arctan2(CLEARANCE_M, np.maximum(distance, 0.0))))
    return np.where((inside_m < 0.0) | (inside_m > length_m), 1.0, np.minimum(total, 1.0))


def light_at(
    underpasses: NDArray[np.float64], u_m: NDArray[np.float64] | float, v_m: NDArray[np.float64] | float
) -> NDArray[np.float64]:
    """Share of the sky's light that falls on what stands at places.

    Args:
        underpasses: ``(n, 4)`` rows of :class:`Underpass`.
        u_m: on the street grid, of any shape.
        v_m: likewise.
    """
    axis, x, y, length = underpasses.T
    du, dv = np.asarray(u_m)[..., None] - x, np.asarray(v_m)[..., None] - y
    along, across = np.where(axis == 0.0, du, dv), np.where(axis == 0.0, dv, du)
    inside = (np.abs(across) < SIDEWALK_M) & (np.abs(along) < 0.5 * length)
    light = np.ones(np.shape(u_m))
    for *place, bridge in np.argwhere(inside).tolist():  # hardly ever one
        light[tuple(place)] = sky_share(along[(*place, bridge)] + 0.5 * length[bridge], length[bridge])
    return light


def underpass_mesh(materials: Materials, bridge: Underpass, land: Land = FLAT) -> Mesh:
    """The bridge, its abutments and the darkened ground below, on the map."""
    half = 0.5 * bridge.length_m
    stone = replace(materials.concrete, tint=(0.75, 0.74, 0.72))
    patches: list[Patch] = []
    for sense in (-1.0, 1.0):  # the two fronts, seen from outside
        x, left = sense * half, -sense * SIDEWALK_M
        width, wall = 2.0 * sense * SIDEWALK_M, sense * (SIDEWALK_M - _WALL_M)
        patches.append(quad(stone, (x, left, DECK_M), (0.0, width, 0.0), (0.0, 0.0, CLEARANCE_M - DECK_M)))
        for start in (left, -left - wall):
            patches.append(quad(stone, (x, start, CLEARANCE_M), (0.0, wall, 0.0), (0.0, 0.0, -CLEARANCE_M)))
    edges = np.linspace(-half, half, max(2, round(bridge.length_m / _STRIP_M)) + 1).tolist()
    ground: list[Patch] = []
    for x0, x1 in itertools.pairwise(edges):
        light = float(sky_share(np.array(0.5 * (x0 + x1) + half), bridge.length_m))
        dark = replace(stone, tint=_dimmed(stone.tint, light))
        patches += _lining(dark, x0, x1)
        shade = replace(materials.ground, tint=_dimmed(materials.ground.tint, light), material=SHADE)
        for low, high, z in (
            (-SIDEWALK_M, -HALF_ROAD_M, KERB_M),
            (-HALF_ROAD_M, HALF_ROAD_M, 0.0),
            (HALF_ROAD_M, SIDEWALK_M, KERB_M),
        ):
            ground.append(quad(shade, (x0, high, z + _OVERLAY_M), (x1 - x0, 0.0, 0.0), (0.0, low - high, 0.0)))
    turn = 0.5 * np.pi * bridge.axis
    body = placed(mesh_of(patches), bridge.x_m, bridge.y_m, turn)
    floor = placed(mesh_of(ground), bridge.x_m, bridge.y_m, turn)
    floor = ground_aligned(floor, materials.ground.texels_per_m[0], FLAT)
    return joined([laid(body, land), laid(floor, land)])


def _dimmed(tint: Vector, light: float) -> Vector:
    red, green, blue = tint
    return light * red, light * green, light * blue


def _lining(stone: Surface, x0: float, x1: float) -> list[Patch]:
    """Underside and both walls from ``x0`` to ``x1``."""
    run, per_m = x1 - x0, stone.texels_per_m[0]
    start = (per_m * x0, 0.0)  # textures run on from strip to strip
    down = (0.0, 0.0, -CLEARANCE_M)
    return [
        quad(stone, (x0, -_WALL_M, CLEARANCE_M), (run, 0.0, 0.0), (0.0, 2.0 * _WALL_M, 0.0), start),
        quad(stone, (x0, _WALL_M, CLEARANCE_M), (run, 0.0, 0.0), down, start),
        quad(stone, (x1, -_WALL_M, CLEARANCE_M), (-run, 0.0, 0.0), down, (-per_m * x1, 0.0)),
    ]
