"""The sun in the lens: veiling glare, bloom, ghosts, and the bright sky around a low sun.

Lens and glass scatter a share of the sun's light over the whole picture. The glare spread function falls with the
square of the angle to the sun, as measured for eyes (Vos and van den Berg, CIE 135/1, 1999) and cameras (Talvala,
Adams, Horowitz and Levoy, "Veiling glare in high dynamic range imaging", ACM Transactions on Graphics 26, 2007):
K / (a^2 + a0^2) per steradian, a0 one degree, K such that it adds up to the share that is scattered. Near the sun it
is the bloom, far from it a grey veil. Two reflections between coated surfaces throw weak ghosts, mirrored about the
middle of the picture. A hood keeps the sun out once it stands some degrees beyond the picture's edge.

The sky around the sun is bright from light that haze has scattered once (Henyey and Greenstein, "Diffuse radiation in
the galaxy", Astrophysical Journal 93, 1941, asymmetry 0.75; the lower the sun, the longer its way through the air). It
is behind everything, glare is before everything.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked
from mixo_env.errors import ConfigurationError
from mixo_env.simulator.picture.developed import WHITE, image_of, radiance_of
from mixo_env.simulator.picture.spans import RADIANCE_TOP
from mixo_env.simulator.picture.views import Float32s, Float64s, Int64s

SCATTER = 0.04
"""Share of the sun's light that a lens with a little dust scatters (good ones: 1 to 5 %, measured as in ISO 9358)."""

_CELL = 8  # pixels: glare is smooth
_CORE_RAD = math.radians(1.0)
_HOOD_RAD = math.radians(12.0)  # so far beyond the edge of the picture the hood keeps the sun out
_GHOSTS = ((-0.6, 0.022), (-1.1, 0.045))  # where, in distances of the sun from the middle; radius in widths
_GHOST_FLUX = 2.5e-5  # of the sun: two surfaces that reflect half a per cent each
_HAZE_DEPTH = 0.06  # optical depth of the haze overhead
_ASYMMETRY = 0.75
_FIELD = (1 << 21) - 1
_Floats = NDArray[np.floating]


def sun_share(direction: Float64s, intrinsic: Float64s, height: int, width: int) -> float:
    """Share of the sun that falls on the lens: 1 in the picture, falling to 0 where the hood hides it.

    Args:
        direction: ``(3,)`` unit vector towards the sun in camera axes (x right, y down, z forward).
        intrinsic: ``(3, 3)``.
        height: of the picture in pixels.
        width: likewise.
    """
    # The nearest direction within the picture; behind the camera none is near.
    x, y, z = direction.tolist()
    if z <= 0.0:
        return 0.0
    u, v = intrinsic[0, 0] * x / z + intrinsic[0, 2], intrinsic[1, 1] * y / z + intrinsic[1, 2]
    nearest = np.array(
        [
            (min(max(u, 0.0), width - 1.0) - intrinsic[0, 2]) / intrinsic[0, 0],
            (min(max(v, 0.0), height - 1.0) - intrinsic[1, 2]) / intrinsic[1, 1],
            1.0,
        ]
    )
    beyond = math.acos(min(1.0, float(nearest @ direction) / float(np.linalg.norm(nearest))))
    return max(0.0, 1.0 - beyond / _HOOD_RAD)


