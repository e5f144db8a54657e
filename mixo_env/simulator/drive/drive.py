"""How the car drives a route: speed, stops, and what the body does on its springs.

The rear axle moves along the route; the heading of the body differs from the course by a constant (the axle is never
mounted quite straight) and by tyre slip. Pitch, roll and heave move the cameras but never enter a written pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.simulator.city.land import Land
from mixo_env.simulator.drive.routes import LEFT, RIGHT, STEP_M, STRAIGHT, Route, plan_route
from mixo_env.simulator.drive.targets import STANDING, STANDING_M, TURNING, Motion

FloatArray = NDArray[np.float64]

DRIVE_RATE_HZ = 100
MARGIN_S = 8.0
"""A drive is known this long before and after the scene: other vehicles follow it shifted in time."""

LAST_IMAGE_S = 0.5
"""A scene's last image comes so long before its end."""

CROWDED = frozenset({"side_queue", "oncoming_platoon", "majority_wrong"})
"""The other lane has no room to swerve into."""

_BEND_PM = 0.02  # curvature below which a curve is a bend
_PASSING = 0.2  # probability of a vehicle in the way, per block
_STOPPING = 0.45  # probability of having to wait, per crossing

# A scene is cut out of a longer drive where it does what it is to do, within these tolerances; tried so many drives.
_PATH_SHARE, _PATH_LEAST_M = 0.04, 1.5
_TURNED_SHARE, _TURNED_LEAST_RAD = 0.06, np.radians(0.25)
_TRIES = 16
_ONE_TURN_RAD, _TWO_TURNS_RAD, _THREE_TURNS_RAD = np.radians([8.0, 103.0, 193.0])  # turns that a heading change needs
_CUT_EVERY = 10  # samples

_ROLL_PER_ACCELERATION = 0.006  # roll per lateral acceleration [rad per m/s^2], outward
_PITCH_PER_ACCELERATION = -0.005  # pitch [rad per m/s^2]; braking dips the nose, which is positive about y
_SLIP_PER_ACCELERATION = -0.0025  # course minus heading [rad per m/s^2 to the left]
_BODY_HZ, _BODY_DAMPING = 1.4, 0.3
_ROAD_PITCH_RAD, _ROAD_ROLL_RAD, _ROAD_HEAVE_M = 0.0025, 0.003, 0.010  # standard deviations at 8 m/s and more


@dataclass(frozen=True)
class Drive:
    """The car's true motion, ``(n,)`` samples at ``DRIVE_RATE_HZ``; scene time 0 is the first key frame.

    Attributes:
        time_s: from -MARGIN_S to the scene's length + MARGIN_S.
        s_m: distance along the route.
        x_m, y_m, z_m: rear-axle centre on the ground, map frame.
        yaw_rad: heading of the body, not wrapped.
        speed_mps: of the rear axle.
        acceleration_mps2: along the course.
        yaw_rate_radps: of the heading.
        roll_rad, pitch_rad, heave_m: of the body on its springs, about the axes and origin of the ego frame; roll and
            pitch contain the slope of the road.
        route: the path that is driven.
        situation: the staged situation, or "ordinary".
    """

    time_s: FloatArray
    s_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    acceleration_mps2: FloatArray
    yaw_rate_radps: FloatArray
    roll_rad: FloatArray
    pitch_rad: FloatArray
    heave_m: FloatArray
    route: Route
    situation: str

    def at(self, name: str, time_s: FloatArray | float) -> FloatArray:
        """The attribute ``name`` at other times; linear between samples, which is exact to 0.1 mm."""
        return np.interp(time_s, self.time_s, getattr(self, name))


