"""How vehicles look: a profile drawn out over the width, with painted sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.mesh import CUT_OUT, SHADE, Mesh, Surface, mesh_of, quad
from mixo_env.simulator.city.textures import (
    WORDS,
    Atlas,
    Bytes,
    Floats,
    lettering_width,
    plain,
    rgba,
    spectral_noise,
    write,
)
from mixo_env.simulator.city.vehicles import COLOURS, VEHICLE_KINDS

_PAINTS = np.array(
    [
        (212, 214, 215),
        (38, 39, 42),
        (150, 153, 157),
        (128, 24, 24),
        (38, 62, 130),
        (96, 99, 104),
        (236, 237, 236),
        (52, 74, 62),
        (168, 158, 136),
        (214, 170, 40),
    ],
    np.float32,
)
assert len(_PAINTS) == COLOURS


@dataclass(frozen=True)
class _Shape:
    """Profile from rear bottom over the roof to front bottom, a word per segment; windows and wheels of the side."""

    profile: tuple[tuple[float, float], ...]
    parts: tuple[str, ...]
    windows: tuple[tuple[tuple[float, float], ...], ...]
    axles: tuple[float, ...]
    wheel_m: float


_SHAPES = {
    "sedan": _Shape(
        (
            (-2.25, 0.3),
            (-2.2, 0.98),
            (-1.6, 1.02),
            (-0.95, 1.41),
            (0.3, 1.45),
            (1.05, 1.0),
            (2.05, 0.84),
            (2.22, 0.66),
            (2.25, 0.28),
        ),
        ("rear", "roof", "glass", "roof", "screen", "hood", "hood", "front"),
        (
            ((-1.45, 1.0), (-0.9, 1.34), (-0.25, 1.37), (-0.25, 1.0)),
            ((-0.17, 1.0), (-0.17, 1.37), (0.26, 1.37), (0.85, 1.0)),
        ),
        (-1.35, 1.35),
        0.32,
    ),
    "suv": _Shape(
        (
            (-2.35, 0.36),
            (-2.35, 0.98),
            (-2.25, 1.1),
            (-1.98, 1.66),
            (-1.6, 1.72),
            (0.4, 1.70),
            (1.12, 1.14),
            (2.12, 1.02),
            (2.32, 0.82),
            (2.35, 0.36),
        ),
        ("rear", "roof", "glass", "roof", "roof", "screen", "hood", "hood", "front"),
        (
            ((-2.0, 1.14), (-1.8, 1.58), (-1.3, 1.62), (-1.3, 1.14)),
            ((-1.2, 1.14), (-1.2, 1.62), (-0.3, 1.62), (-0.3, 1.14)),
            ((-0.2, 1.14), (-0.2, 1.62), (0.36, 1.6), (0.92, 1.14)),
        ),
        (-1.4, 1.42),
        0.37,
    ),
    "van": _Shape(
        (
            (-2.7, 0.36),
            (-2.7, 1.35),
            (-2.66, 2.2),
            (-2.5, 2.4),
            (1.15, 2.4),
            (1.3, 2.34),
            (1.95, 1.34),
            (2.5, 1.16),
            (2.68, 0.9),
            (2.7, 0.34),
        ),
        ("rear", "glass", "roof", "roof", "roof", "screen", "hood", "hood", "front"),
        (((0.3, 1.35), (0.3, 2.1), (1.2, 2.1), (1.7, 1.35)),),
        (-1.75, 1.75),
        0.36,
    ),
    "truck": _Shape(
        ((-4.3, 0.55), (-4.3, 3.5), (2.3, 3.5), (2.35, 2.85), (3.75, 2.85), (4.18, 1.6), (4.3, 0.45)),
        ("doors", "roof", "roof", "roof", "screen", "front"),
        (((3.0, 1.65), (3.0, 2.55), (3.7, 2.55), (3.98, 1.65)),),
        (-2.9, -1.75, 3.2),
        0.5,
    ),
}


class _Frame(NamedTuple):
    """Where points of a vehicle's side are in its picture: half its length, its height, texels per metre."""

    half_m: float
    height_m: float
    per_m: float

    def at(self, x: float, z: float) -> tuple[int, int]:
        """Column and row of a point."""
        return int((self.half_m - x) * self.per_m), int((self.height_m - z) * self.per_m)

    def outline(self, points: tuple[tuple[float, float], ...]) -> NDArray[np.int32]:
        """Columns and rows of a polygon's corners in 1/16 texels, as OpenCV takes them with a shift of 4."""
        column = (self.half_m - np.array(points)[:, 0]) * self.per_m
        row = (self.height_m - np.array(points)[:, 1]) * self.per_m
        return (16 * np.stack([column, row], axis=1)).astype(np.int32)


