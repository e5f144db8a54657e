"""What stands in for an expert that delivered nothing: the one rule, for fitting and for playing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import TRACKS

FloatArray = NDArray[np.float64]


def substitute_increment_rad(recordings: Recordings, track: str) -> FloatArray:
    """The yaw increment ``(rows,)`` [rad] that a lost expert counts with.

    It is that of the track's own inertial expert; INERTIAL's where the track has none or that one is missing as well.
    Recordings without any inertial expert (imported trajectories alone) have the median of the voters that delivered.
    No rotation where nothing is left. Row 0 of each scene ends no step and is NaN.
    """
    substitute = np.zeros(int(recordings.offsets[-1]))
    if not recordings.manifest.inertial:
        votes = [recordings[f"{voter}.yaw_increment_rad"].astype(np.float64) for voter in recordings.voters(track)]
        told = np.isfinite(votes).any(axis=0)
        substitute[told] = np.nanmedian(np.stack(votes)[:, told], axis=0)
    for inertial in ("INERTIAL", TRACKS[track]):
        if inertial in recordings.manifest.inertial:
            own = recordings[f"{inertial}.yaw_increment_rad"]
            substitute = np.where(np.isfinite(own), own.astype(np.float64), substitute)
    substitute[recordings.offsets[:-1]] = np.nan
    return substitute


def substituted_increments(recordings: Recordings, track: str) -> FloatArray:
    """The voters' yaw increments ``(rows, voters)`` [rad] with ``lost="inertial"``; NaN in row 0 of each scene."""
    substitute = substitute_increment_rad(recordings, track)
    votes = [recordings[f"{expert}.yaw_increment_rad"] for expert in recordings.voters(track)]
    return np.stack([np.where(np.isfinite(vote), vote, substitute) for vote in votes], axis=-1)
