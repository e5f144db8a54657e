"""Mini-roundabouts: some crossings have a round island in the middle, which everybody leaves on the left.

The streets stay as they are: the island is small enough for the crossing of two of them (inscribed circle 18.6 m from
corner to corner; Department for Transport, "Mini roundabouts: good practice guidance", 2006, asks for at most 28 m and
an island of up to 4 m across). Who goes straight on swerves to the right around it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.city.streets import HALF_CITY_BLOCKS, LANE_M

FloatArray = NDArray[np.float64]
Crossing = tuple[int, int]
"""Numbers of the streets along y and along x that meet: the place (i, j) * BLOCK_M on the street grid."""

ISLAND_M = 2.0
"""Radius of the island."""

SHARE = 0.09
"""Of all crossings."""

PASSING_M = 4.3
"""Who goes straight on passes the island's middle at this distance ..."""

REACH_M = 17.0
"""... and swerves from so far before it to so far behind."""

CALM_MPS = 4.5
"""Nobody on a street with a roundabout in sight drives faster: 2 m/s^2 aside in the swerve."""


def roundabouts_of(seed: int) -> frozenset[Crossing]:
    """The crossings of one city that have an island."""
    numbers = np.arange(-HALF_CITY_BLOCKS, HALF_CITY_BLOCKS + 1)
    chosen = np.random.default_rng([seed, 8]).random((len(numbers), len(numbers))) < SHARE
    return frozenset((int(numbers[i]), int(numbers[j])) for i, j in np.argwhere(chosen))


def swerve(from_middle_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far right of the lane a vehicle is that passes straight on, and the slope of that.

    Args:
        from_middle_m: way along the street behind (before, if negative) the middle of the crossing.

    Returns:
        Metres to the right of the middle of the lane, at most ``PASSING_M - LANE_M``, and their derivative; curvature
        is at most 1 / 14 m and has no jump.
    """
    part = np.clip(from_middle_m / REACH_M, -1.0, 1.0)
    rest = 1.0 - part * part
    aside_m = PASSING_M - LANE_M
    return aside_m * rest**4, -8.0 * aside_m / REACH_M * part * rest**3


def _extra_m() -> float:
    way = np.linspace(-REACH_M, REACH_M, 1001)
    return float(np.mean(1.0 - np.cos(swerve(way)[1])) * 2.0 * REACH_M)


EXTRA_M = _extra_m()
"""What the swerve is longer than the straight way."""
