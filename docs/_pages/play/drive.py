"""The numbers behind the page: what every expert claimed, what is true, and the weights of the rows to beat."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from mixo_env.envs.replay import Replay
from mixo_env.envs.stepping import DISTANCE, DT, SUBSTITUTE, TRUE_X, TRUE_Y, TRUE_YAW, TRUTH
from mixo_env.errors import RecordingError
from mixo_env.experts.expert import State
from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import Travel, poses
from mixo_env.metrics.pairs import find_pairs, path_length
from mixo_env.policies.fitting import prepare
from mixo_env.policies.playing import play
from mixo_env.policies.registry import create
from mixo_env.recordings.collection import Recordings
from mixo_env.trajectory.planar import PlanarPoses

ROWS = ("HUBER", "MIXO", "ORACLE HULL")
"""Rows to beat, and one that cannot be beaten: the best that shares of 100 % could do in each step."""

TURNING_RADPS = 0.05
"""A car that turns faster than this is turning; about 3 deg/s."""

STATE_LETTERS = {State.INITIALISING: "i", State.TRACKING: "t", State.LOST: "l", State.NO_IMAGE: "n"}


def telling_drive(recordings: Recordings, track: str) -> str:
    """Of the drives on which a camera is lost in a turn, that on which HUBER gains most on the front camera.

    The gain is the front camera's ATE of yaw minus HUBER's, learned on other logs.

    Raises:
        RecordingError: where no camera is ever lost in a turn.
    """
    protocol = CrossValidation(recordings)
    scored = protocol.recordings
    truth = PlanarPoses(*(scored[f"truth.{name}"].astype(np.float64) for name in ("x_m", "y_m", "yaw_rad")))
    front, huber = (yaw_errors_rad(scored, protocol.run(name, track).travel, truth) for name in ("CAM_FRONT", "HUBER"))
    lost = [_lost_in_a_turn(scored, *rows) for rows in itertools.pairwise(scored.offsets.tolist())]
    gain = np.where(lost, front - huber, -np.inf)
    if not np.isfinite(gain).any():
        raise RecordingError("no camera is lost in a turn of these recordings: name the scene to play")
    return scored.scenes[int(np.argmax(gain))].name


def yaw_errors_rad(recordings: Recordings, travel: Travel, truth: PlanarPoses) -> FloatArray:
    """``(scenes,)`` RMSE of yaw over the poses of every scene."""
    error = poses(travel, truth, recordings.offsets).yaw_rad - truth.yaw_rad
    return np.array([np.sqrt(np.mean(error[i:j] ** 2)) for i, j in itertools.pairwise(recordings.offsets.tolist())])


def _lost_in_a_turn(recordings: Recordings, first: int, stop: int) -> bool:
    rate = recordings["truth.yaw_increment_rad"][first + 1 : stop] / recordings["dt_s"][first + 1 : stop]
    lost = [recordings[f"{camera}.state"][first + 1 : stop] == State.LOST for camera in recordings.manifest.cameras]
    return bool((np.any(lost, axis=0) & (np.abs(rate) > TURNING_RADPS)).any())


def drive_json(recordings: Recordings, scene: str, track: str, rows: Sequence[str] = ROWS) -> dict[str, Any]:
    """One drive as the environment plays it, with the weights that ``rows`` give, fitted on the other folds.

    Numbers are those of the environment's tables to the last digit.

    Raises:
        RecordingError: for a scene that is in no fold.
    """
    fold = next((entry.fold for entry in recordings.scenes if entry.name == scene), -1)
    if fold < 0:
        raise RecordingError(f"expected a scene that is in a fold, got {scene}: choose another")
    env: Any = gym.make("mixo_env:MixoOdometry-v0", recordings=recordings, track=track, split="test", fold=fold)
    session = env.unwrapped.session
    entry = next(one for one in session.recordings.scenes if one.name == scene)
    played = session.recordings.select(scenes=[scene])
    training = session.settings.open()[1]
    replay = Replay(played, track=track)
    table, start = replay.table, replay.starts[0]
    path_m = path_length(np.concatenate([[[0.0, 0.0]], table[:, [TRUE_X, TRUE_Y]]]))
    pairs = find_pairs(path_m)
    order = np.argsort(pairs.end, kind="stable")
    return {
        "scene": scene,
        "log": entry.log,
        "conditions": list(entry.conditions),
        "data": recordings.manifest.data_version,
        "track": track,
        "fold": fold,
        "experts": list(replay.experts),
        "course_rad": float(start["course_rad"]),
        "dt_s": table[:, DT].tolist(),
        "distance_m": table[:, DISTANCE].tolist(),
        "substitute_rad": table[:, SUBSTITUTE].tolist(),
        "claims_rad": [
            [claim if own else None for claim, own in zip(*step, strict=True)]
            for step in zip(replay.votes.increments_rad.tolist(), replay.votes.available.tolist(), strict=True)
        ],
        "states": {name: _states(played, name) for name in replay.experts if f"{name}.state" in played},
        "matches": {name: _matches(played, name) for name in replay.experts if f"{name}.matches" in played},
        "truth": {
            name: table[:, column].tolist()
            for name, column in (("increment_rad", TRUTH), ("yaw_rad", TRUE_YAW), ("x_m", TRUE_X), ("y_m", TRUE_Y))
        },
        "pieces": {
            "start": pairs.start[order].tolist(),
            "end": pairs.end[order].tolist(),
            "length_m": pairs.length_m[order].tolist(),
        },
        "rows": [_row(name, training, played, track) for name in rows],
    }


def _row(name: str, training: Recordings, played: Recordings, track: str) -> dict[str, Any]:
    """Name of a row, whether it knows the truth, and the weights ``(steps, experts)`` that it gives."""
    policy = create(name, training)
    prepare(policy, training, track)
    replay = Replay(played, track=track, privileged=policy.privileged)
    weights = [np.asarray(given, dtype=np.float64)[0].tolist() for _, _, given in play(policy, replay)]
    return {"name": name, "knows": policy.privileged, "weights": weights}


def _states(played: Recordings, expert: str) -> str:
    """A letter a step."""
    return "".join(STATE_LETTERS[State(int(state))] for state in played[f"{expert}.state"][1:])


def _matches(played: Recordings, expert: str) -> list[int]:
    return np.nan_to_num(played[f"{expert}.matches"][1:].astype(np.float64)).astype(np.int64).tolist()
