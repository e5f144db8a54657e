"""What recordings must hold to be learned from, or scored, at all."""

from __future__ import annotations

import numpy as np

from mixo_env.errors import RecordingError
from mixo_env.recordings.collection import Recordings

FROM_START = ("truth.x_m", "truth.y_m", "truth.yaw_rad", "time_s", "speed_mps")
STEPS = ("dt_s", "distance_m", "truth.yaw_increment_rad", "truth.distance_m")
"""Needed in every row, and in every row but the first of a scene."""


def check_complete(recordings: Recordings) -> None:
    """Raise :class:`RecordingError` where a number is missing that every row of the table rests on."""
    inside = recordings["step"] > 0
    for column in (*FROM_START, *STEPS):
        missing = ~np.isfinite(recordings[column]) & (inside | (column in FROM_START))
        if missing.any():
            row = int(np.argmax(missing))
            scene = int(np.searchsorted(recordings.offsets, row, side="right")) - 1
            where = f"{recordings.scenes[scene].name}, row {row - recordings.offsets[scene]}"
            if missing[inside].all():
                where = "any scene"
            raise RecordingError(
                f"{column}: expected a number in every row, got none in {where}: record or import anew"
            )
