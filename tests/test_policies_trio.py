"""TRIO: a gate over votes, one over votes without their biases, and the filter between them."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.envs.replay import Replay
from mixo_env.policies import registry
from mixo_env.policies.bias_filter import BiasFilter
from mixo_env.policies.blocks import in_rows
from mixo_env.policies.debiased import Debiased
from mixo_env.policies.fitting import prepare
from mixo_env.policies.playing import play
from mixo_env.policies.policy import Observation
from mixo_env.policies.robust import Mean, believable
from mixo_env.policies.token_gate import Token
from mixo_env.policies.tokens import UNIT_RAD
from mixo_env.policies.trio import SHARE, Trio
from mixo_env.recordings.collection import Recordings
from tests.batches import assert_same_alone_and_among_many
from tests.bundle import few_drives


@pytest.fixture(scope="module")
def drives() -> Recordings:
    return few_drives(6).select(folds=[0])


@pytest.fixture(scope="module")
def fitted(drives: Recordings) -> Trio:
    return ready(Trio(epochs=3), drives)


def ready(policy, drives: Recordings, track: str = "VISION"):
    prepare(policy, drives, track)
    return policy


def looks(policy, drives: Recordings, count: int) -> list[Observation]:
    return [look for _, look, _ in play(policy, Replay(drives, track="VISION"))][:count]


def increments(look: Observation) -> np.ndarray:
    return look["yaw_rates"].astype(np.float64) * look["dt"]


def test_its_weights_are_the_mean_of_three(fitted: Trio, drives: Recordings) -> None:
    token, debiased, alone = fitted._gates["token"], fitted._gates["debiased"], ready(BiasFilter(), drives)
    steps = looks(fitted, drives, 4)
    together = []
    fitted.reset(len(drives))
    for look in steps:
        together.append(fitted.act(look))
        np.testing.assert_allclose(together[-1].sum(axis=1), 1.0, atol=1e-6)
    for policy in (token, debiased, alone):
        policy.reset(len(drives))
    for look, weights in zip(steps, together, strict=True):
        gates = SHARE * (token.act(look) + debiased.act(look))
        np.testing.assert_allclose(weights, gates + (1.0 - 2.0 * SHARE) * alone.act(look), atol=1e-12)


def test_gates_learn_with_seeds_of_their_own_and_the_same_bits_again(fitted: Trio, drives: Recordings) -> None:
    again, another = ready(Trio(epochs=3), drives), Trio(epochs=3)
    prepare(another, drives, "VISION", seed=1)
    for name, value in fitted.tensors().items():
        np.testing.assert_array_equal(again.tensors()[name], value)
    assert not np.array_equal(another.tensors()["token.weight.0"], fitted.tensors()["token.weight.0"])
    assert not np.array_equal(fitted.tensors()["debiased.weight.0"], fitted.tensors()["token.weight.0"])


def test_the_filter_predicts_before_it_hears(drives: Recordings) -> None:
    """Biases that are taken off are those known before the step, faded by its duration."""
    policy = ready(BiasFilter(), drives)
    policy.reset(len(drives))
    drift = policy._drift
    for look in looks(policy, drives, 30):
        before, dt = in_rows(policy._state[0], len(drives)).copy(), look["dt"].astype(np.float64)
        policy.act(look)
        predicted = drift.constant_radps + before * np.exp(-dt / drift.memory_s)
        votes = believable(look)
        expected = increments(look) - dt * predicted
        np.testing.assert_allclose(policy.apart[votes], expected[votes], rtol=1e-9, atol=1e-15)
        assert np.isinf(policy.left[~votes]).all()
        assert (policy.left[votes] > 0.0).all()


def test_the_gate_sees_votes_without_their_biases_and_its_sum_is_mixed_from_votes(drives: Recordings) -> None:
    policy = ready(Debiased(epochs=0), drives)
    plain = ready(Token(epochs=0), drives)
    policy.reset(len(drives))
    for look in looks(plain, drives, 40):
        policy.reset(len(drives))
        seen = policy.see(look)
        np.testing.assert_allclose(seen.increment, policy.filter.apart / UNIT_RAD)
        np.testing.assert_array_equal(seen.counts, plain.see(look).counts)
        policy.reset(len(drives))
        weights = policy.act(look)
        votes, values = believable(look), increments(look)
        low = np.where(votes, values, np.inf).min(axis=1)
        high = np.where(votes, values, -np.inf).max(axis=1)
        fused = np.sum(weights * values, axis=1)
        assert (fused >= low - 1e-12).all()
        assert (fused <= high + 1e-12).all()
        assert (weights >= 0.0).all()
        assert (weights[~votes] == 0.0).all()


def test_a_vote_that_is_biased_throughout_is_corrected(drives: Recordings) -> None:
    """A constant is measured in training and taken off: the gate sees votes as if it were not there."""
    biased = drives["CAM_BACK.yaw_increment_rad"] + 5e-3 * drives["dt_s"]
    shifted = drives.replace(columns={"CAM_BACK.yaw_increment_rad": biased.astype(np.float32)})
    one, other = ready(Debiased(epochs=0), drives), ready(Debiased(epochs=0), shifted)
    increments = []
    for policy, recordings in ((one, drives), (other, shifted)):
        policy.reset(len(drives))
        steps = looks(ready(Mean(), recordings), recordings, 20)
        increments.append([np.where(look["available"] > 0, policy.see(look).increment, 0.0) for look in steps])
    apart = np.abs(np.subtract(*increments))  # 1.4 before; who agrees lately is judged before the bias is off
    assert np.median(apart) < 0.05
    assert np.quantile(apart, 0.99) < 0.2


def test_a_saved_one_decides_the_same(fitted: Trio, drives: Recordings, tmp_path) -> None:
    fitted.save(tmp_path)
    loaded = registry.load(tmp_path)
    for look in looks(fitted, drives, 1):
        for policy in (fitted, loaded):
            policy.reset(len(drives))
        np.testing.assert_array_equal(loaded.act(look), fitted.act(look))


def test_a_scene_has_the_same_bits_alone_and_among_many(fitted: Trio, drives: Recordings) -> None:
    assert_same_alone_and_among_many(fitted, drives, "VISION")


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_one_expert_missing_throughout_has_no_weight(missing: int, drives: Recordings) -> None:
    gone = {f"{drives.voters('VISION')[missing]}.yaw_increment_rad": np.full(drives.offsets[-1], np.nan, np.float32)}
    without = drives.replace(columns=gone)
    policy = ready(Trio(epochs=1), without)
    for _, look, weights in play(policy, Replay(without, track="VISION")):
        assert np.isfinite(weights).all()
        others = look["available"].any(axis=1)
        np.testing.assert_allclose(weights[others, missing], 0.0, atol=1e-12)
