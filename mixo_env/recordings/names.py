"""Names that an expert from a file cannot have, because something else is called so."""

from __future__ import annotations

import re
from collections.abc import Collection

from mixo_env.errors import ConfigurationError
from mixo_env.nuscenes.selections import ALL_CAMERAS
from mixo_env.recordings.schema import INERTIAL_EXPERTS, STEP_COLUMNS, TRACKS

ROWS = (
    "JOINT",
    "HIGHEST MATCH",
    "MEAN",
    "MEDIAN",
    "LINEAR",
    "LINEAR SIMPLEX",
    "INVERSE VARIANCE",
    "COVARIANCE INTERSECTION",
    "HUBER",
    "STUDENT-T",
    "SOFTMIN",
    "FIXED SHARE",
    "BIAS FILTER",
    "TANDEM",
    "TOKEN",
    "TRIO",
    "LINEAR GATE",
    "MIXO",
    "PPO",
    "A2C",
    "SAC",
    "TD3",
    "DQN",
    "SMOOTHER (NON-CAUSAL)",
    "MULTICAMERA GT",
    "ORACLE ALL",
    "ORACLE HULL",
    "NOISE FLOOR",
    "PERFECT YAW",
    "PERFECT YAW + TRUE DISTANCE",
)
"""Policies and floors of the leaderboard, which is above this floor: a test keeps the list complete."""


CONSTANT_RATE = "CONSTANT_RATE"
"""The expert that `mixo import --constant-rate` makes of the others."""

GROUNDTRUTH = "groundtruth"
"""As `mixo import --axes` names the truth."""


def _key(name: str) -> str:
    return "".join(filter(str.isalnum, name.casefold()))


_RESERVED = {
    _key(name)
    for name in (
        *(*INERTIAL_EXPERTS, *TRACKS, *ROWS, CONSTANT_RATE, GROUNDTRUTH),
        *(column.split(".")[0] for column in STEP_COLUMNS),
    )
}


_CAMERAS = {_key(name) for name in ALL_CAMERAS}


def is_reserved(name: str) -> bool:
    """Whether a name, however it is written, means something else already.

    That is a column such as ``truth`` or ``exact``, an inertial grade, a track, or another row of the leaderboard. The
    name of a camera is free, written as the camera's own is: an odometry of that camera may bear it.
    """
    return _key(name) in _RESERVED or (_key(name) in _CAMERAS and name not in ALL_CAMERAS)


def check_expert_name(name: str, taken: Collection[str]) -> None:
    """Whether an expert from files may be called so.

    Raises:
        ConfigurationError: for a name that is no column, is reserved, or is among ``taken``.
    """
    if not re.fullmatch(r"[A-Za-z][\w+-]{0,63}", name, re.ASCII):
        raise ConfigurationError(
            f"expected a name of letters, digits, _, + and - (up to 64) for the expert, got {name!r}"
        )
    if name.casefold() in {other.casefold() for other in taken}:
        raise ConfigurationError(f"expert {name!r} is already there: choose another name, or --without {name}")
    if is_reserved(name):
        raise ConfigurationError(f"{name!r} is the name of something else here: choose another name for the expert")
