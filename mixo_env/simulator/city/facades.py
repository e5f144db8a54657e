"""House fronts and shop fronts at 40 and 80 texels a metre."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from mixo_env.simulator.city.textures import WORDS, Bytes, Floats, rgba, spectral_noise, write

FACADE_TEXELS_PER_M = 40.0
FACADE_SIDE = 512
STOREY_M = 3.2
SHOP_TEXELS_PER_M = 80.0

_BASES = np.array(
    [
        (150, 92, 74),
        (196, 180, 152),
        (140, 140, 136),
        (178, 146, 104),
        (206, 202, 192),
        (122, 128, 132),
        (186, 164, 150),
        (160, 170, 168),
    ],
    np.float32,
)


def _wall(rng: np.random.Generator, base: Floats, kind: str) -> Floats:
    """Wall material without windows, ``(FACADE_SIDE, FACADE_SIDE, 3)``."""
    side = FACADE_SIDE
    light = 1.0 + 0.06 * spectral_noise(side, side, 1.3, rng) + 0.035 * spectral_noise(side, side, 0.4, rng, 20.0)
    y, x = np.mgrid[0:side, 0:side]
    if kind == "brick":
        row = y // 4
        shifted = x + (row % 2) * 6
        bricks = rng.normal(1.0, 0.10, (side // 4 + 1, side // 12 + 2)).astype(np.float32)
        light = light * bricks[row, (shifted // 12) % (side // 12)]
        light = np.where((y % 4 == 0) | (shifted % 12 == 0), 0.8 * light + 0.1, light)
    elif kind == "panel":
        light = np.where((y % 128 < 2) | (x % 64 < 2), 0.65 * light, light)
    # Rain marks: vertical streaks that darken from the top down.
    streaks = (
        np.tile(spectral_noise(1, side, 0.6, rng), (side, 1)) * np.linspace(0.2, 1.0, side, dtype=np.float32)[:, None]
    )
    return base * (light + 0.025 * streaks)[..., None]


def _pane(rng: np.random.Generator, height: int, width: int) -> Floats:
    """Window glass with reflected sky, blind or curtain, ``(height, width, 3)``."""
    bright = rng.uniform(30.0, 150.0)
    tone = np.linspace(1.35 * bright, 0.6 * bright, height, dtype=np.float32)[:, None]
    tone = tone + 10.0 * spectral_noise(height + height % 2, width + width % 2, 1.4, rng)[:height, :width]
    pane = np.stack([0.9 * tone, tone, 1.12 * tone], axis=-1)
    fate = rng.random()
    if fate < 0.35:
        rows = int(height * rng.uniform(0.15, 0.95))
        pane[:rows] = rng.uniform(120, 225) * (1.0 - 0.12 * (np.arange(rows) % 4 == 0))[:, None, None]
    elif fate < 0.55:
        columns = int(width * rng.uniform(0.15, 0.4))
        cloth = rng.uniform(100, 210) * rng.uniform(0.85, 1.15, 3)
        pane[:, :columns] = cloth
        pane[:, width - columns :] = cloth
    return pane


def _curtain_wall(rng: np.random.Generator, base: Floats) -> tuple[Floats, Floats]:
    """Office front of glass panes between thin bars, and its light at night."""
    side = FACADE_SIDE
    image = np.empty((side, side, 3), np.float32)
    glow = np.zeros((side, side), np.float32)
    columns = int(rng.choice([8, 12, 16]))
    width, storey = side / columns, side // 4
    tint = np.array((0.82, 0.98, 1.12)) * rng.uniform(0.9, 1.1)
    for i in range(4):
        for j in range(columns):
            x0, x1, y0, y1 = int(j * width), int((j + 1) * width), i * storey, (i + 1) * storey
            tone = rng.uniform(55, 150) * np.linspace(1.25, 0.7, y1 - y0)[:, None, None]
            image[y0:y1, x0:x1] = tone * tint
            if rng.random() < 0.25:
                image[y0 : y0 + int(storey * rng.uniform(0.2, 0.7)), x0:x1] = rng.uniform(120, 190)
            image[y1 - 34 : y1, x0:x1] = base * 0.75  # the storey's edge
            image[y0:y1, x0 : x0 + 2] = base * 0.5
            glow[y0 : y1 - 34, x0:x1] = 90.0 if rng.random() < 0.3 else 0.0
        edge = (i + 1) * storey - 34
        image[edge : edge + 3] = base * 1.2
    image *= 1.0 + 0.05 * spectral_noise(side, side, 1.4, rng)[..., None]
    return image, glow


def facade(rng: np.random.Generator) -> Bytes:
    """One seamless front of four storeys, 12.8 m wide and high."""
    side, storeys = FACADE_SIDE, 4
    base = _BASES[rng.integers(len(_BASES))] * rng.uniform(0.85, 1.15)
    kind = str(rng.choice(["brick", "brick", "panel", "plaster", "plaster", "glass"]))
    if kind == "glass":
        return rgba(*_curtain_wall(rng, base))
    image = _wall(rng, base, kind)
    glow = np.zeros((side, side), np.float32)
    bays = int(rng.choice([3, 4, 4, 5, 6]))
    bay, storey = side / bays, side // storeys
    width, height = int(bay * rng.uniform(0.36, 0.62)), int(storey * rng.uniform(0.45, 0.66))
    frame = rng.uniform(50, 235) * np.ones(3)
    divided, balconies, shutters = rng.integers(0, 3), rng.random() < 0.3, rng.random() < 0.25
    shutter_colour = base * rng.uniform(0.35, 0.8, 3)
    for i in range(storeys):
        if kind != "panel":
            image[i * storey : i * storey + 4] = base * 1.12  # string course
            image[i * storey + 4 : i * storey + 6] *= 0.7
        for j in range(bays):
            x0 = int(j * bay + (bay - width) / 2) + int(rng.integers(-1, 2))
            y0 = i * storey + (storey - height) // 2 + 4
            x1, y1 = x0 + width, y0 + height
            if shutters:
                image[y0 - 2 : y1 + 2, x0 - 14 : x1 + 14] = shutter_colour
                image[y0:y1:4, x0 - 13 : x1 + 13] *= 0.8
            image[y0 - 3 : y1 + 3, x0 - 3 : x1 + 3] = frame
            image[y0:y1, x0:x1] = _pane(rng, height, width)
            image[y0 : y0 + 4, x0:x1] *= 0.5  # the reveal's shadow
            if divided != 1:
                image[y0:y1, (x0 + x1) // 2 - 1 : (x0 + x1) // 2 + 1] = frame
            if divided <= 1:
                image[y0 + height // 3 : y0 + height // 3 + 2, x0:x1] = frame
            image[y1 + 3 : y1 + 7, x0 - 6 : x1 + 6] = base * rng.uniform(1.1, 1.35)  # sill and the shadow below
            image[y1 + 7 : y1 + 11, x0 - 5 : x1 + 5] *= 0.6
            if balconies and j % 2 == 0:
                image[y1 - 26 : y1 + 6, x0 - 10 : x1 + 10 : 4] = 40.0
                image[y1 - 28 : y1 - 25, x0 - 12 : x1 + 12] = 45.0
                image[y1 + 4 : y1 + 10, x0 - 12 : x1 + 12] = base * 0.8
            elif rng.random() < 0.12:  # air conditioner
                ax, ay = x0 + int(rng.integers(0, max(1, width - 22))), min(y1 + 5, side - 16)
                image[ay : ay + 14, ax : ax + 22] = 195.0
                image[ay + 3 : ay + 11, ax + 3 : ax + 14] = 75.0
            glow[y0:y1, x0:x1] = rng.uniform(50, 110) if rng.random() < 0.3 else 0.0
    if rng.random() < 0.6:  # drain pipe
        x = int(rng.integers(0, side - 6))
        image[:, x : x + 4] = base * 0.55
        image[:, x + 4 : x + 6] *= 0.75
    return rgba(image, glow)


def shop_front(rng: np.random.Generator) -> Bytes:
    """A strip of shops, 12.8 m long and one storey high, with name boards, displays and doors."""
    height, width = 256, 1024
    image = np.full((height, width, 3), rng.uniform(70, 170), np.float32) * rng.uniform(0.9, 1.1, 3)
    image *= 1.0 + 0.06 * spectral_noise(height, width, 1.0, rng)[..., None]
    glow = np.zeros((height, width), np.float32)
    cuts = [0, *sorted(rng.choice(np.arange(2, 7), 2, replace=False) * 128), width]
    for left, right in pairwise(cuts):
        board = 0.5 * rng.uniform(20, 240) + 0.5 * rng.uniform(20, 240, 3)
        image[14:64, left:right] = board * np.linspace(1.08, 0.92, 50)[:, None, None]
        ink = np.full(3, 245.0) if board.mean() < 130 else rng.uniform(0, 90, 3)
        name = " ".join(str(word) for word in rng.choice(WORDS, 1 + (right - left > 300)))
        write(image, name, (left + 14, 52), float(rng.uniform(1.2, 1.5)), ink, 3)
        image[64:70, left:right] *= 0.5
        inside = rng.uniform(28, 75) * rng.uniform(0.9, 1.1, 3)
        view = image[70:226, left + 10 : right - 10]
        view[:] = inside + 14.0 * spectral_noise(256, 1024, 1.3, rng)[70:226, : view.shape[1], None]
        for _ in range(int(rng.integers(8, 20))):  # goods, posters, people
            w, h = int(rng.integers(8, 52)), int(rng.integers(10, 90))
            x, y = int(rng.integers(0, max(1, view.shape[1] - w))), int(rng.integers(10, max(11, 156 - h)))
            thing = 0.65 * rng.uniform(20, 230) + 0.35 * rng.uniform(20, 230, 3)
            view[y : y + h, x : x + w] = 0.75 * thing + 0.25 * inside
            if w > 34 and h > 22:
                write(view[y : y + h, x : x + w], str(rng.choice(WORDS))[:5], (2, 18), 0.45, 255.0 - thing)
        view *= np.linspace(1.25, 0.85, view.shape[1])[None, :, None]  # reflected street
        door = int(rng.integers(left + 12, right - 84))
        image[74:256, door : door + 72] = rng.uniform(40, 120) * rng.uniform(0.8, 1.2, 3)
        image[84:236, door + 8 : door + 64] = inside * 1.2
        image[150:156, door + 52 : door + 62] = 190.0
        image[226:, left:door] *= 0.8
        image[64:, left : left + 6] = rng.uniform(60, 220)
        if rng.random() < 0.7:
            glow[14:64, left:right] = 100.0
        if rng.random() < 0.6:
            glow[70:226, left + 10 : right - 10] = 55.0
    return rgba(image, glow)
