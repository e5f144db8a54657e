"""One hash per drive over all that the experts report, and whether another checkout reports the same as fast.

A change that should only make the experts easier to read, or faster, must not move a bit of any recording. Images are
rendered along a short turn in every weather and camera, with traffic; the single-camera odometry sees them one by one,
and every number that it reports enters the hash. The inertial filter sees a drive with noise, a stop and a pause. The
numbers differ from machine to machine, so none are kept: both checkouts run here, in two processes that take turns
drive by drive, so that a machine that slows down for a while slows both. The other one needs this file as well.

    python -m experiments.speed.experts_hash
    python -m experiments.speed.experts_hash --other ../before
"""

from __future__ import annotations

import hashlib
import time
from dataclasses import astuple, dataclass
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from experiments.speed.checkouts import HERE, ask, compare, line, serve, server
from experiments.speed.rendering import TOUR, camera_pose, traffic
from mixo_env.experts.inertial import GRADES, InertialOdometry
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.scene import CameraCalibration, CanBus, Signal
from mixo_env.nuscenes.selections import ALL_CAMERAS
from mixo_env.simulator.city.world import CityPlan, build_world
from mixo_env.simulator.drive.rig import nominal_calibration
from mixo_env.simulator.picture.render import Renderer

SIZE = (800, 450)
"""Width and height: full size for preset "fast", which halves nothing that is so small."""

WEATHERS = ("day", "rain", "night")

GAP_US = 83_333
"""Time between two images: the 12 Hz of nuScenes."""

STEPS_M = (0.6, 0.7, 0.7, 0.5, 0.3, 0.0)
"""Distance from image to image: enough of them for INITIALISING, TRACKING and a standing car."""

TURN_RADPM = 0.02
"""Curvature of the drive: a bend of 50 m radius."""


@dataclass(frozen=True)
class Comparison:
    """What to compare.

    Attributes:
        other: root of another checkout; only hashes of this one are printed if left out.
        repeats: times that each drive is seen by each of the two.
        serve: answer the numbers of drives that arrive on standard input (how the two processes are run).
    """

    other: Path | None = None
    repeats: int = 15
    serve: bool = False


@dataclass(frozen=True)
class Run:
    """One drive of the set: what a preset of the odometry, or all inertial grades, make of it."""

    weather: str
    channel: str
    preset: str
    stop: tuple[float, float, float]

    def __str__(self) -> str:
        return f"{self.preset:8s} {self.weather:5s} {self.channel}"


INERTIAL = Run("", "CAN bus", "inertial", (0.0, 0.0, 0.0))


def runs() -> list[Run]:
    """Every camera in every weather, each from another place of the tour, some at preset "paper"; the filter last."""
    every = [
        Run(weather, channel, "fast", TOUR[(number + place) % len(TOUR)])
        for place, weather in enumerate(WEATHERS)
        for number, channel in enumerate(ALL_CAMERAS)
    ]
    paper = [Run("day", channel, "paper", TOUR[place]) for place, channel in enumerate(ALL_CAMERAS[:2])]
    return [*every, *paper, INERTIAL]


@cache
def renderer(weather: str) -> Renderer:
    """Of a small city with many parked cars."""
    return Renderer(_city(), weather)


_city = cache(partial(build_world, 3, CityPlan(half_blocks=2, variety=6, ground_side=1024, parked=0.8)))


@cache
def images(run: Run) -> tuple[CameraCalibration, list[NDArray[np.uint8]]]:
    """Calibration and grey images along the drive, the traffic standing where it is."""
    calibration = nominal_calibration(run.channel, *SIZE)
    x, y, yaw = run.stop
    others, shown = traffic(x, y, yaw), []
    for number, step in enumerate((0.0, *STEPS_M)):
        x, y, yaw = x + step * np.cos(yaw), y + step * np.sin(yaw), yaw + TURN_RADPM * step
        pose = camera_pose(calibration, x, y, yaw, 0.0)
        image = renderer(run.weather).render(calibration, pose, pose, others, noise_seed=number).image
        shown.append(np.ascontiguousarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8))
    return calibration, shown


def see(run: Run) -> bytes:
    """All that the odometry reports of a drive, as bytes."""
    calibration, shown = images(run)
    odometry = MonocularOdometry(calibration, MonocularConfig.preset(run.preset))
    steps = [
        odometry.process(image, number * GAP_US, distance_m)
        for number, (image, distance_m) in enumerate(zip(shown, (0.0, *STEPS_M), strict=True))
    ]
    return np.array([astuple(step) for step in steps], np.float64).tobytes()


@cache
def can_bus() -> CanBus:
    """Twenty seconds: a stop of three, a bend, noise, jitter of the times, and a pause of one second."""
    rng = np.random.default_rng(14)

    def signal(rate_hz: float, value: NDArray[np.float64], noise: float) -> Signal:
        time_s = np.arange(0.0, 20.0, 1.0 / rate_hz)
        jittered = np.rint(1e6 * (time_s + rng.uniform(0.0, 0.2 / rate_hz, len(time_s)))).astype(np.int64)
        measured = np.interp(time_s, np.arange(21.0), value) + noise * rng.normal(size=len(time_s))
        kept = (time_s < 15.0) | (time_s > 16.0)
        return Signal(jittered[kept], measured[kept])

    speed = np.repeat([6.0, 0.0, 9.0], (5, 4, 12)).astype(np.float64)
    yaw_rate = np.repeat([0.0, 0.2, -0.1], (10, 5, 6)).astype(np.float64)
    wheel = signal(50.0, speed / 0.305, 0.0)
    return CanBus(
        wheel_speed_radps=Signal(wheel.timestamp_us, np.repeat(wheel.value[:, None], 4, axis=1)),
        imu_yaw_rate_radps=signal(100.0, yaw_rate + 0.001, 0.01),
        pose_speed_mps=signal(50.0, speed, 0.1),
        pose_yaw_rate_radps=signal(50.0, yaw_rate, 0.01),
        monitor_yaw_rate_radps=signal(2.0, yaw_rate + 0.004, 0.01),
    )


def filter_rates() -> bytes:
    """All that the inertial odometry of every grade reports, as bytes."""
    times_us = np.arange(50_000, 19_500_000, GAP_US)
    return b"".join(np.stack(astuple(InertialOdometry(can_bus(), grade).at(times_us))).tobytes() for grade in GRADES)


def answer(number: int) -> tuple[str, float]:
    """Hash and milliseconds of a drive."""
    run = runs()[number]
    if run is not INERTIAL:
        images(run)
    began = time.thread_time()
    content = filter_rates() if run is INERTIAL else see(run)
    took = time.thread_time() - began
    return hashlib.blake2b(content, digest_size=8).hexdigest(), 1e3 * took


def main(options: Comparison) -> None:
    """Print a hash per drive, or which drives differ and how the times compare."""
    cv2.setNumThreads(1)
    if options.serve:
        return serve(answer)
    every = runs()
    module = "experiments.speed.experts_hash"
    if options.other is None:
        with server(module, HERE) as ours:
            for number, run in enumerate(every):
                print(ask(ours, number)[0], run)
        return None
    with server(module, options.other) as theirs, server(module, HERE) as ours:
        different, times = compare((theirs, ours), len(every), range(len(every)), options.repeats)
    print(f"{len(different)} of {len(every)} drives differ", *(every[number] for number in different), sep="\n  ")
    for preset in ("fast", "paper", "inertial"):
        chosen = [number for number, run in enumerate(every) if run.preset == preset]
        print(line(preset, times[:, :, chosen]))
    return None


if __name__ == "__main__":
    main(tyro.cli(Comparison, description=__doc__))
