"""Learned policies learn: tasks with a known optimum, small enough for a test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mixo_env.envs.actions import LOGIT_SCALE
from mixo_env.envs.observation import PAPER, RICH
from mixo_env.envs.replay import Replay
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.fusion import softmax
from mixo_env.leaderboard.evaluation import rollout
from mixo_env.policies.fitting import drives, prepare
from mixo_env.policies.gate import Mixo
from mixo_env.policies.linear import Linear
from mixo_env.policies.policy import Policy
from mixo_env.policies.reinforcement import AGENTS, DQN, PPO, flat
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
    agent = PPO(steps=12_288, environments=32, settings={"n_steps": 32, "batch_size": 256})
    training = one_is_right.select(split="train")
    agent.fit(training, "CONSUMER", seed=0)  # with the scale of the reward given above: LINEAR has no error here
    agent.fitted_on = drives(training)
    assert yaw_rmse_deg(agent, one_is_right.select(split="test"), "CONSUMER") < 0.1


@pytest.mark.parametrize(
    "create",
    [
        lambda: Mixo(epochs=1, min_updates=30),
        lambda: PPO(steps=1024, environments=8, settings={"batch_size": 256, "n_epochs": 5}),
        lambda: DQN(steps=256, environments=8, settings={"batch_size": 32, "learning_starts": 64}),
    ],
    ids=["MIXO", "PPO", "DQN"],
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


@pytest.mark.parametrize("name", AGENTS)
def test_kept_matrices_act_as_the_trained_model(name: str) -> None:
    recordings = synthetic_recordings(3, scenes=2)
    agent = AGENTS[name](environments=4, settings={"n_steps": 16, "batch_size": 64} if name == "PPO" else {})
    agent.start(recordings.voters("CONSUMER"))
    agent.standardise_by(recordings, "CONSUMER")
    environment = agent.environment(recordings, "CONSUMER")
    model = agent.model(environment, seed=0)
    model.learn(64)
    agent.take(model)
    replay = Replay(recordings, track="CONSUMER")
    replay.reset(np.arange(2))
    observation = replay.observe()
    seen = agent._standardise(flat(observation))
    assert seen.shape[1] == environment.observation_space.shape[0]
    action, _ = model.predict(seen, deterministic=True)
    one_expert = name == "DQN"
    expected = np.eye(5)[action] if one_expert else softmax(LOGIT_SCALE * action)
    np.testing.assert_allclose(agent.act(observation), expected, atol=1e-5)


def test_an_agent_of_the_papers_observation_sees_nothing_else() -> None:
    recordings = synthetic_recordings(3, scenes=2, steps=40)
    agent = PPO(steps=64, environments=4, observation="paper", settings={"n_steps": 8, "batch_size": 32})
    prepare(agent, recordings, "CONSUMER")
    replay = Replay(recordings, track="CONSUMER")
    replay.reset(np.arange(2))
    observation = {quantity.name: replay.observe()[quantity.name] for quantity in PAPER}
    assert agent.act(observation).shape == (2, 5)
    assert agent.sees == "paper"


def test_a_training_that_goes_astray_is_one_line() -> None:
    recordings = synthetic_recordings(3, scenes=2, steps=40)
    wild = PPO(steps=256, environments=4, settings={"n_steps": 8, "batch_size": 32, "learning_rate": 1e30})
    with pytest.raises(PolicyError, match=r"PPO: training .*: lower its learning_rate") as caught:
        prepare(wild, recordings, "CONSUMER")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "changes",
    [{"gamma": 1.5}, {"gamma": np.nan}, {"steps": 0}, {"reward": "abss"}, {"observation": "all"}],
)
def test_settings_without_sense_are_one_line(changes: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(changes))):
        PPO(**changes)


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
