"""Turning of the car as its camera saw it last: a car cannot change its yaw rate at will.

Two images of a side view may be ruled by one vehicle that drives past; what follows from it would need a yaw
acceleration that no car reaches. The yaw rate of the last good pair, less certain the older it is, is the expectation
for the next one. It comes from the images alone, never from a yaw-rate sensor.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mixo_env.experts.monocular.motion import Motion, MotionPrior


class Turn:
    """Expectation of the yaw increment of the next pair of images of one camera.

    Args:
        acceleration_radps2: standard deviation of the yaw acceleration.
    """

    def __init__(self, acceleration_radps2: float) -> None:
        self._acceleration = acceleration_radps2
        self._rate, self._std, self._time_us = 0.0, math.inf, 0

    def expect(self, prior: MotionPrior, timestamp_us: int, gap_s: float) -> MotionPrior:
        """The prior of a pair with what was learnt about the yaw rate.

        Args:
            prior: of the pair alone.
            timestamp_us: of its second image.
            gap_s: time between its images.
        """
        age_s = 1e-6 * (timestamp_us - self._time_us)
        std = math.hypot(self._std, self._acceleration * age_s)
        return replace(prior, yaw_mean_rad=self._rate * gap_s, yaw_std_rad=std * gap_s)

    def learn(self, motion: Motion, timestamp_us: int, gap_s: float) -> None:
        """Take the motion of a pair; arguments as above."""
        self._rate, self._std, self._time_us = motion.yaw_rad / gap_s, motion.yaw_std_rad / gap_s, timestamp_us