class _Lettering(NamedTuple):
    """A name on a vehicle's side: what, column at which it starts on the left side, row of its foot, size, colour."""

    text: str
    column: int
    row: int
    size: float
    colour: NDArray[np.float64]

    def on(self, image: Floats, flipped: bool) -> None:
        """Write it so that it ends before the tail; ``flipped``: at the same place of the right side."""
        room = image.shape[1] - self.column - 8
        size = self.size * min(1.0, room / lettering_width(self.text, self.size, 4))
        wide = lettering_width(self.text, size, 4)
        start = image.shape[1] - self.column - wide if flipped else self.column
        write(image, self.text, (start, self.row), size, self.colour, 4)


def _sides(rng: np.random.Generator, kind: str, paint: NDArray[np.float32]) -> tuple[Bytes, Bytes, float]:
    """Pictures of the left side (front to the left as seen by the viewer) and of the right one (front to the right).

    They are 512 texels long and mirror each other but for lettering, which reads from left to right on both. The
    third value is their texels per metre.
    """
    shape, size = _SHAPES[kind], VEHICLE_KINDS[kind]
    frame = _Frame(0.5 * size.length_m, size.height_m, 512.0 / size.length_m)
    height = 256
    rows = np.linspace(1.25, 0.62, height, dtype=np.float32)[:, None, None]
    image: Floats = (
        paint * np.broadcast_to(rows, (height, 512, 1)) + 1.5 * spectral_noise(height, 512, 1.0, rng)[..., None]
    )
    image = np.ascontiguousarray(image)
    covered = np.zeros((height, 512), np.uint8)
    cv2.fillPoly(covered, [frame.outline(shape.profile)], 255, cv2.LINE_8, 4)
    sill = frame.at(0.0, 0.48 + 0.2 * (kind == "truck"))[1]
    image[sill:] = 28.0
    name: _Lettering | None = None
    if kind == "truck":
        name = _load_box(image, rng, paint * rows[:sill], rows[:sill], frame.at(2.32, 0.0)[0])
    for window in shape.windows:
        pane = frame.outline(window)
        _window(image, pane)
        if kind != "truck":
            _door(image, pane, sill)
    if kind == "van":
        cut = frame.at(-0.1, 0.0)[0]
        image[20:sill, cut : cut + 2] *= 0.4
        if rng.random() < 0.6:
            name = _Lettering(str(rng.choice(WORDS)), frame.at(-0.3, 0.0)[0], 120, 1.6, rng.uniform(0, 220, 3))
    if kind != "truck":
        head, tail = frame.at(frame.half_m - 0.25, 0.72), frame.at(0.2 - frame.half_m, 0.9)
        cv2.ellipse(image, head, (22, 8), 8, 0, 360, (225.0, 232.0, 236.0), -1, cv2.LINE_AA)
        cv2.rectangle(image, (tail[0], tail[1] - 12), (511, tail[1] + 10), (150.0, 22.0, 22.0), -1)
    tyre = int(shape.wheel_m * frame.per_m)
    for axle in shape.axles:
        hub = frame.at(axle, shape.wheel_m)
        _wheel(image, hub, tyre)
        cv2.circle(covered, hub, tyre, 255, -1)
    right = np.ascontiguousarray(image[:, ::-1])
    if name is not None:
        name.on(image, flipped=False)
        name.on(right, flipped=True)
    outline = covered.astype(np.float32)
    return rgba(image, outline), rgba(right, outline[:, ::-1]), frame.per_m


def _load_box(image: Floats, rng: np.random.Generator, painted: Floats, rows: Floats, cut: int) -> _Lettering:
    """A lorry's box with its ribs and a band: white, or ``painted`` like the cab before column ``cut``; the name on it.

    Args:
        image: of the side; changed in place.
        rng: of the colours and the name.
        painted: what stands over the sill in the vehicle's colour.
        rows: brightness of those rows.
        cut: first column of the gap between cab and box.
    """
    sill = len(rows)
    image[: sill - 4, cut : cut + 4] = 20.0
    image[:sill, cut + 4 :] = 235.0 * np.ones(3) * rows if rng.random() < 0.6 else painted
    for x in range(cut + 30, 512, 38):
        image[:sill, x : x + 2] *= 0.88
    band = rng.uniform(30, 220, 3)
    image[90:106, cut + 4 :] = band
    return _Lettering(" ".join(str(word) for word in rng.choice(WORDS, 2)), cut + 30, 78, 1.5, band)


