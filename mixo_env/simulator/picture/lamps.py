"""Lights of the night: beams of head lights on the road and the glare around whatever is bright."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numba import float32
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.city.vehicles import VEHICLE_KINDS, VehicleState
from mixo_env.simulator.picture.views import Float32s, Float64s, Int64s

WINDOW = 512
"""Side of the window of lamp light around the camera, one value a metre."""

_CELL = 8  # pixels: glare is smooth, so it is computed on a grid sixty-four times smaller
_FIELD = (1 << 21) - 1  # one colour of a packed radiance
_SAMPLED = 4  # every second pixel of every second row stands for four
_FAINT = 2.0  # integer radiance that nobody sees: 1/16000 of white

_BEAM_REACH_M = 28  # a dipped beam fades out there
_BEAM_POWER = 30.0  # seen from afar, less than the own lights (sampling.lamp_light), by eye
_BEAM_SOFTENING_M2 = 25.0  # keeps the inverse square finite near the lamps
_BEAM_NARROW = 6.0  # the beam falls to 1/e at 22 degrees to either side


@compiled_unchecked
def _add_beams(window: Float32s, origin: Float64s, beams: Float64s) -> None:
    """Add head light beams (x, y of the lamps, cos and sin of the heading) to the light on the ground."""
    side = window.shape[0]
    for n in range(beams.shape[0]):
        x, y, c, s = beams[n, 0] - origin[0], beams[n, 1] - origin[1], beams[n, 2], beams[n, 3]
        for row in range(max(0, int(y) - _BEAM_REACH_M), min(side, int(y) + _BEAM_REACH_M + 1)):
            for column in range(max(0, int(x) - _BEAM_REACH_M), min(side, int(x) + _BEAM_REACH_M + 1)):
                dx, dy = column + 0.5 - x, row + 0.5 - y
                ahead, aside = c * dx + s * dy, c * dy - s * dx
                fade = max(1.0 - ahead / _BEAM_REACH_M, 0.0)
                if ahead > 0.5 and fade > 0.0:
                    angle = aside / ahead
                    strength = _BEAM_POWER / (ahead * ahead + _BEAM_SOFTENING_M2)
                    window[row, column] += strength * np.exp(-_BEAM_NARROW * angle * angle) * fade


def light_window(
    lamp_light: NDArray[np.float32], extent_m: float, position_m: NDArray[np.float64], vehicles: Sequence[VehicleState]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Lamp light and the vehicles' beams around the camera: ``(WINDOW, WINDOW)`` and its corner on the map."""
    corner = np.floor(position_m[:2]).astype(int) - WINDOW // 2
    from_map = corner + int(0.5 * extent_m)
    low, high = np.clip(from_map, 0, len(lamp_light)), np.clip(from_map + WINDOW, 0, len(lamp_light))
    part = lamp_light[low[1] : high[1], low[0] : high[0]]
    if part.shape == (WINDOW, WINDOW):
        window = part.copy()
    else:
        to = low - from_map
        window = np.zeros((WINDOW, WINDOW), np.float32)
        window[to[1] : to[1] + part.shape[0], to[0] : to[0] + part.shape[1]] = part
    beams = []
    for v in vehicles:
        c, s, nose = np.cos(v.yaw_rad), np.sin(v.yaw_rad), 0.5 * VEHICLE_KINDS[v.kind].length_m
        beams.append((v.x_m + c * nose, v.y_m + s * nose, c, s))
    _add_beams(window, corner.astype(np.float64), np.array(beams).reshape(-1, 4))
    return window, corner.astype(np.float64)


@compiled_unchecked
def _bright(radiance: Int64s, threshold: int, cells: Float32s) -> None:
    """Add the light above ``threshold`` of every second pixel in every second row to its cell."""
    for y in range(0, cells.shape[0] * _CELL, 2):
        for x in range(0, cells.shape[1] * _CELL, 2):
            word = radiance[y, x]
            for c in range(3):
                excess = (word >> 21 * c & _FIELD) - threshold
                if excess > 0:
                    cells[y // _CELL, x // _CELL, c] += _SAMPLED * excess


@inlined
def _between(cells: Float32s, i: int, j: int, channel: int, b: float) -> tuple[float, float]:
    """Value on the left of a cell at height ``b`` (0..1), and how much more there is on its right."""
    lower, upper = float32(b), float32(1.0 - b)
    left = cells[i, j, channel] * upper + cells[i + 1, j, channel] * lower
    return left, cells[i, j + 1, channel] * upper + cells[i + 1, j + 1, channel] * lower - left


@compiled_unchecked
def _add(radiance: Int64s, cells: Float32s) -> None:
    """Add ``cells`` (h, w, 3), given at the centres of the cells, to the picture; dark cells cost nothing.

    A field of 21 bits holds the sum: the scattered share of ``RADIANCE_TOP`` is small.
    """
    near, shift = float32(1.0 / _CELL), float32(0.5 / _CELL)
    height, width = radiance.shape
    rows, columns, _ = cells.shape
    half = _CELL // 2
    for i in range(rows - 1):
        for j in range(columns - 1):
            # The square between the centres of four cells; at the border it reaches to the edge of the picture.
            brightest = float32(0.0)
            for c in range(3):
                upper, lower = max(cells[i, j, c], cells[i, j + 1, c]), max(cells[i + 1, j, c], cells[i + 1, j + 1, c])
                brightest = max(brightest, max(upper, lower))
            if brightest < _FAINT:
                continue
            begin, end = 0 if j == 0 else j * _CELL + half, width if j == columns - 2 else (j + 1) * _CELL + half
            for y in range(0 if i == 0 else i * _CELL + half, height if i == rows - 2 else (i + 1) * _CELL + half):
                b = min(max((y + 0.5) / _CELL - 0.5 - i, 0.0), 1.0)
                r0, r1 = _between(cells, i, j, 0, b)
                g0, g1 = _between(cells, i, j, 1, b)
                b0, b1 = _between(cells, i, j, 2, b)
                row = radiance[y]
                for x in range(begin, end):
                    a = min(max(float32(x - j * _CELL - half) * near + shift, float32(0.0)), float32(1.0))
                    red, green, blue = np.int32(r0 + r1 * a), np.int32(g0 + g1 * a), np.int32(b0 + b1 * a)
                    row[x] += np.int64(red) | np.int64(green) << 21 | np.int64(blue) << 42


def add_glare(radiance: NDArray[np.int64], threshold: float, share: float) -> None:
    """Scatter ``share`` of the light above ``threshold`` (integer radiance) over the neighbourhood, in place."""
    height, width = radiance.shape
    cells = np.zeros((height // _CELL, width // _CELL, 3), np.float32)
    _bright(radiance, int(threshold), cells)
    cells *= share / _CELL**2
    # Most of it stays near (lens), the rest reaches far (air).
    halo = 0.6 * cv2.GaussianBlur(cells, (0, 0), 1.2) + 0.4 * cv2.GaussianBlur(cells, (0, 0), 5.0)
    _add(radiance, halo.astype(np.float32, copy=False))
