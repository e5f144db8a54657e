"""What nobody fitted: lost tracks, and which camera is locally best, from a recording alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, unknown
from mixo_env.experts.expert import State
from mixo_env.leaderboard.evaluation import lost_tracks
from mixo_env.leaderboard.firing_order import MOVING_MPS
from mixo_env.metrics.tracks import LostTracks
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.variants import as_variant, variants

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

TURNING_RADPS = np.radians(5.0)
"""A step of a turn."""

PAPER_LOST: Mapping[str, tuple[float, float]] = {
    "CAM_FRONT": (0.76, 1.93),
    "CAM_BACK": (0.74, 3.14),
    "CAM_BACK_RIGHT": (5.83, 6.20),
    "CAM_FRONT_LEFT": (7.00, 5.58),
    "CAM_BACK_RIGHT w/ retrained vocabulary": (4.43, 4.89),
    "CAM_FRONT_LEFT w/ retrained vocabulary": (4.68, 5.58),
}
"""Lost tracks per scene, mean and standard deviation: Table I of the paper."""

PAPER_BEST_FRONT, PAPER_BEST_OTHERS = 0.39, 0.20
"""Share of time points at which the front camera is locally best, and the others on average (below eq. 2)."""


def camera_lost_tracks(recordings: Recordings, row: str, *, instantly: bool = False) -> LostTracks:
    """Of a camera or a variant of one.

    Args:
        recordings: the scenes.
        row: name of the camera or variant.
        instantly: as if initialising anew took no time; else a camera has to track again before it can be lost again.

    Raises:
        ConfigurationError: for an expert that is no camera.
    """
    lost = lost_tracks(as_variant(recordings, row), variants(recordings).get(row, row), instantly=instantly)
    if lost is None:
        raise ConfigurationError(unknown("camera", row, recordings.manifest.cameras))
    return lost


def moving_steps(recordings: Recordings) -> BoolArray:
    """``(rows,)`` steps in which the car truly moves."""
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = np.abs(recordings["truth.distance_m"]) / recordings["dt_s"]
    return np.nan_to_num(speed) >= MOVING_MPS


def turning_steps(recordings: Recordings) -> BoolArray:
    """``(rows,)`` steps in which the car truly turns."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.abs(recordings["truth.yaw_increment_rad"]) / recordings["dt_s"]
    return np.nan_to_num(rate) >= TURNING_RADPS


def own_time_errors(recordings: Recordings) -> FloatArray:
    """``(rows, cameras)`` absolute yaw error over each camera's own image window against the poses at its own times.

    NaN where a camera has no increment of its own: it is initialising, lost or without an image.
    """
    errors = [
        recordings[f"{camera}.own_window_yaw_increment_rad"]
        - recordings[f"{camera}.own_window_truth_yaw_increment_rad"]
        for camera in recordings.manifest.cameras
    ]
    return np.abs(np.stack(errors, axis=1))


@dataclass(frozen=True)
class YawErrors:
    """Yaw increments of cameras over their own image windows, against the poses at their own times.

    Attributes:
        median_deg: of the absolute errors.
        rms_deg: of the errors.
        gain: slope against the truth where it turns by 5 deg/s and more; NaN without such windows.
        accumulated_deg: size of the summed error of every scene and camera with an increment.
    """

    median_deg: float
    rms_deg: float
    gain: float
    accumulated_deg: FloatArray


def yaw_errors(recordings: Recordings, cameras: Sequence[str]) -> YawErrors:
    """Of all windows of some cameras, together."""
    scene = np.repeat(np.arange(len(recordings)), np.diff(recordings.offsets))
    errors, turns, sums = [], [], []
    for camera in cameras:
        yaw, truth, lasted = (
            recordings[f"{camera}.own_window_{name}"].astype(np.float64)
            for name in ("yaw_increment_rad", "truth_yaw_increment_rad", "s")
        )
        error = np.degrees(yaw - truth)
        good = np.isfinite(error)
        turning = good & (np.abs(truth) > TURNING_RADPS * lasted)
        errors.append(error[good])
        turns.append(np.stack([yaw[turning], truth[turning]]))
        sums.append([abs(error[good & (scene == k)].sum()) for k in np.unique(scene[good])])
    error, (yaw, truth) = np.concatenate(errors), np.concatenate(turns, axis=1)
    gain = float(yaw @ truth / (truth @ truth)) if len(truth) else np.nan
    median, rms = (float(np.median(np.abs(error))), float(np.sqrt(np.mean(error**2)))) if len(error) else (np.nan,) * 2
    return YawErrors(median, rms, gain, np.concatenate(sums))


def exact_step_errors(recordings: Recordings) -> FloatArray:
    """``(rows, cameras)`` absolute yaw error over the steps against the simulator's noise-free truth."""
    truth = np.diff(recordings["exact.yaw_rad"], prepend=np.nan)
    truth[recordings.offsets[:-1]] = np.nan
    estimates = [recordings[f"{camera}.yaw_increment_rad"] for camera in recordings.manifest.cameras]
    return np.abs(np.stack(estimates, axis=1) - truth[:, None])


def tracking_share(recordings: Recordings, camera: str) -> float:
    """Share of a camera's images in state TRACKING."""
    state = recordings[f"{camera}.state"]
    return float((state[state != State.NO_IMAGE] == State.TRACKING).mean())
