"""The other vehicles of a scene: ahead, behind, oncoming and crossing, each on its own smooth way, none colliding.

Vehicles in the car's own lane follow Newell's car-following model: the same trajectory, shifted in time and space
(Newell 2002, "A simplified car-following theory: a lower order model"). All others drive along lanes of the
streets. A candidate that would come too close to the car or to an earlier vehicle at any time is left out.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.land import Land
from mixo_env.simulator.city.roundabout import CALM_MPS, ISLAND_M, Crossing, swerve
from mixo_env.simulator.city.streets import BLOCK_M, HALF_CITY_BLOCKS, LANE_M
from mixo_env.simulator.city.vehicles import COLOURS, VEHICLE_KINDS, VehicleState
from mixo_env.simulator.drive.drive import Drive
from mixo_env.simulator.drive.routes import PASSING_M

FloatArray = NDArray[np.float64]

CAR_LENGTH_M, CAR_WIDTH_M = 4.08, 1.95
"""The car itself (with its mirrors)."""

REAR_AXLE_TO_FRONT_M = 3.44
REAR_AXLE_TO_REAR_M = CAR_LENGTH_M - REAR_AXLE_TO_FRONT_M

_RATE_HZ = 20
_BEYOND_S = 0.5  # vehicles are known this long before and after the scene
_SIGHT_M = 110.0
_STANDING_ASIDE_M = 1.5  # who stands in the lane stands this far right of its middle, along the parked cars
_CLEAR_AHEAD_M, _CLEAR_ASIDE_M = 0.9, 0.15  # room around every vehicle, half of the smallest gap
_CLEAR_IN_CONVOY_M = 0.25  # instead, where everybody creeps bumper to bumper
_CLEAR_OF_ISLANDS_M = 0.2  # of a convoy, whose second column would else drive over the islands of roundabouts
_COLUMN_ASIDE_M = 3.9  # of its other column: beyond the middle of the oncoming lane, as vehicles cut in in a turn
_GAPS_M = (0.8, 1.0, 1.3, 1.7, 2.2, 2.8, 3.5)  # of a convoy to the vehicles before and behind the car
_KINDS, _KIND_SHARES = ("sedan", "suv", "van", "truck"), (0.52, 0.26, 0.15, 0.07)


@dataclass(frozen=True)
class Vehicle:
    """One vehicle over a scene: ``(n,)`` samples of the centre on the ground, map frame; heading not wrapped."""

    kind: str
    colour: int
    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray

    @property
    def size_m(self) -> tuple[float, float]:
        """Length and width."""
        kind = VEHICLE_KINDS[self.kind]
        return kind.length_m, kind.width_m

    def state(self, time_s: float) -> VehicleState:
        """Where the vehicle is and how it moves at one instant of the scene."""
        index = int(np.clip((time_s - self.time_s[0]) * _RATE_HZ, 0, len(self.time_s) - 2))
        part = (time_s - self.time_s[index]) * _RATE_HZ
        x, y, yaw = (
            values[index] + part * (values[index + 1] - values[index]) for values in (self.x_m, self.y_m, self.yaw_rad)
        )
        rate_x, rate_y, rate_yaw = (
            _RATE_HZ * (values[index + 1] - values[index]) for values in (self.x_m, self.y_m, self.yaw_rad)
        )
        speed = rate_x * np.cos(yaw) + rate_y * np.sin(yaw)
        return VehicleState(self.kind, self.colour, float(x), float(y), float(yaw), float(speed), float(rate_yaw))


@dataclass(frozen=True)
class Lane:
    """One lane of the grid: along ``axis`` (0 = x, 1 = y) of street ``street``, driven in ``direction`` +1 or -1."""

    axis: int
    street: int
    direction: int

    @property
    def opposite(self) -> Lane:
        """The other lane of the street."""
        return Lane(self.axis, self.street, -self.direction)

    def crossing(self, number: int) -> Crossing:
        """The crossing with street ``number`` of the other axis."""
        return (number, self.street) if self.axis == 0 else (self.street, number)

    def at(self, along_m: FloatArray, aside_m: float | FloatArray = LANE_M) -> tuple[FloatArray, FloatArray, float]:
        """u, v and heading, on the grid, of points at ``along_m``, ``aside_m`` right of the street's centre line."""
        # Right-hand traffic: eastbound lanes lie south of the centre line, northbound ones east of it.
        aside = self.street * BLOCK_M + (aside_m if self.axis else -aside_m) * self.direction
        across = np.full_like(along_m, aside)
        heading = 0.5 * np.pi * self.axis + (0.0 if self.direction > 0 else np.pi)
        return (along_m, across, heading) if self.axis == 0 else (across, along_m, heading)


