"""Learned policies learn: tasks with a known optimum, small enough for a test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mixo_env.envs.observation import RICH
from mixo_env.envs.replay import Replay
from mixo_env.leaderboard.evaluation import rollout
from mixo_env.policies.fitting import drives, prepare
from mixo_env.policies.gate import Mixo
from mixo_env.policies.linear import Linear
from mixo_env.policies.policy import Policy
from mixo_env.policies.reinforcement import PPO, actor_layers, flat, mean_action
from mixo_env.policies.robust import Median
from mixo_env.recordings.collection import Recordings
from tests.synthetic import synthetic_recordings


@pytest.fixture(scope="module")
def noisy() -> Recordings:
    """Camera errors are inversely proportional to the match counts: a gate can see who is right, constants cannot."""
    return synthetic_recordings(0, scenes=12, steps=200)


@pytest.fixture(scope="module")
def one_is_right(noisy: Recordings) -> Recordings:
    """INERTIAL_CONSUMER is exact and every camera is off by a constant 0.5 degrees per step."""
    columns = {name: noisy[name].copy() for name in noisy.column_names}
    truth = noisy["truth.yaw_increment_rad"]
    columns["INERTIAL_CONSUMER.yaw_increment_rad"] = truth.astype(np.float32)
    for camera in noisy.manifest.cameras:
        columns[f"{camera}.yaw_increment_rad"] = (truth + np.radians(0.5)).astype(np.float32)
    scale = dict.fromkeys(noisy.manifest.reward_scale_rad, float(np.radians(0.1)))
    return Recordings(replace(noisy.manifest, reward_scale_rad=scale), columns)


def yaw_rmse_deg(policy: Policy, recordings: Recordings, track: str) -> float:
    error = rollout(policy, recordings, track).yaw_increment_rad - recordings["truth.yaw_increment_rad"]
    return float(np.degrees(np.sqrt(np.nanmean(error**2))))


def test_gate_uses_the_match_counts(noisy: Recordings) -> None:
    training, test = noisy.select(split="train"), noisy.select(split="test")
    gate, linear, median = Mixo(), Linear(), Median()
    for policy in (gate, linear, median):
        prepare(policy, training, "VISION", seed=0)
    error = {policy.name: yaw_rmse_deg(policy, test, "VISION") for policy in (gate, linear, median)}
    assert error["MIXO"] < error["LINEAR"] < error["MEDIAN"]


def test_gate_finds_the_exact_expert(one_is_right: Recordings) -> None:
    gate = Mixo(min_updates=150)
    prepare(gate, one_is_right.select(split="train"), "CONSUMER")
    assert yaw_rmse_deg(gate, one_is_right.select(split="test"), "CONSUMER") < 0.03


def test_reinforcement_finds_the_exact_expert(one_is_right: Recordings) -> None:
    agent = PPO(steps=12_288, environments=32, rollout=32, batch=256)
    training = one_is_right.select(split="train")
    agent.fit(training, "CONSUMER", seed=0)  # with the scale of the reward given above: LINEAR has no error here
    agent.fitted_on = drives(training)
    assert yaw_rmse_deg(agent, one_is_right.select(split="test"), "CONSUMER") < 0.1


@pytest.mark.parametrize(
    "create",
    [
        lambda: Mixo(epochs=1, min_updates=30),
        lambda: PPO(steps=1024, environments=8, rollout=64, batch=256),
    ],
    ids=["MIXO", "PPO"],
)
def test_the_seed_alone_decides_what_is_learned(create: Callable[[], Policy]) -> None:
    recordings = synthetic_recordings(0, scenes=4, steps=30)
    first, again, other = create(), create(), create()
    for policy, seed in ((first, 3), (again, 3), (other, 4)):
        policy.fit(recordings, "CONSUMER", seed=seed)
    learned, same, different = (policy.tensors() for policy in (first, again, other))
    assert all(np.array_equal(values, same[name]) for name, values in learned.items())
    matrices = [name for name, values in learned.items() if values.ndim == 2]
    assert len(matrices) == 3
    assert all((learned[name] != different[name]).mean() > 0.9 for name in matrices)


def test_both_dropouts_act_while_training_and_none_afterwards() -> None:
    import torch
    from torch import nn

    gate = Mixo(hidden=(40, 30), dropout=(0.3, 0.6))
    network = gate._build(6, 5)
    kinds = [nn.Linear, nn.ReLU, nn.Dropout, nn.Linear, nn.ReLU, nn.Dropout, nn.Linear]
    assert [type(layer) for layer in network] == kinds
    assert [(layer.in_features, layer.out_features) for layer in network if isinstance(layer, nn.Linear)] == [
        (6, 40),
        (40, 30),
        (30, 5),
    ]
    torch.manual_seed(0)
    network.train()
    for share, layer in zip((0.3, 0.6), (network[2], network[5]), strict=True):
        kept = layer(torch.ones(100, 400))
        assert abs(float((kept == 0).float().mean()) - share) < 0.02
        torch.testing.assert_close(kept.max(), torch.tensor(1 / (1 - share)))
    assert not torch.equal(network(torch.ones(1, 6)), network(torch.ones(1, 6)))
    network.eval()
    assert torch.equal(network(torch.ones(1, 6)), network(torch.ones(1, 6)))


def test_the_papers_gate_drops_a_tenth_after_either_hidden_layer() -> None:
    from torch import nn

    network = Mixo()._build(6, 5)
    assert [layer.p for layer in network if isinstance(layer, nn.Dropout)] == [0.1, 0.1]


def test_kept_matrices_act_as_the_trained_model() -> None:
    import stable_baselines3

    from mixo_env.envs.sb3 import MixoVecEnv

    recordings = synthetic_recordings(3, scenes=2)
    environment = MixoVecEnv(num_envs=4, recordings=recordings, split="all", observation="rich")
    model = stable_baselines3.PPO("MlpPolicy", environment, n_steps=8, batch_size=32, n_epochs=1, seed=0, device="cpu")
    model.learn(64)
    replay = Replay(recordings, track="CONSUMER")
    replay.reset(np.arange(2))
    seen = flat(replay.observe())
    assert seen.shape[1] == environment.observation_space.shape[0]
    expected, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(np.clip(mean_action(actor_layers(model.policy), seen), -1, 1), expected, atol=1e-5)


def test_flat_observation_is_that_of_the_environment() -> None:
    from mixo_env.envs.odometry import MixoOdometryEnv

    recordings = synthetic_recordings(3, scenes=1)
    environment = MixoOdometryEnv(recordings=recordings, split="all", observation="rich")
    expected, _ = environment.reset(options={"scene": "scene-2001"})
    replay = Replay(recordings, track="CONSUMER")
    replay.reset([0])
    seen = replay.observe()
    assert list(seen) == [quantity.name for quantity in RICH]
    np.testing.assert_array_equal(flat(seen)[0], expected)
