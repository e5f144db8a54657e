"""The filter of biases and its smoother, against filterpy, a dense solution and cases worked by hand."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from mixo_env.policies.bias_filter import BiasFilter
from mixo_env.policies.bias_steps import BEST_SCALE, invert, point_at, predict, step
from mixo_env.policies.blocks import AT_ONCE, in_rows
from mixo_env.policies.calibration import Calibration, Past
from mixo_env.policies.consensus import ROOM
from mixo_env.policies.drift import Drift, summed_variance
from mixo_env.policies.policy import Observation
from mixo_env.policies.smoother import LAG, Smoother

DT = 0.1


def drift_of(slow: list[float], memory_s: list[float], constant: list[float] | None = None) -> Drift:
    n = len(slow)
    return Drift(
        constant_radps=np.array(constant or [0.0] * n),
        slow_radps=np.array(slow),
        memory_s=np.array(memory_s),
        white_share=np.ones(n),
        turn_share=np.zeros(n),
    )


def ready(kind: type[BiasFilter], std_rad: list[float], drift: Drift, batch: int = 1) -> BiasFilter:
    policy = kind()
    policy.start([chr(97 + i) for i in range(len(std_rad))])
    calibration = Calibration(np.array(std_rad), np.full(len(std_rad), np.inf))
    policy.restore({**calibration.tensors(), **drift.tensors()})
    policy.reset(batch)
    return policy


def seen(rates: np.ndarray, available: np.ndarray | None = None) -> Observation:
    """``(batch, experts)`` rad/s."""
    table = {
        "yaw_rates": rates,
        "available": np.ones(rates.shape) if available is None else available,
        "dt": np.full((len(rates), 1), DT),
        "yaw_rate_std": np.zeros(rates.shape),
    }
    return {name: values.astype(np.float32) for name, values in table.items()}


def gyro_and_cameras(steps: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rates ``(steps, 3)`` of two noisy cameras and a quiet gyro with a bias of 0.02 rad/s; true rates."""
    rng = np.random.default_rng(seed)
    truth = 0.3 * np.sin(np.arange(steps) / 20)
    noise = rng.standard_normal((steps, 3)) * [0.02, 0.02, 0.002]
    return truth[:, None] + noise + [0.0, 0.0, 0.02], truth


