"""How far the increment of the rig leans towards what the cameras' own odometries have reported.

The estimate of the rig and the headings of the single cameras come from the same matches, but err differently: one
holds all cameras to one motion of the body, the others remember three images and a course of their own, and use more
matches. Half of each is better than either. The cameras have a common say by their standard deviations, with heavy
tails: one that a vehicle has captured is hardly heard.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled

FloatArray = NDArray[np.float64]

_ITERATIONS = 10


@compiled
def lean(deviation_rad: FloatArray, std_rad: FloatArray, freedom: float) -> tuple[float, float]:
    """Student-t mean of deviations from the rig, in which the rig has the weight of all cameras that agree with it.

    Args:
        deviation_rad: ``(n,)`` increment that a camera has reported less that of the rig over the same time.
        std_rad: ``(n,)``, positive.
        freedom: degrees of freedom of the errors.

    Returns:
        What is to be added to the increment of the rig [rad], and the share of the weight that the rig keeps; 0 and 1
        without cameras.
    """
    if not len(deviation_rad):
        return 0.0, 1.0
    rig, mean, share = float(np.sum(std_rad**-2.0)), 0.0, 1.0
    for _ in range(_ITERATIONS):
        total, pull = rig, 0.0
        for i in range(len(deviation_rad)):
            deviation, std = deviation_rad[i], std_rad[i]
            weight = (freedom + 1.0) / (freedom + ((deviation - mean) / std) ** 2) / std**2
            total += weight
            pull += weight * deviation
        mean, share = pull / total, rig / total
    return mean, share
