"""TANDEM: half of every weight is TOKEN's, half BIAS FILTER's, and the gate is trained for that."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.envs.replay import Replay
from mixo_env.policies import tandem
from mixo_env.policies.bias_filter import BiasFilter
from mixo_env.policies.fitting import prepare
from mixo_env.policies.playing import play
from mixo_env.policies.tandem import Tandem, fused_increments
from mixo_env.policies.token_gate import Token
from mixo_env.policies.tokens import UNIT_RAD
from mixo_env.recordings.collection import Recordings
from tests.bundle import few_drives


@pytest.fixture(scope="module")
def drives() -> Recordings:
    return few_drives(6).select(folds=[0])


def fitted(policy, drives: Recordings, **kwargs):
    prepare(policy, drives, "VISION", **kwargs)
    return policy


def test_its_weights_are_the_mean_of_both(drives: Recordings) -> None:
    policy = fitted(Tandem(epochs=4), drives)
    token, beside = policy._members.values()
    steps = list(play(policy, Replay(drives, track="VISION")))[:3]
    policy.reset(len(drives))
    for _, look, weights in steps:
        np.testing.assert_allclose(weights, 0.5 * (token.act(look) + beside.act(look)))
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-6)


def test_without_training_the_gate_is_tokens_and_with_it_another(drives: Recordings) -> None:
    untrained, alone = fitted(Tandem(epochs=0), drives), fitted(Token(epochs=0), drives)
    for name, value in alone.tensors().items():
        np.testing.assert_array_equal(untrained.tensors()[f"token.{name}"], value)
    beside, trained = fitted(Tandem(epochs=6), drives), fitted(Token(epochs=6), drives)
    assert not np.array_equal(beside.tensors()["token.weight.3"], trained.tensors()["weight.3"])
    for name, value in fitted(BiasFilter(), drives).tensors().items():
        np.testing.assert_array_equal(beside.tensors()[f"filter.{name}"], value)


def test_what_the_companion_fuses_reaches_the_loss(drives: Recordings, monkeypatch: pytest.MonkeyPatch) -> None:
    first = fitted(Tandem(epochs=6), drives).tensors()["token.weight.3"]
    steps = int(np.diff(drives.offsets).max()) - 1
    monkeypatch.setattr(tandem, "fused_increments", lambda *_: np.zeros((len(drives), steps), np.float32))
    assert not np.array_equal(first, fitted(Tandem(epochs=6), drives).tensors()["token.weight.3"])


def test_fused_increments_are_those_of_the_replay(drives: Recordings) -> None:
    policy = fitted(BiasFilter(), drives)
    found = fused_increments(policy, drives, "VISION")
    replay = Replay(drives, track="VISION")
    list(play(policy, replay))
    rows = drives.offsets[1] - drives.offsets[0] - 1
    np.testing.assert_allclose(found[0, :rows] * UNIT_RAD, replay.history.T[0, :rows], atol=1e-7)
