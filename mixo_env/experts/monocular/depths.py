"""A pair of images as the kernels see it: matches, mounting, and how near or far their points may be."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled

FloatArray = NDArray[np.float64]

MAX_INVERSE_DEPTH = 0.7
"""[1/m] Nothing but the car itself is nearer than 1.4 m: cameras sit on the roof, some 1.5 m above the road."""

_SLOPE = math.tan(math.radians(2.0))
"""The road may fall away, and the car nod, by so much against the written mounting ..."""

_DIP_M = 0.3
"""... and by this (kerbs, dips): nothing is seen below that."""


class Mounting(NamedTuple):
    """Where a camera sits: ``(3, 3)`` rotation ego from camera, ``(3,)`` position in the ego frame [m]."""

    rotation: FloatArray
    position: FloatArray


class Matches(NamedTuple):
    """The same points on two image planes of unit focal length, ``(n, 2)`` each: x right, y down."""

    first: FloatArray
    second: FloatArray


@compiled
def _least_inverse_depth(u: float, v: float, mounting: Mounting) -> float:
    """Inverse depth [1/m] of the road where the ray (u, v, 1) meets it, 0 above the horizon: nothing lies behind it.

    It unmasks vehicles that move along with the car: their lower half would have to be under the road.
    """
    rotation = mounting.rotation
    x = rotation[0, 0] * u + rotation[0, 1] * v + rotation[0, 2]
    y = rotation[1, 0] * u + rotation[1, 1] * v + rotation[1, 2]
    z = rotation[2, 0] * u + rotation[2, 1] * v + rotation[2, 2]
    return max(0.0, -z - _SLOPE * math.sqrt(x * x + y * y)) / (mounting.position[2] + _DIP_M)


@compiled
def least_inverse_depths(second: FloatArray, mounting: Mounting) -> FloatArray:
    """Least inverse depth [1/m] ``(n,)`` of points ``(n, 2)`` on the second image plane."""
    least = np.empty(len(second))
    for i in range(len(second)):
        least[i] = _least_inverse_depth(second[i, 0], second[i, 1], mounting)
    return least
