"""What the error of every row is made of: bias, outlier steps, steps without any camera, along and across the road."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from mixo_env.envs.reward import DEFAULT_SCALE_RAD
from mixo_env.experts.expert import State
from mixo_env.leaderboard.crossvalidation import Run
from mixo_env.leaderboard.evaluation import Truth, poses
from mixo_env.metrics.anatomy import BIAS_WINDOWS_S, ErrorAnatomy, error_anatomy
from mixo_env.metrics.tracks import BoolArray
from mixo_env.recordings.collection import Recordings
from mixo_env.trajectory.planar import PlanarPoses

OUTLIER_SIGMAS = 4.0
"""A step is an outlier beyond this many sigma_0, the robust spread of LINEAR's error: one limit for all rows."""


def outlier_limit_rad(recordings: Recordings, track: str) -> float:
    """Error [rad] of one step above which it is an outlier."""
    return OUTLIER_SIGMAS * recordings.manifest.reward_scale_rad.get(track, DEFAULT_SCALE_RAD)


def anatomy_of(run: Run, track: str, recordings: Recordings, truth: Truth, name: str) -> ErrorAnatomy:
    """Take the headline error of one row apart, on the scenes it was tested on; the mean over its seeds.

    Args:
        run: of the row.
        track: whose sigma_0 is the unit of outliers.
        recordings: the scenes.
        truth: of the headline.
        name: of that truth.
    """
    rows = np.repeat(run.tested, np.diff(truth.offsets))
    offsets = np.concatenate([[0], np.cumsum(np.diff(truth.offsets)[run.tested])])
    limit, lost = outlier_limit_rad(recordings, track), all_lost(recordings)
    found = [
        error_anatomy(
            _rows(truth.poses, rows),
            _rows(poses(travel, truth.poses, truth.offsets), rows),
            recordings["time_s"][rows],
            offsets,
            None if lost is None else lost[rows],
            limit,
        )
        for travel in run.travels[name]
    ]
    return found[0] if len(found) == 1 else _mean(found)


def all_lost(recordings: Recordings) -> BoolArray | None:
    """``(rows,)`` no camera is TRACKING; ``None`` where no camera is recorded."""
    cameras = recordings.manifest.cameras
    if not cameras:
        return None
    return np.all([recordings[f"{camera}.state"] != State.TRACKING for camera in cameras], axis=0)


def _rows(way: PlanarPoses, rows: BoolArray) -> PlanarPoses:
    return PlanarPoses(way.x_m[rows], way.y_m[rows], way.yaw_rad[rows])


def _mean(found: list[ErrorAnatomy]) -> ErrorAnatomy:
    """The mean of every number."""
    plain = {
        one.name: float(np.mean([getattr(anatomy, one.name) for anatomy in found]))
        for one in fields(ErrorAnatomy)
        if one.name != "bias_deg_per_s"
    }
    bias = {window: float(np.mean([one.bias_deg_per_s[window] for one in found])) for window in BIAS_WINDOWS_S}
    return replace(found[0], bias_deg_per_s=bias, **plain)
