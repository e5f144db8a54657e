"""The picture of the ground: asphalt, markings, pavements and yards, repeating every three blocks."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.streets import BLOCK_M, HALF_ROAD_M, SIDEWALK_M
from mixo_env.simulator.city.textures import Bytes, Floats, rgba, spectral_noise

GROUND_PERIOD_M = 3.0 * BLOCK_M
"""The ground texture covers a square of this side."""

CROSSING_M = HALF_ROAD_M + 3.4
"""Stop lines lie this far from the centre of a crossing."""

_PARKING_LINE_M = 4.45
_YARD, _SLABS, _KERB, _ROAD = range(4)


def _wear(rng: np.random.Generator, side: int, scale: float) -> Floats:
    """Relative brightness from patches, cracks, stains and manhole covers, ``(side, side)``, zero mean."""
    wear = np.zeros((side, side), np.float32)
    for _ in range(900):
        x, y = rng.integers(0, side, 2).tolist()
        w, h = (scale * rng.integers(10, 90, 2)).astype(int).tolist()
        cv2.rectangle(wear, (x, y), (x + w, y + h), float(rng.normal(0.0, 0.14)), -1)
    for _ in range(2600):
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.5, int(rng.integers(4, 30))))
        steps = 5.0 * scale * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        crack = (rng.uniform(0, side, 2) + np.cumsum(steps, axis=0)).astype(np.int32)
        cv2.polylines(wear, [crack], False, float(-rng.uniform(0.15, 0.45)), 1, cv2.LINE_AA)
    for _ in range(3500):
        x, y = rng.integers(0, side, 2).tolist()
        radius = max(1, int(scale * rng.choice([1, 2, 3, 5, 9])))
        cv2.circle(wear, (x, y), radius, float(rng.normal(-0.1, 0.18)), -1, cv2.LINE_AA)
    for _ in range(420):
        x, y = rng.integers(0, side, 2).tolist()
        cv2.circle(wear, (x, y), max(1, int(6 * scale)), -0.45, -1, cv2.LINE_AA)
        cv2.circle(wear, (x, y), max(1, int(5 * scale)), -0.2, 1, cv2.LINE_AA)
    return wear


def _arrow(along: float, across: float, kind: int) -> NDArray[np.float64]:
    """Outline of a lane arrow pointing along +x (kind 0) or bending right (kind 1), metres."""
    straight = [(0, -0.1), (1.8, -0.1), (1.8, -0.35), (3.0, 0), (1.8, 0.35), (1.8, 0.1), (0, 0.1)]
    bent = [
        (0, -0.1),
        (1.5, -0.1),
        (1.5, 0.5),
        (1.1, 0.5),
        (1.7, 1.1),
        (2.3, 0.5),
        (1.9, 0.5),
        (1.9, 0.3),
        (1.6, 0.1),
        (0, 0.1),
    ]
    return np.add(bent if kind else straight, (along, across))


def _markings_along_x(rng: np.random.Generator, x: Floats, y: Floats, texels_per_m: float) -> NDArray[np.uint8]:
    """Paint (0..255) of the streets along x; ``x`` (n,), ``y`` (n,) are signed distances to the nearest street."""
    side = len(x)
    paint = np.zeros((side, side), np.uint8)
    clear = np.abs(x) > CROSSING_M
    metres = np.arange(side) / texels_per_m
    dashes = clear & (metres % 9.0 < 3.0)
    stop = (np.abs(x) > CROSSING_M) & (np.abs(x) < CROSSING_M + 0.4)
    zebra = (np.abs(x) > HALF_ROAD_M + 0.3) & (np.abs(x) < HALF_ROAD_M + 2.9)
    bays = clear & (metres % 6.2 < 0.12)
    centre, line = np.abs(y) < 0.08, np.abs(np.abs(y) - _PARKING_LINE_M) < 0.06
    stripes = (np.abs(y) < HALF_ROAD_M - 0.3) & (y % 1.0 < 0.5)
    # Right-hand traffic: the lane below the centre line runs along +x and stops at the crossing ahead (x < 0).
    approach = (stop & (x < 0))[None, :] & ((y < 0) & (y > -_PARKING_LINE_M))[:, None]
    approach |= (stop & (x > 0))[None, :] & ((y > 0) & (y < _PARKING_LINE_M))[:, None]
    paint[np.ix_(centre, dashes)] = 235
    paint[np.ix_(line, clear)] = 170
    paint[np.ix_((np.abs(y) > _PARKING_LINE_M) & (np.abs(y) < HALF_ROAD_M), bays)] = 150
    paint[np.ix_(stripes, zebra)] = 235
    paint[approach] = 235
    period = side / texels_per_m / 3.0
    for i in range(3):
        for j in range(3):
            for sense in (1.0, -1.0):
                for back in (9.0, 24.0):
                    if rng.random() < 0.3:
                        continue
                    outline = sense * _arrow(-CROSSING_M - back, -1.75, int(rng.integers(2)))
                    outline = np.add(outline, (i * period, j * period)) % (3.0 * period)
                    if np.ptp(outline) < 1.5 * period or np.ptp(outline[:, 0]) < 5.0:
                        cv2.fillPoly(paint, [(outline * texels_per_m * 16).astype(np.int32)], 220, cv2.LINE_AA, 4)
    return paint


def ground_texture(rng: np.random.Generator, side: int = 4096) -> Bytes:
    """The ground of three by three blocks, ``(side, side, 4)``; texel (row, column) = (y, x) * side / period."""
    scale = side / 4096.0
    texels_per_m = side / GROUND_PERIOD_M
    position = (np.arange(side, dtype=np.float32) + 0.5) / texels_per_m
    offset = ((position + 0.5 * BLOCK_M) % BLOCK_M - 0.5 * BLOCK_M).astype(np.float32)
    near = np.minimum(np.abs(offset)[:, None], np.abs(offset)[None, :])
    surface = (near < SIDEWALK_M).astype(np.uint8) * _SLABS
    surface[near < HALF_ROAD_M + 0.25] = _KERB
    surface[near < HALF_ROAD_M] = _ROAD

    coarse = spectral_noise(side // 8, side // 8, 1.1, rng)
    coarse = cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC)
    fine = np.tile(spectral_noise(side // 4, side // 4, 0.5, rng, 8.0), (4, 4))
    light = 1.0 + 0.10 * coarse + 0.06 * fine
    wear = _wear(rng, side, scale)
    light += np.where(surface == _ROAD, wear, 0.5 * wear)
    slab = np.arange(side) % max(1, round(1.25 * texels_per_m)) == 0
    light[(surface == _SLABS) & (slab[:, None] | slab[None, :])] *= 0.84
    wheels = np.abs(np.abs(offset) - 1.75)
    ruts = (0.05 * np.exp(-(((wheels - 0.75) / 0.3) ** 2))).astype(np.float32)
    light *= np.where(surface == _ROAD, 1.0 - np.maximum(ruts[:, None], ruts[None, :]), 1.0)

    paint = _markings_along_x(rng, offset, offset, texels_per_m)
    # A quarter turn maps (x, y) to (y, -x): the other family of streets keeps its right-hand traffic.
    paint = np.maximum(paint, np.rot90(_markings_along_x(rng, offset, offset, texels_per_m)))
    worn = paint * np.clip(0.86 + 0.16 * coarse + 0.10 * fine, 0.3, 1.0) / 255.0

    asphalt = rng.uniform(78.0, 98.0)
    palette = np.array([(120, 105, 82), (152, 149, 143), (168, 166, 160), (asphalt,) * 3], np.float32)
    palette[_SLABS] *= rng.uniform(0.9, 1.1)
    grass = np.array((84, 104, 52), np.float32)
    out = np.empty((side, side, 4), np.uint8)
    for top in range(0, side, 256):  # strips keep the memory of the build low
        rows = slice(top, top + 256)
        colour = palette[surface[rows]]
        lawn = (surface[rows] == _YARD) & (coarse[rows] > -0.8)
        colour[lawn] = grass * (1.0 + 0.16 * fine[rows][lawn])[:, None]
        colour *= np.clip(light[rows], 0.3, 1.7)[..., None]
        share = worn[rows][..., None]
        out[rows] = rgba(colour * (1.0 - share) + 222.0 * share)
    return out
