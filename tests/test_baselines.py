"""Every registered policy keeps the protocol's promises."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixo_env.envs.replay import Replay
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.policies import registry
from mixo_env.policies.affine_gate import LinearGate
from mixo_env.policies.fitting import check, prepare
from mixo_env.policies.gate import Mixo
from mixo_env.policies.playing import play
from mixo_env.policies.policy import Observation, Policy
from mixo_env.policies.reinforcement import AGENTS
from mixo_env.policies.single import Single
from mixo_env.recordings.collection import Recordings
from tests.synthetic import synthetic_recordings

NAMES = registry.names(synthetic_recordings(scenes=1))
TRACK = "CONSUMER"


@pytest.fixture(scope="module")
def training() -> Recordings:
    return synthetic_recordings(0)


@pytest.fixture(scope="module")
def unseen() -> Recordings:
    return synthetic_recordings(1, scenes=3)


SHORT: dict[str, dict[str, Any]] = {name: {"epochs": 1, "min_updates": 30} for name in (Mixo.name, LinearGate.name)}
FEW = {"PPO": {"batch_size": 128}, "A2C": {}, **{name: {"learning_starts": 64} for name in ("SAC", "TD3", "DQN")}}
SHORT |= {name: {"steps": 256, "environments": 8, "settings": FEW[name]} for name in AGENTS}
"""Settings that make the trained policies quick; what they learn does not matter here."""


def fitted(name: str, training: Recordings, seed: int = 0) -> Policy:
    policy = registry.POLICIES[name](**SHORT[name]) if name in SHORT else registry.create(name, training)
    prepare(policy, training, TRACK, seed=seed)
    return policy


@pytest.fixture(scope="module", params=NAMES)
def policy(request: pytest.FixtureRequest, training: Recordings) -> Policy:
    return fitted(request.param, training)


@pytest.fixture(scope="module")
def again(policy: Policy, training: Recordings) -> tuple[Policy, bool]:
    """The policy fitted once more, and whether that left the global generator of torch alone."""
    import torch

    torch.manual_seed(7)
    before = torch.random.get_rng_state()
    second = fitted(policy.name, training)
    return second, torch.equal(torch.random.get_rng_state(), before)


def all_weights(policy: Policy, recordings: Recordings) -> np.ndarray:
    replay = Replay(recordings, track=TRACK, experts=policy.experts, privileged=policy.privileged)
    said: list[np.ndarray] = []
    act = policy.act

    def remember(observation: Observation) -> np.ndarray:
        said.append(act(observation))
        return said[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(policy, "act", remember)
        for _ in play(policy, replay):
            pass
    return np.stack(said)


def test_weights_have_one_finite_number_per_scene_and_expert(policy: Policy, unseen: Recordings) -> None:
    weights = all_weights(policy, unseen)
    assert weights.shape[1:] == (len(unseen), len(policy.experts))
    assert weights.dtype == np.float64
    assert np.isfinite(weights).all()
    if policy.name != "LINEAR":
        np.testing.assert_allclose(weights.sum(axis=-1), 1.0, atol=1e-12)
        assert (weights >= 0.0).all()


def test_experts_are_the_voters_and_at_most_the_single_one_besides(policy: Policy, unseen: Recordings) -> None:
    voters = unseen.voters(TRACK)
    assert policy.experts[: len(voters)] == voters
    assert policy.experts[len(voters) :] == ((policy.name,) if policy.name not in (*voters, *registry.POLICIES) else ())
    check(policy, unseen, TRACK)


def test_same_seed_same_weights(policy: Policy, again: tuple[Policy, bool], unseen: Recordings) -> None:
    np.testing.assert_array_equal(all_weights(policy, unseen), all_weights(again[0], unseen), strict=True)


def test_fitting_leaves_the_global_generator_of_torch_alone(again: tuple[Policy, bool]) -> None:
    assert again[1]


def test_saved_policy_acts_the_same_after_loading(policy: Policy, unseen: Recordings, tmp_path: Path) -> None:
    policy.save(tmp_path / "a")
    again = registry.load(tmp_path / "a")
    assert type(again) is type(policy)
    assert (again.name, again.experts, again.settings()) == (policy.name, policy.experts, policy.settings())
    np.testing.assert_array_equal(all_weights(again, unseen), all_weights(policy, unseen), strict=True)
    again.save(tmp_path / "b")
    assert (tmp_path / "a/policy.safetensors").read_bytes() == (tmp_path / "b/policy.safetensors").read_bytes()


def test_only_privileged_policies_read_the_truth(policy: Policy, unseen: Recordings) -> None:
    replay = Replay(unseen, track=TRACK, experts=policy.experts)
    replay.reset(np.arange(len(unseen)))
    observation = replay.observe()
    assert "truth_yaw_rate" not in observation
    policy.reset(len(unseen))
    if policy.privileged:
        assert any(word in policy.name for word in ("GT", "ORACLE", "NON-CAUSAL"))
        with pytest.raises((KeyError, PolicyError), match="the future" if policy.lag else "truth_yaw_rate"):
            policy.act(observation)
    else:
        policy.act(observation)


def test_only_learners_change_with_the_training_scenes(policy: Policy, unseen: Recordings) -> None:
    other = fitted(policy.name, synthetic_recordings(9, scenes=4))
    same = np.array_equal(all_weights(policy, unseen), all_weights(other, unseen))
    assert same is not policy.learns


def test_policy_refuses_other_voters(policy: Policy, unseen: Recordings) -> None:
    with pytest.raises(PolicyError, match=r"was fitted for .* in this order"):
        check(policy, unseen, "PAPER")


def test_weights_saved_for_another_order_of_experts_are_refused(
    policy: Policy, unseen: Recordings, tmp_path: Path
) -> None:
    policy.experts = policy.experts[::-1]
    try:
        policy.save(tmp_path)
    finally:
        policy.experts = policy.experts[::-1]
    with pytest.raises(PolicyError, match=r"was fitted for .* in this order"):
        check(registry.load(tmp_path), unseen, TRACK)


def test_unfitted_policy_is_refused(unseen: Recordings) -> None:
    with pytest.raises(PolicyError, match="nothing yet"):
        check(Single("CAM_FRONT"), unseen, TRACK)


def test_unknown_name_suggests_the_nearest(training: Recordings) -> None:
    with pytest.raises(ConfigurationError, match=r"unknown policy 'LINAER': did you mean 'LINEAR'\?"):
        registry.create("LINAER", training)


def test_loading_refuses_what_is_missing_broken_or_another_policy(training: Recordings, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="found none"):
        registry.load(tmp_path)
    file = tmp_path / "policy.safetensors"
    file.write_bytes(b"not a policy")
    with pytest.raises(PolicyError, match="is not a saved policy"):
        registry.load(tmp_path)
    fitted("LINEAR", training).save(tmp_path)
    with pytest.raises(PolicyError, match=r"expected HUBER in .*, got LINEAR"):
        registry.POLICIES["HUBER"].load(tmp_path)
    file.write_bytes(file.read_bytes()[:-5])
    with pytest.raises(PolicyError, match="is not a saved policy"):
        registry.load(tmp_path)


def test_importing_the_registry_is_light() -> None:
    code = (
        "import sys, mixo_env.policies.registry; print([m for m in ('torch', 'stable_baselines3') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
