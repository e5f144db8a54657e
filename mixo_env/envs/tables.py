"""Static tables of a recording, in the form the fusion core reads: who votes, what they say, what each step is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.stepping import STEP
from mixo_env.errors import ConfigurationError, RecordingError, unknown
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import TRACKS, VehicleConstants

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Votes:
    """What the experts say at every step of a recording (row 0 of each scene left out).

    Attributes:
        increments_rad: ``(rows, experts)``; the substitute where the expert delivered nothing.
        available: ``(rows, experts)`` bool; the expert delivered an increment of its own.
        substitute_rad: ``(rows,)`` increment that stands in for experts that delivered nothing.
    """

    increments_rad: FloatArray
    available: NDArray[np.bool_]
    substitute_rad: FloatArray


def step_rows(recordings: Recordings) -> NDArray[np.intp]:
    """Rows of the recordings that are steps: all but row 0 of each scene."""
    return np.delete(np.arange(recordings.offsets[-1]), recordings.offsets[:-1])


def choose_experts(recordings: Recordings, track: str, experts: Sequence[str] | None) -> tuple[str, ...]:
    """The track's voters, or those asked for in the order asked for."""
    voters = recordings.voters(track)
    if experts is None:
        return voters
    chosen = tuple(experts)
    for expert in chosen:
        if expert not in recordings.experts:
            raise ConfigurationError(unknown("expert", expert, recordings.experts))
    if not chosen or len(set(chosen)) < len(chosen):
        raise ConfigurationError(
            f"expected different experts among {', '.join(voters)}, got {', '.join(chosen) or 'none'}"
        )
    return chosen


def collect_votes(
    recordings: Recordings,
    steps: NDArray[np.intp],
    experts: tuple[str, ...],
    cameras: tuple[str, ...],
    track: str,
    camera_increments: str,
) -> Votes:
    """Increments of ``experts`` at ``steps``.

    The substitute is the track's own inertial expert; where that has nothing either, INERTIAL; else no rotation.
    """
    substitute = np.zeros(len(steps))
    for inertial in ("INERTIAL", TRACKS[track]):
        if inertial in recordings.manifest.inertial:
            own = recordings[f"{inertial}.yaw_increment_rad"][steps]
            substitute = np.where(np.isfinite(own), own.astype(np.float64), substitute)
    names = [f"{e}.{camera_increments if e in cameras else 'yaw_increment_rad'}" for e in experts]
    increments = np.stack([recordings[name][steps] for name in names], axis=-1).astype(np.float64)
    available = np.isfinite(increments)
    return Votes(np.where(available, increments, substitute[:, None]), available, substitute)


def tabulate_steps(
    recordings: Recordings, steps: NDArray[np.intp], start: FloatArray, substitute_rad: FloatArray
) -> NDArray[Any]:
    """The STEP table ``(rows,)``; ``start`` holds x, y, yaw ``(scenes, 3)`` of every scene's first pose."""
    lengths = [scene.rows - 1 for scene in recordings.scenes]
    constants = [recordings.manifest.vehicles.get(scene.vehicle, VehicleConstants()) for scene in recordings.scenes]
    table = np.zeros(len(steps), STEP)
    table["substitute_rad"] = substitute_rad
    table["dt_s"] = recordings["dt_s"][steps]
    table["distance_m"] = recordings["distance_m"][steps] * np.repeat([c.wheel_scale for c in constants], lengths)
    table["truth_rad"] = recordings["truth.yaw_increment_rad"][steps]
    x, y, yaw = np.repeat(start, lengths, axis=0).T
    table["truth_x_m"] = recordings["truth.x_m"][steps] - x
    table["truth_y_m"] = recordings["truth.y_m"][steps] - y
    table["truth_yaw_rad"] = recordings["truth.yaw_rad"][steps] - yaw
    for name, wrong in (("dt_s", ~(table["dt_s"] > 0.0)), ("distance_m", ~np.isfinite(table["distance_m"]))):
        if wrong.any():
            row = int(np.argmax(wrong))
            scene = int(np.searchsorted(np.cumsum(lengths), row, side="right"))
            raise RecordingError(
                f"{recordings.scenes[scene].name}: expected a usable {name} in every step, got {table[name][row]} in "
                f"row {steps[row] - recordings.offsets[scene]}: record or import the scene anew"
            )
    return table
