"""Rendering one picture of the simulated city: CPU time against ORB extraction on the same picture.

Stops along a fixed tour through a city, renders the paper's four cameras in every weather with traffic and people
around and, in rain, drops on the lenses, and times each picture and ``cv2.ORB_create(8000, 1.2, 19)`` on it in turn, on
one thread. Reported is the median over the pictures of the best of some repeats, which alternate so that a machine that
slows down for a while slows both.

    python -m experiments.speed.rendering
    python -m experiments.speed.rendering --weathers day "low sun" --scale 1.0 --strip tour.png
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from mixo_env.files import write_bytes
from mixo_env.geometry import rotation_from_yaw
from mixo_env.nuscenes.scene import CameraCalibration
from mixo_env.simulator.city.people import PersonState
from mixo_env.simulator.city.streets import BLOCK_M, LANE_M
from mixo_env.simulator.city.vehicles import COLOURS, VehicleState
from mixo_env.simulator.city.world import CityPlan, build_world
from mixo_env.simulator.drive.rig import FULL_HEIGHT, FULL_WIDTH, nominal_calibration
from mixo_env.simulator.picture.drops import Drops, drops_on, glass_of
from mixo_env.simulator.picture.drops_seen import drops_veil
from mixo_env.simulator.picture.render import CameraPose, Renderer

CHANNELS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK_RIGHT", "CAM_BACK")
SPEED_MPS = 7.0
"""About the mean speed of moving nuScenes scenes."""

TOUR = (
    (20.0, -LANE_M, 0.0),
    (BLOCK_M + LANE_M, -60.0, 0.5 * np.pi),
    (-70.0, LANE_M, np.pi),
    (-LANE_M, 150.0, -0.5 * np.pi),
    (200.0, BLOCK_M - LANE_M, 0.0),
    (BLOCK_M - 6.0, -LANE_M - 1.0, -0.6),
)
"""Ego poses x, y, yaw: streets in all four directions and a turn."""


@dataclass(frozen=True)
class Rendering:
    """What to time.

    Attributes:
        weathers: of ``day``, ``low sun``, ``rain``, ``night``; under a low sun the city is another one.
        scale: picture size relative to 1600 x 900.
        repeats: times each picture is rendered; the best counts (of five it still varies by a few per cent).
        seed: of the city.
        strip: write the pictures of the tour, side by side, to this file.
    """

    weathers: tuple[str, ...] = ("day", "low sun", "rain", "night")
    scale: float = 0.5
    repeats: int = 15
    seed: int = 1
    strip: Path | None = None


def traffic(x_m: float, y_m: float, yaw_rad: float) -> list[VehicleState]:
    """A truck and cars ahead, oncoming cars, one behind: the same at every stop of the tour."""
    around = (("truck", 24.0, 0.0), ("sedan", 45.0, 0.0), ("suv", 16.0, 3.5), ("van", 34.0, 3.5), ("sedan", -12.0, 0.0))
    turn = rotation_from_yaw(yaw_rad)[:2, :2]
    states = []
    for number, (kind, ahead, aside) in enumerate(around):
        x, y = np.array([x_m, y_m]) + turn @ (ahead, aside)
        heading = yaw_rad + (np.pi if aside > 1.0 else 0.0)
        states.append(VehicleState(kind, number % COLOURS, float(x), float(y), heading, SPEED_MPS))
    return states


def passers_by(x_m: float, y_m: float, yaw_rad: float) -> list[PersonState]:
    """Seven people on both pavements and one on a bicycle, as many as around the car on average."""
    turn = rotation_from_yaw(yaw_rad)[:2, :2]
    states = []
    for number in range(8):
        kind = "cyclist" if number == 7 else "walker"
        ahead, aside = 8.0 + 6.0 * number, (-7.0, 10.5)[number % 2] if kind == "walker" else -2.0
        x, y = np.array([x_m, y_m]) + turn @ (ahead, aside)
        states.append(PersonState(kind, number, float(x), float(y), 0.12, yaw_rad, 1.3, 0.11 * number))
    return states


def camera_pose(calibration: CameraCalibration, x_m: float, y_m: float, yaw_rad: float, ahead_m: float) -> CameraPose:
    """Pose of a camera when the car has driven ``ahead_m`` on from (x, y, yaw)."""
    turn = rotation_from_yaw(yaw_rad)
    position = np.array([x_m, y_m, 0.0]) + turn @ np.add(calibration.translation_m, (ahead_m, 0.0, 0.0))
    return CameraPose(turn @ calibration.rotation_ego_from_camera, position)


def best_ms(first: Callable[[], object], second: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Least CPU time of this thread in milliseconds, of both."""
    least = [np.inf, np.inf]
    for _ in range(repeats):
        for i, work in enumerate((first, second)):
            start = time.thread_time()
            work()
            least[i] = min(least[i], time.thread_time() - start)
    return 1e3 * least[0], 1e3 * least[1]


def main(options: Rendering) -> None:
    """Print one row per weather."""
    cv2.setNumThreads(1)
    began = time.process_time()
    world, low = build_world(options.seed), None
    print(f"world: {time.process_time() - began:.1f} s, {len(world.static.geometry)} patches")
    orb = cv2.ORB.create(8000, 1.2, 19)
    width, height = round(FULL_WIDTH * options.scale), round(FULL_HEIGHT * options.scale)
    strips = []
    for weather in options.weathers:
        if weather == "low sun" and low is None:
            low = build_world(options.seed, CityPlan(low_sun=True))
        renderer = Renderer(low if low is not None and weather == "low sun" else world, weather)
        half_m = 0.5 * SPEED_MPS * renderer.weather.shutter_s
        times, pictures = [], []
        for stop in TOUR:
            row = []
            for channel in CHANNELS:
                calibration = nominal_calibration(channel, width, height)
                start, end = (camera_pose(calibration, *stop, ahead_m) for ahead_m in (-half_m, half_m))
                vehicles, people = traffic(*stop), passers_by(*stop)
                focal = calibration.intrinsic[0, 0] / width
                drops = drops_on(glass_of(channel), (options.seed,), 20.0, focal) if weather == "rain" else None

                def work(
                    calibration: CameraCalibration = calibration,
                    start: CameraPose = start,
                    end: CameraPose = end,
                    vehicles: list[VehicleState] = vehicles,
                    people: list[PersonState] = people,
                    drops: Drops | None = drops,
                    renderer: Renderer = renderer,
                ) -> NDArray[np.uint8]:
                    veil = drops_veil(drops, 5.0, height, width) if drops else None
                    return renderer.render(calibration, start, end, vehicles, people=people, veil=veil).image

                row.append(work())
                gray = cv2.cvtColor(row[-1], cv2.COLOR_RGB2GRAY)
                times.append(best_ms(work, lambda gray=gray: orb.detectAndCompute(gray, None), options.repeats))
            pictures.append(np.hstack(row))
        ours, peer = np.median(np.array(times), axis=0)
        ratio = np.median([a / b for a, b in times])
        print(f"{weather:8s} {ours:6.1f} ms a picture   ORB(8000, 1.2, 19) {peer:6.1f} ms   ratio {ratio:.2f}")
        strips.append(np.vstack(pictures))
    print(f"memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB at most")
    if options.strip is not None:
        _, encoded = cv2.imencode(options.strip.suffix, cv2.cvtColor(np.vstack(strips), cv2.COLOR_RGB2BGR))
        write_bytes(options.strip, encoded.tobytes())


if __name__ == "__main__":
    main(tyro.cli(Rendering, description=__doc__))
