"""Textures made of noise and simple drawing, and the store that holds them with all their reductions.

A texture is an RGBA array of bytes, its sides powers of two, repeating without a seam. Colours are square roots of
reflectance (gamma 2). The fourth channel is coverage on cut-out patches (leaves) and the strength of emitted light at
night on all others.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Floats = NDArray[np.floating]

LEVELS = 12
DETAIL_SIDE = 512

WORDS = [
    "CAFE",
    "BAKERY",
    "BANK",
    "HOTEL",
    "PHARMACY",
    "MARKET",
    "SUSHI",
    "BOOKS",
    "LAUNDRY",
    "PIZZA",
    "BAR",
    "SALON",
    "OPTIK",
    "FLOWERS",
    "PARKING",
    "NOODLE",
    "DELI",
    "GYM",
    "TAILOR",
    "TEA",
    "24H",
    "SALE",
    "KIOSK",
    "REPAIR",
    "LEGAL",
    "DENTAL",
    "CYCLES",
    "MUSIC",
    "SHOES",
    "TOYS",
]


@lru_cache(maxsize=16)
def _amplitude(height: int, width: int, exponent: float, lowest: float) -> NDArray[np.float32]:
    rows = np.fft.fftfreq(height)[:, None] * height
    columns = np.fft.rfftfreq(width)[None, :] * width
    frequency = np.hypot(rows, columns)
    return np.where(frequency >= lowest, np.maximum(frequency, 1.0) ** -exponent, 0.0).astype(np.float32)


def spectral_noise(height: int, width: int, exponent: float, rng: np.random.Generator, lowest: float = 1.0) -> Floats:
    """Seamless ``(height, width)`` noise, amplitude 1/f^exponent above ``lowest`` cycles, zero mean, unit deviation."""
    amplitude = _amplitude(height, width, exponent, lowest)
    waves = amplitude * rng.standard_normal((*amplitude.shape, 2), np.float32).view(np.complex64)[..., 0]
    noise = np.fft.irfft2(waves, s=(height, width))
    return ((noise - noise.mean()) / (noise.std() + 1e-9)).astype(np.float32)


def rgba(colour: NDArray[np.floating], fourth: NDArray[np.floating] | float = 0.0) -> Bytes:
    """Bytes ``(h, w, 4)`` of colours ``(h, w, 3)`` in 0..255 and the fourth channel."""
    out = np.empty((*colour.shape[:2], 4), np.uint8)
    out[..., :3] = np.clip(colour, 0.0, 255.0)
    out[..., 3] = np.clip(fourth, 0.0, 255.0)
    return out


def _font(text: str) -> int:
    return (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX)[len(text) % 3]


def lettering_width(text: str, size: float, bold: int = 1) -> int:
    """Columns that ``write`` covers."""
    return cv2.getTextSize(text, _font(text), size, bold)[0][0]


def write(
    image: Floats, text: str, origin: tuple[int, int], size: float, colour: NDArray[np.floating], bold: int = 1
) -> None:
    """Draw ``text`` into ``image`` (h, w, 3). OpenCV 5 writes into bytes only, hence the mask."""
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.putText(mask, text, origin, _font(text), size, 255, bold, cv2.LINE_AA)
    share = (mask / np.float32(255.0))[..., None]
    image[:] = image * (1.0 - share) + np.asarray(colour, np.float32) * share


def plain(rng: np.random.Generator, colour: tuple[float, float, float], contrast: float, side: int = 256) -> Bytes:
    """One colour with stains: plaster, metal, bark."""
    light = 1.0 + contrast * spectral_noise(side, side, 1.0, rng)
    return rgba(np.asarray(colour, np.float32) * light[..., None])


def foliage(rng: np.random.Generator, colour: NDArray[np.floating], side: int = 256, dense: bool = False) -> Bytes:
    """Leaves: a ragged disc with holes (coverage in the fourth channel), or a closed and seamless hedge."""
    count = 2600 if dense else 1100
    image = np.zeros((side, side, 3), np.float32) + colour * (0.35 if dense else 0.3)
    covered = np.zeros((side, side), np.uint8)
    bearing, distance = rng.uniform(0, 2 * np.pi, count), 0.46 * side * np.sqrt(rng.random(count))
    if dense:
        xs, ys = rng.uniform(0, side, (2, count))
    else:
        ragged = 0.72 + 0.28 * np.sin(bearing * rng.integers(3, 7) + rng.uniform(0, 6)) * rng.random(count)
        xs, ys = side / 2 + ragged * distance * np.cos(bearing), side / 2 + ragged * distance * np.sin(bearing)
    light = rng.uniform(0.45, 1.6, count) * (1.15 - 0.35 * ys / side)
    hue = 1.0 + 0.12 * rng.standard_normal((count, 3))
    axes = rng.integers([3, 1], [8, 4], (count, 2))
    turn = rng.uniform(0, 180, count)
    for i in range(count):
        leaf = (int(xs[i]), int(ys[i])), (int(axes[i, 0]), int(axes[i, 1])), float(turn[i]), 0.0, 360.0
        cv2.ellipse(image, *leaf, (colour * light[i] * hue[i]).tolist(), -1)
        cv2.ellipse(covered, *leaf, 255, -1)
    return rgba(image, 0.0 if dense else covered.astype(np.float32))


def sign(rng: np.random.Generator, side: int = 128) -> Bytes:
    """A square plate with three words."""
    grounds = np.array([(20, 80, 190), (240, 240, 240), (190, 30, 30), (240, 200, 40), (25, 110, 60)], np.float32)
    choice = int(rng.integers(len(grounds)))
    ink = np.full(3, 20.0 if choice in (1, 3) else 250.0)
    image = np.zeros((side, side, 3), np.float32) + grounds[choice]
    cv2.rectangle(image, (4, 4), (side - 5, side - 5), ink.tolist(), 3)
    for line in range(3):
        write(image, WORDS[rng.integers(len(WORDS))][:6], (9, 40 + 34 * line), 0.8, ink, 2)
    image *= 1.0 + 0.04 * spectral_noise(side, side, 1.0, rng)[..., None]
    return rgba(image, 60.0)


def detail_tile(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Fine grain shared by all surfaces, ``(DETAIL_SIDE, DETAIL_SIDE)``; 127 is neutral.

    The mixture 1/f^0.55 + 1/f^1.3 + specks gives the corner density and the spectrum slope of real streets.
    """
    side = DETAIL_SIDE
    grain = 15.0 * spectral_noise(side, side, 0.55, rng, 6.0) + 16.0 * spectral_noise(side, side, 1.3, rng, 2.0)
    specks = np.zeros((side, side), np.float32)
    for _ in range(700):
        x, y = rng.integers(0, side, 2).tolist()
        radius = int(rng.choice([1, 1, 2, 2, 3, 5]))
        cv2.circle(specks, (x, y), radius, float(rng.normal(0.0, 30.0)), -1, cv2.LINE_AA)
    return np.clip(127.0 + grain + specks, 0.0, 255.0).astype(np.uint8)


