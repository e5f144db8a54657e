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

from mixo_env.compiled import compiled

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


@compiled
def with_changes(
    mean: FloatArray, information: FloatArray, changes: Changes, freedom: float
) -> tuple[FloatArray, FloatArray]:
    """Three rates and the information on them once changes are known.

    Args:
        mean: ``(3,)`` expected rates.
        information: ``(3, 3)`` on them.
        changes: any number; none leaves everything as it is.
        freedom: of the Student-t distribution of their errors.
    """
    rates, total = mean.copy(), information.copy()
    if not len(changes.yaw_rad):
        return rates, total
    for wide in _WIDENINGS:
        total[:], pull = information, information @ mean
        for i in range(len(changes.yaw_rad)):
            weights, yaw, std = changes.weights[i], changes.yaw_rad[i], wide * changes.std_rad[i]
            precision = (freedom + 1.0) / (freedom + ((yaw - np.sum(weights * rates)) / std) ** 2) / std**2
            for j in range(3):
                pull[j] += precision * yaw * weights[j]
                for k in range(3):
                    total[j, k] += precision * weights[j] * weights[k]
        rates = np.linalg.solve(total, pull).astype(np.float64)
    return rates, total
