from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import minimize

from mixo_env import fusion

VECTORS = arrays(np.float64, st.integers(1, 7), elements=st.floats(-20, 20))


@given(VECTORS)
def test_softmax_is_a_distribution_and_ignores_a_shift(logits: np.ndarray) -> None:
    h = fusion.softmax(logits)
    assert np.all(h >= 0)
    np.testing.assert_allclose(h.sum(), 1.0)
    np.testing.assert_allclose(fusion.softmax(logits + 300.0), h, atol=1e-12)


@given(VECTORS)
def test_projection_lies_on_the_simplex_and_is_idempotent(point: np.ndarray) -> None:
    w = fusion.project_to_simplex(point)
    assert np.all(w >= 0)
    np.testing.assert_allclose(w.sum(), 1.0, atol=1e-9)
    np.testing.assert_allclose(fusion.project_to_simplex(w), w, atol=1e-9)


def test_projection_is_the_nearest_point() -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        v = rng.normal(0, 1.5, 4)
        best = minimize(
            lambda w, v=v: np.sum((w - v) ** 2),
            np.full(4, 0.25),
            bounds=[(0, None)] * 4,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1.0},
            tol=1e-12,
        )
        np.testing.assert_allclose(fusion.project_to_simplex(v), best.x, atol=1e-5)


def test_mix_by_hand() -> None:
    np.testing.assert_allclose(fusion.mix([0.5, 0.3, 0.2], [0.1, -0.1, 0.4]), 0.05 - 0.03 + 0.08)


def test_one_expert_alone_is_reproduced_bit_for_bit() -> None:
    increments = np.random.default_rng(1).normal(size=(50, 5))
    np.testing.assert_array_equal(fusion.mix(np.eye(5)[2], increments), increments[:, 2])


def test_quarter_circle_closes_exactly() -> None:
    radius, steps = 10.0, 45
    dpsi = np.full(steps, np.pi / 2 / steps)
    chord = 2 * radius * np.sin(dpsi / 2)
    x, y, yaw = fusion.dead_reckon(dpsi, chord)
    np.testing.assert_allclose([x[-1], y[-1], yaw[-1]], [radius, radius, np.pi / 2], atol=1e-12)


def test_translation_is_the_chord_in_the_new_frame() -> None:
    dpsi, s = 0.3, 2.0
    x, y, _ = fusion.dead_reckon([dpsi], [s], start=(1.0, -2.0, 0.7))
    chord = s * np.array([np.cos(dpsi / 2), -np.sin(dpsi / 2)])
    c, n = np.cos(0.7 + dpsi), np.sin(0.7 + dpsi)
    np.testing.assert_allclose([x[1] - 1.0, y[1] + 2.0], [c * chord[0] - n * chord[1], n * chord[0] + c * chord[1]])


def test_course_offset_turns_the_whole_path() -> None:
    rng = np.random.default_rng(2)
    dpsi, s = rng.normal(0, 0.02, 30), rng.uniform(0, 1, 30)
    x0, y0, _ = fusion.dead_reckon(dpsi, s)
    x1, y1, _ = fusion.dead_reckon(dpsi, s, course_offset_rad=0.1)
    turned = np.exp(0.1j) * (x0 + 1j * y0)
    np.testing.assert_allclose(x1 + 1j * y1, turned, atol=1e-12)


def test_batches_equal_single_scenes() -> None:
    rng = np.random.default_rng(3)
    dpsi, s = rng.normal(0, 0.02, (4, 20)), rng.uniform(0, 1, (4, 20))
    together = fusion.dead_reckon(dpsi, s)
    for i in range(4):
        for batch, single in zip(together, fusion.dead_reckon(dpsi[i], s[i]), strict=True):
            np.testing.assert_array_equal(batch[i], single)


def test_least_squares_recovers_constant_weights() -> None:
    rng = np.random.default_rng(4)
    increments = rng.normal(size=(200, 5))
    weights = np.array([0.851, 0.020, 0.031, 0.013, 0.122])
    np.testing.assert_allclose(fusion.least_squares_weights(increments, increments @ weights), weights, atol=1e-12)
