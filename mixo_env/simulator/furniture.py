"""What stands in a street: houses, walls, hedges, trees, lamps, signs and boxes.

Everything is built in the frame of one side of a block: x along the house fronts to the right as seen from the street, y away
from the street (the pavement has y < 0), z up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.facades import (
    FACADE_SIDE,
    FACADE_TEXELS_PER_M,
    SHOP_TEXELS_PER_M,
    STOREY_M,
    facade,
    shop_front,
)
from mixo_env.simulator.mesh import CUT_OUT, GROUND, TWO_SIDED, Mesh, Span, Surface, box, quad
from mixo_env.simulator.textures import Atlas, foliage, plain, rgba, sign, spectral_noise

KERB_M = 0.12
"""Height of the pavement above the road."""

LAMP_M = 7.0
"""Height of street lamps."""


@dataclass(frozen=True)
class Materials:
    """Surfaces of one city; lists hold the variants."""

    facades: tuple[Surface, ...]
    shops: tuple[Surface, ...]
    walls: tuple[Surface, ...]
    signs: tuple[int, ...]
    leaves: tuple[Surface, ...]
    hedges: tuple[Surface, ...]
    kerbs: tuple[Surface, ...]
    barrier: Surface
    concrete: Surface
    roof: Surface
    metal: Surface
    bark: Surface
    lamp: Surface
    ground: Surface


def _stripes(rng: np.random.Generator, first: float, second: float, side: int = 64) -> NDArray[np.float32]:
    image = np.full((side, side, 3), first, np.float32)
    image[:, side // 2 :] = second
    return image * (1.0 + 0.06 * spectral_noise(side, side, 1.0, rng))[..., None]


def city_materials(
    atlas: Atlas, rng: np.random.Generator, ground: int, ground_texels_per_m: float, variety: int
) -> Materials:
    """Draw the textures of a city: ``variety`` house fronts and a matching number of the rest."""

    def surface(number: int, per_m: float, **look: object) -> Surface:
        return Surface(number, (per_m, per_m), **look)  # pyright: ignore[reportArgumentType]

    some = max(1, variety // 3)
    greens = np.array([(70, 104, 48), (88, 118, 52), (58, 88, 44), (112, 116, 56), (84, 100, 66)], np.float32)
    barrier = _stripes(rng, 225.0, 225.0)
    barrier[:, 32:] *= (0.85, 0.25, 0.12)
    return Materials(
        facades=tuple(
            surface(atlas.add(facade(rng)), FACADE_TEXELS_PER_M, detail_m=2.1, emission=1.0) for _ in range(variety)
        ),
        shops=tuple(
            surface(atlas.add(shop_front(rng)), SHOP_TEXELS_PER_M, detail_m=2.3, detail=0.6, emission=1.0)
            for _ in range(some)
        ),
        walls=tuple(
            surface(
                atlas.add(plain(rng, tuple(np.full(3, tone) * rng.uniform(0.94, 1.06, 3)), 0.045)),
                20.0,
                detail_m=6.0,
                detail=0.22,
            )
            for tone in (150.0, 185.0)
        ),
        signs=tuple(atlas.add(sign(rng)) for _ in range(some + 4)),
        leaves=tuple(
            Surface(atlas.add(foliage(rng, hue)), (256.0, 256.0), detail_m=1.1, detail=0.6, shape=CUT_OUT | TWO_SIDED)
            for hue in greens
        ),
        hedges=tuple(
            surface(atlas.add(foliage(rng, hue, dense=True)), 110.0, detail_m=1.7, detail=0.7) for hue in greens[:3]
        ),
        kerbs=tuple(
            Surface(atlas.add(rgba(image)), (32.0, 64.0 / KERB_M), detail_m=2.0, detail=0.8)
            for image in (_stripes(rng, 160.0, 150.0), _stripes(rng, 225.0, 45.0))
        ),
        barrier=surface(atlas.add(rgba(barrier)), 42.0, detail_m=1.7, detail=0.7),
        concrete=surface(atlas.add(plain(rng, (158.0, 155.0, 150.0), 0.05)), 40.0),
        roof=surface(atlas.add(plain(rng, (96.0, 94.0, 92.0), 0.08)), 20.0),
        metal=surface(atlas.add(plain(rng, (92.0, 94.0, 96.0), 0.08)), 100.0),
        bark=surface(atlas.add(plain(rng, (84.0, 68.0, 54.0), 0.25)), 100.0),
        lamp=surface(atlas.add(rgba(np.full((64, 64, 3), 235.0), 255.0)), 60.0, detail=0.0, emission=4.0),
        ground=surface(ground, ground_texels_per_m, detail_m=2.6, detail=0.55, material=GROUND),
    )


def _tinted(surface: Surface, rng: np.random.Generator, low: float, high: float) -> Surface:
    tint = rng.uniform(low, high) * rng.uniform(0.94, 1.06, 3)
    return replace(surface, tint=tuple(tint.tolist()))


def _reliefs(materials: Materials, rng: np.random.Generator, x: Span, front: float, height: float) -> list[Mesh]:
    """Balconies, awnings, blade signs and pilasters on a street front at y = ``front``."""
    parts = []
    width = x[1] - x[0]
    for _ in range(int(rng.integers(2, 7))):
        wide, out = float(rng.uniform(1.2, 3.0)), float(rng.uniform(0.4, 1.1))
        at = float(rng.uniform(x[0], max(x[0], x[1] - wide)))
        span = (at, min(at + wide, x[1]))
        kind = rng.random()
        storey = STOREY_M * float(rng.integers(1, max(2, int(height / STOREY_M))))
        if kind < 0.4:  # balcony
            rail = _tinted(materials.concrete, rng, 0.5, 1.2)
            parts.append(box(rail, rail, span, (front - out, front), (storey + 0.1, storey + 0.25), rng))
            parts.append(box(rail, None, span, (front - out, front - out + 0.06), (storey + 0.25, storey + 1.1), rng))
        elif kind < 0.6 and height > 4.0:  # awning
            cloth = replace(materials.concrete, tint=tuple(rng.uniform(0.15, 1.1, 3).tolist()), shape=TWO_SIDED)
            parts.append(quad(cloth, (span[0], front, 3.0), (span[1] - span[0], 0, 0), (0, -1.4 * out, -0.55)))
        elif kind < 0.85:  # blade sign across the pavement
            plate = Surface(int(rng.choice(materials.signs)), (128.0 / out, 128.0), detail=0.3, emission=0.8)
            parts.append(box(plate, None, (at, at + 0.12), (front - out, front), (2.8, 3.8), rng, (0.0, 0.0)))
        elif width > 6.0:  # pilaster
            stone = _tinted(materials.concrete, rng, 0.7, 1.1)
            parts.append(box(stone, None, (at, at + 0.5), (front - 0.18, front), (0.0, height), rng))
    return parts


def house(materials: Materials, rng: np.random.Generator, x: Span, y: Span, storeys: int) -> tuple[Mesh, float]:
    """A house on the plot ``x`` by ``y`` (y[0] is the street front) and its height in metres."""
    wall = _tinted(materials.facades[rng.integers(len(materials.facades))], rng, 0.75, 1.2)
    height = STOREY_M * storeys + float(rng.choice([0.0, 0.6]))
    ground_floor = 0.0
    parts = []
    if rng.random() < 0.65:
        ground_floor = STOREY_M
        shop = materials.shops[rng.integers(len(materials.shops))]
        first = float(rng.integers(0, 8)) * 128.0
        parts.append(box(shop, None, x, y, (0.0, ground_floor), rng, (first, 0.0)))
        ledge = _tinted(materials.concrete, rng, 0.6, 1.1)
        parts.append(box(ledge, ledge, x, (y[0] - 0.25, y[0]), (ground_floor - 0.1, ground_floor + 0.12), rng))
    start = (float(rng.uniform(0.0, FACADE_SIDE)), 128.0 * float(rng.integers(0, 4)))
    parts.append(box(wall, None, x, y, (ground_floor, height), rng, start))
    cornice = _tinted(materials.concrete, rng, 0.6, 1.15)
    parts.append(
        box(cornice, None, (x[0] - 0.15, x[1] + 0.15), (y[0] - 0.2, y[1] + 0.15), (height, height + 0.45), rng)
    )
    parts.append(box(cornice, materials.roof, x, y, (height, height + 0.3), rng)[4:])
    hut = float(rng.uniform(x[0], x[1] - 2.5))
    parts.append(
        box(materials.walls[0], materials.roof, (hut, hut + 2.2), (y[0] + 3.0, y[0] + 5.0), (height, height + 2.4), rng)
    )
    parts += _reliefs(materials, rng, x, y[0], height)
    return np.concatenate(parts), height


def blank_wall(materials: Materials, rng: np.random.Generator, x: Span, y: Span, height: float) -> Mesh:
    """A windowless building: hardly anything for a feature detector."""
    wall = _tinted(materials.walls[rng.integers(len(materials.walls))], rng, 0.75, 1.15)
    return box(wall, materials.roof, x, y, (0.0, height), rng)


def garden(materials: Materials, rng: np.random.Generator, x: Span, y: Span) -> tuple[Mesh, float]:
    """An open plot behind a hedge, a low wall or building-site barriers; the mesh and its height."""
    kind = rng.random()
    if kind < 0.6:
        hedge = _tinted(materials.hedges[rng.integers(len(materials.hedges))], rng, 0.7, 1.2)
        height = float(rng.uniform(0.8, 1.9))
        parts = [box(hedge, hedge, x, (y[0], y[0] + 1.1), (0.0, height), rng)]
        for _ in range(int(rng.integers(2, 7))):  # bushes that break the line
            at, size = float(rng.uniform(*x)), float(rng.uniform(0.5, 1.1))
            deep = float(rng.uniform(0.8, 6.0))
            parts.append(bush(materials, rng, at, y[0] + deep, size))
        return np.concatenate(parts), height
    if kind < 0.8:
        return box(materials.barrier, materials.barrier, x, (y[0] - 0.6, y[0] - 0.2), (0.0, 1.0), rng, (0.0, 0.0)), 1.0
    wall = _tinted(materials.concrete, rng, 0.7, 1.1)
    return box(wall, wall, x, (y[0], y[0] + 0.4), (0.0, 1.3), rng), 1.3


def bush(materials: Materials, rng: np.random.Generator, x: float, y: float, size: float) -> Mesh:
    """A round shrub of leaf cards."""
    return _crown(materials, rng, np.array([x, y, 0.75 * size]), size, 9)


def _crown(
    materials: Materials, rng: np.random.Generator, centre: NDArray[np.float64], radius: float, cards: int
) -> Mesh:
    leaves = materials.leaves[rng.integers(len(materials.leaves))]
    parts = []
    for _ in range(cards):
        out = rng.standard_normal(3)
        out /= np.linalg.norm(out)
        at = centre + out * (1.0, 1.0, 0.8) * radius * rng.uniform(0.35, 0.8)
        u = rng.standard_normal(3)
        u /= np.linalg.norm(u)
        v = np.cross(u, rng.standard_normal(3))
        v /= np.linalg.norm(v)
        size = radius * rng.uniform(0.75, 1.15)
        light = 0.75 + 0.4 * out[2] + rng.uniform(-0.12, 0.12)  # dark below, bright on top
        look = replace(leaves, texels_per_m=(256.0 / size,) * 2, tint=(light, light, 0.9 * light))
        grain = tuple(rng.uniform(0.0, 512.0, 2).tolist())
        parts.append(quad(look, at - 0.5 * size * (u + v), size * u, size * v, grain=grain))
    return np.concatenate(parts)


def tree(materials: Materials, rng: np.random.Generator) -> tuple[Mesh, float, float]:
    """A tree at the origin: mesh, height of the crown's centre and radius of the crown."""
    trunk, radius = float(rng.uniform(2.2, 3.4)), float(rng.uniform(1.4, 2.6))
    thick = float(rng.uniform(0.08, 0.17))
    stem = box(materials.bark, None, (-thick, thick), (-thick, thick), (0.0, trunk + 0.8), rng)
    centre = trunk + 0.75 * radius
    crown = _crown(materials, rng, np.array([0.0, 0.0, centre]), radius, 22)
    return np.concatenate([stem, crown]), centre, radius


