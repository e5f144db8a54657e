"""Which reward of the environment agrees with the ranking? Rows that need no training by reward, judged by each.

    python -m experiments.rl_rewards

Every row is played on every held-out fold; Kendall's tau compares its mean reward of a step with its errors.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.situation_shares import kendall_tau
from experiments.studies import print_study
from mixo_env.envs.stepping import CAP
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.leaderboard.evaluation import Truth, poses, rollout
from mixo_env.leaderboard.held_out import hold_out
from mixo_env.policies.fitting import prepare
from mixo_env.policies.policy import Policy
from mixo_env.policies.registry import create, names
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.presets import data_label
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import for_learning
from mixo_env.tables import Cell, Column, Table

REWARDS = ("squared", "abs", "pose")
"""``improvement`` is ``squared`` plus what no row can change."""
ERRORS = ("yaw RMSE", "RTE", "ATE")
SLOW = ("TOKEN", "TANDEM", "TRIO", "PPO", "A2C", "SAC", "TD3", "DQN")


@dataclass(frozen=True)
class Judged:
    """A row on one fold: mean reward of a step by option, and errors in the order of ERRORS [deg, deg/m, m]."""

    rewards: Mapping[str, float]
    errors: tuple[float, float, float]


def judge(policy: Policy, test: Recordings, track: str, sigma_rad: float) -> Judged:
    """Play a prepared policy; rewards as :func:`mixo_env.envs.stepping.judge` has them.

    Args:
        policy: ready.
        test: scenes with the truth that scores them.
        track: who votes.
        sigma_rad: unit of errors in rewards [rad].
    """
    truth = Truth(test)
    travel = rollout(policy, test, track)
    error = travel.yaw_increment_rad - test["truth.yaw_increment_rad"]
    units = np.minimum(np.abs(error[np.isfinite(error)]) / sigma_rad, CAP)
    way = poses(travel, truth.poses, test.offsets)
    apart_m2 = (way.x_m - truth.poses.x_m) ** 2 + (way.y_m - truth.poses.y_m) ** 2
    far = np.minimum(apart_m2[np.isfinite(error)], CAP**2)
    rewards = {"squared": -float(np.mean(units**2)), "abs": -float(units.mean()), "pose": -float(far.mean())}
    measured = truth.measure(travel)
    yaw_deg = float(np.sqrt(measured.squared_yaw_increment_deg2.sum() / measured.steps.sum()))
    rte = float(measured.relative.rotation_deg_per_m.mean())
    return Judged(rewards, (yaw_deg, rte, float(measured.absolute.translation_m.mean())))


@dataclass(frozen=True)
class RewardStudy:
    """Print how far each reward orders rows as each error does."""

    recordings: Path | None = None
    """Folder of recordings; default: the bundled ones."""
    tracks: tuple[str, ...] = ("CONSUMER", "VISION")
    """Who votes."""
    rows: tuple[str, ...] = ()
    """Of the leaderboard; empty: all that reads no truth and learns fast."""

    def run(self) -> Table:
        """Fit, play, compare."""
        recordings = load_recordings(self.recordings)
        folds = sorted({scene.fold for scene in recordings.scenes} - {-1})
        rows: list[list[Cell]] = []
        for track in self.tracks:
            means = self._means(recordings, track, folds)
            errors = -np.array([judged.errors for judged in means]).T
            scores = {reward: np.array([judged.rewards[reward] for judged in means]) for reward in REWARDS}
            for name, values in (scores | {"(RTE itself)": errors[ERRORS.index("RTE")]}).items():
                rows.append([track, name, len(means), *(kendall_tau(values, of_error) for of_error in errors)])
        caption = f"Kendall's tau of mean reward and error over rows, {data_label(recordings.manifest)}"
        columns = Column("track"), Column("reward"), Column("rows"), *(Column(name, "", ".2f") for name in ERRORS)
        return Table(caption, columns, rows)

    def _means(self, recordings: Recordings, track: str, folds: Sequence[int]) -> list[Judged]:
        """Of every row, the mean over folds."""
        if len(folds) < 2:
            raise ConfigurationError("expected recordings with two folds or more, got fewer: give such recordings")
        chosen = self.rows or _honest_and_fast(recordings, track)
        found: dict[str, list[Judged]] = {name: [] for name in chosen}
        for fold in folds:
            training, test = hold_out(recordings, fold)
            sigma_rad = for_learning(training).manifest.reward_scale_rad[track]
            for name in chosen:
                policy = create(name, recordings)
                try:
                    prepare(policy, training, track)
                    found[name].append(judge(policy, test, track, sigma_rad))
                except PolicyError as error:
                    logging.getLogger(__name__).info("%s left out: %s", name, error)
        return [mean(parts) for parts in found.values() if len(parts) == len(folds)]


def _honest_and_fast(recordings: Recordings, track: str) -> list[str]:
    """Voters alone, and every row that fuses, reads no truth and learns in seconds."""
    voters = recordings.voters(track)
    mine = [name for name in names(recordings) if name in voters or name not in recordings.experts]
    return [name for name in mine if name not in SLOW and not create(name, recordings).privileged]


def mean(parts: Sequence[Judged]) -> Judged:
    """Mean over folds."""
    rewards = {name: float(np.mean([part.rewards[name] for part in parts])) for name in REWARDS}
    errors: NDArray[np.float64] = np.mean([part.errors for part in parts], axis=0)
    return Judged(rewards, (float(errors[0]), float(errors[1]), float(errors[2])))


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; see :class:`RewardStudy`."""
    return print_study(RewardStudy, arguments)


if __name__ == "__main__":
    raise SystemExit(main())