def stage_traffic(rng: np.random.Generator, drive: Drive, seconds: float, land: Land) -> tuple[Vehicle, ...]:
    """All other vehicles of one scene.

    Args:
        rng: draws vehicles and their ways.
        drive: of the car; ``drive.situation`` decides what is staged.
        seconds: length of the scene.
        land: of the city.
    """
    time_s = scene_clock(seconds)
    accepted = [car_itself(drive, time_s)]
    car = accepted[0]
    if drive.situation == "majority_wrong":
        for vehicle in _convoy(rng, drive, time_s):
            free = not any(_too_close(vehicle, other, _CLEAR_IN_CONVOY_M) for other in accepted)
            if free and not _over_an_island(vehicle, land):
                accepted.append(vehicle)
    for vehicle in _candidates(rng, drive, time_s, land):
        near = np.hypot(vehicle.x_m - car.x_m, vehicle.y_m - car.y_m).min() < _SIGHT_M
        if near and not any(_too_close(vehicle, other) for other in accepted):
            accepted.append(vehicle)
    return tuple(accepted[1:])


def scene_clock(seconds: float) -> FloatArray:
    """Times at which everybody's place is known, from shortly before the scene until shortly after it."""
    return np.arange(-_BEYOND_S, seconds + _BEYOND_S, 1.0 / _RATE_HZ)


def car_itself(drive: Drive, time_s: FloatArray) -> Vehicle:
    """The car as an obstacle (a sedan is a little larger than it)."""
    x, y, yaw = (drive.at(name, time_s) for name in ("x_m", "y_m", "yaw_rad"))
    ahead = 0.5 * (REAR_AXLE_TO_FRONT_M - REAR_AXLE_TO_REAR_M)
    return Vehicle("sedan", 0, time_s, x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), yaw)


def _candidates(rng: np.random.Generator, drive: Drive, time_s: FloatArray, land: Land) -> Iterator[Vehicle]:
    """Vehicles in the order of their importance; the first ones are the staged ones."""
    situation = drive.situation
    if situation == "lead_truck":
        yield _in_own_lane(rng, drive, time_s, "truck", rng.uniform(0.7, 1.2), gap_m=rng.uniform(3.2, 4.2))
    elif rng.uniform() < 0.35 and situation != "standing_cross_traffic":  # who leads would stand in the crossing
        yield _in_own_lane(rng, drive, time_s, _kind(rng), rng.uniform(1.4, 3.0), gap_m=rng.uniform(2.5, 6.0))
    if situation == "following_van":
        yield _in_own_lane(rng, drive, time_s, "van", -rng.uniform(0.4, 0.8), gap_m=rng.uniform(2.4, 3.0))
    elif rng.uniform() < 0.35:
        yield _in_own_lane(rng, drive, time_s, _kind(rng), -rng.uniform(1.2, 2.5), gap_m=rng.uniform(2.5, 6.0))

    for passed_m in drive.route.passed_m:
        yield _in_the_way(rng, drive, time_s, passed_m)
    own, crossing = lanes_of(drive, time_s)
    for lane in own:
        if situation == "side_queue":
            speed_mps, pause_m = rng.uniform(0.0, 1.0), (1.5, 3.5)
        elif situation == "oncoming_platoon":
            speed_mps, pause_m = rng.uniform(5.0, 9.0), (7.0, 14.0)
        else:
            speed_mps, pause_m = rng.uniform(5.0, 10.0), (15.0, 90.0)
        yield from _flow(rng, (drive, land), time_s, lane.opposite, speed_mps, pause_m)
        yield from _flow(rng, (drive, land), time_s, lane, rng.uniform(5.0, 10.0), (20.0, 120.0))
    for lane in crossing:
        if situation == "standing_cross_traffic":
            yield from _flow(rng, (drive, land), time_s, lane, rng.uniform(5.5, 8.5), (8.0, 22.0))
        elif rng.uniform() < 0.7:
            yield from _flow(rng, (drive, land), time_s, lane, rng.uniform(5.0, 9.0), (20.0, 100.0))


def _in_own_lane(
    rng: np.random.Generator, drive: Drive, time_s: FloatArray, kind: str, ahead_s: float, gap_m: float
) -> Vehicle:
    """A vehicle on the car's own route, ``ahead_s`` in time and ``gap_m`` at standstill ahead (behind if negative)."""
    length_m = VEHICLE_KINDS[kind].length_m
    if ahead_s > 0:
        shift_m = REAR_AXLE_TO_FRONT_M + gap_m + 0.5 * length_m
    else:
        shift_m = -(REAR_AXLE_TO_REAR_M + gap_m + 0.5 * length_m)
    return _along_route(drive, time_s, (kind, _colour(rng)), drive.at("s_m", time_s + ahead_s) + shift_m)


