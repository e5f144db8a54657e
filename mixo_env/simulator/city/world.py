"""A whole city from one seed."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.simulator.city.blocks import SIDES, City, SidePlan, build_pavement, build_side
from mixo_env.simulator.city.furniture import LAMP_M, street_lamp, traffic_light, tree
from mixo_env.simulator.city.ground import GROUND_PERIOD_M, ground_texture
from mixo_env.simulator.city.island import HEDGE_M, HEDGE_TOP_M, island, outline
from mixo_env.simulator.city.land import FLAT, Land
from mixo_env.simulator.city.laying import ground_aligned, laid, parked
from mixo_env.simulator.city.materials import city_materials
from mixo_env.simulator.city.mesh import Mesh, PatchSet, mesh_of, packed, quad
from mixo_env.simulator.city.people_models import people_models
from mixo_env.simulator.city.shadows import EXTENT_M, Shadows
from mixo_env.simulator.city.streets import BLOCK_M, HALF_CITY_BLOCKS, HALF_ROAD_M, SIDEWALK_M
from mixo_env.simulator.city.textures import Atlas, detail_tile, quads, reductions, sky_tile
from mixo_env.simulator.city.underpass import CLEARANCE_M, DECK_M, Underpass, underpass_at, underpass_mesh
from mixo_env.simulator.city.vehicle_models import vehicle_models

BlockSide = tuple[int, int, str]
"""Column, row and side (in ``SIDES``) of a block; block (i, j) begins at the streets x = i and y = j."""

_GROUND_HALF_M = 1024.0


@dataclass(frozen=True)
class World:
    """Everything the renderer reads; plain arrays, so it can be pickled and shared.

    Attributes:
        seed: the city's seed.
        sun: ``(3,)`` unit vector towards the sun, map frame.
        static: patches of everything that never moves.
        vehicles: meshes of vehicles by kind and colour, x forward, origin at the centre on the ground.
        people: meshes of people by kind and look, one for every pose.
        texels, table: packed atlas, see ``Atlas.packed``.
        detail: fine-grain tile with reductions as :func:`quads`, one after the other.
        detail_start: first entry of each reduction.
        sky: clouds, ``(512, 512)`` bytes.
        sunlight: ``(4096, 4096)`` sunlight on the ground, bytes, indexed by the street grid as the ground's texture is.
        shadow_height: ``(2048, 2048)`` float32 height in metres below which houses keep the sun out, map frame.
        lamp_light: ``(1024, 1024)`` float32 light of the street lamps on the ground, per metre, 1 under a lamp.
        ground_texels_per_m: scale of the ground texture.
        underpasses: ``(n, 4)`` rows of ``Underpass``.
        land: bends of the streets and hills.
    """

    seed: int
    sun: NDArray[np.float64]
    static: PatchSet
    vehicles: dict[tuple[str, int], Mesh]
    people: dict[tuple[str, int], list[Mesh]]
    texels: NDArray[np.uint32]
    table: NDArray[np.int64]
    detail: NDArray[np.uint32]
    detail_start: NDArray[np.int64]
    sky: NDArray[np.uint8]
    sunlight: NDArray[np.uint8]
    shadow_height: NDArray[np.float32]
    lamp_light: NDArray[np.float32]
    ground_texels_per_m: float
    underpasses: NDArray[np.float64]
    land: Land = FLAT


def grain_levels(tile: NDArray[np.uint8]) -> tuple[NDArray[np.uint32], NDArray[np.int64]]:
    """Fine grain with all reductions in one row, as :func:`quads`, and where each reduction starts."""
    levels = reductions(tile)
    start = np.concatenate([[0], np.cumsum([level.size for level in levels[:-1]])]).astype(np.int64)
    return np.concatenate([quads(level).ravel() for level in levels]), start


def lamp_light(lamps: NDArray[np.float64]) -> NDArray[np.float32]:
    """Light of lamps at ``(n, 2)`` metres on level ground, ``(1024, 1024)`` one value a metre, indexed [y, x]."""
    side, reach = int(EXTENT_M), 30
    light = np.zeros((side + 2 * reach, side + 2 * reach), np.float32)
    offset = np.arange(-reach, reach + 1)
    for x, y in lamps + 0.5 * EXTENT_M - 0.5:
        column, row = int(np.floor(x)), int(np.floor(y))
        if not (0 <= column < side and 0 <= row < side):
            continue
        squared = (offset[None, :] + column - x) ** 2 + (offset[:, None] + row - y) ** 2
        window = np.clip(1.0 - squared / reach**2, 0.0, 1.0)
        splat = window * LAMP_M**3 / (squared + LAMP_M**2) ** 1.5
        light[row : row + 2 * reach + 1, column : column + 2 * reach + 1] += splat.astype(np.float32)
    return np.ascontiguousarray(light[reach:-reach, reach:-reach])


@dataclass(frozen=True)
class CityPlan:
    """What kind of city to build.

    Attributes:
        blank_walls: share of plots with windowless buildings; 0.85 makes feature trackers fail.
        parked: share of parking places taken.
        grain: strength of the fine grain of all surfaces; 0.3 gives a city with little texture.
        blank_sides: sides of blocks that are one long windowless wall, e.g. ``(0, -1, "north")``.
        half_blocks: the city reaches this many blocks from the origin (tests build smaller ones).
        underpasses: share of blocks' lengths of street with a bridge over it.
        low_sun: the sun stands 7 to 16 degrees high and at most 12 degrees off the direction of a street, where houses
            leave it in sight; else 30 to 62 degrees, anywhere.
        variety: number of house fronts drawn.
        land: bends of the streets and hills.
        ground_side: texels along the side of the ground texture, a power of two.

    Raises:
        ConfigurationError: for shares outside 0..1, an unknown side or a city larger than its maps.
    """

    blank_walls: float = 0.12
    parked: float = 0.6
    grain: float = 1.0
    blank_sides: Collection[BlockSide] = ()
    half_blocks: int = HALF_CITY_BLOCKS
    underpasses: float = 0.06
    low_sun: bool = False
    variety: int = 28
    ground_side: int = 4096
    land: Land = FLAT

    def __post_init__(self) -> None:
        for name, share in (
            ("blank_walls", self.blank_walls),
            ("parked", self.parked),
            ("underpasses", self.underpasses),
        ):
            if not 0.0 <= share <= 1.0:
                raise ConfigurationError(f"{name} is a share and must lie in 0..1, got {share}")
        if not 1 <= self.half_blocks <= HALF_CITY_BLOCKS:
            raise ConfigurationError(f"half_blocks must lie in 1..{HALF_CITY_BLOCKS}, got {self.half_blocks}")
        for side in self.blank_sides:
            if side[2] not in SIDES:
                raise ConfigurationError(f"blank side {side!r}: the side must be one of {', '.join(SIDES)}")


_USUAL = CityPlan()


def build_world(seed: int, plan: CityPlan = _USUAL) -> World:
    """Build the city of ``seed``; the same arguments give the same bits.

    Args:
        seed: decides textures, houses, furniture, parked cars and the position of the sun.
        plan: what kind of city.
    """
    texture_rng, sun_rng, tree_rng = (np.random.default_rng([seed, part]) for part in range(3))
    atlas = Atlas()
    ground_per_m = plan.ground_side / GROUND_PERIOD_M
    ground = atlas.add(ground_texture(texture_rng, plan.ground_side))
    materials = city_materials(atlas, texture_rng, ground, ground_per_m, plan.variety, plan.grain)
    vehicles = vehicle_models(atlas, texture_rng, ground, ground_per_m)
    people = people_models(atlas, np.random.default_rng([seed, 5]), ground, ground_per_m)
    sun = _sun(sun_rng, plan.low_sun)
    trees = [tree(materials, tree_rng) for _ in range(12)]
    lamp, signals = street_lamp(materials, tree_rng), traffic_light(materials, tree_rng)
    shadows = Shadows(sun, plan.land)
    city = City(plan.land, materials, trees, lamp, signals, vehicles, shadows, plan.blank_walls, plan.parked)
    city.groups += _ground(city, ground_per_m, plan.half_blocks)
    _islands(city, plan.half_blocks)
    bridges = _bridges(city, seed, plan)
    _blocks(city, seed, plan, bridges)

    detail, detail_start = grain_levels(detail_tile(texture_rng))
    texels, table = atlas.packed()
    return World(
        seed=seed,
        sun=sun,
        static=packed(city.groups, sun),
        vehicles=vehicles,
        people=people,
        texels=texels,
        table=table,
        detail=detail,
        detail_start=detail_start,
        sky=sky_tile(texture_rng),
        sunlight=city.shadows.picture(),
        shadow_height=city.shadows.field(),
        lamp_light=lamp_light(np.array(city.lamps)),
        ground_texels_per_m=ground_per_m,
        underpasses=np.array(list(bridges.values()), np.float64).reshape(-1, 4),
        land=plan.land,
    )


def _sun(rng: np.random.Generator, low: bool) -> NDArray[np.float64]:
    """Unit vector towards the sun."""
    azimuth, elevation = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(30.0, 62.0)
    if low:
        quarter = 0.5 * np.pi
        azimuth = quarter * round(azimuth / quarter) + np.deg2rad(rng.uniform(-12.0, 12.0))
        elevation = rng.uniform(7.0, 16.0)
    elevation = np.deg2rad(elevation)
    return np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])


def _islands(city: City, half_blocks: int) -> None:
    """The islands of the roundabouts."""
    mesh = island(city.materials)
    for crossing in sorted(city.land.roundabouts):
        if max(map(abs, crossing)) <= half_blocks:
            u, v = (BLOCK_M * number for number in crossing)
            city.groups.append(parked(mesh, city.land, u, v, 0.0))
            city.shadows.prism(outline(HEDGE_M) + np.array((u, v)), HEDGE_TOP_M)


def _bridges(city: City, seed: int, plan: CityPlan) -> dict[tuple[int, int, int], Underpass]:
    """Put up the bridges, by axis, street and block of their place."""
    bridges = {}
    half = plan.half_blocks
    for axis in range(2):
        for street in range(-half, half + 1):
            for block in range(-half, half):
                bridge = underpass_at(seed, axis, street, block, plan.underpasses)
                if bridge is None:
                    continue
                bridges[axis, street, block] = bridge
                city.groups.append(underpass_mesh(city.materials, bridge, city.land))
                sides = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
                reach = (0.5 * bridge.length_m, SIDEWALK_M) if axis == 0 else (SIDEWALK_M, 0.5 * bridge.length_m)
                outline = sides * reach + (bridge.x_m, bridge.y_m)
                city.shadows.prism(outline, DECK_M, floor_m=CLEARANCE_M, field=True)
    return bridges


def _ground(city: City, texels_per_m: float, half_blocks: int) -> list[Mesh]:
    """The roads, and all around the city; blocks with a pavement need nothing below it."""
    streets = BLOCK_M * np.arange(-HALF_CITY_BLOCKS - 1, HALF_CITY_BLOCKS + 2)
    kerbs = np.ravel(streets[:, None] + [-HALF_ROAD_M, HALF_ROAD_M])
    lines = [-_GROUND_HALF_M, *kerbs.tolist(), _GROUND_HALF_M]
    groups = []
    for (west, east), (south, north) in itertools.product(itertools.pairwise(lines), repeat=2):
        column, row = (int(np.floor(0.5 * (low + high) / BLOCK_M)) for low, high in ((west, east), (south, north)))
        in_block = all(HALF_ROAD_M * 2.1 < high - low < BLOCK_M for low, high in ((west, east), (south, north)))
        if in_block and _faces(half_blocks, column, row):
            continue
        face = quad(city.materials.ground, (west, north, 0.0), (east - west, 0.0, 0.0), (0.0, south - north, 0.0))
        groups.append(laid(ground_aligned(mesh_of([face]), texels_per_m, FLAT), city.land))
    return groups


def _faces(half_blocks: int, column: int, row: int) -> list[int]:
    """Sides of a block that are built: all in the city, and those that face it in a ring around it."""

    def inside(column: int, row: int) -> bool:
        return -half_blocks <= column < half_blocks and -half_blocks <= row < half_blocks

    across = {"south": (0, -1), "east": (1, 0), "north": (0, 1), "west": (-1, 0)}
    return [
        number
        for number, side in enumerate(SIDES)
        if inside(column, row) or inside(column + across[side][0], row + across[side][1])
    ]


def _blocks(city: City, seed: int, plan: CityPlan, bridges: dict[tuple[int, int, int], Underpass]) -> None:
    """All blocks, and around them a ring of which only the sides that face the city are built."""
    half_blocks, blank_sides = plan.half_blocks, set(plan.blank_sides)
    for column in range(-half_blocks - 1, half_blocks + 1):
        for row in range(-half_blocks - 1, half_blocks + 1):
            faces = _faces(half_blocks, column, row)
            if not faces:
                continue
            build_pavement(city, column, row)
            for number in faces:
                # Every side has its own stream: changing one share leaves the rest of the city as it is.
                rng = np.random.default_rng([seed, 3, column + 100, row + 100, number])
                park = np.random.default_rng([seed, 4, column + 100, row + 100]).random() < 0.12
                side = SIDES[number]
                bridge = bridges.get(_place(column, row, side))
                kind = SidePlan(park, (column, row, side) in blank_sides, bridge.length_m if bridge else 0.0)
                build_side(city, column, row, number, rng, kind)


def _place(column: int, row: int, side: str) -> tuple[int, int, int]:
    """Axis, street and block of the street along a side of a block."""
    if side in ("south", "north"):
        return 0, row + (side == "north"), column
    return 1, column + (side == "east"), row
