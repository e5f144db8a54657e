"""Tightly coupled odometry: one motion of the body from the matches of all cameras, step by step.

What single cameras estimate one by one and a policy then fuses is one estimate here. Every camera keeps its own image
times (knots.py), an error of its own yaw with heavy tails, so that one that a vehicle has captured loses its say, and
an offset of its mounting, learnt slowly (memory.py). Features and matches are those of the single cameras.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError, unknown
from mixo_env.experts.expert import State
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.joint.knots import knot_covariance, window_weights
from mixo_env.experts.joint.memory import Mountings, Rates
from mixo_env.experts.joint.sight import JointStep, Sight
from mixo_env.experts.joint.solve import BODY, OWN, Solved, Views, solve_step
from mixo_env.experts.monocular.camera import MountedCamera
from mixo_env.experts.monocular.kinematics import never_zero

FloatArray = NDArray[np.float64]

_UNKNOWN_RATE_RADPS = 0.5  # standard deviation before anything was seen
_MEAN_DEPTH, _SPREAD_DEPTH = 0.06, 0.06  # [1/m], as in monocular/refine.py
_SLIP_PER_ACCELERATION = 0.006  # rad per m/s^2, as in monocular/course.py
_FLOOR_M = 0.004  # a car that hardly rolls still sways on its springs
_FEWEST = 8
_INLIER_STD = 3.0


class JointOdometry:
    """Yaw odometry of a rig over one scene.

    States as those of a single camera: INITIALISING until ``initial_steps`` good steps came in a row, TRACKING while
    steps stay good, LOST on the first that is not: no camera has matches, hardly any match agrees with one motion, the
    increment is uncertain, or the step is longer than ``max_gap_s``. No measured yaw rate enters; distances do.

    Args:
        cameras: name -> mounted camera; any number, any images sizes.
        config: settings.

    Raises:
        DatasetError: without a camera.
    """

    def __init__(self, cameras: Mapping[str, MountedCamera], config: JointConfig | None = None) -> None:
        if not cameras:
            raise DatasetError("joint odometry needs at least one camera, got none: name the cameras of the rig")
        self.config = config or JointConfig()
        self._cameras = dict(cameras)
        self._mountings = Mountings(cameras, self.config)
        self._rates = Rates()
        self._times_us: tuple[int, int] | None = None
        self._state = State.INITIALISING
        self._good_steps = 0

    def process(self, timestamp_us: int, sights: Mapping[str, Sight]) -> JointStep:
        """Take the next step; the first call only says when the first step begins.

        Args:
            timestamp_us: when the step closes; must increase.
            sights: by camera; one without matches may be left out. Images may not be later than the step.

        Raises:
            DatasetError: for a camera that is not of the rig, a time that does not increase, an image of the future, or
                a distance that is not finite.
        """
        self._check(timestamp_us, sights)
        if self._times_us is None:
            self._times_us = (timestamp_us, timestamp_us)
            return self._report(None, {}, math.nan)
        before_us, last_us = self._times_us
        gap_s = 1e-6 * (timestamp_us - last_us)
        opening_s = 1e-6 * (last_us - before_us) or gap_s
        self._times_us = (last_us, timestamp_us)
        used = self._usable(sights, last_us, opening_s) if gap_s <= self.config.max_gap_s else {}
        if not used:
            return self._report(None, {}, math.nan)
        knots = (-opening_s, 0.0, gap_s)
        if len(fresh := [s.yaw_rad / (1e-6 * (s.end_us - s.start_us)) for s in used.values() if s.yaw_rad == s.yaw_rad]):
            alone = _Problem(self, used, knots, last_us, Rates(), float(np.median(fresh)))
        else:
            alone = _Problem(self, used, knots, last_us, Rates(), 0.0)
        first = alone.solve()
        two_frame = alone.increment(first)[0] if self._good(alone, first) else math.nan
        if not self._rates.known:
            return self._report((alone, first), used, two_frame)
        problem = _Problem(self, used, knots, last_us, self._rates, None)
        return self._report((problem, problem.solve()), used, two_frame)

    def _check(self, timestamp_us: int, sights: Mapping[str, Sight]) -> None:
        if self._times_us is not None and timestamp_us <= self._times_us[1]:
            raise DatasetError(f"step times must increase, got {timestamp_us} after {self._times_us[1]}: sort them")
        for name, seen in sights.items():
            if name not in self._cameras:
                raise DatasetError(unknown("camera of the rig", name, self._cameras))
            if not seen.start_us < seen.end_us <= timestamp_us:
                raise DatasetError(
                    f"{name}: expected images in time order and none after {timestamp_us}, got {seen.start_us} and "
                    f"{seen.end_us}: a step knows nothing of the future"
                )
            if not math.isfinite(seen.distance_m):
                raise DatasetError(f"{name}: distance must be finite, got {seen.distance_m} m: check the wheel speeds")

    def _usable(self, sights: Mapping[str, Sight], last_us: int, opening_s: float) -> dict[str, Sight]:
        """The cameras that have a say: enough matches, not misplaced, images that the knots reach."""
        earliest_us = last_us - 1.6e6 * opening_s
        least = max(self.config.min_matches, _FEWEST)
        return {
            name: seen
            for name, seen in sights.items()
            if seen.matches >= least
            and len(seen.first) >= _FEWEST
            and seen.start_us >= earliest_us
            and seen.end_us > last_us - 5e5 * opening_s
            and name not in self._mountings.misplaced
        }

    def _good(self, problem: _Problem, solved: Solved) -> bool:
        if not np.isfinite(solved.unknowns).all() or not (np.diag(solved.covariance) > 0.0).all():
            return False
        std = problem.increment(solved)[1]
        return std <= self.config.max_yaw_std_rad and float(np.mean(problem.agree(solved))) >= self.config.least_support

    def _report(self, found: tuple[_Problem, Solved] | None, used: Mapping[str, Sight], two_frame: float) -> JointStep:
        """Advance the state by one step."""
        good = found is not None and self._good(*found)
        share: dict[str, float] = {}
        yaw = std = residual_px = math.nan
        inliers = 0
        if found is not None:
            problem, solved = found
            agree = problem.agree(solved)
            focal = np.repeat([np.mean(self._cameras[name].focal_px) for name in used], np.diff(problem.views.start))
            if agree.any():
                residual_px = float(np.median((np.abs(solved.residual) * focal)[agree]))
            for j, (name, seen) in enumerate(used.items()):
                inside = float(np.mean(agree[problem.views.start[j] : problem.views.start[j + 1]]))
                share[name] = 1.0 - inside
                inliers += round(inside * seen.matches)
            if good:
                yaw, std = problem.increment(solved)
                self._learn(problem, solved)
        if good:
            self._good_steps += 1
            started = self._state is State.TRACKING or self._good_steps >= self.config.initial_steps
            self._state = State.TRACKING if started else State.INITIALISING
        else:
            never = self._state is State.INITIALISING and self._good_steps == 0 and found is None
            self._state = State.INITIALISING if never else State.LOST
            self._good_steps = 0
            self._rates.forget()
        tracking = self._state is State.TRACKING
        return JointStep(
            state=self._state,
            yaw_increment_rad=yaw if tracking else math.nan,
            yaw_std_rad=std if tracking else math.nan,
            matches=sum(seen.matches for seen in used.values()),
            inliers=inliers,
            residual_px=residual_px,
            outlier_share=share,
            misplaced=self._mountings.misplaced,
            two_frame_yaw_increment_rad=two_frame,
        )

    def _learn(self, problem: _Problem, solved: Solved) -> None:
        self._rates.learn(solved.unknowns[1:3], solved.covariance[1:3, 1:3])
        variance = np.diag(solved.covariance)
        for j, name in enumerate(problem.names):
            of = slice(BODY + OWN * j + 1, BODY + OWN * j + 3)
            self._mountings.learn(name, solved.unknowns[of], variance[of])

    def expect_mounting(self, camera: str) -> tuple[FloatArray, FloatArray]:
        """Mean and variance of slip and heave share of a camera against the body, ``(2,)`` each."""
        return self._mountings.expect(camera)

    def mounted(self, camera: str) -> MountedCamera:
        """A camera of the rig."""
        return self._cameras[camera]


class _Problem:
    """One step laid out for the kernel.

    Args:
        odometry: whose cameras and settings count.
        used: cameras that have a say.
        knots: times of the rates, the step begins at 0 [s].
        origin_us: that time.
        rates: what is known of them.
        start_radps: where to start when nothing is known.
    """

    def __init__(
        self,
        odometry: JointOdometry,
        used: Mapping[str, Sight],
        knots: tuple[float, float, float],
        origin_us: int,
        rates: Rates,
        start_radps: float | None,
    ) -> None:
        self.names, self._knots, self._rates, config = list(used), knots, rates, odometry.config
        self._own = (config.own_yaw_std_rad, config.own_yaw_share, config.freedom)
        count = BODY + OWN * len(used)
        change = config.yaw_acceleration_radps2 * knots[2]
        if rates.known:
            self._mean = np.array([*rates.mean, rates.mean[1], *np.zeros(count - 3)])
            covariance = knot_covariance(rates.covariance, change)
        else:
            self._mean = np.array([start_radps or 0.0] * 3 + [0.0] * (count - 3))
            walk = np.full((2, 2), _UNKNOWN_RATE_RADPS**2)
            walk[1, 1] += (config.yaw_acceleration_radps2 * -knots[0]) ** 2
            covariance = knot_covariance(walk, change)
        self._prior_covariance = covariance
        information = np.zeros((count, count))
        information[:3, :3] = np.linalg.inv(covariance)
        distances = [never_zero(seen.distance_m) for seen in used.values()]
        gaps = [1e-6 * (seen.end_us - seen.start_us) for seen in used.values()]
        speed = sum(distances) / sum(gaps)
        typical = max(abs(sum(distances)) / len(distances), 1e-3)
        slip = math.hypot(config.slip_std, _SLIP_PER_ACCELERATION * speed * self._mean[1], _FLOOR_M / typical)
        heave = math.hypot(config.slip_std, _FLOOR_M / typical)
        body = np.array([config.tilt_rate_std_radps] * 2 + [slip, heave])
        information[range(3, BODY), range(3, BODY)] = body**-2.0
        local, alone = np.zeros((len(used), 6, count)), np.zeros((len(used), 6))
        for j, (name, seen) in enumerate(used.items()):
            at = BODY + OWN * j
            mean, variance = odometry.expect_mounting(name)
            if not rates.known and start_radps is not None:  # a step of its own: no memory at all
                mean, variance = np.zeros(2), np.full(2, config.mounting_std**2)
            self._mean[at + 1 : at + 4] = *mean, _MEAN_DEPTH
            information[range(at + 1, at + 4), range(at + 1, at + 4)] = *(1.0 / variance), _SPREAD_DEPTH**-2
            window = [1e-6 * (time_us - origin_us) for time_us in (seen.start_us, seen.end_us)]
            local[j, 0, :3] = window_weights(*window, knots)
            local[j, 0, at] = 1.0
            local[j, 1, 3] = local[j, 2, 4] = gaps[j]
            local[j, 3, 5] = local[j, 3, at + 1] = local[j, 4, 6] = local[j, 4, at + 2] = distances[j]
            local[j, 5, at + 3] = 1.0
            offset = distances[j] ** 2 * (body[2:] ** 2 + variance)
            alone[j] = [1e-6, *(gaps[j] * body[:2]) ** -2.0, *(1.0 / offset), _SPREAD_DEPTH**-2]
        self._information = information
        mounted = [odometry.mounted(name) for name in used]
        self.views = Views(
            np.concatenate([seen.first for seen in used.values()]),
            np.concatenate([seen.second for seen in used.values()]),
            np.cumsum([0, *(len(seen.first) for seen in used.values())]),
            np.array([camera.rotation for camera in mounted]),
            np.array([camera.position_m for camera in mounted]),
            np.array(distances),
            np.array([seen.noise for seen in used.values()]),
            local,
            alone,
        )

    def solve(self) -> Solved:
        """From the expected motion."""
        return solve_step(self.views, self._mean.copy(), self._mean, self._information, self._own)

    def agree(self, solved: Solved) -> NDArray[np.bool_]:
        """``(n,)`` matches that agree with a solution."""
        noise = np.repeat(solved.noise, np.diff(self.views.start))
        return np.abs(solved.residual) < _INLIER_STD * noise

    def increment(self, solved: Solved) -> tuple[float, float]:
        """Yaw increment of the step with what it corrects of the one before, and its standard deviation [rad]."""
        step_s, before_s = self._knots[2], -self._knots[0]
        now, before = np.array([0.0, 0.5, 0.5]) * step_s, np.array([0.5, 0.5, 0.0]) * before_s
        rates, covariance = solved.unknowns[:3], solved.covariance[:3, :3]
        yaw, variance = float(now @ rates), float(now @ covariance @ now)
        if self._rates.known:
            yaw += float(before @ (rates - self._mean[:3]))
            variance += max(0.0, float(before @ (self._prior_covariance - covariance) @ before))
        return yaw, math.sqrt(variance)
