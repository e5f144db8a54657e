"""Rain drops that stick to the glass before a lens: blurred discs that stay, grow, run down and are wiped.

Size of what is seen. The camera focuses on the street, so glass at distance d is out of focus: a drop of radius r is
seen with radius f r / d, smeared by the lens opening (radius a) over a disc of radius f a / d. The share of a pixel's
light that passes the drop is how much of the pupil's disc the drop's disc covers: thin lens and geometry alone. On a
windscreen 10 cm away drops are small and nearly opaque; on the glass of the lens itself they are large soft veils.

What is seen in it. A drop is a short lens that shows nearly the whole surroundings (165 degrees) upside down (Garg and
Nayar, "Vision and rain", International Journal of Computer Vision 75, 2007), here the picture itself, turned about
the drop and as blurred as the drop (``drops_seen``).

How many there are. Drops in the air follow Marshall and Palmer, "The distribution of raindrops with size" (Journal of
Meteorology 5, 1948): N(D) = 8000 exp(-4.1 R^-0.21 D) per m^3 and mm at R mm/h. Those above 0.5 mm that the glass
sweeps arrive; on the glass they flatten to about twice their diameter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mixo_env.errors import ConfigurationError
from mixo_env.simulator.picture.views import Float64s

PUPIL_MM = 1.53
"""Radius of the lens opening: focal length 5.5 mm at f/1.8, as on the nuScenes car."""

_SMALLEST_MM = 0.5  # diameter in the air; smaller drops leave no visible disc
_SPREAD = 2.0  # diameter on the glass over diameter in the air
_RUNS_MM = 2.0  # a drop of this radius on the glass is too heavy to stay (contact angle hysteresis of clean glass)
_RUN_MMPS = 30.0  # how fast it runs down
_MERGE = 0.8  # drops nearer than this share of their radii's sum become one


@dataclass(frozen=True)
class Glass:
    """The glass before a lens.

    Attributes:
        distance_mm: from the lens opening.
        wind_mps: speed at which it sweeps rain: of the car for a windscreen, of gusts for what does not face forward.
        lives_s: mean time until a drop dries, is shaken off or blown away.
        wiped_every_s: time between two strokes of a wiper, 0 without one.
    """

    distance_mm: float
    wind_mps: float
    lives_s: float
    wiped_every_s: float = 0.0


WINDSCREEN = Glass(distance_mm=100.0, wind_mps=8.0, lives_s=60.0, wiped_every_s=1.2)
"""Before CAM_FRONT, which looks through the area that the wiper sweeps."""

OUTSIDE = Glass(distance_mm=15.0, wind_mps=1.5, lives_s=40.0)
"""Before all other cameras, which hang outside and have no wiper."""


def glass_of(channel: str) -> Glass:
    """What stands before a camera of the rig."""
    return WINDSCREEN if channel == "CAM_FRONT" else OUTSIDE


@dataclass(frozen=True)
class Drops:
    """All drops on one glass over one scene; ``(n,)`` arrays, the ones that arrive later after the earlier ones.

    Attributes:
        x, y: centre in the picture, in widths of it, rows downwards from the upper edge.
        radius: sharp radius in widths of the picture.
        born_s: time of arrival.
        gone_s: end, excluded.
        run_s: from when on it runs down; infinite if never.
        run_speed: in widths per second.
        pupil: radius of the lens opening's disc in widths of the picture: the blur.
    """

    x: Float64s
    y: Float64s
    radius: Float64s
    born_s: Float64s
    gone_s: Float64s
    run_s: Float64s
    run_speed: float
    pupil: float

    def at(self, time_s: float) -> Float64s:
        """Drops that are there at a time: ``(m, 3)`` x, y, radius in widths of the picture."""
        there = (self.born_s <= time_s) & (time_s < self.gone_s)
        fallen = self.run_speed * np.maximum(time_s - self.run_s[there], 0.0)
        return np.stack([self.x[there], self.y[there] + fallen, self.radius[there]], axis=1)


def drops_on(
    glass: Glass, seed: Sequence[int], seconds: float, focal: float, aspect: float = 9.0 / 16.0, rain_mmph: float = 4.0
) -> Drops:
    """The drops on one glass over one scene, which began to rain long before.

    Args:
        glass: before the lens.
        seed: whole numbers that name scene and camera; equal ones give equal drops.
        seconds: length of the scene.
        focal: focal length in widths of the picture.
        aspect: height over width of the picture.
        rain_mmph: strength of the rain; 4 is moderate rain.

    Raises:
        ConfigurationError: ``rain_mmph`` is negative or not finite.
    """
    if not 0.0 <= rain_mmph < math.inf:
        raise ConfigurationError(f"rain must be a strength in mm/h, at least 0, got {rain_mmph:g}: change it")
    rng = np.random.default_rng(list(seed))
    per_mm = focal / glass.distance_mm  # widths of the picture per millimetre of glass
    margin = per_mm * (PUPIL_MM + _RUNS_MM)  # drops beyond the edge reach into the picture
    start_s = -3.0 * glass.lives_s if glass.wiped_every_s == 0.0 else -2.0 * glass.wiped_every_s
    rate_mm = 4.1 * max(rain_mmph, 1e-9) ** -0.21
    per_m3 = 8000.0 / rate_mm * math.exp(-rate_mm * _SMALLEST_MM) if rain_mmph > 0.0 else 0.0
    area_m2 = 1e-6 * (1.0 + 2.0 * margin) * (aspect + 2.0 * margin) / per_mm**2
    count = int(rng.poisson(per_m3 * glass.wind_mps * area_m2 * (seconds - start_s)))
    born = np.sort(rng.uniform(start_s, seconds, count))
    x, y = rng.uniform(-margin, 1.0 + margin, count), rng.uniform(-margin, aspect + margin, count)
    radius_mm = 0.5 * _SPREAD * (_SMALLEST_MM + rng.exponential(1.0 / rate_mm, count))
    gone = born + rng.exponential(glass.lives_s, count)
    if glass.wiped_every_s > 0.0:
        first = start_s + rng.uniform(0.0, glass.wiped_every_s)
        strokes = np.ceil((born - first) / glass.wiped_every_s)
        gone = np.minimum(gone, first + glass.wiped_every_s * np.maximum(strokes, 0.0))
    lifted = per_mm * _RUN_MMPS
    arrived = np.stack([x, y, per_mm * radius_mm, born, gone], axis=1)
    drops = _joined(arrived, per_mm * _RUNS_MM, lifted, aspect + margin)
    return Drops(*drops.T, run_speed=lifted, pupil=per_mm * PUPIL_MM)


def _joined(drops: Float64s, heavy: float, speed: float, below: float) -> Float64s:
    """Let drops that arrive on others swell them, and the ones that grow too heavy run off; in order of arrival.

    Args:
        drops: ``(n, 5)`` x, y, radius, born, gone.
        heavy: radius from which a drop runs.
        speed: of running.
        below: ``y`` at which a running drop has left.

    Returns:
        ``(m, 6)``: x, y, radius, born, gone, run; a swollen drop is a new one in the place of the old one.
    """
    done: list[list[float]] = []
    for x, y, radius, born, gone in drops.tolist():
        for other in reversed(done[-200:]):
            near = _MERGE * (radius + other[2])
            if other[3] <= born < other[4] and math.isinf(other[5]) and math.hypot(x - other[0], y - other[1]) < near:
                # Volumes add up; the water gathers where most of it was.
                x, y = (other[0], other[1]) if other[2] > radius else (x, y)
                radius, gone = (radius**3 + other[2] ** 3) ** (1.0 / 3.0), max(gone, other[4])
                other[4] = born
        run = born if radius > heavy else math.inf
        if run < math.inf:
            gone = min(gone, born + max(below - y, 0.0) / speed)
        done.append([x, y, radius, born, gone, run])
    return np.array(done).reshape(-1, 6)
