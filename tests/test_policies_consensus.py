"""The Student's t consensus, the experts' calibration, and what is built on both."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from mixo_env.policies.calibration import Calibration, Past, robust_std
from mixo_env.policies.consensus import (
    DEGREES_OF_FREEDOM,
    SAFE,
    StudentT,
    agreement,
    consensus_weights,
)
from mixo_env.policies.covariance_intersection import CovarianceIntersection
from mixo_env.policies.fixed_share import SWITCHING, FixedShare, share
from mixo_env.policies.inner import by_log, inner_folds
from mixo_env.policies.inverse_variance import InverseVariance
from mixo_env.policies.policy import Observation, Policy
from mixo_env.policies.robust import RATE_BOUND, Huber, believable
from mixo_env.policies.softmin import MEAN_TO_SIGMA, MEMORY, Softmin
from tests.synthetic import NOISE_RAD, synthetic_recordings

DT = 0.1


def observation(rates: list[float], available: list[int] | None = None, std: list[float] | None = None) -> Observation:
    table = {
        "yaw_rates": rates,
        "available": available or [1] * len(rates),
        "dt": [DT],
        "yaw_rate_std": std or [0.0] * len(rates),
    }
    return {name: np.array([values], dtype=np.float32) for name, values in table.items()}


def ready(kind: type[Policy], std_rad: list[float], factor: list[float] | None = None, **more: float) -> Policy:
    policy = kind()
    policy.start([chr(97 + i) for i in range(len(std_rad))])
    tensors = {"std_rad": np.array(std_rad), "factor": np.array(factor or [np.inf] * len(std_rad))}
    policy.restore(tensors | {name: np.array([value]) for name, value in more.items()})
    policy.reset(1)
    return policy


@pytest.mark.parametrize("nu", DEGREES_OF_FREEDOM)
def test_consensus_is_the_likeliest_value_of_scipy(nu: float) -> None:
    rng = np.random.default_rng(0)
    std = np.array([1.0, 2.0, 4.0, 1.0, 2.0])
    grid = np.linspace(-60, 60, 60_001)
    for _ in range(10):
        values = rng.standard_t(1.5, size=5) * std
        weights = consensus_weights(values[None], std[None], np.ones((1, 5), bool), nu)
        likelihood = stats.t.logpdf((grid[:, None] - values) / std, nu).sum(axis=1)
        found = stats.t.logpdf((float(weights[0] @ values) - values) / std, nu).sum()
        assert found >= likelihood.max() - 5e-3


def test_consensus_of_two_camps_is_the_likelier_one_not_their_middle() -> None:
    values = np.array([[0.0, 0.1, 10.0, 10.1, 10.2]])
    weights = consensus_weights(values, np.ones((1, 5)), np.ones((1, 5), bool), 1.0)
    assert float((weights * values).sum()) == pytest.approx(10.1, abs=0.15)
    sure = np.array([[0.1, 0.1, 9.0, 9.0, 9.0]])
    assert float((consensus_weights(values, sure, np.ones((1, 5), bool), 5.0) * values).sum()) < 0.5


def test_where_only_strangers_vote_agreement_is_with_their_median() -> None:
    calibration = Calibration(np.array([np.inf, np.inf, np.inf, 1e-3]), np.full(4, np.inf))
    one = observation([0.1, 0.2, 0.5, 0.1], [1, 1, 1, 0])
    other = observation([0.1, 0.2, 0.5, 0.3])
    both = {name: np.concatenate([values, other[name]]) for name, values in one.items()}
    apart, std, known = agreement(both, calibration)
    np.testing.assert_allclose(apart[0], np.array([-0.1, 0.0, 0.3, -0.1]) * DT, atol=1e-8)
    assert (std[0] == 1.0).all()
    assert known.tolist() == [[True, True, True, False], [False, False, False, True]]
    assert apart[1].tolist() == [0.0, 0.0, 0.0, 0.0]  # in standard deviations, which strangers have none of


def test_products_of_many_likelihoods_do_not_overflow() -> None:
    """30 sure votes against 31 less sure ones, too far away for the product of their likelihoods to be a number."""
    values, std = np.repeat([0.0, 1e8], [30, 31])[None], np.repeat([0.01, 1.0], [30, 31])[None]
    weights = consensus_weights(values, std, np.ones((1, 61), bool), 5.0)
    assert float((weights * values).sum()) == pytest.approx(0.0, abs=1e-3)


def test_influence_redescends_where_that_of_huber_does_not() -> None:
    student, scale = ready(StudentT, [1e-3] * 4, nu=5.0), {"scale_rad": np.full(4, 1e-3)}
    huber = Huber()
    huber.experts = student.experts
    huber.restore(scale)
    near, far = observation([0.0, 0.001, -0.001, 0.05]), observation([0.0, 0.001, -0.001, 3.0])

    def pull(policy: Policy, seen: Observation) -> float:
        return float((policy.act(seen) * seen["yaw_rates"]).sum())

    assert abs(pull(student, far)) < 0.1 * abs(pull(student, near))
    assert abs(pull(huber, far)) >= 0.9 * abs(pull(huber, near))


def test_experts_of_unknown_error_decide_only_where_nobody_else_votes() -> None:
    policy = ready(StudentT, [1e-3, np.inf, np.inf], nu=5.0)
    assert policy.act(observation([1.0, 2.0, 3.0])).tolist() == [[1, 0, 0]]
    assert policy.act(observation([1.0, 2.0, 3.0], [0, 1, 1])).tolist() == [[0, 0.5, 0.5]]


def test_a_rate_at_the_bound_of_the_observation_has_no_vote() -> None:
    bound = float(RATE_BOUND)
    assert believable(observation([0.1, bound, -bound, 3.0])).tolist() == [[True, False, False, True]]
    assert believable(observation([bound, 0.1], [1, 0])).tolist() == [[True, False]]
    for kind in (StudentT, InverseVariance, CovarianceIntersection, Softmin, FixedShare):
        policy = ready(kind, [1e-3, 1e-6, 1e-3], **({"nu": 5.0} if kind is StudentT else {}))
        assert policy.act(observation([0.1, bound, 0.1]))[0, 1] == 0.0


def test_calibration_measures_the_noise_and_scales_what_is_stated() -> None:
    recordings = synthetic_recordings(5, scenes=20, steps=200)
    experts = recordings.voters("PAPER")
    found = Calibration.fit(Past.read(recordings, experts))
    at = experts.index("INERTIAL_POSE")
    assert found.std_rad[at] == pytest.approx(NOISE_RAD["INERTIAL_POSE"], rel=0.1)
    np.testing.assert_allclose(found.factor, 1.0, rtol=0.15)  # the synthetic experts state their noise
    seen = observation([0.0] * len(experts), std=[0.02, *[0.0] * (len(experts) - 1)])
    assert found.std(seen)[0, 0] == pytest.approx(found.factor[0] * 0.02 * DT, rel=1e-6)
    assert found.std(seen)[0, 1] == found.std_rad[1]


def test_calibration_sees_what_adds_up_and_not_the_noise_of_poses() -> None:
    """Errors of poses cancel from step to step; an error that stays for seconds adds up."""
    rng = np.random.default_rng(0)
    scenes, steps, window = 20, 401, 20
    own = rng.normal(0.0, 1e-4, (scenes, steps, 2))
    own[..., 1] = np.repeat(rng.normal(0.0, 1e-4, (scenes, steps // window + 1)), window, axis=1)[:, :steps]
    poses = np.diff(rng.normal(0.0, 3e-4, (scenes, steps + 1)), axis=1)[..., None]
    past = Past(
        (own + poses).reshape(-1, 2),
        np.full((scenes * steps, 2), np.nan),
        np.zeros(scenes * steps),
        np.full(scenes * steps, 0.1),
        np.arange(scenes + 1) * steps,
    )
    noise, stays = Calibration.fit(past).std_rad
    assert noise == pytest.approx(np.sqrt(1e-4**2 + 2 * 3e-4**2 / window), rel=0.15)
    assert stays > 2.0 * noise
    single = Calibration.over(past, 1).std_rad
    np.testing.assert_allclose(single, np.sqrt(1e-4**2 + 2 * 3e-4**2), rtol=0.1)


def test_robust_std_of_an_expert_never_seen_is_infinite() -> None:
    values = np.array([[1.0, np.nan], [-1.0, np.nan], [100.0, np.nan]])
    assert robust_std(values).tolist() == [1.4826, np.inf]


def test_inner_folds_hold_every_log_out_once_and_never_train_on_it() -> None:
    recordings = synthetic_recordings(0, scenes=8, logs=4)
    logs = []
    for held_out, rest in inner_folds(recordings):
        assert not {scene.log for scene in rest.scenes} & set(held_out)
        logs += held_out
    assert sorted(logs) == sorted({scene.log for scene in recordings.scenes})
    assert not list(inner_folds(recordings.select(scenes=[recordings.scenes[0].name])))
    assert set(by_log(recordings, "VISION")) == set(logs)


def test_nu_is_chosen_by_log_and_falls_where_an_expert_breaks_now_and_then() -> None:
    clean = synthetic_recordings(3, scenes=8)
    wild = clean["CAM_FRONT.yaw_increment_rad"].copy()
    rng = np.random.default_rng(0)
    broken = rng.random(len(wild)) < 0.2
    wild[broken] += rng.choice([-0.02, 0.02], broken.sum()).astype(np.float32)
    student = StudentT()
    student.fit(clean.replace(columns={"CAM_FRONT.yaw_increment_rad": wild}), "VISION")
    assert student.nu <= 3.0
    student.fit(clean.select(scenes=[clean.scenes[0].name]), "VISION")
    assert student.nu == SAFE  # one log alone cannot choose


def test_inverse_variance_by_hand_and_without_outliers() -> None:
    policy = ready(InverseVariance, [1e-3, 2e-3, 1e-3])
    np.testing.assert_allclose(policy.act(observation([0.1, 0.1, 0.1])), [[4 / 9, 1 / 9, 4 / 9]])
    np.testing.assert_allclose(policy.act(observation([0.1, 0.1, 2.0])), [[0.8, 0.2, 0.0]])
    stated = ready(InverseVariance, [1e-3, 1e-3], [2.0, 1.0])
    np.testing.assert_allclose(
        stated.act(observation([0.1, 0.1], std=[0.01, 0.01])), [[0.2, 0.8]], rtol=1e-5
    )  # 2 x 1 mrad against 1 mrad


def test_covariance_intersection_is_the_best_omega_of_a_grid() -> None:
    std = np.array([2e-3, 1e-3, 3e-3])
    policy = ready(CovarianceIntersection, std.tolist())
    steps = np.linspace(0, 1, 21)
    grid = np.array([[a, b, 1 - a - b] for a in steps for b in steps if a + b <= 1 + 1e-12])
    variance = 1.0 / (grid @ std**-2)
    np.testing.assert_allclose(policy.act(observation([0.1, 0.11, 0.1]))[0], grid[np.argmin(variance)], atol=1e-12)


def test_covariance_intersection_leaves_an_expert_that_contradicts_the_others() -> None:
    policy = ready(CovarianceIntersection, [1e-3, 5e-4, 2e-3, 2e-3])
    assert policy.act(observation([0.1, 0.5, 0.1, 0.1])).tolist() == [[1, 0, 0, 0]]


def test_softmin_by_hand() -> None:
    policy = ready(Softmin, [1e-3, 2e-3])
    first = observation([0.1, 0.1])
    kept = 1.0 - 1.0 / MEMORY
    np.testing.assert_allclose(policy.act(first), [[0.8, 0.2]])  # both fade alike
    apart, _, _ = agreement(observation([0.1, 0.2]), policy._calibration)  # type: ignore[attr-defined]
    scale = np.array([1e-3, 2e-3]) * (kept * kept + MEAN_TO_SIGMA * np.abs(apart[0]) / MEMORY)
    np.testing.assert_allclose(policy.act(observation([0.1, 0.2]))[0], scale**-2 / (scale**-2).sum(), rtol=1e-9)


def test_softmin_remembers_who_broke_and_forgives() -> None:
    policy = ready(Softmin, [1e-3] * 3)
    for _ in range(5):
        policy.act(observation([0.1, 0.1, 0.4]))
    soon = policy.act(observation([0.1, 0.1, 0.1]))[0, 2]
    for _ in range(300):
        late = policy.act(observation([0.101, 0.099, 0.1]))[0, 2]
    assert soon < 0.05 < late
    policy.reset(1)
    assert policy.act(observation([0.1, 0.1, 0.1]))[0, 2] == pytest.approx(1 / 3)


def best_with_switches(loss: np.ndarray, switches: int) -> float:
    """Least sum of losses ``(T, n)`` along a sequence of experts with so many changes, by dynamic programming."""
    best = np.full((switches + 1, loss.shape[1]), np.inf)
    best[0] = loss[0]
    for row in loss[1:]:
        moved = np.vstack([np.full((1, loss.shape[1]), np.inf), np.repeat(best[:-1].min(1)[:, None], len(row), 1)])
        best = np.minimum(best, moved) + row
    return float(best.min())


@pytest.mark.parametrize("switches", [0, 1, 3, 8])
def test_fixed_share_keeps_its_promise_against_every_sequence_of_experts(switches: int) -> None:
    rng = np.random.default_rng(switches)
    rounds, n = 400, 4
    loss = rng.exponential(2.0, (rounds, n))
    for k, part in enumerate(np.array_split(np.arange(rounds), switches + 1)):
        loss[part, k % n] *= 0.05  # another expert is good in every part
    trust, mixed, regret = np.full((1, n), 1 / n), 0.0, []
    for t in range(rounds):
        _, trust, one = share(trust, loss[t : t + 1], np.ones((1, n), bool))
        mixed += float(one[0])
        if t + 1 in (100, 200, 400):
            k = min(switches, t)
            bound = np.log(n) + k * np.log(n / SWITCHING) + (t - k) * np.log(1 / (1 - SWITCHING))
            regret.append(mixed - best_with_switches(loss[: t + 1], switches))
            assert regret[-1] <= bound
    if switches == 0:  # the curve is flat but for the share that is dealt out
        assert regret[-1] - regret[0] <= 300 * np.log(1 / (1 - SWITCHING))


def test_fixed_share_sleepers_keep_their_trust() -> None:
    trust = np.array([[0.5, 0.3, 0.2]])
    posterior, following, loss = share(trust, np.array([[1.0, 2.0, 9.0]]), np.array([[True, True, False]]))
    a, b = 0.5 * np.exp(-1), 0.3 * np.exp(-2)
    np.testing.assert_allclose(posterior, [[a / (a + b), b / (a + b), 0.0]])
    assert loss[0] == pytest.approx(-np.log((a + b) / 0.8))
    np.testing.assert_allclose(following[0, 2], 0.99 * 0.2 + 0.01 / 3)


def test_fixed_share_follows_the_agreeing_expert() -> None:
    policy = ready(FixedShare, [1e-3] * 3)
    for _ in range(20):
        weights = policy.act(observation([0.1, 0.1, 0.15]))
    assert weights[0, 2] < 1e-3
