"""What stands in a street: houses, walls, hedges, trees, lamps, signs and boxes.

Everything is built in the frame of one side of a block: x along the house fronts to the right as seen from the street,
y away from the street (the pavement has y < 0), z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.facades import FACADE_SIDE, STOREY_M
from mixo_env.simulator.city.materials import Materials
from mixo_env.simulator.city.mesh import TWO_SIDED, Mesh, Pair, Patch, Surface, Vector, box, joined, mesh_of, quad

LAMP_M = 7.0
"""Height of street lamps."""


_Item = TypeVar("_Item")


def _one(items: Sequence[_Item], rng: np.random.Generator) -> _Item:
    return items[int(rng.integers(len(items)))]


def _rgb(colour: NDArray[np.float64]) -> Vector:
    red, green, blue = colour.tolist()
    return red, green, blue


def _tinted(surface: Surface, rng: np.random.Generator, low: float, high: float) -> Surface:
    return replace(surface, tint=_rgb(rng.uniform(low, high) * rng.uniform(0.94, 1.06, 3)))


def _reliefs(materials: Materials, rng: np.random.Generator, x: Pair, front: float, height: float) -> list[Patch]:
    """Balconies, awnings, blade signs and pilasters on a street front at y = ``front``."""
    patches: list[Patch] = []
    for _ in range(int(rng.integers(2, 7))):
        wide, out = float(rng.uniform(1.2, 3.0)), float(rng.uniform(0.4, 1.1))
        at = float(rng.uniform(x[0], max(x[0], x[1] - wide)))
        span = (at, min(at + wide, x[1]))
        kind = rng.random()
        storey = STOREY_M * float(rng.integers(1, max(2, int(height / STOREY_M))))
        if kind < 0.4:  # balcony
            rail = _tinted(materials.concrete, rng, 0.5, 1.2)
            patches += box(rail, rail, span, (front - out, front), (storey + 0.1, storey + 0.25), rng)
            patches += box(rail, None, span, (front - out, front - out + 0.06), (storey + 0.25, storey + 1.1), rng)
        elif kind < 0.6 and height > 4.0:  # awning
            cloth = replace(materials.concrete, tint=_rgb(rng.uniform(0.15, 1.1, 3)), shape=TWO_SIDED)
            patches.append(quad(cloth, (span[0], front, 3.0), (span[1] - span[0], 0.0, 0.0), (0.0, -1.4 * out, -0.55)))
        elif kind < 0.85:  # blade sign across the pavement
            plate = Surface(_one(materials.signs, rng), (128.0 / out, 128.0), detail=0.3, emission=0.8)
            patches += box(plate, None, (at, at + 0.12), (front - out, front), (2.8, 3.8), rng, (0.0, 0.0))
        elif x[1] - x[0] > 6.0:  # pilaster
            stone = _tinted(materials.concrete, rng, 0.7, 1.1)
            patches += box(stone, None, (at, at + 0.5), (front - 0.18, front), (0.0, height), rng)
    return patches


def house(
    materials: Materials, rng: np.random.Generator, x: Pair, y: Pair, storeys: int, bare: bool = False
) -> tuple[Mesh, float]:
    """A house on the plot ``x`` by ``y`` (y[0] is the street front) and its height in metres.

    A ``bare`` one is the same, but nothing stands out of its front: an underpass lies before it.
    """
    wall = _tinted(_one(materials.facades, rng), rng, 0.75, 1.2)
    height = STOREY_M * storeys + float(rng.choice([0.0, 0.6]))
    ground_floor = 0.0
    patches: list[Patch] = []
    if rng.random() < 0.65:
        ground_floor = STOREY_M
        first = float(rng.integers(0, 8)) * 128.0
        patches += box(_one(materials.shops, rng), None, x, y, (0.0, ground_floor), rng, (first, 0.0))
        ledge = _tinted(materials.concrete, rng, 0.6, 1.1)
        patches += box(ledge, ledge, x, (y[0] - 0.25, y[0]), (ground_floor - 0.1, ground_floor + 0.12), rng)
    start = (float(rng.uniform(0.0, FACADE_SIDE)), 128.0 * float(rng.integers(0, 4)))
    patches += box(wall, None, x, y, (ground_floor, height), rng, start)
    cornice = _tinted(materials.concrete, rng, 0.6, 1.15)
    wide, deep = (x[0] - 0.15, x[1] + 0.15), (y[0] - 0.2, y[1] + 0.15)
    patches += box(cornice, materials.roof, wide, deep, (height, height + 0.45), rng)
    hut = float(rng.uniform(x[0], x[1] - 2.5))
    plan = (hut, hut + 2.2), (y[0] + 3.0, y[0] + 5.0)
    patches += box(materials.walls[0], materials.roof, *plan, (height, height + 2.4), rng)
    reliefs = _reliefs(materials, rng, x, y[0], height)
    patches += [] if bare else reliefs
    return mesh_of(patches), height


def blank_wall(materials: Materials, rng: np.random.Generator, x: Pair, y: Pair, height: float) -> Mesh:
    """A windowless building: hardly anything for a feature detector."""
    wall = _tinted(_one(materials.walls, rng), rng, 0.75, 1.15)
    return mesh_of(box(wall, materials.roof, x, y, (0.0, height), rng))


def garden(materials: Materials, rng: np.random.Generator, x: Pair, y: Pair) -> tuple[Mesh, float]:
    """An open plot behind a hedge, a low wall or building-site barriers; the mesh and its height."""
    kind = rng.random()
    if kind < 0.6:
        hedge = _tinted(_one(materials.hedges, rng), rng, 0.7, 1.2)
        height = float(rng.uniform(0.8, 1.9))
        parts = [mesh_of(box(hedge, hedge, x, (y[0], y[0] + 1.1), (0.0, height), rng))]
        for _ in range(int(rng.integers(2, 7))):  # bushes that break the line
            size, deep = float(rng.uniform(0.5, 1.1)), y[0] + float(rng.uniform(0.8, 6.0))
            parts.append(_crown(materials, rng, (float(rng.uniform(*x)), deep, 0.75 * size), size, 9))
        return joined(parts), height
    if kind < 0.8:
        across = (y[0] - 0.6, y[0] - 0.2)
        return mesh_of(box(materials.barrier, materials.barrier, x, across, (0.0, 1.0), rng, (0.0, 0.0))), 1.0
    wall = _tinted(materials.concrete, rng, 0.7, 1.1)
    return mesh_of(box(wall, wall, x, (y[0], y[0] + 0.4), (0.0, 1.3), rng)), 1.3


def _crown(materials: Materials, rng: np.random.Generator, centre: Vector, radius: float, cards: int) -> Mesh:
    """Leaf cards of random attitude around ``centre``, dark below and bright on top."""

    def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)

    out = unit(rng.standard_normal((cards, 3)))
    at = np.array(centre) + out * (1.0, 1.0, 0.8) * radius * rng.uniform(0.35, 0.8, (cards, 1))
    u = unit(rng.standard_normal((cards, 3)))
    v = unit(np.cross(u, rng.standard_normal((cards, 3))))
    size = radius * rng.uniform(0.75, 1.15, (cards, 1))
    light = 0.75 + 0.4 * out[:, 2] + rng.uniform(-0.12, 0.12, cards)
    leaf = _one(materials.leaves, rng)
    mesh = np.repeat(mesh_of([quad(leaf, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]), cards)
    mesh["origin"], mesh["edge_u"], mesh["edge_v"] = at - 0.5 * size * (u + v), size * u, size * v
    mesh["detail"][:, :2] *= size  # the whole picture of a twig on every card
    mesh["detail"][:, 2:4] = rng.uniform(0.0, 512.0, (cards, 2))
    mesh["tint"] = light[:, None] * (1.0, 1.0, 0.9)
    return mesh


def tree(materials: Materials, rng: np.random.Generator) -> tuple[Mesh, float, float]:
    """A tree at the origin: mesh, height of the crown's centre and radius of the crown."""
    trunk, radius = float(rng.uniform(2.2, 3.4)), float(rng.uniform(1.4, 2.6))
    thick = float(rng.uniform(0.08, 0.17))
    stem = mesh_of(box(materials.bark, None, (-thick, thick), (-thick, thick), (0.0, trunk + 0.8), rng))
    centre = trunk + 0.75 * radius
    return joined([stem, _crown(materials, rng, (0.0, 0.0, centre), radius, 22)]), centre, radius


