"""The yaw rate of the car as a polygon over three closing times, and its integral over any image window.

Cameras fire one after another, and an increment over a step is not what any of them sees. With the rate linear
between the knots, what a camera sees is a linear function of the three rates, so the stagger costs no approximation
but that of the polygon.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def window_weights(start_s: float, end_s: float, knots_s: tuple[float, float, float]) -> FloatArray:
    """Weights ``(3,)`` [s] of the rates at the knots in the integral over a window.

    Args:
        start_s: of the window; before the first knot its line goes on.
        end_s: of the window, not after the last knot.
        knots_s: increasing times.
    """
    middle = knots_s[1]
    weights = np.zeros(3)
    for k, low, high in ((0, start_s, min(end_s, middle)), (1, max(start_s, middle), end_s)):
        if high > low:
            share = (0.5 * (low + high) - knots_s[k]) / (knots_s[k + 1] - knots_s[k])
            weights[k] += (high - low) * (1.0 - share)
            weights[k + 1] += (high - low) * share
    return weights


def knot_covariance(last: FloatArray, change_std: float) -> FloatArray:
    """Covariance ``(3, 3)`` of three rates: two that are known, and a third that starts from the second.

    Args:
        last: ``(2, 2)`` of the first two.
        change_std: standard deviation of the change to the third.
    """
    copy = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    covariance = copy @ last @ copy.T
    covariance[2, 2] += change_std**2
    return covariance + 1e-12 * np.eye(3)  # rates that were known exactly would make the equations singular
