"""One block of the city: what stands along its four sides, put in its place on the map."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city import furniture, laying
from mixo_env.simulator.city.land import FLAT, Land
from mixo_env.simulator.city.materials import KERB_M, Materials
from mixo_env.simulator.city.mesh import SHADE, Mesh, joined, mesh_of, placed, quad
from mixo_env.simulator.city.roundabout import Crossing
from mixo_env.simulator.city.shadows import Shadows
from mixo_env.simulator.city.streets import BLOCK_M, HALF_ROAD_M, PARKING_M, SIDEWALK_M
from mixo_env.simulator.city.vehicles import COLOURS, VEHICLE_KINDS

SIDES = ("south", "east", "north", "west")
"""Sides of a block in the order of their numbers, anticlockwise."""

FRONT_M = BLOCK_M - 2.0 * SIDEWALK_M
"""Length of the house fronts along one side."""

_KERB_Y = HALF_ROAD_M - SIDEWALK_M
_PARKING_Y = PARKING_M - SIDEWALK_M
_CORNER_M = 14.0  # plots of the south and north side are this deep: the other two sides start behind them


@dataclass
class City:
    """Everything blocks are built from, and what they leave behind.

    Attributes:
        land: that all stands on.
        materials: surfaces.
        trees: meshes at the origin with height and radius of their crowns.
        lamp: mesh of a street lamp at the origin, its arm towards -y.
        traffic_light: mesh at the origin.
        vehicles: meshes of vehicles, by kind and colour.
        shadows: collects what throws shadows.
        blank_walls: share of plots with a windowless building.
        parked: share of parking places taken.
        lamps: collects the positions of street lamps, map frame, metres.
        groups: collects the meshes, map frame.
    """

    land: Land
    materials: Materials
    trees: list[tuple[Mesh, float, float]]
    lamp: Mesh
    traffic_light: Mesh
    vehicles: dict[tuple[str, int], Mesh]
    shadows: Shadows
    blank_walls: float
    parked: float
    lamps: list[NDArray[np.float64]] = field(default_factory=list)
    groups: list[Mesh] = field(default_factory=list)


@dataclass(frozen=True)
class _Frame:
    """Frame of one side of a block on the street grid."""

    x_m: float
    y_m: float
    yaw_rad: float

    def points(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """``(n, 2)`` points of the side's frame on the grid."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return points @ np.array([[c, s], [-s, c]]) + (self.x_m, self.y_m)

    def rectangle(self, x: tuple[float, float], y: tuple[float, float]) -> NDArray[np.float64]:
        """``(4, 2)`` corners on the grid."""
        return self.points(np.array([(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]))

    def put(self, mesh: Mesh) -> Mesh:
        """The mesh on the grid."""
        return placed(mesh, self.x_m, self.y_m, self.yaw_rad)

    def stand(self, mesh: Mesh, land: Land, x_m: float, y_m: float, yaw_rad: float = 0.0, scale: float = 1.0) -> Mesh:
        """The mesh at a point of the side's frame, on the map."""
        u, v = self.points(np.array([[x_m, y_m]]))[0].tolist()
        return laying.standing(mesh, land, u, v, self.yaw_rad + yaw_rad, scale)

    def lay(self, mesh: Mesh, land: Land) -> Mesh:
        """A mesh of the side's frame that follows the ground, on the map."""
        return laying.laid(self.put(mesh), land)

    def level(self, mesh: Mesh, land: Land, x_m: float) -> Mesh:
        """A house of the side's frame, on the map, at the height of the ground before ``x_m``."""
        u, v = self.points(np.array([[x_m, 0.0]]))[0].tolist()
        return laying.levelled(self.put(mesh), land, u, v)


def _frame(column: int, row: int, side: int) -> _Frame:
    west, south = column * BLOCK_M + SIDEWALK_M, row * BLOCK_M + SIDEWALK_M
    x, y = ((west, south), (west + FRONT_M, south), (west + FRONT_M, south + FRONT_M), (west, south + FRONT_M))[side]
    return _Frame(x, y, 0.5 * np.pi * side)


def build_pavement(city: City, column: int, row: int) -> None:
    """The raised ground of one block with its kerbs."""
    west, south, wide = column * BLOCK_M + HALF_ROAD_M, row * BLOCK_M + HALF_ROAD_M, BLOCK_M - 2.0 * HALF_ROAD_M
    ground = city.materials.ground
    top = mesh_of([quad(ground, (west, south + wide, KERB_M), (wide, 0.0, 0.0), (0.0, -wide, 0.0))])
    parts = [laying.laid(laying.ground_aligned(top, ground.texels_per_m[0], FLAT), city.land)]
    kerb = city.materials.kerbs[int((column * 7 + row * 3) % 5 == 0)]
    for side in range(4):
        face = quad(kerb, (_KERB_Y, _KERB_Y, KERB_M), (wide, 0.0, 0.0), (0.0, 0.0, -KERB_M))
        parts.append(_frame(column, row, side).lay(mesh_of([face]), city.land))
    city.groups.append(joined(parts))


class SidePlan(NamedTuple):
    """What is special about a side.

    Attributes:
        park: gardens instead of houses.
        blank: one windowless wall along the whole side.
        underpass_m: length of the underpass in its middle, 0 without one: nothing stands or parks there.
    """

    park: bool = False
    blank: bool = False
    underpass_m: float = 0.0

    def blocked(self, x_m: float, margin_m: float) -> bool:
        """Whether something at ``x_m`` along the fronts would stand in the underpass or too close to it."""
        return self.underpass_m > 0.0 and abs(x_m - 0.5 * FRONT_M) < 0.5 * self.underpass_m + margin_m


def build_side(city: City, column: int, row: int, side: int, rng: np.random.Generator, plan: SidePlan) -> None:
    """Houses, trees, furniture and parked cars along one side.

    Args:
        city: materials in, meshes out.
        column: the block lies between the streets ``column`` and ``column + 1`` in x,
        row: and between ``row`` and ``row + 1`` in y.
        side: number in ``SIDES``.
        rng: of this side alone.
        plan: what is special about it.
    """
    frame = _frame(column, row, side)
    _plots(city, frame, side, rng, plan)
    _pavement_furniture(city, frame, rng, plan)
    if _corner(column, row, side) not in city.land.roundabouts:
        _signals(city, frame)
    _parked_cars(city, frame, rng, plan)


def _plots(city: City, frame: _Frame, side: int, rng: np.random.Generator, plan: SidePlan) -> None:
    materials = city.materials
    start, stop = (0.0, FRONT_M) if side % 2 == 0 else (_CORNER_M, FRONT_M - _CORNER_M)
    if plan.blank:
        x, height = (start, stop), float(rng.uniform(9.0, 14.0))
        city.groups.append(frame.lay(furniture.blank_wall(materials, rng, x, (0.0, _CORNER_M), height), city.land))
        city.shadows.prism(frame.rectangle(x, (0.0, _CORNER_M)), height, field=True)
        return
    position = start
    while position < stop - 7.0:
        width = float(min(rng.uniform(8.0, 20.0), stop - position))
        gap = float(rng.choice([0.0, 0.0, 0.0, 1.5, 4.0]))
        x = (position, position + width - gap)
        y = (float(rng.choice([0.0, 0.0, 0.4, 1.2])), float(rng.uniform(9.0, _CORNER_M)))
        position += width
        fate = rng.random()
        if plan.park or fate < 0.12:
            mesh, height = furniture.garden(materials, rng, x, y)
            city.groups.append(frame.lay(mesh, city.land))
            city.shadows.prism(frame.rectangle(x, (y[0], y[0] + 0.8)), height)
            for _ in range(int(rng.integers(1, 4))):
                _tree(city, frame, float(rng.uniform(*x)), float(rng.uniform(y[0] + 2.0, y[1])), rng)
            continue
        if fate < 0.12 + city.blank_walls:
            height = float(rng.uniform(6.0, 15.0))
            mesh = furniture.blank_wall(materials, rng, x, y, height)
        else:
            bare = plan.blocked(0.5 * (x[0] + x[1]), 0.5 * (x[1] - x[0]))
            mesh, height = furniture.house(materials, rng, x, y, int(rng.choice([2, 3, 3, 4, 5, 6, 8])), bare)
        city.groups.append(frame.level(mesh, city.land, 0.5 * (x[0] + x[1])))
        city.shadows.prism(frame.rectangle(x, y), height, field=True)


def _tree(city: City, frame: _Frame, x_m: float, y_m: float, rng: np.random.Generator) -> None:
    mesh, centre, radius = city.trees[rng.integers(len(city.trees))]
    scale = float(rng.uniform(0.75, 1.3))
    city.groups.append(frame.stand(mesh, city.land, x_m, y_m, float(rng.uniform(0.0, 2.0 * np.pi)), scale))
    x, y = frame.points(np.array([[x_m, y_m]]))[0]
    city.shadows.crown(x, y, scale * centre, scale * radius, rng)


def _pavement_furniture(city: City, frame: _Frame, rng: np.random.Generator, plan: SidePlan) -> None:
    materials, sparse = city.materials, plan.blank
    for x in np.arange(9.0, FRONT_M, 24.0) + rng.uniform(-1.0, 1.0):
        if plan.blocked(float(x), 1.0):
            continue
        city.groups.append(frame.stand(city.lamp, city.land, float(x), -2.95))
        city.shadows.prism(frame.rectangle((x - 0.1, x + 0.1), (-3.05, -2.85)), furniture.LAMP_M)
        u, v = frame.points(np.array([[x, -4.85]]))[0]
        city.lamps.append(np.array(city.land.map(u, v)))
    trees = rng.uniform(0.15, 0.55)
    position = 3.0
    while position < FRONT_M - 2.0:
        y = -2.5 + float(rng.uniform(-0.25, 0.25))
        fate = rng.random()
        if plan.blocked(position, 3.5):
            pass
        elif fate < trees:
            if not sparse:
                _tree(city, frame, position, y, rng)
        elif fate < trees + 0.14:
            city.groups.append(frame.stand(furniture.traffic_sign(materials, rng), city.land, position, y - 0.3))
            city.shadows.prism(frame.rectangle((position - 0.06, position + 0.06), (y - 0.4, y - 0.2)), 2.9)
        elif fate < trees + 0.3 and not sparse:
            city.groups.append(frame.stand(furniture.street_box(materials, rng), city.land, position, y))
            city.shadows.prism(frame.rectangle((position - 0.4, position + 0.4), (y - 0.4, y + 0.4)), 1.2)
        position += float(rng.uniform(3.5, 9.0))


def _signals(city: City, frame: _Frame) -> None:
    """The traffic light at the crossing where the side begins."""
    x = _KERB_Y + 0.5
    city.groups.append(frame.stand(city.traffic_light, city.land, x, _KERB_Y + 0.5))
    city.shadows.prism(frame.rectangle((x - 0.1, x + 0.1), (_KERB_Y + 0.4, _KERB_Y + 0.6)), 3.6)


def _corner(column: int, row: int, side: int) -> Crossing:
    """The crossing where a side of a block begins."""
    return column + (side in (1, 2)), row + (side in (2, 3))


def _parked_cars(city: City, frame: _Frame, rng: np.random.Generator, plan: SidePlan) -> None:
    position = 6.0
    while position < FRONT_M - 6.0:
        kind = str(rng.choice(["sedan", "sedan", "sedan", "suv", "suv", "van"]))
        colour, taken = int(rng.integers(COLOURS)), rng.random() < city.parked
        if taken and not plan.blocked(position, 3.5):
            turn = np.pi + float(rng.normal(0.0, 0.02))  # right-hand traffic: the kerb is on the right
            y = _PARKING_Y + float(rng.normal(0.0, 0.06))
            at = frame.points(np.array([[position, y]]))[0].tolist()
            mesh = laying.parked(city.vehicles[kind, colour], city.land, at[0], at[1], frame.yaw_rad + turn)
            city.groups.append(_dark(mesh, city))
            size = VEHICLE_KINDS[kind]
            x = (position - 0.48 * size.length_m, position + 0.48 * size.length_m)
            outline = frame.rectangle(x, (y - 0.5 * size.width_m, y + 0.5 * size.width_m))
            city.shadows.prism(outline, 0.8 * size.height_m, floor_m=0.3)
        position += float(rng.uniform(5.8, 7.4))


def _dark(mesh: Mesh, city: City) -> Mesh:
    """A parked vehicle: its lamps are off, and the ground below it shows."""
    mesh["emission"] = 0.0
    under = mesh["material"] == SHADE
    mesh[under] = laying.ground_aligned(mesh[under], city.materials.ground.texels_per_m[0], city.land)
    return mesh