def street_lamp(materials: Materials, rng: np.random.Generator) -> Mesh:
    """A lamp post at the origin whose arm reaches over the street (towards -y)."""
    parts = [
        box(materials.metal, None, (-0.07, 0.07), (-0.07, 0.07), (0.0, LAMP_M), rng),
        box(materials.metal, materials.metal, (-0.05, 0.05), (-1.9, 0.07), (LAMP_M, LAMP_M + 0.1), rng),
        box(materials.metal, materials.metal, (-0.14, 0.14), (-2.3, -1.5), (LAMP_M, LAMP_M + 0.14), rng),
        quad(replace(materials.lamp, shape=TWO_SIDED), (-0.14, -2.3, LAMP_M - 0.02), (0.28, 0, 0), (0, 0.8, 0)),
    ]
    return np.concatenate(parts)


def traffic_sign(materials: Materials, rng: np.random.Generator) -> Mesh:
    """A plate on a pole at the origin, facing along the street."""
    plate = Surface(int(rng.choice(materials.signs)), (128.0 / 0.7,) * 2, detail=0.2, shape=TWO_SIDED)
    pole = box(materials.metal, None, (-0.04, 0.04), (-0.04, 0.04), (0.0, 2.9), rng)
    return np.concatenate([pole, quad(plate, (0.05, 0.35, 2.9), (0, -0.7, 0), (0, 0, -0.7))])


def street_box(materials: Materials, rng: np.random.Generator) -> Mesh:
    """A bin, a kiosk or a switch cabinet at the origin."""
    half, height = float(rng.uniform(0.2, 0.6)), float(rng.uniform(0.8, 1.8))
    plate = Surface(int(rng.choice(materials.signs)), (64.0 / half, 128.0 / height), detail_m=1.5)
    return box(plate, materials.metal, (-half, half), (-half, half), (0.0, height), rng, (0.0, 0.0))


def traffic_light(materials: Materials, rng: np.random.Generator) -> Mesh:
    """Signal heads on a post at the origin."""
    dark = replace(materials.metal, tint=(0.1, 0.11, 0.1))
    post = box(materials.metal, None, (-0.07, 0.07), (-0.07, 0.07), (0.0, 3.6), rng)
    return np.concatenate([post, box(dark, dark, (-0.18, 0.18), (-0.18, 0.18), (2.5, 3.6), rng)])
