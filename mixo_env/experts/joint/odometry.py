"""Tightly coupled odometry: one motion of the body from the matches of all cameras, step by step.

What single cameras estimate one by one and a policy then fuses is one estimate here. Every camera keeps its own image
times (knots.py), an error of its own yaw with heavy tails, so that one that a vehicle has captured loses its say, and
an offset of its mounting, learnt slowly (memory.py). Features and matches are those of the single cameras.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mixo_env.errors import DatasetError, unknown
from mixo_env.experts.expert import State
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.joint.layout import Moment, lay_out
from mixo_env.experts.joint.memory import Mountings, Rates
from mixo_env.experts.joint.problem import REACH, Answer, Problem
from mixo_env.experts.joint.sight import JointStep, Sight
from mixo_env.experts.joint.solve import BODY, OWN, Solved
from mixo_env.experts.monocular.camera import MountedCamera

_MOVING_M = 0.3  # the median point of any camera moves by pixels then
_ROLLING_M = 0.01  # the car does not stand; pictures that are then equal to the last bit are one and the same
_DOUBTED_STEPS = 12  # after a camera's last contradiction, one second
_THIN = 3  # every third match is enough for the increment without memory
_FEWEST = 8  # matches in the estimate of a camera that has a say: its six unknowns, and two more


def _stands(seen: Sight) -> bool:
    """Nothing moves in the pictures although the car does: they are old, or show dirt on the lens."""
    if abs(seen.distance_m) <= _ROLLING_M:
        return False
    still = np.abs(seen.second - seen.first) <= (seen.noise if abs(seen.distance_m) > _MOVING_M else 0.0)
    return bool(2 * np.count_nonzero(still[:, 0] & still[:, 1]) > len(still))


class JointOdometry:
    """Yaw odometry of a rig over one scene.

    States as those of a single camera: INITIALISING until ``initial_steps`` good steps came in a row, TRACKING while
    steps stay good, LOST on the first that is not: no camera has matches, hardly any match agrees with one motion, the
    increment is uncertain, or the step is longer than ``max_gap_s``. No measured yaw rate enters; distances do.

    Args:
        cameras: name -> mounted camera; any number, images of any size.
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
        self._doubted: dict[str, int] = {}  # for so many steps yet
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
        moment = Moment((-opening_s, 0.0, gap_s), last_us, used)
        layout = lay_out(self._cameras, moment)
        alone = Problem(self.config, moment, layout, Rates(), Mountings(used, self.config), every=_THIN).answer()
        two_frame = alone.yaw_rad if self._good(alone) else math.nan
        problem = Problem(self.config, moment, layout, self._rates, self._mountings, self._doubted)
        answer = problem.answer()
        accused = problem.accused(answer.solved)
        left = {name: steps - 1 for name, steps in self._doubted.items() if steps > 1}
        self._doubted = left | dict.fromkeys(accused, _DOUBTED_STEPS)
        if accused:
            self._learn_mountings(problem, answer.solved, accused)
            rest = [j for j, name in enumerate(used) if name not in accused]
            moment = replace(moment, used={name: seen for name, seen in used.items() if name not in accused})
            problem = Problem(self.config, moment, layout.of(rest), self._rates, self._mountings)
            answer = problem.answer()
        return self._report((problem, answer), moment.used, two_frame)

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
        earliest_us = last_us - 1e6 * REACH * opening_s
        least = max(self.config.min_matches, _FEWEST)
        return {
            name: seen
            for name, seen in sights.items()
            if seen.matches >= least
            and len(seen.first) >= _FEWEST
            and seen.start_us >= earliest_us
            and seen.end_us > last_us - 5e5 * opening_s
            and name not in self._mountings.misplaced
            and not _stands(seen)
        }

    def _good(self, answer: Answer) -> bool:
        solved = answer.solved
        if not np.isfinite(solved.unknowns).all() or not (np.diag(solved.covariance) > 0.0).all():
            return False
        support = np.count_nonzero(solved.agree) / len(solved.agree)
        return answer.std_rad <= self.config.max_yaw_std_rad and bool(support >= self.config.least_support)

    def _report(self, found: tuple[Problem, Answer] | None, used: Mapping[str, Sight], two_frame: float) -> JointStep:
        """Advance the state by one step."""
        good = found is not None and self._good(found[1])
        share: dict[str, float] = {}
        yaw = std = residual_px = math.nan
        inliers = 0
        if found is not None:
            problem, (solved, yaw, std) = found
            residual_px = self._residual_px(problem, solved)
            support = dict(zip(used, solved.support.tolist(), strict=True))
            share = {name: 1.0 - inside for name, inside in support.items()}
            inliers = sum(round(inside * used[name].matches) for name, inside in support.items())
            if good:
                more, share_of_rig = problem.lean(solved)
                yaw, std = yaw + more, std * math.sqrt(share_of_rig)
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
        if good and found is not None:
            self._learn(found[0], found[1].solved, tracking=tracking)
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

    def _residual_px(self, problem: Problem, solved: Solved) -> float:
        """Median residual of the matches that agree [px]; NaN without any."""
        focal = [float(self._cameras[name].focal_px.mean()) for name in problem.moment.used]
        across = np.abs(solved.residual) * np.repeat(focal, np.diff(problem.views.start))
        return float(np.median(across[solved.agree])) if solved.agree.any() else math.nan

    def _learn(self, problem: Problem, solved: Solved, *, tracking: bool) -> None:
        with_heading = problem.with_heading(solved) if tracking else np.zeros(2)  # others need no making up for
        self._rates.learn(solved.unknowns[1:3], solved.covariance[1:3, 1:3], with_heading)
        self._learn_mountings(problem, solved, frozenset(problem.moment.used))

    def _learn_mountings(self, problem: Problem, solved: Solved, cameras: frozenset[str]) -> None:
        variance = np.diag(solved.covariance)
        for j, name in enumerate(problem.moment.used):
            if name in cameras:
                of = slice(BODY + OWN * j + 1, BODY + OWN * j + 3)
                self._mountings.learn(name, solved.unknowns[of], variance[of])
