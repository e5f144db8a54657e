"""Motion of the car between two images of one camera, from matched points, known distance, mounting and lever arm.

Model (kinematics.py). A point seen at h2 = (x, y, 1) on the second image plane with inverse depth rho is seen on the
first one along M h2 + rho C^T t, with M = C^T R C, C the rotation ego from camera, R the rotation first from second ego
frame and t the displacement of the camera, both of yaw, tilt, slip, heave and the known distance and lever arm.

The two-dimensional transfer error of a match is split along and across its epipolar direction w = d(image 1)/d(rho).
Across, the error is position noise. Along, it is noise plus the unknown depth, rho ~ N(mean, spread^2): worthless when
the camera has moved far, as good as the other when it stands. One estimator so covers driving, creeping, pure rotation
and standstill without a switch; points behind the camera, absurdly near or under the road are outliers.

Search is exhaustive over the yaw increment (vote.py; the one-point model of Scaramuzza, IJCV 2011, here with known
scale and lever arm for any mounting), then all six unknowns are refined by iteratively reweighted least squares with
priors (refine.py).
No measured yaw rate enters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.monocular.depths import Matches, Mounting
from mixo_env.experts.monocular.kinematics import never_zero
from mixo_env.experts.monocular.refine import Expected, refine_motion
from mixo_env.experts.monocular.vote import vote_yaw

FloatArray = NDArray[np.float64]

_SLIP_FLOOR_M = 0.004
"""A car that hardly rolls still sways on its springs by millimetres."""

_OPTIMISM = 1.4
"""Real errors over those of independent noise: neighbouring matches err together (simulated drives)."""

_MIN_MATCHES = 8
"""Six unknowns and two more: fewer matches agree with anything."""

_MOST_VOTES = 300
"""Matches that vote on the start: the search is coarse, and its time goes with their number."""

_ITERATIONS = 10
"""Of the refinement: the noise falls from its wide start to its floor in seven, the rest settles the motion."""

_INLIER_STD = 3.0
"""A match further from its line than so many standard deviations disagrees: one in 400 of normal noise."""

_OUT_OF_RANGE = 1.2
"""A solution beyond the search range by more than this factor is a mistake: refining moves the start by less."""


@dataclass(frozen=True)
class MotionPrior:
    """What is known before looking.

    Attributes:
        distance_m: travelled between the images; negative when reversing.
        max_yaw_rad: largest yaw increment searched for, either sign.
        noise: expected position noise on the image plane (unit focal length).
        tilt_std_rad: standard deviation of roll and pitch increments.
        slip_mean, slip_std: expected sideways motion and its standard deviation, as shares of the distance.
        heave_mean, heave_std: the same of vertical motion.
        yaw_mean_rad, yaw_std_rad: expected yaw increment and its standard deviation; infinite when nothing is known.
    """

    distance_m: float
    max_yaw_rad: float
    noise: float
    tilt_std_rad: float = 0.003
    slip_mean: float = 0.0
    slip_std: float = 0.05
    heave_mean: float = 0.0
    heave_std: float = 0.05
    yaw_mean_rad: float = 0.0
    yaw_std_rad: float = math.inf

    def offset(self) -> tuple[FloatArray, FloatArray]:
        """Mean [m] and standard deviation [m] of slip and heave, ``(2,)`` each, over this distance."""
        s = never_zero(self.distance_m)
        std = [math.hypot(share * s, _SLIP_FLOOR_M) for share in (self.slip_std, self.heave_std)]
        return np.array([self.slip_mean, self.heave_mean]) * s, np.array(std)


@dataclass(frozen=True)
class Motion:
    """Motion first from second image, ego frame.

    Attributes:
        yaw_rad: yaw increment, anticlockwise positive.
        yaw_std_rad: its standard deviation, from the residuals.
        pitch_rad, roll_rad: tilt increments.
        slip_m, heave_m: motion of the camera to the left and up, beyond the arc.
        slip_std_m, heave_std_m: their standard deviations, prior included.
        inlier: ``(n,)`` bool, matches that agree.
        residual: median distance of the inliers from their epipolar lines, on the image plane; NaN without inliers.
    """

    yaw_rad: float
    yaw_std_rad: float
    pitch_rad: float
    roll_rad: float
    slip_m: float
    heave_m: float
    slip_std_m: float
    heave_std_m: float
    inlier: NDArray[np.bool_]
    residual: float


def estimate_motion(
    first: FloatArray,
    second: FloatArray,
    rotation: FloatArray,
    position_m: FloatArray,
    prior: MotionPrior,
    start_rad: float | None = None,
) -> Motion | None:
    """Motion of the car between two images of one camera.

    Args:
        first: ``(n, 2)`` matched points on the first image plane (x right, y down, unit focal length).
        second: ``(n, 2)`` the same on the second.
        rotation: ``(3, 3)`` ego from camera.
        position_m: ``(3,)`` camera in the ego frame; its height says where the road is.
        prior: distance, search range, noise and what the car is expected to do.
        start_rad: yaw increment to refine, for instance of an earlier solution; ``None`` searches for it.

    Returns:
        ``None`` when fewer than 8 matches are given or the solution leaves the search range or is not finite.
    """
    if len(first) < _MIN_MATCHES:
        return None
    first, second = np.ascontiguousarray(first, dtype=np.float64), np.ascontiguousarray(second, dtype=np.float64)
    matches, mounting = Matches(first, second), Mounting(rotation, position_m)
    if start_rad is None:
        # a tilt moves points across their lines as well, and the search knows none
        tolerance = max(3.0 * prior.noise, 0.6 * prior.tilt_std_rad)
        some = slice(None, None, max(1, len(first) // _MOST_VOTES))
        voters = Matches(first[some], second[some])
        start_rad, _ = vote_yaw(voters, mounting, prior.distance_m, prior.max_yaw_rad, tolerance, tolerance)
    expected = Expected(
        prior.distance_m,
        prior.noise,
        prior.yaw_mean_rad,
        prior.yaw_std_rad,
        prior.tilt_std_rad,
        *prior.offset(),
    )
    unknowns, covariance, sigma, residual = refine_motion(matches, mounting, expected, start_rad, _ITERATIONS)
    return _motion(unknowns, np.sqrt(np.diag(covariance)), residual, sigma, prior)


def _motion(
    unknowns: FloatArray, std: FloatArray, residual: FloatArray, sigma: float, prior: MotionPrior
) -> Motion | None:
    """A solution of :func:`refine_motion` as a motion; ``None`` where it is none."""
    if not np.isfinite(unknowns).all() or not (std > 0.0).all() or abs(unknowns[0]) > _OUT_OF_RANGE * prior.max_yaw_rad:
        return None
    inlier = np.abs(residual) < _INLIER_STD * sigma
    return Motion(
        yaw_rad=float(unknowns[0]),
        yaw_std_rad=_OPTIMISM * float(std[0]),
        pitch_rad=float(unknowns[1]),
        roll_rad=float(unknowns[2]),
        slip_m=float(unknowns[3]),
        heave_m=float(unknowns[4]),
        slip_std_m=float(std[3]),
        heave_std_m=float(std[4]),
        inlier=inlier,
        residual=float(np.median(np.abs(residual[inlier]))) if inlier.any() else math.nan,
    )
