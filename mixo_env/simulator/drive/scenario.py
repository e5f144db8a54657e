"""Which logs and scenes a configuration stands for: everything that is decided before anything is driven."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from mixo_env.nuscenes.selections import FIRST_SIMULATED_SCENE
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.drive.localisation import LAG_RANGE_S
from mixo_env.simulator.drive.rig import Rig, draw_rig
from mixo_env.simulator.drive.targets import Motion, deal_motions
from mixo_env.simulator.drive.vehicle_bus import BusSensors, draw_sensors

LOCATION = "mixocity"
_FIRST_DAY = datetime(2024, 5, 6, tzinfo=UTC)
_HOUR = {"day": 10, "rain": 14, "night": 22}
_SCENE_EVERY_S = 60

# Two cars: usual effective wheel radius [m] and course minus heading [rad]; both vary a little from drive to drive.
_CARS = {"m001": (0.3035, np.radians(-0.40)), "m002": (0.3065, np.radians(-0.60))}
_COURSE_VARIATION_RAD = np.radians(0.2)


@dataclass(frozen=True)
class ScenePlan:
    """One scene: its number in the data set from 0, name, situation, motion and time of the first key frame."""

    number: int
    name: str
    situation: str
    motion: Motion
    start_us: int


@dataclass(frozen=True)
class LogPlan:
    """One drive of one car through one city in one weather, and the scenes cut out of it.

    Attributes:
        number: in the data set, from 0.
        logfile: its name, e.g. ``"m001-2024-05-06-10-00-00+0000"``.
        vehicle: which car.
        weather: ``"day"``, ``"rain"`` or ``"night"``.
        low_sun: whether it is a day with a low sun.
        low_texture: whether the city has little texture and many blank walls.
        world_seed: of the city.
        rig: true and written calibrations.
        sensors: constants of the CAN bus.
        course_offset_rad: course minus heading when driving straight on.
        localisation_lag_s: how late written poses are; the same in every log of a car.
        scenes: in time order.
    """

    number: int
    logfile: str
    vehicle: str
    weather: str
    low_sun: bool
    low_texture: bool
    world_seed: int
    rig: Rig
    sensors: BusSensors
    course_offset_rad: float
    localisation_lag_s: float
    scenes: tuple[ScenePlan, ...]


def generator(config: SimulationConfig, purpose: str, *numbers: int) -> np.random.Generator:
    """The random numbers of one purpose (in one log, scene, camera), independent of all others."""
    return np.random.default_rng([config.seed, *purpose.encode(), *numbers])


def plan_logs(config: SimulationConfig) -> tuple[LogPlan, ...]:
    """All logs of a data set."""
    weathers = _dealt({"rain": config.rain, "night": config.night}, config.logs, "day", generator(config, "weather"))
    suns = iter(_dealt({"low": config.low_sun}, weathers.count("day"), "high", generator(config, "sun")))
    textures = _dealt({"low": config.low_texture}, config.logs, "usual", generator(config, "texture"))
    situations = _dealt(config.situations.by_name(), config.scenes, "ordinary", generator(config, "situations"))
    motions = deal_motions(generator(config, "motion"), situations)
    lag_s = {car: generator(config, "lag", number).uniform(*LAG_RANGE_S) for number, car in enumerate(_CARS)}
    logs = []
    for number in range(config.logs):
        rng = generator(config, "log", number)
        vehicle = tuple(_CARS)[number % len(_CARS)]
        radius_m, course_rad = _CARS[vehicle]
        begin = _FIRST_DAY + timedelta(days=number, hours=_HOUR[weathers[number]])
        first = number * config.scenes_per_log
        scenes = tuple(
            ScenePlan(
                number=scene,
                name=f"scene-{FIRST_SIMULATED_SCENE + scene:04d}",
                situation=situations[scene],
                motion=motions[scene],
                start_us=(int(begin.timestamp()) + _SCENE_EVERY_S * (scene - first + 1)) * 1_000_000,
            )
            for scene in range(first, min(first + config.scenes_per_log, config.scenes))
        )
        logs.append(
            LogPlan(
                number=number,
                logfile=f"{vehicle}-{begin:%Y-%m-%d-%H-%M-%S}+0000",
                vehicle=vehicle,
                weather=weathers[number],
                low_sun=weathers[number] == "day" and next(suns) == "low",
                low_texture=textures[number] == "low",
                world_seed=int(rng.integers(2**31)),
                rig=draw_rig(rng, config.width, config.height),
                sensors=draw_sensors(rng, radius_m),
                course_offset_rad=course_rad + _COURSE_VARIATION_RAD * rng.uniform(-1.0, 1.0),
                localisation_lag_s=lag_s[vehicle],
                scenes=scenes,
            )
        )
    return tuple(logs)


def _dealt(shares: Mapping[str, float], count: int, rest: str, rng: np.random.Generator) -> list[str]:
    """``count`` names in random order, with shares as exact as whole numbers allow (largest remainders)."""
    names = [*shares, rest]
    exact = np.array([*shares.values(), max(0.0, 1.0 - sum(shares.values()))]) * count
    whole = np.floor(exact + 1e-9).astype(int)
    missing = count - int(whole.sum())
    for index in np.argsort(-(exact - whole), kind="stable")[:missing]:
        whole[index] += 1
    dealt = [name for name, times in zip(names, whole, strict=True) for _ in range(times)]
    return [dealt[index] for index in rng.permutation(count)]
