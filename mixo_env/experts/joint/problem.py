"""One step of a rig laid out for the kernel: the prior of all unknowns, and what a solution says about the step."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.joint.changes import Changes, with_changes
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.joint.headings import lean
from mixo_env.experts.joint.knots import knot_covariance, window_weights
from mixo_env.experts.joint.layout import Layout, Moment
from mixo_env.experts.joint.memory import Mountings, Rates
from mixo_env.experts.joint.solve import BODY, OWN, Solved, Views, solve_step

FloatArray = NDArray[np.float64]

_UNKNOWN_RATE_RADPS = 0.5
"""Standard deviation of the yaw rate before anything was seen."""

_MEAN_DEPTH, _SPREAD_DEPTH = 0.06, 0.06
"""[1/m] As in monocular/refine.py."""

_SLIP_PER_ACCELERATION = 0.006
"""rad per m/s^2, as in monocular/course.py."""

_SWAY_M = 0.004
"""A car that hardly rolls still sways on its springs."""

_SHORTEST_M = 1e-3

REACH = 1.6
"""Before the first knot the line through the first two goes on, for so many steps at most."""

_CONTRADICTION_STD = 3.0
"""A camera whose own yaw error is larger has no say at all."""

_DOUBT_STD = 2.0
"""The same where the turn is none that was expected: then the solution itself is in doubt."""

_DOUBT = 10.0
"""A camera that contradicted the last step may err by so many times as much: it must not take the rig along in this."""


class Answer(NamedTuple):
    """A solution and what it says about the step.

    Attributes:
        solved: of the kernel.
        yaw_rad: increment of the step with what it corrects of earlier ones.
        std_rad: its standard deviation; NaN without one.
    """

    solved: Solved
    yaw_rad: float
    std_rad: float


class Problem:
    """One step laid out for the kernel.

    Args:
        config: settings.
        moment: the step.
        layout: of its cameras.
        rates: what is known of the yaw rate; nothing: the pairs alone say where to start.
        mountings: what is known of the mountings.
        doubted: cameras that contradicted the last step.
        every: only every so manieth match: one third is enough for an estimate without memory, at a third of the cost.
    """

    def __init__(
        self,
        config: JointConfig,
        moment: Moment,
        layout: Layout,
        rates: Rates,
        mountings: Mountings,
        doubted: Collection[str] = (),
        every: int = 1,
    ) -> None:
        self.moment, self._config, self._rates, self._layout = moment, config, rates, layout
        self._own = (config.own_yaw_std_rad, config.own_yaw_share, config.freedom)
        self._mean, variance = np.zeros(BODY + OWN * len(moment.used)), np.ones(BODY + OWN * len(moment.used))
        self._rate_information = self._expect_rates()
        variance[3:BODY] = self._expect_body()
        alone = self._expect_cameras(mountings, variance)
        self._information = np.diag(1.0 / variance)
        self._information[:3, :3] = self._rate_information
        first = [seen.first[::every] for seen in moment.used.values()]
        second = [seen.second[::every] for seen in moment.used.values()]
        start = np.cumsum([0, *map(len, first)])
        doubt = np.array([_DOUBT if name in doubted else 1.0 for name in moment.used])
        self.views = Views(np.concatenate(first), np.concatenate(second), start, *layout[:5], alone, doubt)

    def _expect_rates(self) -> FloatArray:
        """Fill in the expected yaw rates; returns the information on them ``(3, 3)``."""
        knots, acceleration = self.moment.knots_s, self._config.yaw_acceleration_radps2
        if not self._rates.known:
            self._expected = self._mean[:3] = np.full(3, self.moment.start_radps())
            last = np.full((2, 2), _UNKNOWN_RATE_RADPS**2)
            last[1, 1] += (acceleration * knots[0]) ** 2
            self._knot_covariance, self._gain = knot_covariance(last, acceleration * knots[2]), np.zeros(3)
            return np.asarray(np.linalg.inv(self._knot_covariance), np.float64)
        self._expected = self._rates.mean[[0, 1, 1]]
        self._knot_covariance = knot_covariance(self._rates.covariance, acceleration * knots[2])
        information = np.asarray(np.linalg.inv(self._knot_covariance), np.float64)
        self._gain = information @ self._rates.with_heading[[0, 1, 1]]
        self._mean[:3], total = with_changes(self._expected, information, self._changes(), self._config.freedom)
        return total

    def _changes(self) -> Changes:
        """What three images of the cameras say, where the knots reach them."""
        moment, config = self.moment, self._config
        weights, yaw, std = [], [], []
        for row, seen in zip(self._layout.local, moment.used.values(), strict=True):
            if seen.change is None or (before_s := moment.since_s(seen.change.before_us)) < REACH * moment.knots_s[0]:
                continue
            weights.append(row[0, :3] - window_weights(before_s, moment.since_s(seen.start_us), moment.knots_s))
            yaw.append(seen.change.yaw_rad)
            std.append(math.hypot(config.change_std_rad, config.change_share * seen.change.std_rad))
        return Changes(np.reshape(weights, (-1, 3)), np.array(yaw), np.array(std))

    def _expect_body(self) -> list[float]:
        """Prior variances of pitch rate, roll rate, slip and heave; their means are 0."""
        config, sights = self._config, self.moment.used.values()
        way_m = sum(seen.distance_m for seen in sights)
        speed = way_m / float(self._layout.gap_s.sum())
        sway = _SWAY_M / max(abs(way_m) / len(sights), _SHORTEST_M)
        turning = _SLIP_PER_ACCELERATION * speed * float(self._mean[1])
        level = config.slip_std**2 + sway**2
        return [config.tilt_rate_std_radps**2, config.tilt_rate_std_radps**2, level + turning**2, level]

    def _expect_cameras(self, mountings: Mountings, variance: FloatArray) -> FloatArray:
        """Fill in means and variances of the cameras' own unknowns; returns ``alone`` of :class:`Views`."""
        expected = [mountings.expect(name) for name in self.moment.used]
        offset = np.array([of for _, of in expected])
        means, variances = self._mean[BODY:].reshape(-1, OWN), variance[BODY:].reshape(-1, OWN)
        means[:, 1:3], means[:, 3] = [mean for mean, _ in expected], _MEAN_DEPTH
        variances[:, 0], variances[:, 1:3], variances[:, 3] = np.inf, offset, _SPREAD_DEPTH**2
        alone = np.empty((len(expected), 6))
        gap_s, distance = self._layout.gap_s[:, None], self._layout.distance[:, None]
        alone[:, 0], alone[:, 5] = 1e-6, _SPREAD_DEPTH**-2
        alone[:, 1:3] = 1.0 / (gap_s**2 * variance[3:5])
        alone[:, 3:5] = 1.0 / (distance**2 * (variance[5:7] + offset))
        return alone

    def answer(self) -> Answer:
        """Solve, from the expected motion."""
        solved = solve_step(self.views, self._mean.copy(), self._mean, self._information, self._own)
        now, gain = self._now(), self._gain
        rates, covariance = solved.unknowns[:3], solved.covariance[:3, :3]
        yaw = float(now @ rates + gain @ (rates - self._expected))
        variance = float(now @ covariance @ now)
        variance += max(0.0, float(gain @ (self._knot_covariance - covariance) @ gain))
        return Answer(solved, yaw, math.sqrt(variance) if variance > 0.0 else math.nan)

    def accused(self, solved: Solved) -> frozenset[str]:
        """Cameras that contradict the solution, unless all do: a vehicle has captured them, or they see no motion.

        One camera may be so sure, a creeping car's for instance, that the solution is its own. Where most of the others
        contradict it, or half of them do and the turn is none that was expected, it is the one that is captured.
        """
        least, share, _ = self._own
        unexpected = self._unexpected(solved)
        limit = _DOUBT_STD if unexpected else _CONTRADICTION_STD
        used, against, unsupported = frozenset(self.moment.used), set(), set()
        for j, name in enumerate(self.moment.used):
            std = math.hypot(least, share * float(solved.formal[j]))
            if abs(float(solved.unknowns[BODY + OWN * j])) > limit * std:
                against.add(name)
            elif solved.support[j] < self._config.least_support:
                unsupported.add(name)
        half = 0.5 * (len(used) - len(unsupported))
        with_it = used - against - unsupported
        if with_it and (len(against) > half or (len(against) == half > 0 and unexpected)):
            return with_it
        found = frozenset(against | unsupported)
        return found if found != used else frozenset()

    def _unexpected(self, solved: Solved) -> bool:
        """The turn of the step is far from what earlier steps and three images let expect."""
        now = self._now()
        variance = now @ np.linalg.solve(self._rate_information, now)
        return bool(abs(now @ (solved.unknowns[:3] - self._mean[:3])) > _CONTRADICTION_STD * math.sqrt(variance))

    def lean(self, solved: Solved) -> tuple[float, float]:
        """What the cameras' own odometries add to the increment [rad], and the share that the rig keeps."""
        rates = solved.unknowns[:3]
        corrected = float(self._gain @ (rates - self._expected))
        seen = (self.views.local[:, 0, :3] @ rates + corrected).tolist()
        used = self.moment.used.values()
        told = [(one.told.yaw_rad - yaw, one.told.std_rad) for one, yaw in zip(used, seen, strict=True) if one.told]
        deviation, std = np.ascontiguousarray(np.reshape(told, (-1, 2)).T)
        return lean(deviation, std, self._config.freedom)

    def with_heading(self, solved: Solved) -> FloatArray:
        """Covariance ``(2,)`` of the rates at the last two knots with the heading that the increments add up to."""
        return ((self._now() + self._gain) @ solved.covariance[:3, :3])[1:]

    def _now(self) -> FloatArray:
        return np.array([0.0, 0.5, 0.5]) * self.moment.knots_s[2]
