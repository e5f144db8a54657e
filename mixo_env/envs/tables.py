"""Static tables of a recording, in the form the fusion core reads: who votes, what they say, what each step is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.stepping import DISTANCE, DT, LINEAR_ERROR, SUBSTITUTE, TRUE_X, TRUE_Y, TRUE_YAW, TRUTH
from mixo_env.errors import ConfigurationError, RecordingError, unknown
from mixo_env.fusion import mix
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.vehicles import travelled_m
from mixo_env.recordings.votes import substitutes_rad

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

    What stands in for those that delivered nothing is :func:`~mixo_env.recordings.votes.substitutes_rad`.
    """
    substitute = substitutes_rad(recordings, track)[steps]
    names = [f"{e}.{camera_increments if e in cameras else 'yaw_increment_rad'}" for e in experts]
    increments = np.stack([recordings[name][steps] for name in names], axis=-1).astype(np.float64)
    available = np.isfinite(increments)
    return Votes(np.where(available, increments, substitute[:, None]), available, substitute)


def tabulate_steps(
    recordings: Recordings,
    steps: NDArray[np.intp],
    start: FloatArray,
    votes: Votes,
    mask: bool,
    linear: FloatArray | None = None,
) -> FloatArray:
    """The table of steps, columns as in :mod:`mixo_env.envs.stepping`.

    Args:
        recordings: where everything comes from.
        steps: ``(rows,)`` its rows that are steps.
        start: ``(scenes, 3)`` x [m], y [m], yaw [rad] of every scene's first pose.
        votes: of those rows.
        mask: experts without an increment do not vote (otherwise the substitute votes in their place).
        linear: ``(experts,)`` weights of LINEAR, where its error is wanted.

    Raises:
        RecordingError: for a step without duration or distance.
    """
    lengths = [scene.rows - 1 for scene in recordings.scenes]
    x, y, yaw = np.repeat(start, lengths, axis=0).T
    truth = recordings["truth.yaw_increment_rad"][steps]
    columns = {
        SUBSTITUTE: votes.substitute_rad,
        DT: recordings["dt_s"][steps],
        DISTANCE: travelled_m(recordings)[steps],
        LINEAR_ERROR: np.zeros(len(steps)) if linear is None else mix(linear, votes.increments_rad) - truth,
        TRUTH: truth,
        TRUE_YAW: recordings["truth.yaw_rad"][steps] - yaw,
        TRUE_X: recordings["truth.x_m"][steps] - x,
        TRUE_Y: recordings["truth.y_m"][steps] - y,
    }
    for name, wrong in (("dt_s", ~(columns[DT] > 0.0)), ("distance_m", ~np.isfinite(columns[DISTANCE]))):
        if wrong.any():
            row = int(np.argmax(wrong))
            scene = int(np.searchsorted(np.cumsum(lengths), row, side="right"))
            raise RecordingError(
                f"{recordings.scenes[scene].name}: expected a usable {name} in every step, got "
                f"{recordings[name][steps[row]]} in row {steps[row] - recordings.offsets[scene]}: record or import anew"
            )
    experts = np.where(votes.available | (not mask), votes.increments_rad, np.nan)
    return np.column_stack([*(columns[c] for c in sorted(columns)), experts])
