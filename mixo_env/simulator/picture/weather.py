"""What the weather does to light, air, road and exposure."""

from __future__ import annotations

from dataclasses import dataclass

from mixo_env.errors import ConfigurationError, unknown

Rgb = tuple[float, float, float]


@dataclass(frozen=True)
class Weather:
    """One kind of weather. Radiance is in units in which a white wall in full daylight is about 1.

    Attributes:
        name: ``"day"``, ``"low sun"``, ``"rain"`` or ``"night"``.
        shutter_s: exposure time; the caller takes the end pose this much after the start pose.
        sun: direct light on a surface facing the sun.
        ambient: light from the whole sky.
        colour: of all this light and of lamps.
        haze_per_m: share of light lost to the air per metre.
        haze: radiance of the air, also of the sky at the horizon.
        zenith: radiance of the sky overhead.
        sight_m: everything farther away is lost in the haze.
        grain_levels: reductions of the fine grain that are drawn; the grain of what is farther is lost in the air.
        most_taps: samples of a slanted surface for one pixel; in rain the air and the long exposure take the sharpness
            that a third one would give.
        clouds: contrast of the clouds.
        lamps: strength of street lamps, shop windows and vehicle lights.
        wetness: 0 dry to 1 wet: the road darkens and mirrors, vehicles throw up spray.
        exposure_target: mean radiance times gain that the exposure control aims at.
        largest_gain: limit of the exposure control.
        shot_noise: variance of the noise per unit of exposed radiance.
        read_noise: variance of the noise in the dark.
    """

    name: str
    shutter_s: float
    sun: float
    ambient: float
    colour: Rgb
    haze_per_m: float
    haze: Rgb
    zenith: Rgb
    sight_m: float
    grain_levels: int
    most_taps: int
    clouds: float
    lamps: float
    wetness: float
    exposure_target: float
    largest_gain: float
    shot_noise: float
    read_noise: float


_ALL = (
    Weather(
        "day",
        shutter_s=0.004,
        sun=2.6,
        ambient=0.42,
        colour=(1.03, 1.0, 0.96),
        haze_per_m=0.0009,
        haze=(0.92, 0.98, 1.04),
        zenith=(0.36, 0.56, 0.96),
        sight_m=240.0,
        grain_levels=5,
        most_taps=3,
        clouds=0.55,
        lamps=0.0,
        wetness=0.0,
        exposure_target=0.225,
        largest_gain=3.0,
        shot_noise=2e-4,
        read_noise=1e-5,
    ),
    # The sun 10 degrees above the horizon: its light has gone through five times as much air as from overhead, half of
    # it is left, and more of the blue is gone (Kasten and Young 1989 for the air mass, Meinel and Meinel 1976 for what
    # is left).
    Weather(
        "low sun",
        shutter_s=0.004,
        sun=1.5,
        ambient=0.34,
        colour=(1.10, 1.0, 0.86),
        haze_per_m=0.0012,
        haze=(0.92, 0.90, 0.88),
        zenith=(0.34, 0.48, 0.80),
        sight_m=240.0,
        grain_levels=5,
        most_taps=3,
        clouds=0.45,
        lamps=0.0,
        wetness=0.0,
        exposure_target=0.225,
        largest_gain=3.0,
        shot_noise=2e-4,
        read_noise=1e-5,
    ),
    Weather(
        "rain",
        shutter_s=0.008,
        sun=0.0,
        ambient=0.50,
        colour=(0.97, 1.0, 1.03),
        haze_per_m=0.0045,
        haze=(0.58, 0.60, 0.63),
        zenith=(0.50, 0.53, 0.58),
        sight_m=180.0,
        grain_levels=2,
        most_taps=2,
        clouds=0.25,
        lamps=0.10,
        wetness=1.0,
        exposure_target=0.20,
        largest_gain=4.0,
        shot_noise=6e-4,
        read_noise=3e-5,
    ),
    Weather(
        "night",
        shutter_s=0.018,
        sun=0.0,
        ambient=0.010,
        colour=(1.22, 1.0, 0.72),
        haze_per_m=0.0015,
        haze=(0.010, 0.009, 0.009),
        zenith=(0.003, 0.004, 0.007),
        sight_m=240.0,
        grain_levels=5,
        most_taps=3,
        clouds=0.4,
        lamps=1.0,
        wetness=0.0,
        exposure_target=0.085,
        largest_gain=5.0,
        shot_noise=4e-3,
        read_noise=2.5e-4,
    ),
)
WEATHERS = {weather.name: weather for weather in _ALL}


def weather_named(name: str) -> Weather:
    """The weather of that name.

    Raises:
        ConfigurationError: for an unknown name.
    """
    if name not in WEATHERS:
        raise ConfigurationError(unknown("weather", name, WEATHERS))
    return WEATHERS[name]
