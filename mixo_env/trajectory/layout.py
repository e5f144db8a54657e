"""Which files belong together: single files, folders of scenes, and the layout of rpg_trajectory_evaluation."""

from __future__ import annotations

from pathlib import Path

from mixo_env.errors import TrajectoryError, printable
from mixo_env.trajectory.text import STANDARD_INPUT

RPG_TRUTH = "stamped_groundtruth.txt"
RPG_ESTIMATE = "stamped_traj_estimate.txt"

_SUFFIXES = (".txt", ".tum", ".kitti", ".csv")
_NOT_POSES = ("times", "timestamps")


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
    if (path / rpg_name).is_file():
        return {printable(path.name): path / rpg_name}
    nested = {printable(file.parent.name): file for file in sorted(path.glob(f"*/{rpg_name}"))}
    if nested:
        return nested
    files = [
        file
        for file in sorted(path.iterdir())
        if file.is_file() and file.suffix.lower() in _SUFFIXES and file.stem.lower() not in _NOT_POSES
    ]
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
