"""Scenes of a folder by the name of a selection: by condition, by motion, the paper's, or a split of the devkit.

The lists of the official splits are not in the tables and are not shipped here. They are read from ``splits.json`` in
the version folder (devkit 1.2 and later), or from the devkit itself where it is installed.
"""

from __future__ import annotations

import msgspec

from mixo_env.errors import ConfigurationError, DatasetError, unknown
from mixo_env.nuscenes.files import read_file
from mixo_env.nuscenes.selections import PAPER_SCENES, STANDING_M, paper_selection
from mixo_env.nuscenes.tables import Dataset

SELECTIONS = ("all", "day", "night", "rain", "moving", "paper736")
"""Selections that need no list."""


def chosen(dataset: Dataset, scenes: tuple[str, ...], selection: str) -> tuple[str, ...]:
    """The scenes a command works on: those named, which must be of the selection, else all of the selection.

    Raises:
        ConfigurationError: an unknown scene or selection, a scene outside the selection, or an empty selection.
        DatasetError: as :func:`select`.
    """
    names = select(dataset, selection)
    for name in scenes:
        dataset.position(name)
        if name not in names:
            raise ConfigurationError(f"{name} is not in the selection {selection!r}: leave one of the two out")
    if not names:
        raise ConfigurationError(f"no scene of {dataset.version} is in the selection {selection!r}: choose another")
    return scenes or names


def select(dataset: Dataset, selection: str) -> tuple[str, ...]:
    """Names of the scenes of a selection, in ascending order.

    Args:
        dataset: the folder.
        selection: one of ``SELECTIONS``, or the name of a split such as ``"val"``.

    Raises:
        ConfigurationError: no such selection, or a split whose list is not at hand.
        DatasetError: a list that cannot be read; ``paper736`` of anything but the full trainval set.
    """
    if selection == "all":
        return dataset.scene_names
    if selection in ("day", "night", "rain"):
        return tuple(scene.name for scene in dataset.scenes if selection in scene.conditions)
    if selection == "moving":
        # Not `>=`: a scene with a missing pose has no distance and is kept, for the checks to name it.
        return tuple(name for name in dataset.scene_names if not dataset.distance_m(name) < STANDING_M)
    if selection == "paper736":
        return _paper(dataset)
    splits = _splits(dataset)
    if selection not in splits:
        hint = "" if splits else "; official splits need splits.json beside the tables, or nuscenes-devkit installed"
        raise ConfigurationError(unknown("selection", selection, (*SELECTIONS, *splits)) + hint)
    return tuple(sorted(set(splits[selection]) & set(dataset.scene_names)))


def _paper(dataset: Dataset) -> tuple[str, ...]:
    """The paper's scenes, all of them or none."""
    names = paper_selection(dataset.scenes, dataset.version)
    if len(names) != PAPER_SCENES:
        raise DatasetError(
            f"paper736 is 850 scenes of v1.0-trainval less 99 by night and 15 without CAN bus; {dataset.version} in "
            f"{dataset.root} has {len(names)} such scenes: choose another selection, such as 'day'"
        )
    return names


def _splits(dataset: Dataset) -> dict[str, list[str]]:
    """Lists of scene names by split; empty where there is none."""
    path = dataset.root / dataset.version / "splits.json"
    try:
        return msgspec.json.decode(read_file(path), type=dict[str, list[str]])
    except FileNotFoundError:
        pass
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise DatasetError(f"{path} is no file of splits ({error}): expected lists of scene names by split") from None
    try:
        from nuscenes.utils.splits import create_splits_scenes  # pyright: ignore[reportMissingImports]
    except ImportError:
        return {}
    return create_splits_scenes()
