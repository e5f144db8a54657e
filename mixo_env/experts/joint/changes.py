"""What three images of each camera say about the yaw rates: how much more or less the car turns than in the last step.

A pair of images tells its own turn across the epipolar lines only; a third image tells the change of the turn along
them as well, several times better (monocular/bundle.py). With the rate linear between the knots every change is a
linear function of the three rates, like a turn (knots.py). A camera whose view is full of traffic may be told a wrong
change, so the errors have heavy tails here too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_WIDENINGS = (8.0, 4.0, 2.0, 1.0, 1.0, 1.0)
"""Standard deviations are taken so many times as large at first: the expected rates are far from where changes lead."""


class Changes(NamedTuple):
    """Changes of yaw increments of some cameras.

    Attributes:
        weights: ``(n, 3)`` of the rates in each [s].
        yaw_rad: ``(n,)``.
        std_rad: ``(n,)``.
    """

    weights: FloatArray
    yaw_rad: FloatArray
    std_rad: FloatArray


def with_changes(
    mean: FloatArray, covariance: FloatArray, changes: Changes, freedom: float
) -> tuple[FloatArray, FloatArray]:
    """Three rates and their covariance once changes are known.

    Args:
        mean: ``(3,)`` expected rates.
        covariance: ``(3, 3)`` of them.
        changes: any number; none leaves everything as it is.
        freedom: of the Student-t distribution of their errors.
    """
    if not len(changes.yaw_rad):
        return mean, covariance
    rates, information = mean, np.linalg.inv(covariance)
    total = information
    for wide in _WIDENINGS:
        std = wide * changes.std_rad
        error = (changes.yaw_rad - changes.weights @ rates) / std
        weighted = changes.weights.T * ((freedom + 1.0) / (freedom + error**2) / std**2)
        total = information + weighted @ changes.weights
        rates = np.asarray(np.linalg.solve(total, information @ mean + weighted @ changes.yaw_rad), np.float64)
    return rates, np.asarray(np.linalg.inv(total), np.float64)
