"""What stands in for an expert that delivered nothing: one rule for environments, fits and scores."""

from __future__ import annotations

import numpy as np

from mixo_env.geometry import FloatArray
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import TRACKS


def substitutes_rad(recordings: Recordings, track: str) -> FloatArray:
    """Yaw increment ``(rows,)`` that bridges lost experts; 0 where nobody knows anything.

    It is that of the track's own inertial expert, where that is missing INERTIAL's. Recordings without any inertial
    expert (imported trajectories alone) have the median of the voters that delivered.
    """
    inertial = recordings.manifest.inertial
    substitute = np.zeros(recordings.offsets[-1])
    for expert in ("INERTIAL", TRACKS[track]):
        if expert in inertial:
            own = recordings[f"{expert}.yaw_increment_rad"]
            substitute = np.where(np.isfinite(own), own.astype(np.float64), substitute)
    if inertial:
        return substitute
    votes = np.stack([recordings[f"{voter}.yaw_increment_rad"] for voter in recordings.voters(track)], axis=-1)
    known = np.isfinite(votes).any(axis=-1)
    substitute[known] = np.nanmedian(votes[known].astype(np.float64), axis=-1)
    return substitute
