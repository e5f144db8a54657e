"""TUTORIAL: the visual odometry everyone writes first, one camera, two images, no memory and no prior.

ORB corners, brute-force matching with Lowe's ratio test, the essential matrix by the five-point algorithm (Nister 2004)
in a RANSAC loop, its decomposition, and the yaw of the car read off the rotation as it comes. Nothing is known of the
ground, of the course, or of how a car moves. It fails as such odometries fail:

* standing still the essential matrix is undetermined. With no parallax any translation fits, so the pair is LOST or,
  worse, has a confident rotation that is noise: nothing tells the two apart;
* a vehicle that fills the view is taken for the world;
* a plane (a blank wall, an empty road) has two decompositions, and the wrong one may win;
* it has no standard deviation: a count of inliers and their residual are all that it says of itself.

The classic RANSAC of OpenCV is used: its newer ``USAC_*`` estimators returned nothing on real pairs of images.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.monocular.camera import check_input, mount
from mixo_env.nuscenes.scene import CameraCalibration

FloatArray = NDArray[np.float64]

TUTORIAL = "TUTORIAL"
"""Family of its experts, one a camera."""

_SEED = 1


@dataclass(frozen=True)
class TutorialConfig:
    """Everything that may be varied; the values are those of the usual examples.

    Attributes:
        features: ORB corners of an image.
        ratio: the best match must be so much nearer than the second best.
        threshold_px: distance from the epipolar line of an inlier.
        confidence: that one sample of RANSAC was free of outliers.
        min_matches: fewer are LOST.
        min_inliers: fewer are LOST, before and after the test that points lie in front of both cameras.
    """

    features: int = 2000
    ratio: float = 0.75
    threshold_px: float = 1.0
    confidence: float = 0.999
    min_matches: int = 30
    min_inliers: int = 15

    def __post_init__(self) -> None:
        """Check ranges once.

        Raises:
            ConfigurationError: for a value that is not positive, a share of 1 or more, or too few matches to solve.
        """
        for field in fields(self):
            if not getattr(self, field.name) > 0:
                raise ConfigurationError(f"{field.name} must be positive, got {getattr(self, field.name)}")
        for name in ("ratio", "confidence"):
            if getattr(self, name) >= 1.0:
                raise ConfigurationError(f"{name} must be below 1, got {getattr(self, name)}")
        if self.min_matches < 5 or self.min_inliers < 5:
            raise ConfigurationError(
                "five points determine an essential matrix: min_matches and min_inliers must be 5 or more, got "
                f"{self.min_matches} and {self.min_inliers}"
            )


@dataclass(frozen=True)
class _Motion:
    """What a pair of images told."""

    yaw_rad: float
    inliers: int
    residual_px: float


class TutorialOdometry:
    """Two-frame odometry of one camera (implements ``CameraExpert``); same input, same bits.

    INITIALISING with the first image; then TRACKING or LOST, pair by pair. The distance is not used, nor is any
    measured yaw rate.

    Args:
        calibration: pinhole camera and mounting; images must have its width and height.
        config: settings.

    Raises:
        DatasetError: for a calibration that is none (see :func:`~mixo_env.experts.monocular.camera.mount`).
    """

    halvings = 0
    """It wants the image as it was taken."""

    def __init__(self, calibration: CameraCalibration, config: TutorialConfig | None = None) -> None:
        """Start before the first image."""
        self.camera = mount(calibration, None)
        self.config = config or TutorialConfig()
        self._intrinsic = np.asarray(calibration.intrinsic, np.float64)
        self._orb = cv2.ORB.create(nfeatures=self.config.features)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
        self._last: tuple[FloatArray, NDArray[np.uint8]] | None = None
        self._last_us: int | None = None

    def process(self, image: NDArray[np.uint8], timestamp_us: int, distance_m: float) -> CameraStep:
        """Take the next image.

        Args:
            image: ``(height, width)`` grey uint8, of the calibrated size.
            timestamp_us: exposure time; must increase.
            distance_m: checked, but not used: two images alone have no scale, and yaw needs none.

        Raises:
            DatasetError: wrong type or size of image, time that does not increase, distance that is not finite.
        """
        check_input(self.camera, image, timestamp_us, self._last_us, distance_m)
        before, now = self._last, self._features(image)
        self._last, self._last_us = now, timestamp_us
        if before is None:
            return _lost(State.INITIALISING)
        first, second = self._matches(before, now)
        if not len(first):
            return _lost(State.LOST)
        flow_px = float(np.median(np.linalg.norm(second - first, axis=1)))
        motion = self._motion(first, second) if len(first) >= self.config.min_matches else None
        if motion is None:
            return _lost(State.LOST, len(first), flow_px)
        yaw = motion.yaw_rad
        return CameraStep(State.TRACKING, yaw, math.nan, len(first), motion.inliers, motion.residual_px, flow_px, yaw)

    def _features(self, image: NDArray[np.uint8]) -> tuple[FloatArray, NDArray[np.uint8]]:
        """Corners ``(n, 2)`` [px] and their descriptors ``(n, 32)``."""
        keypoints, descriptors = self._orb.detectAndCompute(image, None)
        if descriptors is None:
            return np.empty((0, 2)), np.empty((0, 32), np.uint8)
        return np.array([keypoint.pt for keypoint in keypoints], np.float64), np.asarray(descriptors, np.uint8)

    def _matches(
        self, before: tuple[FloatArray, NDArray[np.uint8]], now: tuple[FloatArray, NDArray[np.uint8]]
    ) -> tuple[FloatArray, FloatArray]:
        """Pixels ``(n, 2)`` of the matches that pass the ratio test, in the earlier and in the later image."""
        if min(len(before[0]), len(now[0])) < 2:
            return np.empty((0, 2)), np.empty((0, 2))
        pairs = self._matcher.knnMatch(before[1], now[1], k=2)
        kept = [best for best, second in pairs if best.distance < self.config.ratio * second.distance]
        return before[0][[m.queryIdx for m in kept]], now[0][[m.trainIdx for m in kept]]

    def _motion(self, first: FloatArray, second: FloatArray) -> _Motion | None:
        """The car's turn between two images; ``None`` where the pose cannot be recovered."""
        config, intrinsic = self.config, self._intrinsic
        cv2.setRNGSeed(_SEED)  # of every pair alike: a result must not depend on the pairs before
        essential, mask = cv2.findEssentialMat(
            first, second, intrinsic, method=cv2.RANSAC, prob=config.confidence, threshold=config.threshold_px
        )
        if essential is None or essential.shape != (3, 3) or mask is None:
            return None
        agree = mask.ravel() > 0
        if int(agree.sum()) < config.min_inliers:
            return None
        count, rotation, _, _ = cv2.recoverPose(essential, first, second, intrinsic, mask=mask.copy())
        if count < config.min_inliers or not np.isfinite(rotation).all():
            return None
        # OpenCV maps points from the first camera to the second: the camera itself turned the other way.
        turned = self.camera.rotation @ rotation.T @ self.camera.rotation.T
        residual = _sampson_px(np.asarray(essential, np.float64), intrinsic, first[agree], second[agree])
        return _Motion(math.atan2(turned[1, 0], turned[0, 0]), int(agree.sum()), float(np.median(residual)))


def _sampson_px(essential: FloatArray, intrinsic: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """``(n,)`` first-order distance [px] of matches from the epipolar geometry (Hartley and Zisserman, eq. 11.9)."""
    inverse = np.linalg.inv(intrinsic)
    fundamental = inverse.T @ essential @ inverse
    one = np.column_stack([first, np.ones(len(first))])
    other = np.column_stack([second, np.ones(len(second))])
    line, back = one @ fundamental.T, other @ fundamental
    slope = np.sqrt((line[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))
    return np.abs((other * line).sum(axis=1)) / np.maximum(slope, 1e-12)


def _lost(state: State, matches: int = 0, flow_px: float = math.nan) -> CameraStep:
    """A step without an increment."""
    return CameraStep(state, math.nan, math.nan, matches, 0, math.nan, flow_px, math.nan)
