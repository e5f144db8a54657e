"""Reference rows of the paper's Table I: one camera under other circumstances. They are scored, but never vote.

A variant is the recording itself with some columns of one camera exchanged. So a policy, an environment or an
observation cannot meet one by accident: it has to be asked for. Experts of other families are recorded alike, but are
no such rows: they stand for themselves, in the track UNEQUAL.
"""

from __future__ import annotations

import itertools

import numpy as np

from mixo_env.experts.expert import State
from mixo_env.recordings.collection import Column, Recordings
from mixo_env.recordings.schema import VARIANT_COLUMNS

WITHOUT_INITIALISATION = "CAM_FRONT w/o inertial initialization"
"""The front camera with no yaw and no distance until it tracks for the first time in a scene (first row of Table I)."""


def variants(recordings: Recordings) -> dict[str, str]:
    """Variants that ``recordings`` can show: name -> camera, in the order of the cameras."""
    found = {name: of for name, of in recordings.manifest.variants.items() if name not in recordings.further}
    if "CAM_FRONT" in recordings.manifest.cameras:
        found[WITHOUT_INITIALISATION] = "CAM_FRONT"
    order = recordings.manifest.cameras.index
    return {name: found[name] for name in sorted(found, key=lambda name: order(found[name]))}


def as_variant(recordings: Recordings, name: str) -> Recordings:
    """The recordings with the columns of a variant in place of its camera's; the same for any other name."""
    if name == WITHOUT_INITIALISATION:
        return recordings.replace(columns=_without_initialisation(recordings, "CAM_FRONT"))
    camera = variants(recordings).get(name)
    return recordings.replace(
        columns={f"{camera}.{column}": recordings[f"{name}.{column}"] for column in VARIANT_COLUMNS if camera}
    )


def _without_initialisation(recordings: Recordings, camera: str) -> dict[str, Column]:
    """No turn, no distance and no change of speed in the steps before the camera's first TRACKING of each scene."""
    names = (f"{camera}.yaw_increment_rad", "distance_m", "speed_mps")
    increment, distance, speed = (recordings[name].copy() for name in names)
    for start, stop in itertools.pairwise(recordings.offsets):
        tracking = np.flatnonzero(recordings[f"{camera}.state"][start:stop] == State.TRACKING)
        first = start + int(tracking[0]) if len(tracking) else stop
        increment[start + 1 : first] = distance[start + 1 : first] = 0.0
        speed[start:first] = speed[first - 1]
    return dict(zip(names, (increment, distance, speed), strict=True))
