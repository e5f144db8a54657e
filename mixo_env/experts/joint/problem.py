"""One step of a rig laid out for the kernel: the prior, and each camera's own unknowns from those of the body."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.joint.changes import Changes, with_changes
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.joint.headings import lean
from mixo_env.experts.joint.knots import knot_covariance, window_weights
from mixo_env.experts.joint.memory import Mountings, Rates
from mixo_env.experts.joint.sight import Sight
from mixo_env.experts.joint.solve import BODY, OWN, Solved, Views, solve_step
from mixo_env.experts.monocular.camera import MountedCamera
from mixo_env.experts.monocular.kinematics import never_zero

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

_INLIER_STD = 3.0
"""As in monocular/motion.py."""


@dataclass(frozen=True)
class Moment:
    """When a step is, and what sees it.

    Attributes:
        knots_s: the beginning of the last step (negative), of this one (0) and its end [s].
        origin_us: the time of the middle one.
        used: the cameras that have a say.
    """

    knots_s: tuple[float, float, float]
    origin_us: int
    used: Mapping[str, Sight]

    def start_radps(self) -> float:
        """Median yaw rate of the pairs alone; 0 where none tells."""
        seen = [sight.yaw_rad / (1e-6 * (sight.end_us - sight.start_us)) for sight in self.used.values()]
        told = [rate for rate in seen if math.isfinite(rate)]
        return float(np.median(told)) if told else 0.0


def thinned(moment: Moment) -> Moment:
    """The same with every third match: enough for an estimate without memory, at a third of the cost."""
    few = {
        name: replace(seen, first=np.ascontiguousarray(seen.first[::3]), second=np.ascontiguousarray(seen.second[::3]))
        for name, seen in moment.used.items()
    }
    return replace(moment, used=few)


class Problem:
    """One step laid out for the kernel.

    Args:
        config: settings.
        cameras: of the rig.
        moment: the step.
        rates: what is known of the yaw rate; nothing: the pairs alone say where to start.
        mountings: what is known of the mountings.
    """

    def __init__(
        self,
        config: JointConfig,
        cameras: Mapping[str, MountedCamera],
        moment: Moment,
        rates: Rates,
        mountings: Mountings,
    ) -> None:
        self.moment, self._config, self._rates, self._mountings = moment, config, rates, mountings
        self._positions = {name: cameras[name].position_m for name in moment.used}
        self._own = (config.own_yaw_std_rad, config.own_yaw_share, config.freedom)
        count = BODY + OWN * len(moment.used)
        self._mean, self._information = np.zeros(count), np.zeros((count, count))
        self._knot_covariance = self._expect_rates()
        body_std = self._expect_body()
        local, alone = self._cameras(body_std)
        sights, mounted = list(moment.used.values()), [cameras[name] for name in moment.used]
        self.views = Views(
            np.concatenate([seen.first for seen in sights]),
            np.concatenate([seen.second for seen in sights]),
            np.cumsum([0, *(len(seen.first) for seen in sights)]),
            np.array([camera.rotation for camera in mounted]),
            np.array([camera.position_m for camera in mounted]),
            np.array([never_zero(seen.distance_m) for seen in sights]),
            np.array([seen.noise for seen in sights]),
            local,
            alone,
        )

    def _expect_rates(self) -> FloatArray:
        """Fill in the prior of the yaw rates; returns their covariance ``(3, 3)`` without the changes."""
        knots, acceleration = self.moment.knots_s, self._config.yaw_acceleration_radps2
        if self._rates.known:
            self._expected = self._rates.mean[[0, 1, 1]]
            last = self._rates.covariance
        else:
            self._expected = np.full(3, self.moment.start_radps())
            last = np.full((2, 2), _UNKNOWN_RATE_RADPS**2)
            last[1, 1] += (acceleration * knots[0]) ** 2
        covariance = knot_covariance(last, acceleration * knots[2])
        mean, known = self._expected, covariance
        if self._rates.known:
            mean, known = with_changes(mean, covariance, self._changes(), self._config.freedom)
        self._mean[:3], self._information[:3, :3] = mean, np.linalg.inv(known)
        return covariance

    def _changes(self) -> Changes:
        """What three images of the cameras say, where the knots reach them."""
        knots, config = self.moment.knots_s, self._config
        weights, yaw, std = [], [], []
        for seen in self.moment.used.values():
            if seen.change is None:
                continue
            before_s, start_s, end_s = (
                1e-6 * (time_us - self.moment.origin_us)
                for time_us in (seen.change.before_us, seen.start_us, seen.end_us)
            )
            if before_s < REACH * knots[0]:
                continue
            weights.append(window_weights(start_s, end_s, knots) - window_weights(before_s, start_s, knots))
            yaw.append(seen.change.yaw_rad)
            std.append(math.hypot(config.change_std_rad, config.change_share * seen.change.std_rad))
        return Changes(np.reshape(weights, (-1, 3)), np.array(yaw), np.array(std))

    def _expect_body(self) -> FloatArray:
        """Fill in the prior of pitch rate, roll rate, slip and heave; returns its standard deviations ``(4,)``."""
        config, sights = self._config, self.moment.used.values()
        way_m = sum(seen.distance_m for seen in sights)
        speed = way_m / sum(1e-6 * (seen.end_us - seen.start_us) for seen in sights)
        sway = _SWAY_M / max(abs(way_m) / len(sights), _SHORTEST_M)
        turning = _SLIP_PER_ACCELERATION * speed * self._mean[1]
        slip, heave = math.hypot(config.slip_std, turning, sway), math.hypot(config.slip_std, sway)
        std = np.array([config.tilt_rate_std_radps, config.tilt_rate_std_radps, slip, heave])
        body = np.arange(3, BODY)
        self._information[body, body] = std**-2.0
        return std

    def _cameras(self, body_std: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Fill in the priors of the cameras; returns ``local`` and ``alone`` of :class:`Views`."""
        used = self.moment.used
        local, alone = np.zeros((len(used), 6, len(self._mean))), np.zeros((len(used), 6))
        for j, (name, seen) in enumerate(used.items()):
            own = BODY + OWN * j
            slip, heave, depth = own + 1, own + 2, own + 3
            mean, variance = self._mountings.expect(name)
            self._mean[slip], self._mean[heave], self._mean[depth] = *mean, _MEAN_DEPTH
            of = np.array([slip, heave, depth])
            self._information[of, of] = [*(1.0 / variance), _SPREAD_DEPTH**-2]
            gap_s, distance = 1e-6 * (seen.end_us - seen.start_us), never_zero(seen.distance_m)
            start_s, end_s = (1e-6 * (time_us - self.moment.origin_us) for time_us in (seen.start_us, seen.end_us))
            local[j, 0, :3] = window_weights(start_s, end_s, self.moment.knots_s)
            local[j, 0, own] = 1.0
            local[j, 1, 3] = local[j, 2, 4] = gap_s
            local[j, 3, [5, slip]] = local[j, 4, [6, heave]] = distance
            x, y, z = gap_s * self._positions[name]  # a tilt of the body also swings the camera
            local[j, 3, 4], local[j, 4, 4], local[j, 4, 3] = -z, y, -x
            local[j, 5, depth] = 1.0
            offset = distance**2 * (body_std[2:] ** 2 + variance)
            alone[j] = [1e-6, *(gap_s * body_std[:2]) ** -2.0, *(1.0 / offset), _SPREAD_DEPTH**-2]
        return local, alone

    def solve(self) -> Solved:
        """From the expected motion."""
        return solve_step(self.views, self._mean.copy(), self._mean, self._information, self._own)

    def agree(self, solved: Solved) -> NDArray[np.bool_]:
        """``(n,)`` matches that agree with a solution."""
        noise = np.repeat(solved.noise, np.diff(self.views.start))
        return np.abs(solved.residual) < _INLIER_STD * noise

    def accused(self, solved: Solved) -> frozenset[str]:
        """Cameras that contradict the solution, unless all do: a vehicle has captured them, or they see no motion.

        One camera may be so sure, a creeping car's for instance, that the solution is its own. Where most of the others
        contradict it, or half of them do and the turn is none that was expected, it is the one that is captured.
        """
        least, share, _ = self._own
        agree, start = self.agree(solved), self.views.start
        unexpected = self._unexpected(solved)
        limit = _DOUBT_STD if unexpected else _CONTRADICTION_STD
        used, against, unsupported = frozenset(self.moment.used), set(), set()
        for j, name in enumerate(self.moment.used):
            std = math.hypot(least, share * float(solved.formal[j]))
            if abs(float(solved.unknowns[BODY + OWN * j])) > limit * std:
                against.add(name)
            elif float(np.mean(agree[start[j] : start[j + 1]])) < self._config.least_support:
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
        variance = now @ np.linalg.solve(self._information[:3, :3], now)
        return bool(abs(now @ (solved.unknowns[:3] - self._mean[:3])) > _CONTRADICTION_STD * math.sqrt(variance))

    def increment(self, solved: Solved) -> tuple[float, float]:
        """Yaw increment of the step with what it corrects of earlier ones, and its standard deviation [rad]."""
        now, gain = self._now(), self._gain()
        rates, covariance = solved.unknowns[:3], solved.covariance[:3, :3]
        yaw = float(now @ rates + gain @ (rates - self._expected))
        variance = float(now @ covariance @ now)
        variance += max(0.0, float(gain @ (self._knot_covariance - covariance) @ gain))
        return yaw, math.sqrt(variance) if variance > 0.0 else math.nan

    def lean(self, solved: Solved) -> tuple[float, float]:
        """What the cameras' own odometries add to the increment [rad], and the share that the rig keeps."""
        gain, used = self._gain(), self.moment.used.values()
        corrected = float(gain @ (solved.unknowns[:3] - self._expected))
        seen = self.views.local[:, 0, :3] @ solved.unknowns[:3] + corrected
        told = [(one.told.yaw_rad - yaw, one.told.std_rad) for one, yaw in zip(used, seen, strict=True) if one.told]
        deviation, std = np.reshape(told, (-1, 2)).T
        return lean(deviation, std, self._config.freedom)

    def with_heading(self, solved: Solved) -> FloatArray:
        """Covariance ``(2,)`` of the rates at the last two knots with the heading that the increments add up to."""
        return ((self._now() + self._gain()) @ solved.covariance[:3, :3])[1:]

    def _now(self) -> FloatArray:
        return np.array([0.0, 0.5, 0.5]) * self.moment.knots_s[2]

    def _gain(self) -> FloatArray:
        """``(3,)`` how much of an error of the expected rates the heading has."""
        return np.asarray(np.linalg.solve(self._knot_covariance, self._rates.with_heading[[0, 1, 1]]), np.float64)
