"""Course of a camera against the heading of its car: slow means of slip and heave, learnt while driving.

Two images of a side view hardly tell a turn from a sideways motion. But a car moves sideways in a regular way: course
and heading differ by an angle that is nearly constant over minutes (wheel alignment, error of the written mounting),
and so does the direction of travel from the written horizon. The mean share is followed by a scalar Kalman filter with
exponential forgetting; its prediction replaces the wide prior of a pair alone. It is learnt from the images and the
distances, never from a yaw rate.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mixo_env.experts.monocular.motion import Motion, MotionPrior

_SLOWEST_M = 0.2  # shorter ways between two images say nothing about a direction
_SLIP_PER_ACCELERATION = 0.006  # rad per m/s^2: tyres under side force roll at an angle to the way
_ALIKE_IN_TURNS = 3.0  # pairs of one turn err alike: the mean takes them as so many times less certain than one is
_FORGET = 0.98  # weight that the past keeps from one pair to the next: a memory of about 4 s
_FARTHEST = 3.0  # standard deviations; a pair that is further off is a mistake of its own


class _SlowMean:
    """A share of the distance that changes slowly.

    Args:
        start_std: standard deviation before anything was seen.
    """

    def __init__(self, start_std: float) -> None:
        self._least_weight = 1.0 / start_std**2
        self.mean, self._weight = 0.0, self._least_weight

    @property
    def variance(self) -> float:
        """Variance of the mean."""
        return 1.0 / self._weight

    def learn(self, value: float, variance: float) -> None:
        """Take a measured share and the variance it has around the mean."""
        self._weight = max(_FORGET * self._weight, self._least_weight)
        if abs(value - self.mean) > _FARTHEST * math.sqrt(variance + self.variance):
            return
        self.mean += (value - self.mean) / (1.0 + self._weight * variance)
        self._weight += 1.0 / variance


class Course:
    """Expectation of slip and heave of the next pair of images of one camera.

    Args:
        start_std: standard deviation of the mean shares before anything was seen.
        spread: standard deviation of the share of one pair around the mean.
    """

    def __init__(self, start_std: float, spread: float) -> None:
        self._slip, self._heave, self._spread = _SlowMean(start_std), _SlowMean(start_std), spread

    def expect(self, prior: MotionPrior, sideways_mps2: float) -> MotionPrior:
        """The prior of a pair with what was learnt about slip and heave.

        Args:
            prior: of the pair alone.
            sideways_mps2: acceleration to the side: in a turn the course is less certain.
        """
        stds = [
            math.hypot(spread, math.sqrt(mean.variance))
            for mean, spread in zip((self._slip, self._heave), self._spreads(sideways_mps2), strict=True)
        ]
        return replace(
            prior, slip_mean=self._slip.mean, slip_std=stds[0], heave_mean=self._heave.mean, heave_std=stds[1]
        )

    def _spreads(self, sideways_mps2: float) -> tuple[float, float]:
        """Standard deviations of the shares of one pair, slip and heave, around their means."""
        return math.hypot(self._spread, _SLIP_PER_ACCELERATION * sideways_mps2), self._spread

    def learn(self, motion: Motion, prior: MotionPrior, sideways_mps2: float) -> None:
        """Take slip and heave of a pair, freed of the prior that went into them.

        Args:
            motion: solution of the pair.
            prior: the one it was solved with.
            sideways_mps2: as above.
        """
        distance = prior.distance_m
        if abs(distance) < _SLOWEST_M:
            return
        solved = ((motion.slip_m, motion.slip_std_m), (motion.heave_m, motion.heave_std_m))
        for follower, (value, std), mean, prior_std, spread in zip(
            (self._slip, self._heave),
            solved,
            *prior.offset(),
            self._spreads(_ALIKE_IN_TURNS * sideways_mps2),
            strict=True,
        ):
            information = 1.0 / std**2 - 1.0 / prior_std**2
            if information <= 1e-6 / prior_std**2:
                continue
            seen = (value / std**2 - mean / prior_std**2) / information
            follower.learn(float(seen) / distance, 1.0 / (information * distance**2) + spread**2)
