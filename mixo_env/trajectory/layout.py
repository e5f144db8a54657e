"""Which files belong together: single files, folders of scenes, and the layout of rpg_trajectory_evaluation."""

from __future__ import annotations

import os
from pathlib import Path

from mixo_env.errors import TrajectoryError, printable
from mixo_env.trajectory.text import STANDARD_INPUT

RPG_TRUTH = "stamped_groundtruth.txt"
RPG_ESTIMATE = "stamped_traj_estimate.txt"

_SUFFIXES = (".txt", ".tum", ".kitti", ".csv")
_NOT_POSES = ("times", "timestamps", "readme", "calib")
_BESIDE = (".quality", ".times")
"""Ends of the names of files that stand beside a trajectory."""


def scene_files(path: Path, rpg_name: str) -> dict[str, Path]:
    """Scene name (printable) -> trajectory file.

    Args:
        path: a file, pipe or ``-`` (one scene, named by its stem); a folder of the rpg layout, or of such folders
            (each a scene named by its folder); or a folder of trajectory files (each a scene named by its stem).
        rpg_name: ``RPG_TRUTH`` or ``RPG_ESTIMATE``.

    Raises:
        TrajectoryError: when nothing of the kind is there.
    """
    if path == STANDARD_INPUT:
        return {"stdin": path}
    try:
        return _scene_files(path, rpg_name)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise TrajectoryError(
            f"{path}: expected a trajectory file or a folder of them, cannot look: {reason}"
        ) from None


def _scene_files(path: Path, rpg_name: str) -> dict[str, Path]:
    if not path.exists():
        raise TrajectoryError(f"{path}: expected a trajectory file or a folder of them, found nothing there")
    if not path.is_dir():  # a file, or a pipe as of the shell's <(...)
        return {printable(path.stem): path}
    if is_file(path / rpg_name):
        return {printable(path.name): path / rpg_name}
    nested = {printable(file.parent.name): file for file in sorted(path.glob(f"*/{rpg_name}"))}
    if nested:
        return nested
    files = _pose_files(path)
    if not files:
        raise TrajectoryError(
            f"{path}: expected trajectory files ({', '.join(_SUFFIXES)}) or folders with {rpg_name}, found none"
        )
    scenes = {printable(file.stem): file for file in files}
    if len(scenes) < len(files):
        raise TrajectoryError(f"{path}: expected one file per scene, two share a name; keep one suffix per folder")
    return scenes


def pair_scenes(truth: Path, estimate: Path) -> dict[str, tuple[Path, Path]]:
    """Scene name -> ground-truth file and estimate file.

    One scene on both sides pairs whatever the names; several must have the same names on both sides, so that every
    method is scored on the same scenes.

    Raises:
        TrajectoryError: when a scene is missing on one side.
    """
    truths, estimates = scene_files(truth, RPG_TRUTH), scene_files(estimate, RPG_ESTIMATE)
    if len(truths) == 1 and len(estimates) == 1:
        ((name, truth_file),) = truths.items()
        return {name: (truth_file, next(iter(estimates.values())))}
    for here, there, folder in ((truths, estimates, estimate), (estimates, truths, truth)):
        missing = sorted(here.keys() - there.keys())
        if missing:
            shown = ", ".join(missing[:5]) + (", ..." if len(missing) > 5 else "")
            raise TrajectoryError(
                f"{folder}: expected the {len(here)} scenes of the other side, {len(missing)} are missing: {shown}; "
                "every method is scored on the same scenes"
            )
    return {name: (truths[name], estimates[name]) for name in truths}


_EUROC = ("mav0/state_groundtruth_estimate0/data.csv", "state_groundtruth_estimate0/data.csv", "data.csv")
TRUTH_NAMES = ("groundtruth", "ground_truth", "gt", "truth", "poses", "stamped_groundtruth")
"""Names of the truth's file where a sequence's folder holds several."""


def sequence_files(path: Path, names: tuple[str, ...]) -> dict[str, Path]:
    """Sequence name (printable) -> trajectory file.

    Args:
        path: a file (one sequence, named by its stem); a folder with a file for every sequence; or a folder with a
            folder for every sequence, which holds the EuRoC layout, one file, or several of which one bears a name of
            ``names``.
        names: of that file, without its suffix, however it is spelt.

    Raises:
        TrajectoryError: when nothing of the kind is there, or a sequence's folder leaves open which file is meant.
    """
    try:
        folders = sorted(folder for folder in path.iterdir() if folder.is_dir()) if path.is_dir() else []
        found = {printable(folder.name): file for folder in folders if (file := _sequence_file(folder, names))}
        plain = path.is_dir() and not _pose_files(path)
    except (OSError, ValueError) as error:
        raise TrajectoryError(f"{path}: expected a folder of trajectories, cannot look: {error}") from None
    return found if found and plain else scene_files(path, RPG_ESTIMATE)


def _sequence_file(folder: Path, names: tuple[str, ...]) -> Path | None:
    """The trajectory in the folder of one sequence; ``None`` without any."""
    for inside in _EUROC:
        if is_file(folder / inside):
            return folder / inside
    files = _pose_files(folder)
    if len(files) <= 1:
        return files[0] if files else None
    wanted = {name.casefold() for name in names}
    named = [file for file in files if file.stem.casefold() in wanted]
    if len(named) == 1:
        return named[0]
    raise TrajectoryError(
        f"{folder}: expected one trajectory, or one named {names[0]}, got "
        f"{', '.join(printable(file.name) for file in files[:5])}{', ...' if len(files) > 5 else ''}"
    )


def _pose_files(folder: Path) -> list[Path]:
    """Files that may hold poses, in order of name.

    Raises:
        TrajectoryError: if a pipe, a device or a link to nothing bears such a name.
    """
    return [
        file
        for file in sorted(folder.iterdir())
        if file.suffix.lower() in _SUFFIXES
        and file.stem.lower() not in _NOT_POSES
        and not file.stem.lower().endswith(_BESIDE)
        and is_file(file)
    ]


def is_file(path: Path) -> bool:
    """Whether a file is there; a folder is none.

    Raises:
        TrajectoryError: if a pipe, a device or a link to nothing stands in its place: it would be waited for, read
            without end, or taken for absent.
    """
    if path.is_file():
        return True
    if os.path.lexists(path) and not path.is_dir():
        raise TrajectoryError(f"{path} is no file but a pipe, a device or a link to nothing: put the file there")
    return False
