"""The paper's clock: ground truth at key frames only (2 Hz), steps in between added up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import RecordingError
from mixo_env.experts.expert import State
from mixo_env.recordings.carry import carry, own_windows
from mixo_env.recordings.collection import Column, Recordings
from mixo_env.recordings.fitting import with_fits

_SUMMED = ("yaw_increment_rad", "distance_m", "dt_s", "own_window_s")
_AVERAGED = ("matches", "inliers", "residual_px", "flow_px")


def at_keyframes(recordings: Recordings) -> Recordings:
    """The recordings with one step from key frame to key frame, as with ``ground_truth="keyframes"`` in the paper.

    Increments, distances and times add up; one that is missing in between leaves the whole step without, and its
    camera LOST if it was lost in between, INITIALISING if that is all it did, else NO_IMAGE: a missed image is no lost
    track. What one carried increment of a camera takes off at its start, the one before has added at its end: of a sum
    only both ends are carried, and its standard deviation is told anew from the own windows. Variances of inertial
    experts add up, counts and pixels are averaged, everything else is taken at the key frame. What was recorded before
    a scene's first and after its last key frame is left out. LINEAR and the reward scale are fitted anew.

    Raises:
        RecordingError: if a scene has fewer than two key frames, or for recordings without own-window columns.
    """
    scenes, kept, row_of_step = [], [], []
    for i, scene in enumerate(recordings.scenes):
        rows = recordings.offsets[i] + np.flatnonzero(recordings.rows(i)["is_keyframe"])
        if len(rows) < 2:
            raise RecordingError(f"{scene.name}: expected at least 2 key frames, got {len(rows)}: select other scenes")
        scenes.append(replace(scene, rows=len(rows), values_hash=""))
        kept.append(rows)
        row_of_step.append(rows[0])
    keep, first = np.concatenate(kept), np.array(row_of_step)
    starts = np.isin(keep, first)

    def summed(values: Column) -> Column:
        """Sum over (previous key frame, this one]; NaN in a scene's first row."""
        known = np.isfinite(values)
        total = np.cumsum(np.where(known, values, 0.0), dtype=np.float64)[keep]
        unknown = np.cumsum(~known)[keep]
        steps = np.diff(total, prepend=0.0)
        steps[np.diff(unknown, prepend=0) > 0] = np.nan
        steps[starts] = np.nan
        return steps

    columns: dict[str, Column] = {}
    for name in recordings.column_names:
        values, short = recordings[name], name.rpartition(".")[2]
        if short.endswith(_SUMMED):
            result = summed(values)
        elif short.endswith("yaw_std_rad"):
            result = np.sqrt(summed(np.square(values, dtype=np.float64)))
        elif short in _AVERAGED:
            result = summed(values) / np.diff(keep, prepend=keep[0] - 1).clip(1)
        else:
            result = values[keep]
        columns[name] = result.astype(values.dtype)
    columns["step"] = np.concatenate([np.arange(scene.rows, dtype=np.int32) for scene in scenes])
    columns["dt_s"][starts] = 0.0
    columns["time_s"] = columns["time_s"] - np.repeat(columns["time_s"][starts], [scene.rows for scene in scenes])
    columns |= _camera_stds(recordings, kept)
    for camera in (*recordings.manifest.cameras, *recordings.manifest.variants, *recordings.manifest.imported):
        state = columns[f"{camera}.state"]
        complete = np.isfinite(columns[f"{camera}.yaw_increment_rad"])
        lost, begun = (_any(recordings[f"{camera}.state"] == which, keep) for which in (State.LOST, State.INITIALISING))
        broken = np.where(lost, State.LOST, np.where(begun, State.INITIALISING, State.NO_IMAGE))
        state[~starts] = np.where(complete, State.TRACKING, broken)[~starts]
    return with_fits(Recordings(replace(recordings.manifest, scenes=tuple(scenes)), columns))


def _any(happened: NDArray[np.bool_], keep: NDArray[np.int64]) -> NDArray[np.bool_]:
    """``(len(keep),)`` whether it happened in any row after the kept one before, up to this one."""
    return np.diff(np.cumsum(happened)[keep], prepend=0) > 0


def _camera_stds(recordings: Recordings, keyframes: Sequence[NDArray[np.int64]]) -> dict[str, Column]:
    """Standard deviations of the cameras' summed increments, carried and over their own windows.

    Args:
        recordings: at the full rate.
        keyframes: by scene, its rows among all rows.
    """
    experts: Mapping[str, str] = {camera: camera for camera in recordings.manifest.cameras}
    experts |= recordings.manifest.variants
    stds: dict[str, Column] = {}
    for expert, camera in experts.items():
        carried, own = [], []
        for i, rows in enumerate(keyframes):
            windows = own_windows(recordings.rows(i), expert, camera)
            closing = rows - recordings.offsets[i]
            carried.append(carry(windows, closing)[1])
            own.append(carry(replace(windows, tail_s=np.zeros_like(windows.tail_s)), closing)[1])
        for name, values in (("yaw_std_rad", carried), ("own_window_yaw_std_rad", own)):
            stds[f"{expert}.{name}"] = np.concatenate(values).astype(recordings[f"{expert}.{name}"].dtype)
    return stds