def sky_tile(rng: np.random.Generator, side: int = 512) -> NDArray[np.uint8]:
    """Clouds on a plane above the city, ``(side, side)``; 0 is clear sky."""
    noise = spectral_noise(side, side, 1.7, rng) + 0.15 * spectral_noise(side, side, 0.9, rng, 8.0)
    return np.clip(110.0 * (noise + rng.uniform(-0.3, 0.7)), 0.0, 255.0).astype(np.uint8)


def _halved(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    wide = image.astype(np.uint16)
    return ((wide[0::2, 0::2] + wide[1::2, 0::2] + wide[0::2, 1::2] + wide[1::2, 1::2] + 2) >> 2).astype(np.uint8)


def reductions(image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """The image and its halvings, at most ``LEVELS``, until a side is 2."""
    levels = [image]
    while len(levels) < LEVELS and min(levels[-1].shape[:2]) > 2:
        levels.append(_halved(levels[-1]))
    return levels


def quads(tile: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Every texel of a repeating tile with its right, lower and lower right neighbour, lowest byte first."""
    right, below = np.roll(tile, -1, axis=1), np.roll(tile, -1, axis=0)
    return np.stack([tile, right, below, np.roll(right, -1, axis=0)], axis=-1).view(np.uint32)[..., 0]


class Atlas:
    """All textures of a world in one flat array."""

    def __init__(self) -> None:
        self._parts: list[Bytes] = []
        self._table: list[list[tuple[int, int, int]]] = []
        self._size = 0

    def add(self, image: Bytes) -> int:
        """Store an RGBA image (sides powers of two) with its reductions; its number."""
        rows = []
        for level in reductions(image):
            height, width = level.shape[:2]
            rows.append((self._size, width.bit_length() - 1, height.bit_length() - 1))
            self._parts.append(level)
            self._size += height * width
        self._table.append(rows + [rows[-1]] * (LEVELS - len(rows)))
        return len(self._table) - 1

    def packed(self) -> tuple[NDArray[np.uint32], NDArray[np.int64]]:
        """Texels and where they are.

        Returns:
            ``(n,)`` texels, red in the lowest byte, and the table ``(textures, LEVELS, 3)``: offset, log2 width,
            log2 height.
        """
        texels = np.empty(self._size, np.uint32)
        start = 0
        for part in self._parts:
            count = part.shape[0] * part.shape[1]
            texels[start : start + count] = np.ascontiguousarray(part).view(np.uint32).ravel()
            start += count
        return texels, np.array(self._table, np.int64)