def test_inverse_is_that_of_numpy() -> None:
    rng = np.random.default_rng(0)
    for n in range(1, 8):
        a = rng.standard_normal((n, n))
        matrix = a @ a.T + np.eye(n)
        expected = np.linalg.inv(matrix)
        both = np.stack([np.eye(n), matrix], axis=-1)
        invert(both)
        np.testing.assert_allclose(both[..., 1], expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(both[..., 0], np.eye(n))


def test_weights_of_two_votes_mix_to_the_target_inside_what_votes_span() -> None:
    values, weights = np.array([0.1, 0.5, 0.3, 9.0]), np.empty(4)
    std = np.array([1.0, 1.0, 1.0, np.inf])
    for target, expected in ((0.4, 0.4), (0.3, 0.3), (-1.0, 0.1), (7.0, 0.5)):
        point_at(target, values, std, weights)
        assert float(weights @ values) == pytest.approx(expected)
        assert weights.sum() == pytest.approx(1.0)
        assert weights[3] == 0.0
        assert (weights >= 0).all()
    point_at(np.nan, values, std, weights)
    assert not weights.any()


def test_filter_is_that_of_filterpy_with_a_free_yaw_increment() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from filterpy.kalman import KalmanFilter

    rng = np.random.default_rng(1)
    drift = drift_of([0.02, 0.05, 0.01], [1.0, 5.0, 30.0])
    constants = np.stack(list(drift.tensors().values()))
    bias, covariance = np.zeros((3, 1)), np.diag(drift.slow_radps**2)[..., None].copy()
    room = np.empty((3, 3, 3, 1)), np.empty((4, 3, 1)), np.empty((1 + ROOM, 1))
    theirs = KalmanFilter(dim_x=4, dim_z=3)
    theirs.x, theirs.P = np.zeros((4, 1)), np.diag([*drift.slow_radps**2, 1.0])
    fade = np.exp(-DT / drift.memory_s)
    for _ in range(40):
        dt_rates = rng.standard_normal(3) * 2e-3 + 0.01
        psi, noise = np.empty(1), np.empty((3, 1))
        told = dt_rates[:, None].copy(), np.full((3, 1), 2e-3)
        step((bias, covariance), told, constants, np.array([DT]), (psi, noise), room)
        theirs.predict(
            F=np.diag([*fade, 0.0]), Q=np.diag([*(drift.slow_radps**2 * (1 - fade**2)), 1e4])
        )  # the increment is forgotten and may be anything
        theirs.update(dt_rates[:, None], R=np.diag(noise[:, 0]), H=np.column_stack([DT * np.eye(3), np.ones(3)]))
        np.testing.assert_allclose(bias[:, 0], theirs.x[:3, 0], atol=1e-8)
        np.testing.assert_allclose(covariance[..., 0], theirs.P[:3, :3], rtol=1e-4, atol=1e-10)
        assert psi[0] == pytest.approx(theirs.x[3, 0], abs=1e-7)


def test_biases_age_to_what_they_were_on_training_scenes() -> None:
    drift = drift_of([0.02, 0.05], [1.0, 10.0])
    bias, covariance = np.array([[0.1], [-0.1]]), np.array([[1e-5, 1e-6], [1e-6, 1e-5]])[..., None].copy()
    predict(bias, covariance, np.stack(list(drift.tensors().values())), np.array([1e3]), np.empty((2, 1)))
    np.testing.assert_allclose(bias, 0.0, atol=1e-12)
    np.testing.assert_allclose(covariance[..., 0], np.diag(drift.slow_radps**2), atol=1e-12)


@pytest.mark.parametrize("broken", [False, True])
def test_the_bias_of_a_gyro_is_found_from_the_cameras(broken: bool) -> None:
    rates, truth = gyro_and_cameras(400)
    if broken:
        rates[:, 1] += np.random.default_rng(5).choice([-2.0, 2.0], 400)
    policy = ready(BiasFilter, [2e-3, 2e-3, 2e-4], drift_of([0.0, 0.0, 0.05], [1.0, 1.0, 100.0]))
    fused = np.array([float((policy.act(seen(row[None])) * row).sum()) for row in rates])
    assert policy._state[0][0, 2, 0] == pytest.approx(0.02, abs=4e-3)
    error, gyro = fused - truth, rates[:, 2] - truth
    assert abs(error[200:].mean()) < 0.2 * abs(gyro[200:].mean())
    assert error[200:].std() < (0.018 if broken else 0.014)


def test_a_constant_bias_is_taken_off_from_the_first_step() -> None:
    drift = drift_of([0.0, 0.0], [1.0, 1.0], [0.02, 0.0])
    policy = ready(BiasFilter, [1e-3, 1e-3], drift)
    weights = policy.act(seen(np.array([[0.12, 0.1]])))
    np.testing.assert_allclose(weights, [[0.0, 1.0]], atol=1e-3)  # 0.1 is what both mean


def test_agreement_halves_a_variance_at_most_and_disagreement_raises_it() -> None:
    policy = ready(BiasFilter, [1e-3] * 3, drift_of([0.0] * 3, [1.0] * 3))
    for _ in range(100):
        policy.act(seen(np.array([[0.1, 0.1, 0.3]])))
    np.testing.assert_allclose(policy._noise[0, :2], (1e-3 * BEST_SCALE) ** 2)
    assert policy._noise[0, 2] > 1e-4


def test_a_scene_does_not_remember_the_one_before_and_rows_do_not_mix() -> None:
    rates, _ = gyro_and_cameras(60)
    drift = drift_of([0.0, 0.0, 0.05], [1.0, 1.0, 100.0])
    alone, pair = ready(BiasFilter, [2e-3, 2e-3, 2e-4], drift), ready(BiasFilter, [2e-3, 2e-3, 2e-4], drift, 2)
    first = [alone.act(seen(row[None])) for row in rates]
    alone.reset(1)
    again = [alone.act(seen(row[None])) for row in rates]
    np.testing.assert_array_equal(first, again)
    both = [pair.act(seen(np.stack([row[::-1], row])))[1] for row in rates]
    np.testing.assert_array_equal(np.concatenate(first), both)


@pytest.mark.parametrize("batch", [2, AT_ONCE - 1, AT_ONCE, AT_ONCE + 1, 2 * AT_ONCE + 3])
def test_a_scene_has_the_same_bits_alone_and_among_many_with_experts_missing(batch: int) -> None:
    rng = np.random.default_rng(batch)
    drift = drift_of([0.02, 0.0, 0.05], [1.0, 1.0, 100.0])
    looks = []
    for _ in range(4):
        looks.append(seen(0.05 * rng.standard_normal((batch, 3)), rng.random((batch, 3)) < 0.6))
        looks[-1]["dt"] = rng.choice([0.05, 0.1], (batch, 1)).astype(np.float32)
    std = [2e-3, 2e-3, np.inf]  # where only the third votes the median decides
    many = ready(BiasFilter, std, drift, batch)
    together = [many.act(look) for look in looks]
    for k in range(batch):
        alone = ready(BiasFilter, std, drift)
        for look, weights in zip(looks, together, strict=True):
            one = {name: values[k : k + 1] for name, values in look.items()}
            np.testing.assert_array_equal(alone.act(one)[0], weights[k])
        np.testing.assert_array_equal(alone._state[1][0, ..., 0], in_rows(many._state[1], batch)[k])


def test_variance_of_sums_is_the_double_sum() -> None:
    for memory in (3.0, 100.0):
        f = np.exp(-1 / memory)
        for window in (1, 2, 7, 50):
            k = np.arange(window)
            expected = (f ** np.abs(k[:, None] - k)).sum()
            assert summed_variance(np.array([window]), memory)[0] == pytest.approx(expected)


def test_drift_is_found_again() -> None:
    rng = np.random.default_rng(2)
    steps, scenes, memory = 1500, 12, 30.0
    f = np.exp(-1 / memory)
    errors, truths = [], []
    for _ in range(scenes):
        slow = np.zeros(steps)
        slow[0] = 1e-3 * rng.standard_normal()
        for k in range(1, steps):
            slow[k] = f * slow[k - 1] + 1e-3 * np.sqrt(1 - f * f) * rng.standard_normal()
        truth = rng.choice([0.0, 0.1], steps, p=[0.85, 0.15])
        white = 2e-3 * rng.standard_normal((steps, 2))
        error = white + np.column_stack([slow + 5e-4, 0.05 * truth * rng.standard_normal(steps)])
        errors.append(np.vstack([[np.nan, np.nan], error]))
        truths.append(np.concatenate([[np.nan], truth]))
    rows = scenes * (steps + 1)
    dt = np.full(rows, DT)
    dt[:: steps + 1] = 0.0
    offsets = np.arange(scenes + 1) * (steps + 1)
    past = Past(np.concatenate(errors), np.full((rows, 2), np.nan), np.concatenate(truths), dt, offsets)
    drift, calibration = Drift.fit(past)
    assert drift.constant_radps[0] == pytest.approx(5e-3, rel=0.15)
    assert drift.slow_radps[0] == pytest.approx(1e-2, rel=0.3)
    assert drift.memory_s[0] == pytest.approx(memory * DT)
    assert drift.white_share[0] == pytest.approx(0.8, abs=0.15)
    assert drift.white_share[1] >= 0.9  # robust sums of heavy tails spread a little more than single ones
    assert drift.turn_share[1] == pytest.approx(0.05, rel=0.2)
    assert drift.turn_share[0] ** 2 < 0.25 * drift.turn_share[1] ** 2
    assert calibration.std_rad[0] == pytest.approx(np.sqrt(5) * 1e-3, rel=0.1)


def test_an_expert_never_seen_has_no_drift_and_no_vote() -> None:
    rows = 300
    error = np.column_stack([1e-3 * np.random.default_rng(0).standard_normal(rows), np.full(rows, np.nan)])
    past = Past(error, np.full((rows, 2), np.nan), np.zeros(rows), np.full(rows, DT), np.array([0, rows]))
    drift, calibration = Drift.fit(past)
    assert all(np.isfinite(values).all() for values in drift.tensors().values())
    policy = ready(BiasFilter, calibration.std_rad.tolist(), drift)
    assert policy.act(seen(np.array([[0.1, 5.0]]))).tolist() == [[1.0, 0.0]]
    assert policy.act(seen(np.array([[0.1, 0.3]]), np.array([[0, 1]]))).tolist() == [[0.0, 1.0]]


def dense_biases(values: np.ndarray, noise: np.ndarray, drift: Drift) -> np.ndarray:
    """Biases ``(n,)`` of the first step given all ``(steps, n)`` increments, from the whole Gaussian at once."""
    steps, n = values.shape
    lag = np.abs(np.arange(steps)[:, None] - np.arange(steps)) * DT
    prior = np.zeros((steps, n, steps, n))
    for i in range(n):
        prior[:, i, :, i] = drift.slow_radps[i] ** 2 * np.exp(-lag / drift.memory_s[i])
    prior = prior.reshape(steps * n, steps * n)
    free = np.zeros((steps, n, steps))
    for k in range(steps):
        free[k, :, k] = 1.0  # the increment of every step may be anything
    free = free.reshape(steps * n, steps)
    spread = DT * DT * prior + np.diag(noise.ravel()) + 1e2 * free @ free.T
    return (DT * prior @ np.linalg.solve(spread, values.ravel()))[:n]


def test_smoother_is_the_dense_solution_of_its_window() -> None:
    rates, _ = gyro_and_cameras(LAG + 1, 3)
    drift = drift_of([0.01, 0.02, 0.05], [0.5, 2.0, 100.0])
    policy = ready(Smoother, [2e-3, 2e-3, 2e-4], drift)
    assert isinstance(policy, Smoother)
    for row in rates:
        policy.preview(seen(row[None]), np.ones(1, bool))
    noise = policy._ring[1][:, 0]
    values = (rates.astype(np.float32) * np.float64(np.float32(DT))).astype(np.float64)
    bias = dense_biases(values, noise, drift)
    from mixo_env.policies.smoother import look_back

    np.testing.assert_allclose(look_back(policy._ring, 0, 0), bias, atol=2e-6)
    target = np.average(values[0] - DT * bias, weights=1 / noise[0])
    weights = policy.act(seen(rates[:1]))
    assert float(weights[0] @ values[0]) == pytest.approx(np.clip(target, values[0].min(), values[0].max()), abs=1e-6)


def test_the_end_of_a_scene_has_no_future() -> None:
    rates, truth = gyro_and_cameras(50)
    drift = drift_of([0.0, 0.0, 0.05], [1.0, 1.0, 100.0])
    policy = ready(Smoother, [2e-3, 2e-3, 2e-4], drift)
    padded = np.vstack([rates, np.full((LAG + 1, 3), 2.5)])  # whatever is shown after the end is not believed
    fused = []
    for k in range(LAG + len(rates)):
        policy.preview(seen(padded[k][None]), np.array([k < len(rates)]))
        if k >= LAG:
            row = rates[k - LAG]
            fused.append(float((policy.act(seen(row[None])) * row).sum()))
    assert np.abs(np.array(fused) - truth).max() < 0.05
