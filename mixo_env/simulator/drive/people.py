"""People of one scene: walking on pavements and over crossings, standing, cycling along the edge of the carriageway.

Walking speed 1.3 +- 0.2 m/s (Bohannon and Andrews, "Normal walking speed: a descriptive meta-analysis", Physiotherapy
97, 2011); the length of a step grows with the square root of the speed. Cyclists in cities ride at 4 to 6 m/s. How many
there are: a key frame of nuScenes shows 7 people on average (Caesar et al., "nuScenes", CVPR 2020), of whom one
in five stands; the number is drawn anew for every scene. Nobody comes near a vehicle that moves: whoever would waits
at the kerb, and where that does not help is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.land import Land
from mixo_env.simulator.city.materials import KERB_M
from mixo_env.simulator.city.people import LOOKS, PersonState
from mixo_env.simulator.city.streets import BLOCK_M, HALF_CITY_BLOCKS, HALF_ROAD_M
from mixo_env.simulator.drive.drive import Drive
from mixo_env.simulator.drive.traffic import Lane, Vehicle, car_itself, lanes_of, scene_clock

FloatArray = NDArray[np.float64]
Place = tuple[Lane, Land]
"""A lane and the land that it lies on."""

PER_METRE = 0.015
"""Median of the people per metre of pavement; gives about 7 in view of all cameras."""

SHARE_OF = {"day": 1.0, "rain": 0.5, "night": 0.35}
"""How many of them are out, by weather."""

_SPREAD = 0.6  # of the logarithm of their number, between scenes
_STANDING = 0.25  # share of groups of people that stand
_PAIRS = 0.25  # share of walkers with another one at their side
_WALK_M = (8.2, 9.5)  # from the centre line: clear of lamps and trees, and of the houses
_CYCLE_M = 3.75  # likewise, between the lane and the parked cars
_CYCLISTS = 0.5  # per lane of the own street; half of that on others
_NEAR_M = 70.0
_CYCLE_STRIDE_M = 5.0  # way of a turn of the pedals
_STRIDE_M = 1.42  # way of two steps at 1.3 m/s
_KERB_RAMP_M = 0.3
_WAITS_S = (0.0, 3.0, 6.0, 10.0, 60.0)
_CLEAR_AHEAD_M, _CLEAR_ASIDE_M = 1.0, 0.5


@dataclass(frozen=True)
class Person:
    """One person over a scene: ``(n,)`` samples, map frame; ``stride`` counts cycles."""

    kind: str
    look: int
    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray
    yaw_rad: FloatArray
    stride: FloatArray

    def state(self, time_s: float) -> PersonState:
        """Where the person is and in which pose at one instant of the scene."""
        x, y, z, yaw, stride = (
            float(np.interp(time_s, self.time_s, values))
            for values in (self.x_m, self.y_m, self.z_m, self.yaw_rad, self.stride)
        )
        step_s = float(self.time_s[1] - self.time_s[0])
        index = int(np.clip((time_s - self.time_s[0]) / step_s, 0, len(self.time_s) - 2))
        moved = self.x_m[index + 1] - self.x_m[index], self.y_m[index + 1] - self.y_m[index]
        speed = float(np.hypot(*moved)) / step_s
        return PersonState(self.kind, self.look, x, y, z, yaw, speed, stride % 1.0)


def stage_people(
    rng: np.random.Generator, drive: Drive, land: Land, seconds: float, vehicles: Sequence[Vehicle], weather: str
) -> tuple[Person, ...]:
    """All people near the car in one scene.

    Args:
        rng: draws who they are and where they go.
        drive: of the car.
        land: of the city.
        seconds: length of the scene.
        vehicles: of the scene, the car not among them.
        weather: a key of ``SHARE_OF``.
    """
    time_s = scene_clock(seconds)
    movers = [car_itself(drive, time_s), *vehicles]
    density = PER_METRE * SHARE_OF[weather] * float(rng.lognormal(0.0, _SPREAD))
    own, crossing = lanes_of(drive, time_s)
    people: list[Person] = []
    for lane in dict.fromkeys((*own, *(lane.opposite for lane in own), *crossing)):
        along = drive.route.on_grid(drive.at("s_m", time_s))[lane.axis]
        edge_m = (HALF_CITY_BLOCKS - 0.1) * BLOCK_M
        low, high = max(along.min() - _NEAR_M, -edge_m), min(along.max() + _NEAR_M, edge_m)
        if high <= low:
            continue
        for _ in range(int(rng.poisson(density * (high - low)))):
            people += _walkers(rng, (lane, land), time_s, rng.uniform(low, high), movers)
        is_own = lane in own or lane.opposite in own
        rate = _CYCLISTS * (1.0 if is_own else 0.5) * SHARE_OF[weather]
        for _ in range(int(rng.poisson(rate))):
            rider = _cyclist(rng, (lane, land), time_s, rng.uniform(low, high))
            if not any(clash(rider, other) for other in movers) and not any(_meets(rider, other) for other in people):
                people.append(rider)
    return tuple(people)


class _Walk(NamedTuple):
    """Who walks: look, share of the cycle at the start, and speed."""

    look: int
    phase: float
    speed_mps: float


def _walkers(
    rng: np.random.Generator, place: Place, time_s: FloatArray, start_m: float, movers: Sequence[Vehicle]
) -> list[Person]:
    """Whoever walks or stands together on the pavement beside a lane."""
    lane, _ = place
    stands, together = rng.uniform() < _STANDING, rng.uniform() < _PAIRS
    speed = float(np.clip(rng.normal(1.3, 0.2), 0.7, 2.0))
    sense = int(rng.choice([-1, 1]))
    aside_m = float(rng.uniform(*_WALK_M))
    turn = float(rng.uniform(-np.pi, np.pi))
    looks = rng.integers(LOOKS, size=2)
    phases = rng.uniform(0.0, 1.0, 2)
    if stands:
        if _on_carriageway(np.array([start_m]))[0]:
            return []
        return [
            _on_pavement(place, aside_m, time_s, np.full_like(time_s, start_m), turn, _Walk(int(looks[0]), 0.0, speed))
        ]
    for wait_s in _WAITS_S:
        along = _walked(start_m, sense, speed, wait_s, time_s)
        heading = lane.axis * 0.5 * np.pi + (0.0 if sense > 0 else np.pi)
        group = [_on_pavement(place, aside_m, time_s, along, heading, _Walk(int(looks[0]), phases[0], speed))]
        if together:
            beside_m = aside_m + (0.65 if aside_m < 8.85 else -0.65)
            group.append(_on_pavement(place, beside_m, time_s, along, heading, _Walk(int(looks[1]), phases[1], speed)))
        if not any(clash(person, other) for person in group for other in movers):
            return group
    return []


def _walked(start_m: float, sense: int, speed: float, wait_s: float, time_s: FloatArray) -> FloatArray:
    """Coordinate along the street of someone who waits ``wait_s`` at the first kerb on the way."""
    moved_m = speed * (time_s - time_s[0])
    # The first kerb lies HALF_ROAD_M before a crossing's centre.
    ahead_m = sense * start_m
    kerb_m = np.ceil((ahead_m + HALF_ROAD_M + 0.4) / BLOCK_M) * BLOCK_M - HALF_ROAD_M - 0.4
    free_m = max(kerb_m - ahead_m, 0.0)
    moved_m = np.where(moved_m < free_m, moved_m, np.maximum(moved_m - speed * wait_s, free_m))
    return start_m + sense * moved_m


def _on_carriageway(along_m: FloatArray) -> NDArray[np.bool_]:
    """Whether a pavement at that coordinate is interrupted by a street that it crosses."""
    return np.abs(along_m - np.round(along_m / BLOCK_M) * BLOCK_M) < HALF_ROAD_M


def _on_pavement(
    place: Place, aside_m: float, time_s: FloatArray, along_m: FloatArray, yaw_rad: float, who: _Walk
) -> Person:
    """Someone on the pavement beside ``lane``, stepping down where it crosses a street."""
    lane, land = place
    u, v, _ = lane.at(along_m, aside_m)
    yaw = land.heading(u, v, np.full_like(time_s, yaw_rad))
    to_centre = np.abs(along_m - np.round(along_m / BLOCK_M) * BLOCK_M)
    height = KERB_M * np.clip((to_centre - HALF_ROAD_M) / _KERB_RAMP_M, 0.0, 1.0)
    way_m = np.abs(along_m - along_m[0])
    stride_m = _STRIDE_M * (who.speed_mps / 1.3) ** 0.5
    return Person("walker", who.look, time_s, *land.map(u, v), height, yaw, who.phase + way_m / stride_m)


def _cyclist(rng: np.random.Generator, place: Place, time_s: FloatArray, start_m: float) -> Person:
    """Someone who cycles along the right edge of a lane."""
    lane, land = place
    way_m = rng.uniform(4.0, 6.0) * (time_s - time_s[0])
    u, v, heading = lane.at(start_m + lane.direction * way_m, _CYCLE_M + rng.uniform(-0.1, 0.1))
    yaw = land.heading(u, v, np.full_like(time_s, heading))
    stride = rng.uniform() + way_m / _CYCLE_STRIDE_M
    return Person("cyclist", int(rng.integers(LOOKS)), time_s, *land.map(u, v), np.zeros_like(u), yaw, stride)


def clash(person: Person, vehicle: Vehicle) -> bool:
    """Whether the person ever comes close to a vehicle (both on the same clock)."""
    length_m, width_m = vehicle.size_m
    dx, dy = person.x_m - vehicle.x_m, person.y_m - vehicle.y_m
    c, s = np.cos(vehicle.yaw_rad), np.sin(vehicle.yaw_rad)
    half_m = 0.9 if person.kind == "cyclist" else 0.3
    near = np.abs(c * dx + s * dy) < 0.5 * length_m + _CLEAR_AHEAD_M + half_m
    near &= np.abs(c * dy - s * dx) < 0.5 * width_m + _CLEAR_ASIDE_M
    return bool(near.any())


def _meets(rider: Person, other: Person) -> bool:
    """Whether a cyclist ever comes close to someone else."""
    return bool((np.hypot(rider.x_m - other.x_m, rider.y_m - other.y_m) < 2.0).any())