def plan_drive(
    rng: np.random.Generator, situation: str, seconds: float, course_offset_rad: float, motion: Motion, land: Land
) -> Drive:
    """A drive of ``seconds`` (and margins) in a staged situation, cut out of a longer one.

    Args:
        rng: draws route, driver and the cut.
        situation: a field of ``SituationShares``, or "ordinary".
        seconds: length of the scene.
        course_offset_rad: course minus heading of this car when driving straight on.
        motion: what the scene is to do; the nearest of several drives where none does exactly that.
        land: of the city.
    """
    best, least = None, np.inf
    for _ in range(_TRIES):
        cruise_mps = _cruise_mps(rng, situation, motion)
        route = _route(rng, situation, cruise_mps, motion, land)
        time_s, s_m, speed_mps = _driven(rng, route, situation, cruise_mps, seconds)
        starts, misses = _cuts(route, situation, motion, seconds, time_s, s_m)
        if not len(starts):
            continue
        fitting = np.flatnonzero(misses <= 1.0)
        chosen = int(rng.choice(fitting)) if len(fitting) else int(np.argmin(misses))
        if misses[chosen] < least:
            least = misses[chosen]
            best = route, time_s, s_m, speed_mps, starts[chosen]
        if least <= 1.0:
            break
    if best is None:
        raise ConfigurationError(f"no drive of {seconds:g} s was found for {situation}: make the scenes shorter")
    route, time_s, s_m, speed_mps, start_s = best
    scene_s = np.arange(-MARGIN_S, seconds + MARGIN_S + 0.5 / DRIVE_RATE_HZ, 1.0 / DRIVE_RATE_HZ)
    s = np.interp(scene_s + start_s, time_s, s_m)
    speed = np.interp(scene_s + start_s, time_s, speed_mps)
    return _with_body(rng, route, situation, (scene_s, s, speed), course_offset_rad, land)


def _cruise_mps(rng: np.random.Generator, situation: str, motion: Motion) -> float:
    """The speed of free traffic, at which the scene's mean is possible."""
    if situation == "fast_straight" or motion.mean_mps > 9.0:
        return motion.mean_mps * rng.uniform(1.02, 1.15)
    if situation == "majority_wrong":  # a convoy creeps, and does not stop
        return motion.mean_mps * rng.uniform(1.1, 1.25)
    if rng.uniform() < 0.2:  # everybody drives slowly here
        return max(motion.mean_mps, 1.2) * rng.uniform(1.1, 1.5)
    return float(np.clip(rng.normal(9.0, 1.9), max(1.08 * motion.mean_mps, 4.5), 13.5))


def _route(rng: np.random.Generator, situation: str, cruise_mps: float, motion: Motion, land: Land) -> Route:
    if situation == "fast_straight":
        return plan_route(rng, [STRAIGHT] * 7, cruise_mps, land)
    moves = [int(move) for move in rng.choice([LEFT, STRAIGHT, RIGHT], size=6, p=[0.06, 0.88, 0.06])]
    number, side = int(rng.integers(2, 4)), int(rng.choice([LEFT, RIGHT]))
    if situation == "majority_wrong":  # one turn, with the other column on its outer side, where it stays in view
        moves, side = [STRAIGHT] * 6, RIGHT
    if situation in TURNING or motion.turned_rad > _ONE_TURN_RAD:
        moves[number] = side
    if motion.turned_rad > _TWO_TURNS_RAD:
        moves[number + 1] = side
    if motion.turned_rad > _THREE_TURNS_RAD:
        moves[number + 2] = side
    passing = 0.0 if situation in CROWDED else _PASSING
    return plan_route(rng, moves, cruise_mps, land, situation == "tight_turn", passing)


