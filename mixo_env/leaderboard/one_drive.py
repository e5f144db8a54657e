"""One drive as a viewer shows it: the true way, those of experts and policies, weights, what cameras reported."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.drives import weights_of
from mixo_env.leaderboard.evaluation import Truth, poses
from mixo_env.leaderboard.trajectories import divided, runs
from mixo_env.policies.outside import Outside
from mixo_env.recordings.collection import Recordings


@dataclass(frozen=True)
class OneWay:
    """One row's way through the drive, in metres and radians of the map; row 0 is the true first pose.

    Attributes:
        name: of the expert, policy or floor.
        x_m, y_m, yaw_rad: ``(rows,)``.
        experts: who had a weight; empty for experts alone, floors and privileged rows.
        weights: ``(rows - 1, experts)`` of every step.
    """

    name: str
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray
    experts: tuple[str, ...]
    weights: FloatArray


@dataclass(frozen=True)
class OneDrive:
    """One scene, played by every expert alone and by policies that were fitted on other drives.

    Attributes:
        recordings: the scene alone, as the leaderboard scores it.
        track: who voted.
        truth: the headline's.
        ways: experts, then policies.
    """

    recordings: Recordings
    track: str
    truth: OneWay
    ways: tuple[OneWay, ...]

    @property
    def time_s(self) -> NDArray[np.float64]:
        """``(rows,)`` since the start of the scene."""
        return self.recordings["time_s"]

    def error_m(self, way: OneWay) -> FloatArray:
        """``(rows,)`` distance of a way from the true one."""
        return np.hypot(way.x_m - self.truth.x_m, way.y_m - self.truth.y_m)


def most_winding(recordings: Recordings) -> str:
    """The scene whose true heading covers the widest range: where odometries differ most."""
    starts = recordings.offsets[:-1]
    yaw = recordings["truth.yaw_rad"]
    turned = np.maximum.reduceat(yaw, starts) - np.minimum.reduceat(yaw, starts)
    return recordings.scenes[int(np.argmax(turned))].name


def protocol_of(
    recordings: Recordings, scene: str, track: str, policies: Sequence[Outside], seed: int
) -> CrossValidation:
    """Training and test scenes such that ``scene`` is tested; a scene outside all folds is out of distribution.

    Raises:
        ConfigurationError: for an unknown scene or track.
        PolicyError: when a frozen policy does not fit the recordings.
    """
    fold = recordings.scenes[recordings.index(scene)].fold
    folds = () if fold < 0 else (fold,)
    outside = fold < 0 and any(entry.fold >= 0 for entry in recordings.scenes)
    return divided(recordings, track, policies, folds=folds, seed=seed, out_of_distribution=outside)


def one_drive(
    recordings: Recordings,
    scene: str,
    track: str,
    policies: Sequence[Outside],
    *,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> OneDrive:
    """Play one scene as the leaderboard does.

    Args:
        recordings: all scenes; policies that learn are fitted on the folds that do not hold this one.
        scene: its name.
        track: who votes.
        policies: rows of the leaderboard or from outside.
        seed: of learned policies.
        progress: told what is about to run.

    Raises:
        ConfigurationError: for an unknown scene or track.
        PolicyError: when a policy does not fit the recordings.
    """
    protocol = protocol_of(recordings, scene, track, policies, seed)
    tested = protocol.recordings
    truth = Truth(tested, protocol.truths[0])
    i, alone = tested.index(scene), tested.select(scenes=[scene])
    rows = slice(*tested.offsets[i : i + 2])
    fused = {policy.name for policy in policies}
    ways = []
    for run in runs(protocol, track, policies, progress):
        way = poses(run.travel, truth.poses, truth.offsets)
        experts, weights = weights_of(run, alone, track) if run.name in fused else ((), {})
        given = weights.get(0, np.zeros((alone.offsets[-1] - 1, 0)))
        ways.append(OneWay(run.name, way.x_m[rows], way.y_m[rows], way.yaw_rad[rows], tuple(experts), given))
    true = truth.poses
    nothing = np.zeros((alone.offsets[-1] - 1, 0))
    return OneDrive(
        alone, track, OneWay("truth", true.x_m[rows], true.y_m[rows], true.yaw_rad[rows], (), nothing), tuple(ways)
    )
