"""The surfaces of one city."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.facades import FACADE_TEXELS_PER_M, SHOP_TEXELS_PER_M, facade, shop_front
from mixo_env.simulator.city.mesh import CUT_OUT, GROUND, TWO_SIDED, Surface
from mixo_env.simulator.city.textures import Atlas, Floats, foliage, plain, rgba, sign, spectral_noise

KERB_M = 0.12
"""Height of the pavement above the road."""

STRIPES_SIDE = 64
"""Texels of one period of striped surfaces: half in the first colour, half in the second."""

_LEAF_SIDE = 256
_GREENS = np.array([(70, 104, 48), (88, 118, 52), (58, 88, 44), (112, 116, 56), (84, 100, 66)], np.float32)


@dataclass(frozen=True)
class Materials:
    """Surfaces by use; tuples hold the variants, ``signs`` texture numbers."""

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


def _stripes(rng: np.random.Generator, first: float, second: float, side: int = STRIPES_SIDE) -> Floats:
    image = np.full((side, side, 3), first, np.float32)
    image[:, side // 2 :] = second
    return image * (1.0 + 0.06 * spectral_noise(side, side, 1.0, rng))[..., None]


def city_materials(
    atlas: Atlas, rng: np.random.Generator, ground: int, ground_texels_per_m: float, variety: int, grain: float
) -> Materials:
    """Draw the textures of a city.

    Args:
        atlas: takes the textures.
        rng: decides how they look.
        ground: number of the ground texture in the atlas.
        ground_texels_per_m: its scale.
        variety: number of house fronts, and a measure of all the rest.
        grain: factor on the fine grain of all surfaces.
    """

    def surface(
        number: int, per_m: float, grain_m: float = 2.5, strength: float = 1.0, emission: float = 0.0
    ) -> Surface:
        return Surface(number, (per_m, per_m), detail_m=grain_m, detail=grain * strength, emission=emission)

    def coloured(colour: tuple[float, float, float], contrast: float, per_m: float) -> Surface:
        return surface(atlas.add(plain(rng, colour, contrast)), per_m)

    def wall(tone: float) -> Surface:
        red, green, blue = (tone * rng.uniform(0.94, 1.06, 3)).tolist()
        return surface(atlas.add(plain(rng, (red, green, blue), 0.045)), 20.0, 6.0, 0.22)

    def leaves(colour: NDArray[np.float32]) -> Surface:
        number = atlas.add(foliage(rng, colour, _LEAF_SIDE))
        scale = float(_LEAF_SIDE)
        return Surface(number, (scale, scale), detail_m=1.1, detail=0.6 * grain, shape=CUT_OUT | TWO_SIDED)

    def kerb(first: float, second: float) -> Surface:
        number = atlas.add(rgba(_stripes(rng, first, second)))
        return Surface(number, (32.0, 64.0 / KERB_M), detail_m=2.0, detail=0.8 * grain)

    some = max(1, variety // 3)
    red_white = _stripes(rng, 225.0, 225.0)
    red_white[:, STRIPES_SIDE // 2 :] *= (0.85, 0.25, 0.12)
    bulb = rgba(np.full((64, 64, 3), 235.0, np.float32), 255.0)
    return Materials(
        facades=tuple(surface(atlas.add(facade(rng)), FACADE_TEXELS_PER_M, 2.1, 1.0, 1.0) for _ in range(variety)),
        shops=tuple(surface(atlas.add(shop_front(rng)), SHOP_TEXELS_PER_M, 2.3, 0.6, 1.0) for _ in range(some)),
        walls=(wall(150.0), wall(185.0)),
        signs=tuple(atlas.add(sign(rng)) for _ in range(some + 4)),
        leaves=tuple(leaves(colour) for colour in _GREENS),
        hedges=tuple(surface(atlas.add(foliage(rng, c, dense=True)), 110.0, 1.7, 0.7) for c in _GREENS[:3]),
        kerbs=(kerb(160.0, 150.0), kerb(225.0, 45.0)),
        barrier=surface(atlas.add(rgba(red_white)), 42.0, 1.7, 0.7),
        concrete=coloured((158.0, 155.0, 150.0), 0.05, 40.0),
        roof=coloured((96.0, 94.0, 92.0), 0.08, 20.0),
        metal=coloured((92.0, 94.0, 96.0), 0.08, 100.0),
        bark=coloured((84.0, 68.0, 54.0), 0.25, 100.0),
        lamp=Surface(atlas.add(bulb), (60.0, 60.0), detail=0.0, emission=4.0),
        ground=Surface(
            ground, (ground_texels_per_m, ground_texels_per_m), detail_m=2.6, detail=0.55 * grain, material=GROUND
        ),
    )
