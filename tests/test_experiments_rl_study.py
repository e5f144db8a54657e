"""The study of agents: what a finished training is worth to the next run, and when a goal counts as reached."""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import experiments.rl_study as module
from experiments.rl_rewards import REWARDS, judge
from experiments.rl_study import RLStudy, main, reached, table
from experiments.rl_training import Point, Training
from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.held_out import hold_out
from mixo_env.policies.fitting import prepare
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.recordings.store import save_recordings
from mixo_env.recordings.truths import for_learning
from tests.synthetic import synthetic_recordings

pytestmark = pytest.mark.integration

CURVE = [Point(0, 0.0, 0.9, 0.9), Point(100, 1.0, 0.5, 0.8), Point(200, 2.0, 0.6, 0.2)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings")
    save_recordings(synthetic_recordings(scenes=4, steps=30), path)
    return path


def quick(folder: Path, kept: Path, **options: object) -> RLStudy:
    return RLStudy(folder, ("PPO",), ("CONSUMER",), seeds=2, steps=8192, every=4096, folder=kept, **options)  # type: ignore[arg-type]


def test_a_goal_is_reached_at_the_first_evaluation_that_is_as_good() -> None:
    training = Training(CURVE, 0.1)
    assert reached(training, (0.5, 0.2), 0) == CURVE[1]
    assert reached(training, (0.5, 0.2), 1) == CURVE[2]
    assert reached(training, (0.4, 0.1), 0) is None


def test_the_table_counts_the_seeds_that_reached_a_goal() -> None:
    late = Training([CURVE[0], CURVE[0], Point(200, 4.0, 0.9, 0.9)], 0.3)
    goals = {"CONSUMER": [module.Goals((0.5, 0.2), (0.1, 0.1))]}
    row = table({("CONSUMER", "PPO"): [Training(CURVE, 0.1), late]}, goals, "").rows[-1]
    assert row[4:6] == pytest.approx([0.75, 0.55])
    assert row[6:9] == pytest.approx([200, 3.0, 20.0])
    assert row[9] == "0 k, 1.0 s (1 of 2)"
    assert row[11] == "not reached"


def test_an_interrupted_study_keeps_finished_trainings(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, real = [], module.train

    def stops(*arguments: object) -> Training:
        calls.append(arguments[-1])
        if calls == [0, 1]:
            raise KeyboardInterrupt
        return real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "train", stops)
    study = quick(folder, tmp_path, out=tmp_path / "curves.png")
    with pytest.raises(KeyboardInterrupt):
        study.run()
    (kept,) = tmp_path.glob("*.json")
    before = kept.read_bytes()
    first = study.run()
    assert calls == [0, 1, 1]  # the finished one is not repeated
    assert kept.read_bytes() == before
    assert study.run() == first
    assert len(calls) == 3
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    curve = json.loads(before)["training"]["curve"]
    assert [point["steps"] for point in curve] == [0, 4096, 8192]


def test_trainings_of_other_settings_or_broken_ones_are_refused_in_one_line(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    command = ["--recordings", str(folder), "--recipes", "PPO", "--tracks", "CONSUMER", "--seeds", "1"]
    command += ["--every", "4096", "--folder", str(tmp_path), "--steps"]
    assert main([*command, "4096"]) == 0
    (kept,) = tmp_path.glob("*.json")
    before = kept.read_bytes()
    assert main([*command, "8192"]) == 1
    assert "trained with other steps: choose another --folder" in caplog.text
    assert kept.read_bytes() == before
    kept.write_bytes(before[:100])
    assert main([*command, "4096"]) == 1
    assert "is no finished training" in caplog.records[-1].message
    assert "\n" not in caplog.records[-1].message


def test_a_clone_of_the_oracle_learns_and_reads_no_truth_when_it_acts(folder: Path, tmp_path: Path) -> None:
    study = RLStudy(folder, ("clone of the oracle",), ("CONSUMER",), seeds=1, steps=4000, every=1, folder=tmp_path)
    (row,) = [row for row in study.run().rows if row[1] == "clone of the oracle"]
    (kept,) = tmp_path.glob("*.json")
    curve = json.loads(kept.read_bytes())["training"]["curve"]
    assert curve[-1]["steps"] >= 4000
    assert curve[-1]["yaw_rmse_deg"] < curve[0]["yaw_rmse_deg"]
    assert row[4] == curve[-1]["yaw_rmse_deg"]


class Equal(Policy):
    """What the environment makes of equal logits: a silent expert's substitute counts like the others."""

    name = "EQUAL"

    def act(self, observation: Observation) -> Weights:
        return np.full(observation["yaw_rates"].shape, 1.0 / len(self.experts))


@pytest.mark.parametrize("reward", REWARDS)
def test_rows_are_judged_by_the_rewards_of_the_environment(reward: str) -> None:
    recordings = synthetic_recordings(scenes=4, steps=30)
    training, test = hold_out(recordings, 3)
    policy = Equal()
    prepare(policy, training, "CONSUMER")
    shown = for_learning(test)  # else the environment would reward against the poses as written, free of lag
    env = gym.make(
        "mixo_env:MixoOdometry-v0", recordings=shown, split="all", order="fixed", track="CONSUMER", reward=reward
    )
    sigma_rad = env.unwrapped.session.reward.scale_rad  # type: ignore[attr-defined]
    earned, over = [], False
    env.reset(seed=0)
    while not over:  # equal weights
        _, one, _, over, _ = env.step(np.zeros(env.action_space.shape or 0, np.float32))
        earned.append(one)
    assert judge(policy, test, "CONSUMER", sigma_rad).rewards[reward] == pytest.approx(np.mean(earned), rel=1e-5)


def test_the_reward_study_prints_a_line_per_reward(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from experiments.rl_rewards import main as compare

    save_recordings(synthetic_recordings(scenes=4), tmp_path)  # long enough for pieces of path in every fold
    assert compare(["--recordings", str(tmp_path), "--tracks", "CONSUMER", "--rows", "LINEAR", "MEDIAN", "MEAN"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[1] for line in lines if line and line[0] == "CONSUMER"] == ["squared", "abs", "pose", "(RTE"]


def test_unknown_agents_are_named(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="unknown agent 'PPPO': did you mean 'PPO'"):
        RLStudy(folder, ("PPPO",), folder=tmp_path).run()
