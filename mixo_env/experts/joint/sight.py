"""What one camera contributes to a joint step, and what comes of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.expert import State
from mixo_env.experts.monocular.pair import Pair


@dataclass(frozen=True)
class Change:
    """How the yaw increment of two images differs from that of the two before, from points seen in all three.

    Attributes:
        before_us: when the first of the three was taken.
        yaw_rad: the second increment less the first.
        std_rad: its standard deviation, were the errors of the points independent.
    """

    before_us: int
    yaw_rad: float
    std_rad: float


@dataclass(frozen=True)
class Told:
    """What the camera's own odometry has reported for its two images.

    Attributes:
        yaw_rad: increment, with what it corrects of earlier ones.
        std_rad: its standard deviation.
    """

    yaw_rad: float
    std_rad: float


@dataclass(frozen=True)
class Sight:
    """Two images of one camera, compared: no yaw-rate sensor and no pose is in it.

    Attributes:
        start_us, end_us: when they were taken.
        distance_m: travelled between them.
        noise: expected position noise on the image plane.
        matches: number of matched features.
        first, second: ``(n, 2)`` a sample of them on the image planes.
        yaw_rad: yaw increment that the two images alone tell; NaN where they do not.
        change: of that increment, from three images; ``None`` where they do not tell.
        told: by the camera's own odometry; ``None`` unless it is tracking.
    """

    start_us: int
    end_us: int
    distance_m: float
    noise: float
    matches: int
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    yaw_rad: float
    change: Change | None = None
    told: Told | None = None


def sight(
    pair: Pair, times_us: tuple[int, int], most: int, change: Change | None = None, told: Told | None = None
) -> Sight:
    """The part of a pair that a joint step needs.

    Args:
        pair: of a single-camera odometry.
        times_us: when its images were taken.
        most: matches to keep, evenly picked.
        change: against the pair before.
        told: by the odometry.
    """
    picked = slice(None, None, max(1, -(-len(pair.first) // most)))
    yaw = math.nan if pair.motion is None else pair.motion.yaw_rad
    return Sight(
        *times_us,
        pair.prior.distance_m,
        pair.prior.noise,
        pair.matches,
        pair.first[picked].copy(),
        pair.second[picked].copy(),
        yaw,
        change,
        told,
    )


@dataclass(frozen=True)
class JointStep:
    """Outcome of one step of all cameras.

    Attributes:
        state: INITIALISING, TRACKING or LOST.
        yaw_increment_rad: of the car over the step and what the step corrects of the one before; NaN unless TRACKING.
        yaw_std_rad: its standard deviation; NaN unless TRACKING.
        matches: of all cameras that had a say.
        inliers: estimate of those that agree with the motion.
        residual_px: median residual of those that agree, in pixels of the full images; NaN without any.
        outlier_share: camera -> share of its matches that disagree; only cameras that had a say.
        misplaced: cameras left out because their written mounting is wrong.
        two_frame_yaw_increment_rad: the same from this step's images alone, no memory; NaN when that fails.
    """

    state: State
    yaw_increment_rad: float
    yaw_std_rad: float
    matches: int
    inliers: int
    residual_px: float
    outlier_share: Mapping[str, float]
    misplaced: tuple[str, ...]
    two_frame_yaw_increment_rad: float
