"""Constant weights on the simplex, and the linear gate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

from mixo_env.fusion import least_squares_weights
from mixo_env.policies.affine_gate import LinearGate
from mixo_env.policies.gate import gate_input
from mixo_env.policies.linear import Linear
from mixo_env.policies.playing import collect
from mixo_env.policies.registry import POLICIES
from mixo_env.policies.reinforcement import AGENTS
from mixo_env.policies.simplex import LinearSimplex, simplex_weights
from tests.synthetic import synthetic_recordings


def test_the_page_of_families_names_every_row_that_fuses() -> None:
    page = (Path(__file__).parent.parent / "docs" / "fusion.md").read_text(encoding="utf-8")
    elsewhere = {"HIGHEST MATCH", "ORACLE ALL", "ORACLE HULL", *AGENTS}
    assert [name for name in POLICIES if name not in page and name not in elsewhere] == []


@pytest.mark.parametrize("seed", range(6))
def test_simplex_weights_are_those_of_a_general_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = 0.01 * rng.standard_normal(400)
    mixing = rng.standard_normal((5, 5))  # correlated errors: some optimum lies on the border
    experts = truth[:, None] + 1e-3 * rng.standard_normal((400, 5)) @ mixing
    found = simplex_weights(experts, truth)

    def loss(w: np.ndarray) -> float:
        return 1e6 * float(np.mean((experts @ w - truth) ** 2))

    total = {"type": "eq", "fun": lambda w: w.sum() - 1}
    theirs = minimize(loss, np.full(5, 0.2), bounds=[(0, 1)] * 5, constraints=total, tol=1e-14)
    assert found.sum() == pytest.approx(1.0)
    assert (found >= 0).all()
    assert loss(found) <= theirs.fun * (1 + 1e-6)


def test_simplex_weights_by_hand() -> None:
    truth = np.zeros(4)
    experts = np.array([[1, 2], [-1, 2], [1, -2], [-1, -2.0]])  # uncorrelated, variances 1 and 4
    np.testing.assert_allclose(simplex_weights(experts, truth), [0.8, 0.2])
    np.testing.assert_allclose(simplex_weights(experts[:, :1], truth), [1.0])
    np.testing.assert_allclose(simplex_weights(np.zeros((4, 2)), truth).sum(), 1.0)


def test_the_simplex_costs_error_and_linear_need_not_sum_to_one() -> None:
    recordings = synthetic_recordings(4)
    free, confined = Linear(), LinearSimplex()
    free.fit(recordings, "CONSUMER")
    confined.fit(recordings, "CONSUMER")
    increments, truth = free._samples(recordings, "CONSUMER")
    np.testing.assert_allclose(free.weights, least_squares_weights(increments, truth))

    def error(w: np.ndarray) -> float:
        return float(np.mean((increments @ w - truth) ** 2))

    assert error(free.weights) < error(confined.weights)
    assert abs(free.weights.sum() - 1.0) > 1e-9
    assert confined.weights.sum() == pytest.approx(1.0)


def test_the_linear_gate_is_the_softmax_of_an_affine_map() -> None:
    recordings = synthetic_recordings(1, scenes=4)
    gate = LinearGate(epochs=1, min_updates=20)
    gate.fit(recordings, "VISION", seed=0)
    look = collect(recordings, "VISION", gate)
    tensors = gate.tensors()
    x = (gate_input(look) - tensors["mean"]) / tensors["std"]
    logits = x @ tensors["network.0.weight"].T + tensors["network.0.bias"]
    expected = np.exp(logits) / np.exp(logits).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(gate.act(look), expected, rtol=2e-4, atol=1e-6)
    assert "hidden" not in gate.settings()
