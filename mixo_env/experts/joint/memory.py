"""What a joint odometry remembers from step to step."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.joint.config import JointConfig

FloatArray = NDArray[np.float64]

_FORGET = 0.98  # weight that the past keeps from one step to the next, as in monocular/course.py


class Mountings:
    """Slow means of slip and heave of every camera against the body: the errors of their written mountings.

    A camera whose offset is certain to exceed ``misplaced_rad`` for ``misplaced_steps`` in a row is misplaced from then
    on: a mounting does not heal during a drive.

    Args:
        cameras: their names.
        config: settings.
    """

    def __init__(self, cameras: Iterable[str], config: JointConfig) -> None:
        self._config = config
        self._mean = {name: np.zeros(2) for name in cameras}
        self._variance = {name: np.full(2, config.mounting_std**2) for name in self._mean}
        self._suspected = dict.fromkeys(self._mean, 0)

    @property
    def misplaced(self) -> tuple[str, ...]:
        """Cameras whose written mounting is wrong."""
        return tuple(name for name, steps in self._suspected.items() if steps >= self._config.misplaced_steps)

    def expect(self, camera: str) -> tuple[FloatArray, FloatArray]:
        """Mean and variance of slip and heave share of a camera, ``(2,)`` each."""
        return self._mean[camera], self._variance[camera]

    def learn(self, camera: str, mean: FloatArray, variance: FloatArray) -> None:
        """Take what a step has found, the prior included."""
        self._mean[camera] = mean.copy()
        self._variance[camera] = np.minimum(variance / _FORGET, self._config.mounting_std**2)
        beyond = bool((np.abs(mean) > self._config.misplaced_rad).any())
        self._suspected[camera] = self._suspected[camera] + 1 if beyond else 0


class Rates:
    """The yaw rate at the last two knots and the heading reported so far; unknown before the first step and at a loss.

    The sum of the reported increments has an error that goes along with that of the rates. What a later step finds out
    about the rates therefore tells something about the heading, and is made up for (as in monocular/heading.py).
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Nothing carries over."""
        self.known, self.mean, self.covariance = False, np.zeros(2), np.full((2, 2), math.nan)
        self.with_heading = np.zeros(2)

    def learn(self, mean: FloatArray, covariance: FloatArray, with_heading: FloatArray) -> None:
        """Take the rates at the last two knots of a step.

        Args:
            mean: ``(2,)``.
            covariance: ``(2, 2)`` of their errors.
            with_heading: ``(2,)`` covariance with the error of the sum of the reported increments.
        """
        self.known, self.mean, self.covariance = True, mean.copy(), covariance.copy()
        self.with_heading = with_heading.copy()
