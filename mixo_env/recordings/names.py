"""Names that an expert from a file cannot have, because something else is called so."""

from __future__ import annotations

from mixo_env.nuscenes.selections import ALL_CAMERAS
from mixo_env.recordings.schema import INERTIAL_EXPERTS, STEP_COLUMNS, TRACKS

ROWS = (
    "HIGHEST MATCH",
    "MEAN",
    "MEDIAN",
    "LINEAR",
    "HUBER",
    "MIXO",
    "PPO",
    "MULTICAMERA GT",
    "ORACLE ALL",
    "ORACLE HULL",
    "NOISE FLOOR",
    "PERFECT YAW",
    "PERFECT YAW + TRUE DISTANCE",
)
"""Policies and floors of the leaderboard, which is above this floor: a test keeps the list complete."""


def _key(name: str) -> str:
    return "".join(filter(str.isalnum, name.casefold()))


_RESERVED = {
    _key(name)
    for name in (*ALL_CAMERAS, *INERTIAL_EXPERTS, *TRACKS, *ROWS, *(column.split(".")[0] for column in STEP_COLUMNS))
}


def is_reserved(name: str) -> bool:
    """Whether a name, however it is written, means something else already.

    That is a column such as ``truth`` or ``exact``, a camera of the rig, an inertial grade, a track, or another row of
    the leaderboard.
    """
    return _key(name) in _RESERVED
