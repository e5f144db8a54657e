"""What the car is doing: straight, left, right or standing, step by step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.leaderboard.firing_order import MOVING_MPS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import truths_of, with_truth

MANOEUVRES = ("straight", "left", "right", "standing")

TURNING_RADPS = 0.05
"""3 degrees a second: what `mixo inspect` takes for a turn as well."""


def manoeuvre_of(recordings: Recordings) -> NDArray[np.int64]:
    """Index in ``MANOEUVRES`` of every row by the truth that scores; row 0 of a scene, no step, counts as standing.

    Only for sorting results: policies see nothing of it.
    """
    judged = with_truth(recordings, truths_of(recordings)[0])
    dt_s = np.where(judged["dt_s"] > 0.0, judged["dt_s"], np.inf)
    rate = np.nan_to_num(judged["truth.yaw_increment_rad"]) / dt_s
    speed = np.abs(np.nan_to_num(judged["truth.distance_m"])) / dt_s
    turning = np.where(rate >= TURNING_RADPS, 1, np.where(rate <= -TURNING_RADPS, 2, 0))
    return np.where(speed < MOVING_MPS, 3, turning)
