"""One hash per picture over a fixed set of pictures, and whether another checkout draws the same ones as fast.

A change that should only make the renderer easier to read, or faster, must not move a bit of any picture. The numbers
differ from machine to machine, so none are kept: both checkouts render here, in two processes that take turns picture
by picture, so that a machine that slows down for a while slows both. The other one needs this file as well.

    python -m experiments.speed.pictures_hash
    python -m experiments.speed.pictures_hash --other ../before
"""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray

from experiments.speed.checkouts import HERE, ask, compare, line, serve, server
from experiments.speed.rendering import TOUR, camera_pose, passers_by, traffic
from mixo_env.nuscenes.selections import ALL_CAMERAS
from mixo_env.simulator.city.vehicles import VehicleState
from mixo_env.simulator.city.world import CityPlan, World, build_world
from mixo_env.simulator.drive.rig import nominal_calibration
from mixo_env.simulator.picture.drops import drops_on, glass_of
from mixo_env.simulator.picture.drops_seen import drops_veil
from mixo_env.simulator.picture.render import CameraPose, Renderer

LARGE = (800, 450)
SIZES = ((400, 225), (333, 187), LARGE)
"""Widths and heights: even and odd numbers of pixels, and the size at which time counts."""

TURN_RAD = 0.004
"""Yaw during the exposure, so that pictures are smeared over several pixels."""

WEATHERS = ("day", "low sun", "rain", "night")


@dataclass(frozen=True)
class Comparison:
    """What to compare.

    Attributes:
        other: root of another checkout; only hashes of this one are printed if left out.
        repeats: times that each large picture is rendered by each of the two.
        serve: render the pictures whose numbers arrive on standard input (how the two processes are run).
    """

    other: Path | None = None
    repeats: int = 25
    serve: bool = False


@dataclass(frozen=True)
class View:
    """One picture of the set."""

    weather: str
    channel: str
    size: tuple[int, int]
    stop: tuple[float, float, float]

    def __str__(self) -> str:
        return f"{self.weather:7s} {self.channel:15s} {self.size[0]}x{self.size[1]}"


def views() -> list[View]:
    """Every camera in every weather in every size, each from another place of the tour."""
    return [
        View(weather, channel, size, TOUR[(number + place) % len(TOUR)])
        for place, size in enumerate(SIZES)
        for weather in WEATHERS
        for number, channel in enumerate(ALL_CAMERAS)
    ]


@cache
def renderer(weather: str) -> Renderer:
    """Of a small city with many parked cars."""
    return Renderer(_city(weather == "low sun"), weather)


@cache
def _city(low_sun: bool) -> World:
    return build_world(3, CityPlan(half_blocks=2, variety=6, ground_side=1024, parked=0.8, low_sun=low_sun))


def picture(view: View) -> tuple[NDArray[np.uint8], float]:
    """The picture and the CPU time that it took, in milliseconds."""
    draw = renderer(view.weather)
    calibration = nominal_calibration(view.channel, *view.size)
    x, y, yaw = view.stop
    start = camera_pose(calibration, x, y, yaw, -0.03)
    end: CameraPose = camera_pose(calibration, x, y, yaw + TURN_RAD, 0.03)
    turning = VehicleState("sedan", 2, x + 9.0 * np.cos(yaw), y + 9.0 * np.sin(yaw), yaw + 0.4, 6.0, 0.5)
    people = passers_by(x, y, yaw)
    drops = drops_on(glass_of(view.channel), (3,), 20.0, calibration.intrinsic[0, 0] / view.size[0])
    began = time.thread_time()
    veil = drops_veil(drops, 5.0, calibration.height, calibration.width) if view.weather == "rain" else None
    vehicles = [*traffic(x, y, yaw), turning]
    shown = draw.render(calibration, start, end, vehicles, people=people, noise_seed=5, veil=veil)
    took = time.thread_time() - began
    return shown.image, 1e3 * took


def answer(number: int) -> tuple[str, float]:
    """Hash and milliseconds of a picture."""
    image, took = picture(views()[number])
    return hashlib.blake2b(image.tobytes(), digest_size=8).hexdigest(), took


def main(options: Comparison) -> None:
    """Print a hash per picture, or which pictures differ and how the times compare."""
    cv2.setNumThreads(1)
    if options.serve:
        return serve(answer)
    every = views()
    module = "experiments.speed.pictures_hash"
    if options.other is None:
        with server(module, HERE) as ours:
            for number, view in enumerate(every):
                print(ask(ours, number)[0], view)
        return None
    large = [number for number, view in enumerate(every) if view.size == LARGE]
    with server(module, options.other) as theirs, server(module, HERE) as ours:
        different, times = compare((theirs, ours), len(every), large, options.repeats)
    print(f"{len(different)} of {len(every)} pictures differ", *(every[number] for number in different), sep="\n  ")
    for weather in (*WEATHERS, ""):
        chosen = [place for place, number in enumerate(large) if weather in ("", every[number].weather)]
        print(line(weather or "all", times[:, :, chosen]))
    return None


if __name__ == "__main__":
    main(tyro.cli(Comparison, description=__doc__))