def street_lamp(materials: Materials, rng: np.random.Generator) -> Mesh:
    """A lamp post at the origin whose arm reaches over the street (towards -y)."""
    metal, top = materials.metal, LAMP_M
    bulb = replace(materials.lamp, shape=TWO_SIDED)
    return mesh_of(
        [
            *box(metal, None, (-0.07, 0.07), (-0.07, 0.07), (0.0, top), rng),
            *box(metal, metal, (-0.05, 0.05), (-1.9, 0.07), (top, top + 0.1), rng),
            *box(metal, metal, (-0.14, 0.14), (-2.3, -1.5), (top, top + 0.14), rng),
            quad(bulb, (-0.14, -2.3, top - 0.02), (0.28, 0.0, 0.0), (0.0, 0.8, 0.0)),
        ]
    )


def traffic_sign(materials: Materials, rng: np.random.Generator) -> Mesh:
    """A plate on a pole at the origin; it faces (+x) whoever drives along the near side, in right-hand traffic.

    The back is bare metal: lettering is never seen through the plate.
    """
    plate = Surface(_one(materials.signs, rng), (183.0, 183.0), detail=0.2)
    pole = box(materials.metal, None, (-0.04, 0.04), (-0.04, 0.04), (0.0, 2.9), rng)
    front = quad(plate, (0.05, -0.35, 2.9), (0.0, 0.7, 0.0), (0.0, 0.0, -0.7))
    back = quad(materials.metal, (0.05, 0.35, 2.9), (0.0, -0.7, 0.0), (0.0, 0.0, -0.7))
    return mesh_of([*pole, front, back])


def street_box(materials: Materials, rng: np.random.Generator) -> Mesh:
    """A bin, a kiosk or a switch cabinet at the origin."""
    half, height = float(rng.uniform(0.2, 0.6)), float(rng.uniform(0.8, 1.8))
    plate = Surface(_one(materials.signs, rng), (64.0 / half, 128.0 / height), detail_m=1.5)
    return mesh_of(box(plate, materials.metal, (-half, half), (-half, half), (0.0, height), rng, (0.0, 0.0)))


def traffic_light(materials: Materials, rng: np.random.Generator) -> Mesh:
    """Signal heads on a post at the origin."""
    dark = replace(materials.metal, tint=(0.1, 0.11, 0.1))
    post = box(materials.metal, None, (-0.07, 0.07), (-0.07, 0.07), (0.0, 3.6), rng)
    return mesh_of([*post, *box(dark, dark, (-0.18, 0.18), (-0.18, 0.18), (2.5, 3.6), rng)])
