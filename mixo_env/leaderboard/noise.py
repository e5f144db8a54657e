"""How noisy the truth of real data is: a lower bound, below which no difference between rows means anything."""

from __future__ import annotations

import itertools

import numpy as np

from mixo_env.geometry import MAD_TO_SIGMA
from mixo_env.recordings.collection import Recordings

NOISE_FLOOR = "NOISE FLOOR"
"""Row of the leaderboard: the true yaw plus the noise estimated here. Only where the headline is no exact truth."""

DIFFERENCES = 3
"""Taken of the yaw that INERTIAL and the poses disagree by: drift, bias and lag of either are gone after three."""

GAIN = 20.0
"""Variance of third differences of white noise over that of the noise: 1 + 9 + 9 + 1."""


def yaw_noise_rad(recordings: Recordings) -> float:
    """Standard deviation of the white noise of the true yaw, from what INERTIAL cannot follow.

    INERTIAL is smooth: what is left of the disagreement after three differences is the noise of the poses (and the
    gyro's, which is filtered). Noise of the poses that lasts longer than a few steps stays unseen, so this is a lower
    bound. The median absolute deviation keeps turns and jumps out.
    """
    disagreement = recordings["truth.yaw_increment_rad"] - recordings["INERTIAL.yaw_increment_rad"]
    left = [
        np.diff(disagreement[first + 1 : stop], DIFFERENCES - 1)  # an increment is the first difference
        for first, stop in itertools.pairwise(recordings.offsets.tolist())
    ]
    values = np.concatenate(left)
    values = values[np.isfinite(values)]
    return float(MAD_TO_SIGMA * np.median(np.abs(values)) / np.sqrt(GAIN)) if len(values) else 0.0
