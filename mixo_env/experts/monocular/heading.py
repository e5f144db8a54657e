"""The heading that is reported: what later images say about earlier pairs is added to the next increment.

Two sources tell how the car turns. Each pair of images measures its own yaw increment; three images measure how much
the next increment differs from the last, and more exactly (bundle.py). A Kalman filter over the last increment and the
heading still *owed* joins them. Where views are good the sum of the increments is that of the pairs. Where a view is
poor or full of traffic the pairs say little, the changes carry the turn on, and when good pairs follow, what was
reported too much or too little meanwhile is made up for. Without the owed part the errors of the changes would add up
in the heading, since each lives on in all increments that follow.
"""

from __future__ import annotations

import math

from mixo_env.experts.monocular.motion import Motion


class Heading:
    """Filter of the yaw increments of one camera.

    Args:
        acceleration_radps2: standard deviation of the yaw acceleration.
    """

    def __init__(self, acceleration_radps2: float) -> None:
        self._acceleration = acceleration_radps2
        self.forget()

    def forget(self) -> None:
        """The camera is lost: nothing carries over."""
        self._gap_s = math.nan
        self._yaw = self._variance = self._covariance = 0.0

    def report(
        self, motion: Motion, change: tuple[float, float] | None, gap_s: float, *, tracking: bool
    ) -> tuple[float, float]:
        """Take the next pair.

        Args:
            motion: of the pair alone.
            change: its yaw increment less the last one as three images show it, and the standard deviation of that
                [rad]; ``None`` where they do not.
            gap_s: time between its images.
            tracking: the increment is reported; others need no making up for.

        Returns:
            Yaw increment to report and its standard deviation [rad].
        """
        measured = motion.yaw_std_rad**2
        if math.isnan(self._gap_s):
            self._yaw, self._variance, owed, report_variance = motion.yaw_rad, measured, 0.0, measured
        else:
            carried, spread = self._yaw * (gap_s / self._gap_s - 1.0), (self._acceleration * gap_s**2) ** 2
            if change is not None:
                share = spread / (spread + change[1] ** 2)
                carried, spread = carried + share * (change[0] - carried), share * change[1] ** 2
            expected, variance = self._yaw + carried, self._variance + spread
            innovation, total = motion.yaw_rad - expected, variance + measured
            self._yaw = expected + variance / total * innovation
            self._variance = variance * measured / total
            owed = self._covariance / total * innovation
            report_variance = self._variance + self._covariance**2 / total
            self._covariance *= measured / total
        self._gap_s = gap_s
        # the error of the heading grows by that of this increment
        self._covariance = self._covariance + self._variance if tracking else 0.0
        return self._yaw + owed, math.sqrt(report_variance)
