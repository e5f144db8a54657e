"""What a recording's manifest says about its own statistics: LINEAR's weights per fold and the scale of the reward."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixo_env.fusion import least_squares_weights, mix
from mixo_env.geometry import MAD_TO_SIGMA
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.pose_lag import lag_corrected
from mixo_env.recordings.substitutes import substituted_increments

FloatArray = NDArray[np.float64]

NOTHING_HELD_OUT = "none"
"""Key of the weights fitted on all folds."""

DEFAULT_REWARD_SCALE_RAD = np.deg2rad(0.05)
"""sigma_0 where LINEAR's error says nothing: imported experts, or no scene in any fold."""


def with_fits(recordings: Recordings) -> Recordings:
    """The recordings with ``linear_weights`` and ``reward_scale_rad`` filled in for every track that can be played.

    LINEAR is fitted once on all folds and once per fold held out; night scenes (fold -1) never take part. The reward
    scale is 1.4826 x the median absolute deviation of LINEAR's yaw-increment error, each scene predicted by the
    weights that have not seen its fold (with a single fold: by the weights fitted on it). The truth of both are
    the poses without the lag that the manifest tells of each vehicle.
    """
    folds = np.repeat([scene.fold for scene in recordings.scenes], np.diff(recordings.offsets))
    truth = lag_corrected(recordings)["truth.yaw_increment_rad"]
    weights: dict[str, dict[str, dict[str, float]]] = {}
    scales: dict[str, float] = {}
    for track in recordings.tracks:
        votes = substituted_increments(recordings, track)
        usable = (folds >= 0) & np.isfinite(truth) & np.isfinite(votes).all(axis=-1)
        present = np.unique(folds[usable])
        training = {NOTHING_HELD_OUT: usable} if len(present) else {}
        if len(present) > 1:
            training |= {str(fold): usable & (folds != fold) for fold in present}
        fitted = {held_out: least_squares_weights(votes[rows], truth[rows]) for held_out, rows in training.items()}

        errors = [
            mix(fitted[str(fold) if len(present) > 1 else NOTHING_HELD_OUT], votes[rows]) - truth[rows]
            for fold in present
            for rows in [usable & (folds == fold)]
        ]
        scales[track] = float(DEFAULT_REWARD_SCALE_RAD)
        if errors and not set(recordings.voters(track)) & set(recordings.manifest.imported):
            error = np.concatenate(errors)
            scales[track] = float(MAD_TO_SIGMA * np.median(np.abs(error - np.median(error))))
        voters = recordings.voters(track)
        weights[track] = {
            held_out: dict(zip(voters, map(float, values), strict=True)) for held_out, values in fitted.items()
        }
    manifest = replace(recordings.manifest, linear_weights=weights, reward_scale_rad=scales)
    return recordings.replace(manifest)