def _along_route(
    drive: Drive, time_s: FloatArray, look: tuple[str, int], centre_m: FloatArray, aside_m: float = 0.0
) -> Vehicle:
    """A vehicle at arc lengths ``centre_m`` of the car's route, ``aside_m`` left of it."""
    length_m = VEHICLE_KINDS[look[0]].length_m
    front_x, front_y, _ = drive.route.at(centre_m + 0.3 * length_m)
    rear_x, rear_y, course = drive.route.at(centre_m - 0.3 * length_m)
    # Both axles stay on the route; the direction between them is taken next to the course, so that it does not wrap.
    chord = np.arctan2(front_y - rear_y, front_x - rear_x)
    yaw = course + np.angle(np.exp(1j * (chord - course)))
    x, y = 0.5 * (front_x + rear_x) - aside_m * np.sin(yaw), 0.5 * (front_y + rear_y) + aside_m * np.cos(yaw)
    return Vehicle(*look, time_s, x, y, yaw)


def _convoy(rng: np.random.Generator, drive: Drive, time_s: FloatArray) -> Iterator[Vehicle]:
    """Two columns that creep through a turn abreast, bumper to bumper, the car in the right one.

    All move as one body, so that the cameras which see it agree on a motion that is not the car's. More places are
    named than there is room for: the earlier ones are taken.
    """
    s_m = drive.at("s_m", time_s)
    for ahead_s in (0.05, -0.05):
        for gap_m in _GAPS_M:  # the first that fits through the turn; the others are where it is
            yield _in_own_lane(rng, drive, time_s, "truck", ahead_s, gap_m)
    beside_m = rng.uniform(3.0, 5.0)  # of the one that fills the view to the left
    places = [[beside_m, beside_m - 0.5, beside_m + 0.5], np.arange(8.0, 20.0, 0.4), np.arange(0.0, -16.0, -0.4)]
    for along, kind in itertools.product(places, ("truck", "van")):  # vans where no truck has room
        for along_m in along:
            yield _along_route(drive, time_s, (kind, _colour(rng)), s_m + along_m, _COLUMN_ASIDE_M)


def _in_the_way(rng: np.random.Generator, drive: Drive, time_s: FloatArray, passed_m: float) -> Vehicle:
    """A car that stands in the lane where the route swerves around it."""
    x, y, course = drive.route.at(np.full_like(time_s, passed_m))
    aside_m = PASSING_M + _STANDING_ASIDE_M
    kind = str(rng.choice(_KINDS[:2]))
    return Vehicle(kind, _colour(rng), time_s, x + aside_m * np.sin(course), y - aside_m * np.cos(course), course)


def _flow(
    rng: np.random.Generator,
    place: tuple[Drive, Land],
    time_s: FloatArray,
    lane: Lane,
    speed_mps: float,
    pause_m: tuple[float, float],
) -> Iterator[Vehicle]:
    """Vehicles of one lane, all in the same rhythm; bumper-to-bumper distances lie in ``pause_m``."""
    drive, land = place
    path_m = drive.route.on_grid(drive.at("s_m", time_s))[lane.axis]
    numbers = range(-HALF_CITY_BLOCKS, HALF_CITY_BLOCKS + 1)
    islands_m = [number * BLOCK_M for number in numbers if lane.crossing(number) in land.roundabouts]
    if any(path_m.min() - _SIGHT_M < island_m < path_m.max() + _SIGHT_M for island_m in islands_m):
        speed_mps = min(speed_mps, CALM_MPS)
    # Speed swings by up to 15 %, the same for the whole lane, so that nobody catches up.
    omega = 2.0 * np.pi / rng.uniform(9.0, 18.0)
    moved_m = speed_mps * (time_s + 0.15 / omega * np.sin(omega * time_s + rng.uniform(0.0, 2.0 * np.pi)))
    reach_m = _SIGHT_M + speed_mps * time_s[-1]
    low, high = path_m.min() - reach_m, path_m.max() + reach_m
    along_m = low + rng.uniform(0.0, pause_m[1])
    while along_m < high:
        kind, colour = _kind(rng), _colour(rng)
        length_m = VEHICLE_KINDS[kind].length_m
        along_m += 0.5 * length_m
        way_m = along_m + lane.direction * moved_m
        aside_m, turned_rad = _around_islands(lane.direction * way_m, [lane.direction * at_m for at_m in islands_m])
        u, v, heading = lane.at(way_m, aside_m)
        along_m += 0.5 * length_m + rng.uniform(*pause_m)
        edge_m = (HALF_CITY_BLOCKS + 0.5) * BLOCK_M
        if max(np.abs(u).max(), np.abs(v).max()) < edge_m:
            yaw = land.heading(u, v, heading + turned_rad)
            yield Vehicle(kind, colour, time_s, *land.map(u, v), yaw)


