"""Whom a row prefers in which manoeuvre: its weights while the car drives straight, left, right or stands.

The paper's gate sees the previous yaw rate, the speed and the cameras' matches so that it can prefer cameras by what
the car is doing. Here that is looked at, on scenes that were held out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.replay import Replay
from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.crossvalidation import UNFOLDED, CrossValidation, Run
from mixo_env.leaderboard.firing_order import MOVING_MPS
from mixo_env.metrics.bootstrap import RESAMPLES, resampled_means
from mixo_env.policies.playing import play
from mixo_env.policies.policy import Policy
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import truths_of, with_truth

MANOEUVRES = ("straight", "left", "right", "standing")

TURNING_RADPS = 0.05
"""3 degrees a second: what `mixo inspect` takes for a turn as well."""


@dataclass(frozen=True)
class Preference:
    """Weights of one row by manoeuvre, on steps in which every expert gives an increment; intervals over logs.

    Attributes:
        row: its name.
        experts: in the order of the weights.
        steps: ``(manoeuvres,)`` number of steps.
        mean: ``(manoeuvres, experts)``; NaN where there is no step.
        change: ``(3, manoeuvres, experts)`` difference to ``straight``, and its 95 % interval: low, high.
        rms_deg: ``(manoeuvres,)`` RMS error of the row's yaw increment.
    """

    row: str
    experts: tuple[str, ...]
    steps: NDArray[np.int64]
    mean: FloatArray
    change: FloatArray
    rms_deg: FloatArray

    @property
    def changed(self) -> NDArray[np.bool_]:
        """``(manoeuvres, experts)`` where the interval of the difference to ``straight`` excludes 0."""
        _, low, high = self.change
        return (low > 0.0) | (high < 0.0)


def manoeuvre_of(recordings: Recordings) -> NDArray[np.int64]:
    """Index in ``MANOEUVRES`` of every row by the truth that scores; row 0 of a scene, no step, counts as standing.

    Only for sorting results: policies see nothing of it.
    """
    judged = with_truth(recordings, truths_of(recordings)[0])
    dt_s = np.where(judged["dt_s"] > 0.0, judged["dt_s"], np.inf)
    rate = np.nan_to_num(judged["truth.yaw_increment_rad"]) / dt_s
    speed = np.abs(np.nan_to_num(judged["truth.distance_m"])) / dt_s
    turning = np.where(rate >= TURNING_RADPS, 1, np.where(rate <= -TURNING_RADPS, 2, 0))
    return np.where(speed < MOVING_MPS, 3, turning)


def played_weights(protocol: CrossValidation, run: Run, track: str) -> FloatArray:
    """``(rows, experts)`` weights of a row's policies, each on the scenes it was tested on; NaN elsewhere.

    Args:
        protocol: that made the run.
        run: with policies, of the first seed; none of a floor.
        track: as played.
    """
    recordings = with_truth(protocol.recordings, protocol.truths[0]) if run.privileged else protocol.recordings
    weights = np.full((recordings.offsets[-1], len(recordings.voters(track))), np.nan)
    for fold, policy in run.policies.items():
        here = [scene.name for scene in recordings.scenes if fold in (UNFOLDED, scene.fold)]
        rows = np.repeat([scene.name in here for scene in recordings.scenes], np.diff(recordings.offsets))
        weights[rows] = weights_of(policy, recordings.select(scenes=here), track, privileged=run.privileged)
    return weights


def weights_of(policy: Policy, recordings: Recordings, track: str, *, privileged: bool = False) -> FloatArray:
    """``(rows, experts)`` weights of a prepared policy that plays these scenes; NaN in row 0 of each."""
    weights = np.full((recordings.offsets[-1], len(recordings.voters(track))), np.nan)
    row = recordings.offsets[:-1].copy()
    for active, _, given in play(policy, Replay(recordings, track=track, privileged=privileged)):
        row[active] += 1
        weights[row[active]] = given[active]
    return weights


def preference(row: str, weights: FloatArray, error_rad: FloatArray, recordings: Recordings, track: str) -> Preference:
    """Sort a row's weights and errors by manoeuvre.

    Args:
        row: its name.
        weights: ``(rows, experts)``; NaN in rows that do not count.
        error_rad: ``(rows,)`` of the row's yaw increments.
        recordings: the scenes.
        track: whose experts vote.
    """
    experts = recordings.voters(track)
    given = np.all([np.isfinite(recordings[f"{expert}.yaw_increment_rad"]) for expert in experts], axis=0)
    counts_here = given & np.isfinite(weights).all(axis=1) & np.isfinite(error_rad)
    manoeuvre = manoeuvre_of(recordings)
    names, log_of_scene = np.unique([scene.log for scene in recordings.scenes], return_inverse=True)
    log = np.repeat(log_of_scene, np.diff(recordings.offsets))
    sums = np.zeros((len(names), len(MANOEUVRES), len(experts)))
    counts, squares = np.zeros((2, len(names), len(MANOEUVRES)))
    at = log[counts_here], manoeuvre[counts_here]
    np.add.at(sums, at, weights[counts_here])
    np.add.at(counts, at, 1.0)
    np.add.at(squares, at, np.degrees(error_rad[counts_here]) ** 2)
    steps = counts.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = sums.sum(axis=0) / steps[:, None]
        change = np.full((3, *mean.shape), np.nan)
        change[0] = mean - mean[0]
        straight, *others = (resampled_means(sums[:, k], counts[:, k], RESAMPLES, 0) for k in range(len(MANOEUVRES)))
        for k, drawn in enumerate(others, start=1):
            if steps[k] and steps[0] and len(drawn):
                change[1:, k] = np.nanquantile(drawn - straight, [0.025, 0.975], axis=0)
        change[1:, 0] = change[0, 0]
        rms_deg = np.sqrt(squares.sum(axis=0) / steps)
    return Preference(row, experts, steps.astype(np.int64), mean, change, rms_deg)
