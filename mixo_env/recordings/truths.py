"""The truths a recording holds, which of them scores, and what of them a policy may see.

``exact`` is a simulator's noise-free truth, ``truth`` the poses without their vehicle's lag, ``written`` the poses as
the data set has them. The first one that exists is the *headline*.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mixo_env.errors import ConfigurationError, unknown
from mixo_env.recordings.collection import Column, Recordings
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.pose_lag import lag_corrected

TRUTHS = ("exact", "truth", "written")
"""The headline is the first that exists."""

POSES = ("x_m", "y_m", "yaw_rad")


def truths_of(recordings: Recordings) -> tuple[str, ...]:
    """Those that hold a pose in every row, the headline first."""
    return tuple(
        truth
        for truth in TRUTHS
        if all(f"{truth}.{n}" in recordings and np.isfinite(recordings[f"{truth}.{n}"]).all() for n in POSES)
    )


def with_truth(recordings: Recordings, truth: str) -> Recordings:
    """The recordings with another truth in their ``truth.*`` columns: what a privileged policy and a floor then read.

    Raises:
        ConfigurationError: for a truth these recordings do not hold.
    """
    if truth == "truth":
        return recordings
    if truth not in truths_of(recordings):
        raise ConfigurationError(unknown("truth", truth, truths_of(recordings)))
    x, y, yaw = (recordings[f"{truth}.{name}"].astype(np.float64) for name in POSES)
    dx, dy, turn = (np.diff(values, prepend=np.nan) for values in (x, y, yaw))
    middle = yaw - 0.5 * turn
    distance = np.copysign(np.hypot(dx, dy), dx * np.cos(middle) + dy * np.sin(middle))
    for values in (turn, distance):
        values[recordings.offsets[:-1]] = np.nan
    columns: dict[str, Column] = {
        "truth.x_m": x,
        "truth.y_m": y,
        "truth.yaw_rad": yaw,
        "truth.yaw_increment_rad": turn,
        "truth.distance_m": distance,
    }
    return recordings.replace(columns=columns)


def for_learning(training: Recordings) -> Recordings:
    """What a policy is fitted on: training scenes with poses free of lag and no others, in arrays of their own.

    Exact and raw poses are taken out, and the manifest tells of no lag any more, lest it be removed twice. Its
    statistics (LINEAR's weights, the scale of the reward) are those of these scenes alone; as recorded they have seen
    every scene.
    """
    corrected = training if "written.x_m" in training else lag_corrected(training)
    before = training.manifest
    columns = {name: corrected[name].copy() for name in corrected.column_names if not _hidden(name, before.imported)}
    vehicles = {name: replace(constants, pose_lag_s=0.0) for name, constants in before.vehicles.items()}
    manifest = replace(before, vehicles=vehicles, parameters={}, linear_weights={}, reward_scale_rad={})
    return with_fits(Recordings(manifest, columns))


def _hidden(column: str, imported: tuple[str, ...]) -> bool:
    """Whether a column tells of the exact or of the raw poses."""
    owner, _, name = column.rpartition(".")
    if owner in imported:
        return False
    return owner in ("exact", "written") or "exact" in name or "written" in name