def _driven(
    rng: np.random.Generator, route: Route, situation: str, cruise_mps: float, seconds: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, distance and speed of the whole route, at ``DRIVE_RATE_HZ``."""
    fast = situation == "fast_straight"
    flow = np.ones_like(route.s_m)  # traffic lets the car go at its own speed only now and then
    for wavelength_m in (rng.uniform(40, 70), rng.uniform(90, 160)):
        flow += (0.02 if fast else 0.055) * (np.sin(2 * np.pi * (route.s_m / wavelength_m + rng.uniform())) - 1.0)
    lateral_limit = rng.uniform(0.6, 1.4) * np.ones_like(route.s_m)
    curvature = np.maximum(np.abs(route.curvature_pm), 1e-4)
    lateral_limit *= 1.0 + 1.0 / (1.0 + (curvature / _BEND_PM) ** 2)  # bends are taken faster than turns
    limit = np.minimum(cruise_mps * flow, np.sqrt(lateral_limit / curvature))

    stops: dict[int, float] = {}
    if not fast:
        for stop_m in route.stops_m[1:]:
            if rng.uniform() < _STOPPING:
                stops[round(stop_m / STEP_M)] = 1.5 + rng.exponential(7.0)
    if situation in STANDING:
        stops[round(route.stops_m[int(rng.integers(1, 5))] / STEP_M)] = 2.0 + seconds + rng.exponential(4.0)
    acceleration, braking = rng.uniform(0.8, 1.9), rng.uniform(0.7, 1.9)
    speed = _within_limits(limit, list(stops), acceleration, braking)

    step_s = 2.0 * STEP_M / np.maximum(speed[1:] + speed[:-1], 1e-3)
    time_s = np.concatenate([[0.0], np.cumsum(step_s)])
    knots_s, knots_mps = [], []
    waited_s = 0.0
    for index, (t, v) in enumerate(zip(time_s, speed, strict=True)):
        knots_s.append(t + waited_s)
        knots_mps.append(v)
        if index in stops:
            waited_s += stops[index]
            knots_s.append(t + waited_s)
            knots_mps.append(v)
    grid_s = np.arange(0.0, knots_s[-1], 1.0 / DRIVE_RATE_HZ)
    return grid_s, *_smoothed(np.interp(grid_s, knots_s, knots_mps))


def _within_limits(limit: FloatArray, stops: Sequence[int], acceleration: float, braking: float) -> FloatArray:
    """The highest speed over distance under a limit, with bounded acceleration and standing still at ``stops``."""
    square = limit * limit
    square[stops] = 0.0
    for index in range(1, len(square)):
        square[index] = min(square[index], square[index - 1] + 2.0 * acceleration * STEP_M)
    for index in range(len(square) - 2, -1, -1):
        square[index] = min(square[index], square[index + 1] + 2.0 * braking * STEP_M)
    return np.sqrt(square)


def _smoothed(speed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance and speed with bounded jerk: the speed averaged over 1.6 s by a raised cosine."""
    half = round(0.8 * DRIVE_RATE_HZ)
    kernel = 1.0 + np.cos(np.pi * np.arange(-half, half + 1) / (half + 1))
    kernel /= kernel.sum()
    smooth = np.convolve(np.pad(speed, half, mode="edge"), kernel, mode="valid").astype(np.float64)
    smooth[smooth < 1e-9] = 0.0
    distance = np.concatenate([[0.0], np.cumsum(0.5 * (smooth[1:] + smooth[:-1]))]) / DRIVE_RATE_HZ
    return distance, smooth


def _cuts(
    route: Route, situation: str, motion: Motion, seconds: float, time_s: FloatArray, s_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Times at which the scene may begin, and how far each misses its motion: up to 1 is within the tolerance."""
    start = time_s[(time_s >= MARGIN_S) & (time_s <= time_s[-1] - seconds - MARGIN_S)][::_CUT_EVERY]
    first_m = np.interp(start, time_s, s_m)
    moved_m = np.interp(start + seconds - LAST_IMAGE_S, time_s, s_m) - first_m
    first_rad, last_rad = (np.interp(s, route.s_m, route.course_rad) for s in (first_m, first_m + moved_m))
    path_m = motion.mean_mps * (seconds - LAST_IMAGE_S)
    miss_path = np.abs(moved_m - path_m) / max(_PATH_SHARE * path_m, _PATH_LEAST_M)
    turned = np.abs(last_rad - first_rad)
    miss_turned = np.abs(turned - motion.turned_rad) / max(_TURNED_SHARE * motion.turned_rad, _TURNED_LEAST_RAD)
    whole_m = np.interp(start + seconds, time_s, s_m) - first_m
    good = (whole_m < STANDING_M * seconds / 20.0) == (situation in STANDING)
    if situation in TURNING:
        turning = np.zeros_like(good)
        for turn_first_m, turn_last_m in route.turns_m:
            # A whole turn, or the first metres of one where the scene is too short for more.
            needed_m = turn_last_m if seconds >= 15 else turn_first_m + 1.0
            turning |= (first_m < turn_first_m) & (needed_m < first_m + moved_m)
        good &= turning
    return start[good], np.maximum(miss_path, miss_turned)[good]


def _with_body(
    rng: np.random.Generator,
    route: Route,
    situation: str,
    driven: tuple[FloatArray, FloatArray, FloatArray],
    course_offset_rad: float,
    land: Land,
) -> Drive:
    """Positions along the route and the motion of the body on its springs.

    Args:
        rng: shakes the body.
        route: that is driven.
        situation: that is staged.
        driven: times, arc lengths and speeds.
        course_offset_rad: course minus heading when driving straight on.
        land: whose slope the body follows.
    """
    time_s, s, speed = driven
    x, y, course = route.at(s)
    curvature = np.interp(s, route.s_m, route.curvature_pm)
    forward = np.gradient(speed, 1.0 / DRIVE_RATE_HZ)
    sideways = curvature * speed**2
    yaw = course - course_offset_rad - _SLIP_PER_ACCELERATION * sideways
    shaking = np.minimum(speed / 8.0, 1.2)
    rise_x, rise_y = land.rise(*(np.interp(s, route.s_m, grid) for grid in (route.u_m, route.v_m)))
    uphill = np.arctan(rise_x * np.cos(yaw) + rise_y * np.sin(yaw))
    banked = np.arctan(rise_y * np.cos(yaw) - rise_x * np.sin(yaw))
    return Drive(
        time_s,
        s,
        x,
        y,
        np.interp(s, route.s_m, route.z_m),
        yaw,
        speed,
        forward,
        np.gradient(yaw, 1.0 / DRIVE_RATE_HZ),
        roll_rad=banked
        + _sprung(_ROLL_PER_ACCELERATION * sideways)
        + _ROAD_ROLL_RAD * shaking * road_noise(rng, len(time_s)),
        pitch_rad=-uphill  # the nose down is positive
        + _sprung(_PITCH_PER_ACCELERATION * forward)
        + _ROAD_PITCH_RAD * shaking * road_noise(rng, len(time_s)),
        heave_m=_ROAD_HEAVE_M * shaking * road_noise(rng, len(time_s)),
        route=route,
        situation=situation,
    )


def _spring_response() -> FloatArray:
    """Impulse response of the body on its springs, unit gain at rest."""
    t = np.arange(0.0, 3.0, 1.0 / DRIVE_RATE_HZ)
    omega = 2.0 * np.pi * _BODY_HZ
    response = np.exp(-_BODY_DAMPING * omega * t) * np.sin(omega * np.sqrt(1.0 - _BODY_DAMPING**2) * t)
    return response / response.sum()


def _sprung(force: FloatArray) -> FloatArray:
    """What the body does when ``force`` would move it slowly by that much."""
    response = _spring_response()
    padded = np.concatenate([np.full(len(response) - 1, force[0]), force])
    return np.convolve(padded, response, mode="valid")


def road_noise(rng: np.random.Generator, count: int) -> FloatArray:
    """Unit-variance shaking of the body by a rough road at ``DRIVE_RATE_HZ``."""
    response = _spring_response()
    white = rng.standard_normal(count + len(response) - 1)
    return np.convolve(white, response, mode="valid") / np.linalg.norm(response)