def _around_islands(ahead_m: FloatArray, islands_m: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """Distance right of the centre line and course against it of who follows a lane, at ``ahead_m`` along it."""
    aside_m, turned_rad = np.full_like(ahead_m, LANE_M), np.zeros_like(ahead_m)
    for island_m in islands_m:
        right_m, slope = swerve(ahead_m - island_m)
        aside_m += right_m
        turned_rad -= np.arctan(slope)
    return aside_m, turned_rad


def lanes_of(drive: Drive, time_s: FloatArray) -> tuple[list[Lane], list[Lane]]:
    """Lanes the car drives in, and lanes of the streets it comes near, in the order in which it meets them."""
    way_m = np.linspace(float(drive.at("s_m", time_s[0])), float(drive.at("s_m", time_s[-1])) + 40.0, 400)
    x, y = drive.route.on_grid(way_m)
    course = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
    own: dict[Lane, None] = {}
    crossing: dict[Lane, None] = {}
    for px, py, angle in zip(x, y, course, strict=True):
        quarter = round(angle / (0.5 * np.pi))
        axis, direction = quarter % 2, 1 if quarter % 4 < 2 else -1
        if abs(angle - quarter * 0.5 * np.pi) < 0.1:
            own[Lane(axis, round((py, px)[axis] / BLOCK_M), direction)] = None
        ahead = (px, py)[axis] / BLOCK_M
        if abs(ahead - round(ahead)) * BLOCK_M < 25.0:
            crossing[Lane(1 - axis, round(ahead), 1)] = None
            crossing[Lane(1 - axis, round(ahead), -1)] = None
    driven = set(own) | {lane.opposite for lane in own}
    return list(own), [lane for lane in crossing if lane not in driven]


def _over_an_island(vehicle: Vehicle, land: Land) -> bool:
    """Whether it ever comes over the island of a roundabout, or nearer than _CLEAR_OF_ISLANDS_M."""
    u, v = BLOCK_M * np.reshape(sorted(land.roundabouts), (-1, 2)).astype(np.float64).T
    x, y = land.map(u, v)
    away = ((x + 1j * y)[:, None] - (vehicle.x_m + 1j * vehicle.y_m)) * np.exp(-1j * vehicle.yaw_rad)
    ahead, aside = (
        np.abs(part) - 0.5 * size for part, size in zip((away.real, away.imag), vehicle.size_m, strict=True)
    )
    away_m = np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0))
    return bool((away_m < ISLAND_M + _CLEAR_OF_ISLANDS_M).any())


def _too_close(a: Vehicle, b: Vehicle, ahead_m: float = _CLEAR_AHEAD_M) -> bool:
    """Whether the two, each with some room around it, ever overlap (separating axes of two rectangles)."""
    dx, dy = b.x_m - a.x_m, b.y_m - a.y_m
    half_a, half_b = _half_m(a, ahead_m), _half_m(b, ahead_m)
    near = np.hypot(dx, dy) < np.hypot(*half_a) + np.hypot(*half_b)
    if not near.any():
        return False
    dx, dy, yaw_a, yaw_b = dx[near], dy[near], a.yaw_rad[near], b.yaw_rad[near]
    cosine, sine = np.abs(np.cos(yaw_b - yaw_a)), np.abs(np.sin(yaw_b - yaw_a))
    apart = np.zeros(len(dx), dtype=np.bool_)
    for yaw, (length, width), (other_length, other_width) in ((yaw_a, half_a, half_b), (yaw_b, half_b, half_a)):
        ahead = np.abs(dx * np.cos(yaw) + dy * np.sin(yaw))
        aside = np.abs(dy * np.cos(yaw) - dx * np.sin(yaw))
        apart |= ahead > length + other_length * cosine + other_width * sine
        apart |= aside > width + other_length * sine + other_width * cosine
    return not apart.all()


def _half_m(vehicle: Vehicle, ahead_m: float) -> tuple[float, float]:
    length_m, width_m = vehicle.size_m
    return 0.5 * length_m + ahead_m, 0.5 * width_m + _CLEAR_ASIDE_M


def _kind(rng: np.random.Generator) -> str:
    return str(rng.choice(_KINDS, p=_KIND_SHARES))


def _colour(rng: np.random.Generator) -> int:
    return int(rng.integers(COLOURS))
