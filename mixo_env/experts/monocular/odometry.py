"""Single-camera odometry: images and distances in, yaw increments, states and signals out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.monocular.bundle import turn_change
from mixo_env.experts.monocular.camera import MountedCamera, check_input, mount
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.course import Course
from mixo_env.experts.monocular.front_end import Frame, FrontEnd
from mixo_env.experts.monocular.heading import Heading
from mixo_env.experts.monocular.motion import Motion, estimate_motion
from mixo_env.experts.monocular.pair import Pair, PairSolver
from mixo_env.experts.monocular.turn import Turn
from mixo_env.nuscenes.scene import CameraCalibration

_FROZEN_DISTANCE_M = 0.05  # moving at least so far must change at least one pixel
_AGREE_STD = 4.0  # yaw increments so many standard deviations apart contradict each other
_LEAST_SUPPORT = 0.4  # an expected motion holds if it has so many of the inliers of the best motion of the pair alone


class MonocularOdometry:
    """Yaw odometry of one camera with known scale, mounting and lever arm (implements ``CameraExpert``).

    States. Every image is matched with the one before; a pair is *good* when it has enough matches, its motion was
    found with enough inliers, and its standard deviation is small.

    * INITIALISING from the first image until ``initial_pairs`` good pairs came in a row (each with
      ``initial_matches``) and the car travelled ``initial_distance_m`` during them; a car that stands still gives no
      parallax, so ``initial_patience_pairs`` good pairs are enough without it. The pair that ends it is TRACKING.
    * TRACKING while pairs stay good: the only state with an increment.
    * LOST on the first pair that is not good: fewer than ``min_matches`` matches, no trustworthy motion, a turn that no
      car can make after the last one (a vehicle that drives past fills the view), a lasting contradiction to the
      expected turn, an image equal to the last one although the car moved, a gap in time too long. The next good pair
      starts INITIALISING again.

    A turn is expected from the last good pair. One pair alone that is more than four standard deviations (of both
    together) from it is most likely ruled by a vehicle; it is solved again about the expectation, and TRACKING goes on.
    But solving so confirms whatever is expected if only a vehicle moves along with it, and would for ever. Therefore
    the second such pair in a row, or any while the state is not TRACKING, is not good: nobody can tell which of both is
    wrong. Nothing is learnt from it, so the expectation widens with its age until the pairs alone agree with it again.

    Increments add up to the best heading known: what an image tells about earlier ones that were reported is part of
    its increment. The stateless increment of its pair alone is given too.

    The row "w/o inertial initialization" of the paper is a matter of replay: zero yaw and distance in every step until
    the first TRACKING of a scene. Instant re-initialisation is ``initial_pairs=1, initial_distance_m=0.0``.

    No measured yaw rate enters; the distance does (the external scale s_k). Same input, same bits.

    Args:
        calibration: pinhole camera and mounting; images must have its width and height.
        config: settings; default is the preset ``fast``.
        front_end: what sees and matches corners; default are ORB features.

    Raises:
        DatasetError: for a calibration that is no pinhole camera or left-handed.
    """

    def __init__(
        self,
        calibration: CameraCalibration,
        config: MonocularConfig | None = None,
        front_end: FrontEnd | None = None,
    ) -> None:
        self.config = config or MonocularConfig()
        self.camera: MountedCamera = mount(calibration, self.config.max_pixels)
        self._solver = PairSolver(self.camera, self.config, front_end)
        self._course = Course(self.config.slip_std, self.config.course_spread)
        self._turn = Turn(self.config.yaw_acceleration_radps2)
        self.pair: Pair | None = None
        """The last two images compared, before any memory; ``None`` where they could not be."""
        self.change: tuple[float, float] | None = None
        """What the last three images say of the change of the yaw increment, as :func:`turn_change` gives it."""
        self._previous: Frame | None = None
        self._heading = Heading(self.config.yaw_acceleration_radps2)
        self._solved: tuple[Pair, Motion] | None = None
        self._contradicted = False
        self._last_timestamp_us: int | None = None
        self._last_image: NDArray[np.uint8] | None = None
        self._state = State.INITIALISING
        self._good_pairs = 0
        self._good_distance_m = 0.0

    @property
    def halvings(self) -> int:
        """How often images are halved before work starts; they may come so already."""
        return self.camera.halvings

    def process(self, image: NDArray[np.uint8], timestamp_us: int, distance_m: float) -> CameraStep:
        """Take the next image.

        Args:
            image: ``(height, width)`` grey uint8, of the calibrated size or already at ``camera.working_shape``.
            timestamp_us: exposure time; must increase.
            distance_m: travelled since the previous image, negative in reverse; not used with the first image.

        Raises:
            DatasetError: wrong type or size of image, time that does not increase, distance that is not finite.
        """
        check_input(self.camera, image, timestamp_us, self._last_timestamp_us, distance_m)
        self.pair = self.change = None
        previous, last, working = self._previous, self._last_image, self.camera.shrink(image)
        gap_s = math.inf if self._last_timestamp_us is None else (timestamp_us - self._last_timestamp_us) * 1e-6
        self._last_timestamp_us, self._last_image = timestamp_us, working
        if last is not None and abs(distance_m) > _FROZEN_DISTANCE_M and np.array_equal(working, last):
            self._previous = None  # the time of a frozen image is unknown: nothing may be compared with it
            return self._close(None, gap_s, distance_m)
        frame = self._previous = self._solver.frame(working)
        if previous is None or gap_s > self.config.max_gap_s:
            return self._close(None, gap_s, distance_m)
        self.pair = self._solver.compare(previous, frame, gap_s, distance_m)
        return self._close(self.pair, gap_s, distance_m)

    def _close(self, pair: Pair | None, gap_s: float, distance_m: float) -> CameraStep:
        """Advance the state by one image and report."""
        config, last = self.config, self._solved
        self._solved = None
        found = None if pair is None else pair.motion
        # Estimate: only a sample of the matches is solved with. Aligning all for a true count would cost as much again.
        share = 0.0 if found is None else float(np.mean(found.inlier))
        inliers = 0 if pair is None else round(share * pair.matches)
        sure = found is not None and inliers >= config.min_inliers and found.yaw_std_rad <= config.max_yaw_std_rad
        motion = found if sure else None
        solved = self._refined(pair, motion, gap_s, last) if pair is not None and motion is not None else None
        self.change = None if solved is None else solved[1]
        if solved is None:
            first_image = pair is None and self._state is State.INITIALISING and self._good_pairs == 0
            self._state = State.INITIALISING if first_image else State.LOST
            self._good_pairs, self._good_distance_m = 0, 0.0
            self._heading.forget()
        elif self._state is not State.TRACKING:
            self._state = State.INITIALISING
            if pair is not None and pair.matches >= config.initial_matches:
                self._good_pairs += 1
                self._good_distance_m += abs(distance_m)
            else:
                self._good_pairs, self._good_distance_m = 0, 0.0
            moved = self._good_distance_m >= config.initial_distance_m and self._good_pairs >= config.initial_pairs
            if moved or self._good_pairs >= config.initial_patience_pairs:
                self._state = State.TRACKING
        tracking = self._state is State.TRACKING
        yaw_rad, yaw_std_rad = math.nan, math.nan
        if solved is not None:
            yaw_rad, yaw_std_rad = self._heading.report(*solved, gap_s, tracking=tracking)
        focal = float(np.mean(self.camera.focal_px))
        return CameraStep(
            state=self._state,
            yaw_increment_rad=yaw_rad if tracking else math.nan,
            yaw_std_rad=yaw_std_rad if tracking else math.nan,
            matches=0 if pair is None else pair.matches,
            inliers=inliers,
            residual_px=math.nan if found is None else found.residual * focal,
            flow_px=math.nan if pair is None else pair.flow_px,
            two_frame_yaw_increment_rad=math.nan if motion is None else motion.yaw_rad,
        )

    def _refined(
        self, pair: Pair, motion: Motion, gap_s: float, last: tuple[Pair, Motion] | None
    ) -> tuple[Motion, tuple[float, float] | None] | None:
        """The motion of a pair, given what earlier pairs have shown of course and turn; both learn from it.

        With it comes what :func:`turn_change` says about the last pair and this one. ``None`` when the car cannot have
        turned so: whatever fills the view moves itself, or did when the expectation was learnt.
        """
        assert self._last_timestamp_us is not None
        now_us, camera = self._last_timestamp_us, self.camera
        sideways_mps2 = pair.prior.distance_m * motion.yaw_rad / gap_s**2
        prior = self._turn.expect(self._course.expect(pair.prior, sideways_mps2), now_us, gap_s)
        tolerance = _AGREE_STD * math.hypot(prior.yaw_std_rad, motion.yaw_std_rad)
        again, self._contradicted = self._contradicted, abs(motion.yaw_rad - prior.yaw_mean_rad) >= tolerance
        if self._contradicted and (again or self._state is not State.TRACKING):
            return None
        start = prior.yaw_mean_rad if self._contradicted else motion.yaw_rad
        solved = estimate_motion(pair.first, pair.second, camera.rotation, camera.position_m, prior, start)
        if solved is None or np.count_nonzero(solved.inlier) < _LEAST_SUPPORT * np.count_nonzero(motion.inlier):
            solved = motion
        else:
            self._course.learn(solved, prior, sideways_mps2)
        if abs(solved.yaw_rad - prior.yaw_mean_rad) > _AGREE_STD * prior.yaw_std_rad:
            return None
        self._turn.learn(solved, now_us, gap_s)
        self._solved = pair, solved
        chained = last is not None and last[0].apart == pair.apart  # they number the corners of the middle image alike
        return solved, turn_change(*last, pair, motion, prior, camera) if last is not None and chained else None