def _window(image: Floats, pane: NDArray[np.int32]) -> None:
    """Dark glass with a rubber frame and slanting reflections."""
    cv2.fillPoly(image, [pane], (46.0, 54.0, 62.0), cv2.LINE_AA, 4)
    cv2.polylines(image, [pane], True, (14.0, 14.0, 15.0), 3, cv2.LINE_AA, 4)
    height, width = image.shape[:2]
    glare = np.zeros((height, width), np.uint8)
    cv2.fillPoly(glare, [pane], 255, cv2.LINE_8, 4)
    slant = ((np.arange(width)[None, :] + np.arange(height)[:, None]) % 90 < 26) & (glare > 0)
    image[slant] += 38.0


def _door(image: Floats, pane: NDArray[np.int32], sill: int) -> None:
    """The gap of a door from its window down to the sill, and its handle."""
    low, high = pane.min(axis=0) // 16, pane.max(axis=0) // 16
    x = int(high[0]) + 3
    image[int(low[1]) : sill - 6, x : x + 2] *= 0.35
    image[int(high[1]) + 8 : int(high[1]) + 12, x - 34 : x - 12] *= 0.45


def _wheel(image: Floats, hub: tuple[int, int], tyre: int) -> None:
    """Wheel arch, tyre and a rim with five spokes; ``tyre`` is its radius in texels."""
    cv2.circle(image, hub, int(1.18 * tyre), (10.0,) * 3, -1, cv2.LINE_AA)
    cv2.circle(image, hub, tyre, (34.0, 34.0, 35.0), -1, cv2.LINE_AA)
    cv2.circle(image, hub, int(0.64 * tyre), (150.0, 152.0, 155.0), -1, cv2.LINE_AA)
    for spoke in np.arange(5) * 2.0 * np.pi / 5.0:
        tip = (int(hub[0] + 0.6 * tyre * np.cos(spoke)), int(hub[1] + 0.6 * tyre * np.sin(spoke)))
        cv2.line(image, hub, tip, (60.0, 60.0, 62.0), max(2, tyre // 6), cv2.LINE_AA)


def _end(rng: np.random.Generator, kind: str, paint: NDArray[np.float32], front: bool) -> Bytes:
    """Picture of the front or the rear, 128 x 128, stretched over its segment; lamps shine at night."""
    side = 128
    image = paint * np.linspace(1.15, 0.7, side, dtype=np.float32)[:, None, None] * np.ones((1, side, 1), np.float32)
    glow = np.zeros((side, side), np.float32)
    lamp, strength = ((232, 238, 240), 255.0) if front else ((165, 18, 18), 90.0)
    rows = slice(70, 96) if kind == "truck" else slice(10, 44)
    wide = 12 if kind == "truck" else 26
    for columns in (slice(5, 5 + wide), slice(side - 5 - wide, side - 5)):
        image[rows, columns] = lamp
        glow[rows, columns] = strength
    if front:
        image[18:58, 38:90] = 24.0
        image[20:56:5, 38:90] = 90.0
        cv2.circle(image, (64, 36), 6, (190.0,) * 3, -1, cv2.LINE_AA)
    elif kind == "truck":
        image[:64] = paint if rng.random() < 0.4 else 225.0
        image[:, 62:66] = 40.0
        for x in (24, 48, 80, 104):
            image[6:60, x : x + 2] *= 0.5
        write(image, str(rng.choice(WORDS))[:6], (14, 42), 0.9, rng.uniform(0, 160, 3), 2)
        image[66:] *= 0.4
        image[104:112, 4:124:12] = (220, 60, 20)
    plate = slice(76, 94) if kind != "truck" else slice(108, 120)
    image[92:] = np.minimum(image[92:], 60.0)
    image[plate, 44:84] = 228.0
    letters = "".join(chr(65 + int(c)) for c in rng.integers(0, 26, 4))
    write(image, letters, (46, plate.stop - 4), 0.42, np.full(3, 15.0), 1)
    image[112:, 8:28] = 12.0
    image[112:, side - 28 : side - 8] = 12.0
    return rgba(image, glow)


def _glass(rng: np.random.Generator, side: int = 64) -> Bytes:
    tone = np.linspace(118.0, 44.0, side)[:, None] + 9.0 * spectral_noise(side, side, 1.5, rng)
    image = np.stack([0.92 * tone, tone, 1.1 * tone], axis=-1).astype(np.float32)
    for edge in (image[:3], image[-3:], image[:, :3], image[:, -3:]):
        edge[:] = 18.0
    return rgba(image)


def vehicle_models(
    atlas: Atlas, rng: np.random.Generator, ground: int, ground_texels_per_m: float
) -> dict[tuple[str, int], Mesh]:
    """One mesh per (kind, colour): x forward, y left, z up, origin at the centre on the ground.

    The last patch of each is the dark ground under the vehicle; it is re-textured when the vehicle is put somewhere
    (``laying.ground_aligned``).
    """
    glass = atlas.add(_glass(rng))
    models = {}
    for kind, shape in _SHAPES.items():
        half = 0.5 * VEHICLE_KINDS[kind].width_m
        for colour, paint in enumerate(_PAINTS):
            left, right, per_m = _sides(rng, kind, paint)
            sides = tuple(
                Surface(atlas.add(picture), (per_m, per_m), detail=0.0, shape=CUT_OUT) for picture in (left, right)
            )
            lacquer = Surface(atlas.add(plain(rng, tuple(paint), 0.02, 64)), (20.0, 20.0), detail=0.0)
            ends = {front: atlas.add(_end(rng, kind, paint, front)) for front in (True, False)}
            models[kind, colour] = _model(
                shape, half, VEHICLE_KINDS[kind].height_m, sides, lacquer, glass, ends, ground, ground_texels_per_m
            )
    return models


def _model(
    shape: _Shape,
    half: float,
    height: float,
    sides: tuple[Surface, ...],
    lacquer: Surface,
    glass: int,
    ends: dict[bool, int],
    ground: int,
    ground_texels_per_m: float,
) -> Mesh:
    length = shape.profile[-1][0] - shape.profile[0][0]
    deep = 256.0 / sides[0].texels_per_m[0]
    tail, nose = shape.profile[0][0], shape.profile[-1][0]
    left = quad(sides[0], (nose, half, height), (-length, 0, 0), (0, 0, -deep))
    right = quad(sides[1], (tail, -half, height), (length, 0, 0), (0, 0, -deep))
    parts = [left, right]
    for (x0, z0), (x1, z1), part in zip(shape.profile[:-1], shape.profile[1:], shape.parts, strict=True):
        run = float(np.hypot(x1 - x0, z1 - z0))
        per_m = (128.0 / (2.0 * half), 128.0 / run)
        if part in ("front", "rear", "doors"):
            look = Surface(ends[part == "front"], per_m, detail=0.0, emission=3.0 if part == "front" else 1.5)
        elif part in ("glass", "screen"):
            look = Surface(glass, (64.0 / (2.0 * half), 64.0 / run), detail=0.0)
        else:
            look = lacquer
        forward = part in ("front", "hood", "screen")
        if forward:  # as seen from ahead
            parts.append(quad(look, (x0, -half, z0), (0, 2 * half, 0), (x1 - x0, 0, z1 - z0)))
        else:  # as seen from behind
            parts.append(quad(look, (x1, half, z1), (0, -2 * half, 0), (x0 - x1, 0, z0 - z1)))
    mirror = Surface(lacquer.texture, (60.0, 60.0), detail=0.0)
    x = shape.windows[-1][-1][0] - 0.15
    z = shape.windows[-1][-1][1]
    for y in (half, -half - 0.2):
        parts.append(quad(mirror, (x + 0.12, y, z + 0.16), (0, 0.2, 0), (0, 0, -0.16)))
        parts.append(quad(mirror, (x, y + 0.2, z + 0.16), (0, -0.2, 0), (0, 0, -0.16)))
    scale = (ground_texels_per_m, ground_texels_per_m)
    under = Surface(ground, scale, tint=(0.1, 0.1, 0.1), detail=0.5, material=SHADE)
    parts.append(quad(under, (tail - 0.05, half, 0.02), (length + 0.1, 0, 0), (0, -2 * half, 0)))
    return mesh_of(parts)
