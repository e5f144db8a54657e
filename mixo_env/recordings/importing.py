"""Experts from trajectory files, added to existing recordings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from mixo_env.errors import ConfigurationError, TrajectoryError
from mixo_env.experts.imported import imported_increments
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.names import is_reserved
from mixo_env.trajectory import Trajectory, read_trajectory
from mixo_env.trajectory.layout import RPG_ESTIMATE, scene_files
from mixo_env.trajectory.quaternions import QuaternionOrder

Axes = Literal["file", "vehicle", "camera"]
"""Axes of the poses: as the format defines them, z up, or x right, y down, z forward."""

TIMES_SUFFIX = ".times"
"""KITTI files hold no times: ``scene-0061.times`` beside ``scene-0061.txt`` has one in Unix seconds a line."""


def read_trajectories(
    folder: Path, axes: Axes = "file", quaternions: QuaternionOrder = "file"
) -> dict[str, Trajectory]:
    """Scene name -> trajectory, from files named after the scenes.

    Args:
        folder: with ``scene-0061.txt`` (TUM, EuRoC, KITTI) and so on.
        axes: ``"camera"`` for TUM files of programs that write camera poses, as most visual SLAM does.
        quaternions: their order in files that do not tell it.

    Raises:
        TrajectoryError: if there are no such files or one of them cannot be read.
    """
    trajectories = {}
    for scene, path in scene_files(folder, RPG_ESTIMATE).items():
        times = path.with_suffix(TIMES_SUFFIX)
        trajectory = read_trajectory(path, times if times.exists() else None, quaternions)
        trajectories[scene] = trajectory if axes == "file" else replace(trajectory, camera_axes=axes == "camera")
    return trajectories


def with_imported(recordings: Recordings, expert: str, trajectories: Mapping[str, Trajectory]) -> Recordings:
    """The recordings with one more expert; LINEAR and the reward scale are fitted anew.

    Its increments are NaN in scenes without a trajectory. Match counts and states are absent: a file has none.

    Args:
        recordings: to be extended.
        expert: name of the new expert.
        trajectories: by scene; other scenes than those recorded are left out.

    Raises:
        ConfigurationError: for a name that is taken or cannot be a column.
        TrajectoryError: if no trajectory belongs to a recorded scene, or the times of one do not fit.
    """
    if not re.fullmatch(r"[A-Za-z][\w+-]*", expert):
        raise ConfigurationError(f"expected a name of letters, digits, _, + and - for the expert, got {expert!r}")
    if expert.casefold() in {name.casefold() for name in recordings.experts}:
        raise ConfigurationError(f"expert {expert!r} is already there: choose another name")
    if is_reserved(expert):
        raise ConfigurationError(f"{expert!r} is the name of something else here: choose another name for the expert")
    names = [scene.name for scene in recordings.scenes]
    used = [name for name in names if name in trajectories]
    if not used:
        raise TrajectoryError(
            f"expected trajectories named after scenes like {names[0]}, got {', '.join(sorted(trajectories)[:3])}"
        )
    increments = np.full(len(recordings["step"]), np.nan, np.float32)
    for name in used:
        i = recordings.index(name)
        rows = slice(recordings.offsets[i], recordings.offsets[i + 1])
        try:
            increments[rows] = imported_increments(trajectories[name], recordings["timestamp_us"][rows])
        except TrajectoryError as error:
            raise TrajectoryError(f"{expert}, {name}: {error}") from None
    manifest = replace(recordings.manifest, imported=(*recordings.manifest.imported, expert))
    return with_fits(recordings.replace(manifest, {f"{expert}.yaw_increment_rad": increments}))
