"""What each policy decides, on cases worked by hand and against independent computations."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.policies.linear import Linear
from mixo_env.policies.match import HighestMatch
from mixo_env.policies.oracle import MulticameraGT, OracleAll, OracleHull
from mixo_env.policies.playing import collect
from mixo_env.policies.policy import Observation
from mixo_env.policies.robust import EFFICIENCY_95, Huber, Mean, Median, median_weights, votes
from mixo_env.recordings.fitting import with_fits
from tests.synthetic import NOISE_RAD, synthetic_recordings


def observation(rates: list[float], available: list[int] | None = None, **more: list[float]) -> Observation:
    """One scene with two cameras among the experts, 0.1 s steps."""
    table = {"yaw_rates": rates, "available": available or [1] * len(rates), "dt": [0.1], "matches": [0.0, 0.0]} | more
    return {name: np.array([values], dtype=np.float32) for name, values in table.items()}


def test_highest_match_follows_the_best_available_camera() -> None:
    assert HighestMatch().act(observation([1, 2, 3], matches=[50, 80])).tolist() == [[0, 1, 0]]
    assert HighestMatch().act(observation([1, 2, 3], [1, 0, 1], matches=[50, 80])).tolist() == [[1, 0, 0]]
    assert HighestMatch().act(observation([3, 3, 3], [0, 0, 1])).tolist() == [[1, 0, 0]]


def test_substitutes_have_no_vote_unless_nobody_else_has() -> None:
    seen = observation([1, 5, 5, 5], [1, 0, 0, 1])
    assert votes(seen).tolist() == [[True, False, False, True]]
    assert Mean().act(seen).tolist() == [[0.5, 0, 0, 0.5]]
    assert votes(observation([5, 5], [0, 0])).all()


@pytest.mark.parametrize("count", [1, 2, 4, 5])
def test_median_is_that_of_numpy(count: int) -> None:
    rng = np.random.default_rng(count)
    values = rng.integers(-3, 4, size=(200, count)).astype(float)
    weights = median_weights(values, np.ones(values.shape, dtype=bool))
    np.testing.assert_allclose((weights * values).sum(axis=1), np.median(values, axis=1))
    assert (np.count_nonzero(weights, axis=1) <= 2).all()


def test_median_ignores_substitutes() -> None:
    seen = observation([1, 7, 2, 9], [1, 0, 1, 1])
    assert Median().act(seen).tolist() == [[0, 0, 1, 0]]


def test_linear_weights_are_those_of_the_manifest() -> None:
    recordings = with_fits(synthetic_recordings(3))
    for track, by_fold in recordings.manifest.linear_weights.items():
        for held_out, expected in by_fold.items():
            folds = [fold for fold in range(4) if str(fold) != held_out]
            linear = Linear()
            linear.fit(recordings.select(folds=folds), track)
            np.testing.assert_allclose(linear.weights, list(expected.values()), rtol=1e-9, atol=1e-12)


def test_linear_is_the_least_squares_solution_of_what_it_sees() -> None:
    recordings = synthetic_recordings(4)
    linear = Linear()
    linear.fit(recordings, "VISION")
    seen = collect(recordings, "VISION", linear)
    increments, truth = seen["yaw_rates"] * seen["dt"], (seen["truth_yaw_rate"] * seen["dt"])[:, 0]
    gradient = increments.T @ (increments @ linear.weights - truth)
    np.testing.assert_allclose(gradient / np.linalg.norm(increments) ** 2, 0.0, atol=1e-6)


def test_huber_scales_are_the_noise_of_the_experts() -> None:
    recordings = synthetic_recordings(5, scenes=20, steps=200)
    huber = Huber()
    huber.fit(recordings, "PAPER")
    scale = dict(zip(huber.experts, huber.tensors()["scale_rad"], strict=True))
    assert scale["INERTIAL_POSE"] == pytest.approx(NOISE_RAD["INERTIAL_POSE"], rel=0.1)
    assert scale["CAM_FRONT"] < scale["CAM_BACK"] < scale["CAM_FRONT_LEFT"]


def test_huber_minimises_its_loss() -> None:
    rng = np.random.default_rng(0)
    scale = np.array([1e-3, 2e-3, 4e-3, 1e-3, 2e-3])
    huber = Huber()
    huber.experts = tuple("abcde")
    huber.restore({"scale_rad": scale})
    grid = np.linspace(-0.06, 0.06, 24_001)
    for _ in range(20):
        rates = rng.standard_t(1.5, size=5) * scale * 10
        seen = observation(rates.tolist())
        estimate = float((huber.act(seen) * seen["yaw_rates"]).sum() * 0.1)
        residual = np.abs(grid[:, None] - rates * 0.1) / scale
        loss = np.where(residual < EFFICIENCY_95, residual**2 / 2, EFFICIENCY_95 * (residual - EFFICIENCY_95 / 2))
        at_estimate = np.interp(estimate, grid, loss.sum(axis=1))
        assert at_estimate <= loss.sum(axis=1).min() * 1.005


def test_huber_resists_an_outlier_and_an_expert_never_seen() -> None:
    huber = Huber()
    huber.experts = tuple("abcd")
    huber.restore({"scale_rad": np.array([1e-3, 1e-3, 1e-3, np.inf])})
    weights = huber.act(observation([0.1, 0.1, 50.0, 0.2]))
    assert weights[0, 2] < 0.01
    assert weights[0, 3] == 0.0
    assert huber.act(observation([0.1, 0.1, 50.0, 0.2], [0, 0, 0, 1])).tolist() == [[0, 0, 0, 1]]


def test_multicamera_gt_chooses_among_available_cameras_only() -> None:
    truth = {"truth_yaw_rate": [0.45]}
    oracle = MulticameraGT()
    oracle.start(("CAM_FRONT", "CAM_BACK", "INERTIAL_POSE"))
    assert oracle.act(observation([0.1, 0.9, 0.5], **truth)).tolist() == [[1, 0, 0]]
    assert oracle.act(observation([0.1, 0.5, 0.5], [1, 0, 1], **truth)).tolist() == [[1, 0, 0]]
    oracle.start(("CAM_FRONT", "CAM_BACK", "DROID"))  # an imported odometry is a camera
    assert oracle.act(observation([0.1, 0.9, 0.5], **truth)).tolist() == [[0, 0, 1]]
    assert OracleAll().act(observation([0.1, 0.9, 0.5], **truth)).tolist() == [[0, 0, 1]]


@pytest.mark.parametrize(("truth", "expected"), [(0.5, 0.5), (-2.0, 0.1), (3.0, 0.9), (0.1, 0.1), (0.25, 0.25)])
def test_oracle_hull_clips_the_truth(truth: float, expected: float) -> None:
    seen = observation([0.4, 0.9, 0.1], truth_yaw_rate=[truth])
    assert (OracleHull().act(seen) * seen["yaw_rates"]).sum() == pytest.approx(expected)


def test_oracle_hull_of_equal_experts_is_their_value() -> None:
    seen = observation([0.4, 0.4], truth_yaw_rate=[0.7])
    assert (OracleHull().act(seen) * seen["yaw_rates"]).sum() == pytest.approx(0.4)
