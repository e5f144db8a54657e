"""What moves while the shutter is open, and how the exposure control follows the light."""

from __future__ import annotations

import math

import numpy as np

from mixo_env.compiled import compiled_unchecked
from mixo_env.simulator.picture.fleet import body_motions
from mixo_env.simulator.picture.views import Float64s

EXPOSURE_S = 0.3
"""Time constant of the exposure control: a quarter of the way from one image to the next, at 12 images a second."""


def adapted_gain(used: float, wanted: float, elapsed_s: float) -> float:
    """Gain ``elapsed_s`` after a picture taken with ``used`` for which the control wanted another one.

    The control is a low pass of first order, as in most cameras, so that it does not hunt: pictures are too dark for
    some tenths of a second where the light goes away, and too bright where it comes back.
    """
    return wanted + (used - wanted) * math.exp(-elapsed_s / EXPOSURE_S)


@compiled_unchecked
def _product(first: Float64s, second: Float64s) -> Float64s:
    """Matrix product, without the linear-algebra library that Numba's own one needs."""
    out = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                out[i, j] += first[i, k] * second[k, j]
    return out


@compiled_unchecked
def during_exposure(
    start: Float64s, start_m: Float64s, end: Float64s, end_m: Float64s, states: Float64s, half_s: float
) -> tuple[Float64s, Float64s, Float64s]:
    """The camera at the middle of the exposure, and how everything moves before it in the second half.

    Args:
        start: ``(3, 3)`` map from camera when the shutter opens.
        start_m: ``(3,)`` where.
        end: when it closes.
        end_m: where.
        states: of ``moving_states``, at the middle.
        half_s: half the exposure time.

    Returns:
        Camera from map ``(3, 3)``, position ``(3,)``, and ``(1 + vehicles, 12)`` rigid motions in camera coordinates,
        rotations by rows and translations.
    """
    # The camera turns evenly: half the angle about the axis of the whole turn (Rodrigues; compiled, so not geometry's).
    turn = _product(start.T, end)
    axis = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = np.sqrt(np.sum(axis * axis))
    angle = 0.5 * np.arctan2(sine, 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0))
    x, y, z = axis * (np.sin(angle) / sine) if sine > 0.0 else axis
    c, rest = np.cos(angle), 1.0 / (1.0 + np.cos(angle))  # (1 - cos) / sin^2
    half = np.array(
        [
            [c + rest * x * x, rest * x * y - z, rest * x * z + y],
            [rest * x * y + z, c + rest * y * y, rest * y * z - x],
            [rest * x * z - y, rest * y * z + x, c + rest * z * z],
        ]
    )
    middle, position = _product(start, half), 0.5 * (start_m + end_m)
    # Camera at the middle -> map, the body's own motion, map -> camera at the end.
    turns, shifts = body_motions(states, half_s)
    motions = np.empty((len(turns), 12))
    for n in range(len(turns)):
        motions[n, :9] = _product(_product(end.T, turns[n]), middle).ravel()
        for i in range(3):
            total = 0.0
            for j in range(3):
                moved = shifts[n, j] - end_m[j]
                for k in range(3):
                    moved += turns[n, j, k] * position[k]
                total += end[j, i] * moved
            motions[n, 9 + i] = total
    return np.ascontiguousarray(middle.T), position, motions
