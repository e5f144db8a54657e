"""Pictures of the city: ``Renderer(world, weather).render(...)`` is what the rest of the simulator calls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.nuscenes.scene import CameraCalibration
from mixo_env.simulator.city.people import PersonState
from mixo_env.simulator.city.shadows import EXTENT_M
from mixo_env.simulator.city.textures import quads
from mixo_env.simulator.city.vehicles import VehicleState
from mixo_env.simulator.city.world import World
from mixo_env.simulator.picture.drops_seen import Veil, see_through
from mixo_env.simulator.picture.exposure import adapted_gain, during_exposure
from mixo_env.simulator.picture.fleet import Fleet, moving_states
from mixo_env.simulator.picture.glare import add_light, lens_glare, sky_glare, sun_share
from mixo_env.simulator.picture.lamps import add_glare, light_window
from mixo_env.simulator.picture.mirror import mirror_road
from mixo_env.simulator.picture.rain import add_spray, spray_puffs
from mixo_env.simulator.picture.rasterizer import DepthBuffers
from mixo_env.simulator.picture.sampling import above_shadow, even_cells
from mixo_env.simulator.picture.sensor import NOISE_SIDE, Sensor, expose, mean_radiance, noise_offsets, noise_table
from mixo_env.simulator.picture.shading import shade
from mixo_env.simulator.picture.spans import Canvas, Shot
from mixo_env.simulator.picture.views import LIGHT, Daylight, Float32s, Float64s, Int64s, Lamps, Textures, View
from mixo_env.simulator.picture.weather import Weather, weather_named

IMAGE_EVERY_S = 1.0 / 12.0
"""Usual time between two images of a camera."""

RADIANCE_UNIT = 32768.0
"""Integer radiance of a white surface in full daylight; the largest is eight times that."""

GLARE = 0.12
"""Share of the light above white that lens and air scatter at night."""

_PEOPLE_SEEN_M = 100.0  # farther ones are a few pixels high
_WIDEST_PX = 1600  # the table of noise is as wide as such a row of pixels needs
_VIGNETTE = 0.22  # cos^4 of the angle to the optical axis, whose squared tangent this is at the edge


@dataclass(frozen=True)
class CameraPose:
    """Where a camera is at one instant.

    Attributes:
        rotation_map_from_camera: ``(3, 3)``; camera axes x right, y down, z forward.
        position_m: ``(3,)`` camera centre in the map frame.
    """

    rotation_map_from_camera: NDArray[np.float64]
    position_m: NDArray[np.float64]


@dataclass(frozen=True)
class RenderedImage:
    """One picture.

    Attributes:
        image: ``(height, width, 3)`` uint8, red first.
        gain: exposure to pass to the next image of the same camera.
    """

    image: NDArray[np.uint8]
    gain: float


class _Memory(NamedTuple):
    """Working arrays for one picture size.

    Attributes:
        buffers: what is seen.
        canvas: what is shaded.
        images: of the wet road.
        sensor: with its vignette.
    """

    buffers: DepthBuffers
    canvas: Canvas
    images: NDArray[np.int64]
    sensor: Sensor


class Renderer:
    """Renders one world in one weather; holds the working memory, so one per process and used for many images.

    Args:
        world: the city.
        weather: its name, ``"day"``, ``"rain"`` or ``"night"``, or settings of your own.

    Attributes:
        weather: the settings; ``weather.shutter_s`` is the exposure time.
    """

    def __init__(self, world: World, weather: str | Weather = "day") -> None:
        self.world = world
        self.weather = weather_named(weather) if isinstance(weather, str) else weather
        self._sizes: dict[tuple[int, int], _Memory] = {}
        self._noise = noise_table(3 * _WIDEST_PX + NOISE_SIDE)
        self._fleet = Fleet(world, shadows=self.weather.sun > 0.0)
        self._daylight = Daylight(world.sunlight, even_cells(world.sunlight), world.shadow_height)
        self._textures = Textures(
            world.texels,
            world.table,
            world.detail,
            world.detail_start,
            quads(world.sky).ravel(),
            float(world.ground_texels_per_m),
            self.weather.grain_levels,
            self.weather.most_taps,
        )
        self._no_lamps = Lamps(np.zeros((1, 1), np.float32), np.zeros(2), np.zeros(3), np.zeros(8))
        self._light = _light(self.weather)
        # Radiance of the air as one packed word: what spray looks like.
        self._air = sum(int(RADIANCE_UNIT * part) << 21 * place for place, part in enumerate(self.weather.haze))

    def render(
        self,
        calibration: CameraCalibration,
        start: CameraPose,
        end: CameraPose,
        vehicles: Sequence[VehicleState] = (),
        *,
        people: Sequence[PersonState] = (),
        gain: float | None = None,
        noise_seed: int = 0,
        veil: Veil | None = None,
        next_s: float = IMAGE_EVERY_S,
    ) -> RenderedImage:
        """One picture.

        Args:
            calibration: intrinsics and image size; the mounting only aims the head lights.
            start: of the camera when the shutter opens.
            end: when it closes, ``weather.shutter_s`` later.
            vehicles: at the middle of the exposure, the instant that the picture shows.
            people: likewise.
            gain: from the previous picture of this camera, ``None`` for the first (exposed for itself).
            noise_seed: seed of the sensor noise; different for every picture.
            veil: of the drops on the lens.
            next_s: until the next picture of this camera, for the exposure control.
        """
        world, weather = self.world, self.weather
        memory = self._memory(calibration.height, calibration.width)
        x_m, y_m = (0.5 * (start.position_m.item(i) + end.position_m.item(i)) for i in range(2))
        near = [v for v in vehicles if math.hypot(v.x_m - x_m, v.y_m - y_m) < weather.sight_m]
        about = [p for p in people if math.hypot(p.x_m - x_m, p.y_m - y_m) < _PEOPLE_SEEN_M]
        states = moving_states(near, about, world.underpasses, world.land)
        models = self._fleet.models(near, about)
        rotation, position, motion = during_exposure(
            start.rotation_map_from_camera,
            start.position_m,
            end.rotation_map_from_camera,
            end.position_m,
            states,
            0.5 * weather.shutter_s,
        )
        # What is seen, in which light and how it moves.
        fx, fy, cx, cy = calibration.intrinsic.take((0, 4, 2, 5)).tolist()
        view = View(rotation, position, fx, fy, cx, cy, float(weather.sight_m))
        radiance = memory.canvas.radiance
        placed = self._fleet.placed(models, states, (view, radiance.shape))
        memory.buffers.draw_patches((placed, world.static), view, self._textures)
        seen = memory.buffers.seen  # only now: drawing makes room for more patches
        lamps = self._lamps(calibration, position, near)
        shade(Shot(seen, view, self._light, self._textures, self._daylight, lamps, motion), memory.canvas)
        # Rain, and what lens and glass do.
        if weather.wetness > 0.0:
            self._add_rain(memory, view, states[: len(near)], models[: len(near)])  # people throw nothing up
        if veil is not None:
            see_through(radiance, veil)
        if weather.sun > 0.0:
            self._add_sun(radiance, seen.depth, view, calibration.intrinsic)
        wanted = self._wanted_gain(radiance)
        used = wanted if gain is None else gain
        return RenderedImage(self._exposed(memory, used, noise_seed), adapted_gain(used, wanted, next_s))

    def _wanted_gain(self, radiance: Int64s) -> float:
        """What the exposure control aims at."""
        mean = mean_radiance(radiance) / RADIANCE_UNIT
        return min(self.weather.exposure_target / max(mean, 1e-6), self.weather.largest_gain)

    def _exposed(self, memory: _Memory, gain: float, noise_seed: int) -> NDArray[np.uint8]:
        """What the sensor makes of the light, which at night glares around lamps."""
        radiance = memory.canvas.radiance
        height, width = radiance.shape
        if self._is_dark:
            add_glare(radiance, RADIANCE_UNIT / gain, GLARE)
        image = np.empty((height, width, 3), np.uint8)
        offset = noise_offsets(noise_seed, height)
        expose(radiance, memory.canvas.flow, offset, gain / RADIANCE_UNIT, memory.sensor, image)
        return image

    def _add_rain(self, memory: _Memory, view: View, states: Float64s, models: NDArray[np.int64]) -> None:
        """What the wet road mirrors, and the spray behind vehicles, whose states and models these are."""
        seen, radiance, clouds = memory.buffers.seen, memory.canvas.radiance, self.world.sky
        height_m = float(view.position_m[2] - self.world.land.below(view.position_m[None])[0, 0])
        mirror_road(radiance, seen, view, height_m, clouds, self.weather.wetness, memory.images)
        puffs = spray_puffs(states, self._fleet.size_m[models], view, self.weather.wetness)
        add_spray(radiance, seen.depth, puffs, view, clouds, self._air)

    def _add_sun(self, radiance: Int64s, depth: Float32s, view: View, intrinsic: Float64s) -> None:
        """The sun where it stands in the picture or near its edge: the sky about it, and glare if no house hides it."""
        height, width = radiance.shape
        sun = view.rotation @ self.world.sun
        falls = sun_share(sun, intrinsic, height, width)
        if falls > 0.0:
            irradiance = falls * math.pi * self.weather.sun * RADIANCE_UNIT
            seen = above_shadow(self.world.shadow_height, *view.position_m.tolist())
            lens = lens_glare(sun, intrinsic, height, width, seen * irradiance)
            sky = sky_glare(sun, intrinsic, height, width, irradiance, float(self.world.sun[2]))
            add_light(radiance, depth, lens, sky, np.array(self.weather.colour))

    @property
    def _is_dark(self) -> bool:
        """Whether lamps light anything."""
        return self.weather.lamps > self.weather.ambient

    def _lamps(
        self, calibration: CameraCalibration, position_m: NDArray[np.float64], near: Sequence[VehicleState]
    ) -> Lamps:
        """Street lamps and head lights around the camera, those of its own car as well."""
        if not self._is_dark:
            return self._no_lamps
        to_ego = np.column_stack([calibration.rotation_ego_from_camera, calibration.translation_m])
        window, corner = light_window(self.world.lamp_light, EXTENT_M, position_m, near)
        x, y = position_m[:2]
        height_m, rise_x, rise_y = self.world.land.below(position_m[None])[0, :3]
        ground = np.array([height_m - rise_x * x - rise_y * y, rise_x, rise_y])
        return Lamps(window, corner, ground, to_ego[:2].ravel())

    def _memory(self, height: int, width: int) -> _Memory:
        """Working arrays for one picture size, made once."""
        if (height, width) not in self._sizes:
            if width > _WIDEST_PX:
                raise ConfigurationError(
                    f"pictures can be at most {_WIDEST_PX} pixels wide, got {width}: scale the camera"
                )
            y, x = np.mgrid[0:height, 0:width]
            squared = ((x - 0.5 * width) ** 2 + (y - 0.5 * height) ** 2) / (0.5 * width) ** 2
            # One block, so that the operating system can back all of it with large pages.
            size = height * width
            cells = ((height + 1) // 2) * ((width + 1) // 2)
            block = np.empty(7 * size + size % 2 + 2 * (cells + 1), np.float32)
            radiance = block[: 2 * size].view(np.int64).reshape(height, width)
            planes = block[2 * size : 7 * size].reshape(5, height, width)
            images = block[7 * size + size % 2 :].view(np.int64)
            planes[4] = (1.0 + _VIGNETTE * squared) ** -2
            self._sizes[height, width] = _Memory(
                DepthBuffers(planes[2], planes[3].view(np.int32)),
                Canvas(radiance, planes[:2]),
                images,
                Sensor(planes[4], self._noise, float(self.weather.shot_noise), float(self.weather.read_noise)),
            )
        return self._sizes[height, width]


def _light(weather: Weather) -> NDArray[np.void]:
    """Light and air as the loops read them, in integer radiance."""
    w, unit = weather, RADIANCE_UNIT
    haze, zenith = ((unit * part for part in colour) for colour in (w.haze, w.zenith))
    values = (unit * w.ambient, unit * w.sun, w.haze_per_m, *haze, *zenith, w.clouds, unit * w.lamps, w.wetness)
    return np.array([(*values, *w.colour)], LIGHT)
