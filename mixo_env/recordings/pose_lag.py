"""Written poses, moved to the time for which they hold.

A localisation reports late: what is written at t is where the car was at t - lag (15 to 45 ms on real cars, see
docs/metrics.md). The lag is a constant of the vehicle (:mod:`mixo_env.recordings.pose_lag_fit`); what a policy is
trained on and scored against are poses read at t + lag.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import RecordingError
from mixo_env.recordings.collection import Column, Recordings
from mixo_env.recordings.pose_curve import Curve
from mixo_env.recordings.schema import VehicleConstants
from mixo_env.recordings.truth import signed_chords

POSES = ("x_m", "y_m", "yaw_rad", "yaw_increment_rad", "distance_m")
"""The ``truth.*`` columns; corrected recordings keep what was written as ``written.*``."""

EARLIEST_S, LATEST_S = -0.05, 0.15
"""Lags that can be true; 0.15 s is three periods of the slowest localisation that nuScenes writes."""


def lag_corrected(recordings: Recordings) -> Recordings:
    """The recordings with ``truth.*`` and the cameras' own truth read at t + lag of each scene's vehicle.

    The poses as written stay beside them (:func:`as_written`), and are what is corrected if this was done before:
    applying it twice, or with other constants, is safe. ``exact.*`` is untouched; so is every bit of a scene whose lag
    is 0. Past the last pose the last rate goes on, for at most the lag.

    Raises:
        RecordingError: a lag in the manifest lies outside -50 to 150 ms.
    """
    written = as_written(recordings)
    lag_s = pose_lags_s(recordings)
    late = np.flatnonzero(lag_s)
    if len(late) == 0:
        return written
    changed: dict[str, Column] = {f"truth.{name}": written[f"truth.{name}"].copy() for name in POSES}
    x, y, yaw, increment, distance = changed.values()
    curve = Curve(written, written["truth.yaw_rad"])
    at = written["time_s"] + lag_s
    position = Curve(written, written["truth.x_m"] + 1j * written["truth.y_m"]).at(at[late], late)
    x[late], y[late], yaw[late] = position.real, position.imag, curve.at(at[late], late)
    steps = np.setdiff1d(late, written.offsets[:-1])
    increment[steps] = yaw[steps] - yaw[steps - 1]
    distance[steps] = signed_chords(x, y, yaw)[steps - 1]

    kept = {f"written.{name}": written[f"truth.{name}"] for name in POSES}
    for camera in written.manifest.cameras:
        name = _own_truth(camera)
        kept[_own_written(camera)] = written[name]
        own = changed[name] = written[name].copy()
        end = at + written[f"{camera}.image_time_offset_s"]
        begin = end - written[f"{camera}.own_window_s"]
        rows = late[np.isfinite(own[late] + begin[late])]
        own[rows] = curve.at(end[rows], rows) - curve.at(begin[rows], rows)
    return written.replace(columns=changed | kept)


def as_written(recordings: Recordings) -> Recordings:
    """The recordings with the poses as they were written: what :func:`lag_corrected` was given.

    Poses that were never corrected are returned as they are.
    """
    if "written.x_m" not in recordings:
        return recordings
    columns = {name: recordings[name] for name in recordings.column_names}
    for name in POSES:
        columns[f"truth.{name}"] = columns.pop(f"written.{name}")
    for camera in recordings.manifest.cameras:
        columns[_own_truth(camera)] = columns.pop(_own_written(camera))
    return Recordings(recordings.manifest, columns)


def pose_lags_s(recordings: Recordings) -> NDArray[np.float64]:
    """``(rows,)`` lag of the poses of each scene's vehicle, from the manifest; 0 for a vehicle without constants.

    Raises:
        RecordingError: it is no number, or outside -50 to 150 ms.
    """
    vehicles = recordings.manifest.vehicles
    lags = [vehicles.get(scene.vehicle, VehicleConstants()).pose_lag_s for scene in recordings.scenes]
    for scene, lag in zip(recordings.scenes, lags, strict=True):
        if not EARLIEST_S <= lag <= LATEST_S:
            raise RecordingError(
                f"pose_lag_s of vehicle {scene.vehicle!r}: expected {EARLIEST_S:g} to {LATEST_S:g} s, got {lag:g}: "
                "correct it in the manifest, or record anew"
            )
    return np.repeat(np.array(lags, dtype=np.float64), np.diff(recordings.offsets))


def _own_truth(camera: str) -> str:
    return f"{camera}.own_window_truth_yaw_increment_rad"


def _own_written(camera: str) -> str:
    return f"{camera}.own_window_written_yaw_increment_rad"
