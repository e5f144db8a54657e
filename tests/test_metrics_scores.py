"""Lost tracks, single-step scores, error anatomy, uncertainty, intervals and comparisons."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.metrics.anatomy import error_anatomy, split_error, yaw_bias_deg_per_s
from mixo_env.metrics.bootstrap import holm, interval_over_groups
from mixo_env.metrics.increments import increment_score, increments, skill
from mixo_env.metrics.tracks import count_lost_tracks, longest_true_run
from mixo_env.metrics.uncertainty import uncertainty_score
from mixo_env.trajectory.planar import PlanarPoses
from tests.paired import paired_difference

INITIALISING, TRACKING, LOST, NO_IMAGE = range(4)


def test_lost_tracks_by_hand():
    state = np.concatenate([[0, 1, 1, 2, 2, 0, 1, 2, 1], [0, 0, 2, 1, 1], [1, 3, 2, 2, 1]])
    result = count_lost_tracks(
        state == TRACKING, np.array([0, 9, 14, 19]), lost=state == LOST, observed=state != NO_IMAGE
    )
    assert result.counts.tolist() == [2, 0, 1]
    assert result.steps.tolist() == [3, 1, 2]
    assert result.longest_run.tolist() == [2, 1, 2]
    assert result.mean == 1.0
    assert result.std == pytest.approx(np.sqrt(2 / 3))


def test_a_fused_method_loses_track_when_no_camera_tracks():
    any_tracking = np.array([False, True, False, False, True, False])
    result = count_lost_tracks(any_tracking)
    assert result.counts.tolist() == [2]
    assert result.steps.tolist() == [4]
    assert longest_true_run(~any_tracking) == 2
    assert longest_true_run(np.zeros(3, dtype=bool)) == 0
    never = count_lost_tracks(np.ones(6, dtype=bool))
    assert (never.mean, never.std) == (0.0, 0.0)


def test_a_loss_never_spans_two_scenes():
    assert count_lost_tracks(np.array([True, False]), np.array([0, 1, 2])).counts.tolist() == [0, 0]


def test_increments_stay_within_scenes_and_wrap():
    steps, offsets = increments(np.array([3.0, 3.1, -3.1, 0.5, 0.6]), np.array([0, 3, 5]))
    np.testing.assert_allclose(steps, [0.1, 2 * np.pi - 6.2, 0.1])
    assert offsets.tolist() == [0, 2, 3]


def test_increment_scores_by_hand():
    truth, dt = np.array([0.1, 0.3, 0.2]), np.array([1.0, 1.0, 2.0])
    score = increment_score(truth, np.zeros(3), dt)
    assert score.yaw_increment_rmse_deg == pytest.approx(np.rad2deg(np.sqrt(0.14 / 3)))
    assert score.yaw_rate_rmse_deg_per_s == pytest.approx(np.rad2deg(np.sqrt((0.01 + 0.09 + 0.01) / 3)))
    assert score.skill_zero == pytest.approx(0.0)
    constant = np.array([0.15, 0.15, 0.3])
    assert score.skill_constant_rate == pytest.approx(1 - 0.14 / np.sum((truth - constant) ** 2))
    assert score.skill_previous_rate == pytest.approx(1 - 0.13 / (0.2**2 + 0.4**2))
    perfect = increment_score(truth, truth, dt)
    assert (perfect.yaw_increment_rmse_deg, perfect.skill_zero, perfect.skill_constant_rate) == (0.0, 1.0, 1.0)


def test_skill_is_measured_scene_by_scene():
    truth = np.array([0.1, 0.1, -0.3, -0.3])
    score = increment_score(truth, truth * 0.9, np.ones(4), np.array([0, 2, 4]))
    assert np.isnan(score.skill_constant_rate)
    assert np.isnan(score.skill_previous_rate)
    assert score.skill_zero == pytest.approx(0.99)
    assert np.isnan(skill(np.zeros(2), np.zeros(2)))


def test_position_error_splits_along_and_across_the_heading():
    along, across = split_error(
        PlanarPoses(np.zeros(2), np.zeros(2), np.array([0.0, np.pi / 2])),
        PlanarPoses(np.array([3.0, -2.0]), np.ones(2), np.zeros(2)),
    )
    np.testing.assert_allclose(along, [3.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(across, [1.0, 2.0], atol=1e-12)


@pytest.mark.parametrize("window", [1.0, 5.0, 20.0])
def test_a_constant_bias_is_found_at_every_window(window):
    time = np.concatenate([np.arange(0, 19.9, 0.1), np.arange(0, 40, 0.1)])
    offsets = np.array([0, 199, len(time)])
    error = np.where(np.arange(len(time)) < 199, np.deg2rad(0.3), np.deg2rad(-0.3)) * time
    assert yaw_bias_deg_per_s(error, time, window, offsets) == pytest.approx(0.3)


def test_white_noise_falls_with_the_window():
    rng = np.random.default_rng(0)
    time = np.arange(0, 2000, 0.1)
    error = np.cumsum(rng.normal(0, 1e-3, len(time)))
    one, twenty = (yaw_bias_deg_per_s(error, time, window) for window in (1.0, 20.0))
    assert one / twenty == pytest.approx(np.sqrt(20), rel=0.2)
    assert np.isnan(yaw_bias_deg_per_s(np.zeros(1), np.zeros(1), 1.0))


def test_anatomy_finds_outliers_and_lost_steps():
    rng = np.random.default_rng(1)
    n = 500
    step = rng.normal(0, 1e-3, n)
    lost = np.zeros(n, dtype=bool)
    lost[[0, 50, 260]] = True
    step[lost] = 0.5
    truth = np.zeros(n)
    yaw = np.concatenate([np.cumsum(step[:250]), np.cumsum(step[250:])])
    time = np.tile(np.arange(250) / 12, 2)
    true = PlanarPoses(truth, truth, truth)
    result = error_anatomy(true, PlanarPoses(truth + 1, truth, yaw), time, np.array([0, 250, 500]), lost)
    assert result.along_track_rmse_m == 1.0
    assert result.cross_track_rmse_m == 0.0
    assert result.all_lost_share == pytest.approx(2 / 498)  # row 0 ends no step
    assert result.all_lost_energy > 0.99
    assert 2 / 498 <= result.outlier_share < 0.02
    assert result.outlier_energy > 0.99
    assert set(result.bias_deg_per_s) == {1.0, 5.0, 20.0}
    assert np.isnan(error_anatomy(true, PlanarPoses(truth, truth, yaw), time, np.array([0, 250, 500])).all_lost_share)


def test_true_uncertainties_are_calibrated():
    rng = np.random.default_rng(2)
    std = rng.uniform(0.5, 2.0, 200_000)
    score = uncertainty_score(std * rng.standard_normal(len(std)), std)
    assert score.nees == pytest.approx(1.0, abs=0.02)
    assert score.coverage_68 == pytest.approx(0.68, abs=0.005)
    assert score.coverage_95 == pytest.approx(0.95, abs=0.005)
    timid = uncertainty_score(np.array([0.0, np.nan, 1.0]), np.array([1.0, 1.0, np.nan]))
    assert timid.count == 1
    assert timid.nll == pytest.approx(0.5 * np.log(2 * np.pi))
    assert uncertainty_score(np.array([np.nan]), np.ones(1)).count == 0
    with pytest.raises(ConfigurationError, match="above 0"):
        uncertainty_score(np.ones(2), np.array([1.0, 0.0]))


def test_interval_covers_the_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(3)
    inside = 0
    for trial in range(200):
        groups = np.repeat(np.arange(30), 20)
        values = rng.normal(0, 1, 30)[groups] + rng.normal(0, 1, 600)
        interval = interval_over_groups(values, groups, resamples=500, seed=trial)
        inside += interval.low <= 0.0 <= interval.high
    assert 0.88 <= inside / 200 <= 0.99


def test_interval_leaves_out_five_percent_by_default():
    """Many equal groups of one sample: the resampled mean is normal, of standard deviation sigma / sqrt(groups)."""
    values = np.linspace(-1.0, 1.0, 2000)
    for confidence, normal_quantile in ((0.95, 1.959964), (0.90, 1.644854), (0.5, 0.674490)):
        chosen = {} if confidence == 0.95 else {"confidence": confidence}
        interval = interval_over_groups(values, np.arange(2000), **chosen)
        expected = normal_quantile * values.std() / np.sqrt(2000)
        assert interval.confidence == confidence
        np.testing.assert_allclose([-interval.low, interval.high], expected, rtol=0.04)


def test_interval_resamples_groups_not_samples():
    groups = np.repeat(["a", "b"], 500)
    interval = interval_over_groups(np.where(groups == "a", 1.0, 3.0), groups)
    assert (interval.mean, interval.low, interval.high, interval.groups) == (2.0, 1.0, 3.0, 2)
    assert np.isnan(interval_over_groups([1.0, 2.0], ["a", "a"]).low)
    assert np.isnan(interval_over_groups([], []).mean)


def test_paired_difference_enumerates_all_signs():
    rng = np.random.default_rng(4)
    groups = np.repeat(np.arange(6), 10)
    a, b = rng.normal(0.5, 1, 60), rng.normal(0, 1, 60)
    sums = np.bincount(groups, weights=a - b)
    flipped = [abs(np.dot(signs, sums)) for signs in itertools.product((-1, 1), repeat=6)]
    expected = np.mean([value >= abs(sums.sum()) - 1e-12 for value in flipped])
    assert paired_difference(a, b, groups).p_value == pytest.approx(expected)
    same = paired_difference(a, a, groups)
    assert (same.difference.mean, same.p_value) == (0.0, 1.0)


def test_few_drives_can_never_be_significant():
    groups = np.repeat(np.arange(4), 100)
    assert paired_difference(np.zeros(400), np.ones(400), groups).p_value == 2 / 16


def test_random_signs_agree_with_all_signs(monkeypatch):
    rng = np.random.default_rng(5)
    a, b, groups = rng.normal(0.3, 1, 140), rng.normal(0, 1, 140), np.repeat(np.arange(14), 10)
    exact = paired_difference(a, b, groups).p_value
    monkeypatch.setattr("mixo_env.metrics.signflips.EXACT_GROUPS", 3)
    assert paired_difference(a, b, groups).p_value == pytest.approx(exact, abs=0.002)


def test_holm_by_hand():
    assert holm({"a": 0.01, "b": 0.04, "c": 0.03}) == pytest.approx({"a": 0.03, "b": 0.06, "c": 0.06})
    assert holm({"a": 0.9, "b": 0.8}) == {"a": 1.0, "b": 1.0}
    assert holm({}) == {}


def test_mismatched_samples_are_refused():
    with pytest.raises(ConfigurationError, match="group for each"):
        interval_over_groups([1.0], ["a", "b"])
    with pytest.raises(ConfigurationError, match="confidence"):
        interval_over_groups([1.0], ["a"], confidence=95)