def _angles(direction: Float64s, intrinsic: Float64s, height: int, width: int) -> _Floats:
    """Squared angle [rad^2] to the sun at the centres of the cells, ``(rows, columns)``."""
    middle = 0.5 * (_CELL - 1)
    u = (np.arange(width // _CELL) * _CELL + middle - intrinsic[0, 2]) / intrinsic[0, 0]
    v = (np.arange(height // _CELL) * _CELL + middle - intrinsic[1, 2]) / intrinsic[1, 1]
    x, y, z = direction.tolist()
    cosine = (x * u + (y * v + z)[:, None]) / np.sqrt(1.0 + u * u + (v * v)[:, None])
    return np.arccos(np.clip(cosine, -1.0, 1.0)) ** 2


def lens_glare(
    direction: Float64s, intrinsic: Float64s, height: int, width: int, irradiance: float, scatter: float = SCATTER
) -> NDArray[np.float32]:
    """Light that the lens adds to the picture, at the centres of its cells.

    Args:
        direction: ``(3,)`` unit vector towards the sun in camera axes.
        intrinsic: ``(3, 3)``.
        height: of the picture in pixels.
        width: likewise.
        irradiance: of the lens by the sun, in units of radiance times steradian.
        scatter: share that is scattered.

    Returns:
        ``(height // 8, width // 8)`` radiance.
    """
    squared = _angles(direction, intrinsic, height, width)
    per_sr = scatter / (math.pi * math.log(1.0 + (0.5 * math.pi / _CORE_RAD) ** 2))
    light = irradiance * per_sr / (squared + _CORE_RAD**2)
    # Ghosts, where the sun is before the camera.
    x, y, z = direction.tolist()
    if z > 0.1:
        rows, columns = np.mgrid[0 : height // _CELL, 0 : width // _CELL] * _CELL
        for place, radius in _GHOSTS:
            u, v = intrinsic[0, 2] + place * intrinsic[0, 0] * x / z, intrinsic[1, 2] + place * intrinsic[1, 1] * y / z
            far = np.hypot(columns - u, rows - v) / (radius * width)
            size_sr = math.pi * (radius * width / intrinsic[0, 0]) ** 2
            light += irradiance * _GHOST_FLUX * scatter / SCATTER / size_sr * np.clip(6.0 * (1.0 - far), 0.0, 1.0)
    return light.astype(np.float32)


def sky_glare(
    direction: Float64s, intrinsic: Float64s, height: int, width: int, irradiance: float, sine: float
) -> NDArray[np.float32]:
    """Light of the haze around the sun and of the sun itself, before which nothing stands.

    Args:
        direction: ``(3,)`` unit vector towards the sun in camera axes.
        intrinsic: ``(3, 3)``.
        height: of the picture in pixels.
        width: likewise.
        irradiance: by the sun, in units of radiance times steradian.
        sine: of the sun's elevation.

    Returns:
        ``(height // 8, width // 8)`` radiance.
    """
    squared = _angles(direction, intrinsic, height, width)
    g, depth = _ASYMMETRY, _HAZE_DEPTH / max(sine, 0.05)
    phase = (1.0 - g * g) / (1.0 + g * g - 2.0 * g * np.cos(np.sqrt(squared))) ** 1.5 / (4.0 * math.pi)
    # What is scattered straight up and down is part of the usual sky already.
    side = (1.0 - g * g) / (1.0 + g * g) ** 1.5 / (4.0 * math.pi)
    return (irradiance * depth * np.exp(-depth) * np.maximum(phase - side, 0.0)).astype(np.float32)


@compiled_unchecked
def add_light(radiance: Int64s, depth: Float32s, lens: Float32s, sky: Float32s, colour: Float64s) -> None:
    """Add light given at the centres of cells to ``(h, w)`` packed radiance, in place, clipped at its top.

    Args:
        radiance: of the picture.
        depth: ``(h, w)`` 1/z; 0 is the sky.
        lens: ``(rows, columns)`` added everywhere.
        sky: ``(rows, columns)`` added to the sky only.
        colour: ``(3,)`` of both.
    """
    height, width = radiance.shape
    rows, columns = lens.shape
    red, green, blue = colour[0], colour[1], colour[2]
    for y in range(height):
        b = min(max((y + 0.5) / _CELL - 0.5, 0.0), rows - 1.001)
        i = int(b)
        b -= i
        row, far = radiance[y], depth[y]
        for x in range(width):
            a = min(max((x + 0.5) / _CELL - 0.5, 0.0), columns - 1.001)
            j = int(a)
            a -= j
            light = (lens[i, j] * (1.0 - a) + lens[i, j + 1] * a) * (1.0 - b)
            light += (lens[i + 1, j] * (1.0 - a) + lens[i + 1, j + 1] * a) * b
            if far[x] == 0.0:
                light += (sky[i, j] * (1.0 - a) + sky[i, j + 1] * a) * (1.0 - b)
                light += (sky[i + 1, j] * (1.0 - a) + sky[i + 1, j + 1] * a) * b
            word = row[x]
            r = min((word & _FIELD) + np.int64(red * light), RADIANCE_TOP)
            g = min((word >> 21 & _FIELD) + np.int64(green * light), RADIANCE_TOP)
            row[x] = r | g << 21 | min((word >> 42) + np.int64(blue * light), RADIANCE_TOP) << 42


def add_sun(
    image: NDArray[np.uint8], intrinsic: NDArray[np.float64], direction: NDArray[np.float64], strength: float
) -> NDArray[np.uint8]:
    """A finished picture ``(h, w, 3)`` as it would be with the sun in a direction, exposed as it was.

    Args:
        image: bytes, square roots of light (gamma 2); left as it is.
        intrinsic: ``(3, 3)`` of the camera.
        direction: ``(3,)`` unit vector towards the sun in camera axes (x right, y down, z forward).
        strength: the sun's light that the lens scatters, as a share of that of a usual lens under a low sun; 1 is a
            clean lens, 3 a dusty one.

    Raises:
        ConfigurationError: the strength is negative or not finite.
    """
    if not 0.0 <= strength < math.inf:
        raise ConfigurationError(f"the strength of glare must be at least 0 and finite, got {strength:g}: change it")
    height, width = image.shape[:2]
    falls = sun_share(direction, intrinsic, height, width)
    light = lens_glare(direction, intrinsic, height, width, falls * WHITE * _USUAL, strength * SCATTER)
    radiance = radiance_of(image)
    nowhere = np.ones(image.shape[:2], np.float32)
    add_light(radiance, nowhere, light, np.zeros_like(light), np.ones(3))
    return image_of(radiance)


_USUAL = 1.5 * math.pi  # irradiance by a low sun over the radiance of a white pixel: white walls in it are near white
