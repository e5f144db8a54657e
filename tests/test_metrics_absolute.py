"""Alignment and absolute errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, TrajectoryError
from mixo_env.geometry import rotation_from_quaternion_wxyz, rotation_from_yaw
from mixo_env.metrics.absolute import absolute_errors, absolute_errors_se2, scene_absolute
from mixo_env.metrics.aggregate import share_above, statistics
from mixo_env.metrics.alignment import Alignment, NoScaleError, align, align_one_of_many
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.planar import PlanarPoses
from tests.trajectories import disturbed, drive, literal_angle_deg, moved, random_rotation


def ate_m(truth: Trajectory, estimate: Trajectory) -> float:
    return statistics(absolute_errors(truth, estimate).translation_m).rmse


@pytest.mark.parametrize("seed", range(4))
def test_sim3_undoes_any_similarity(seed):
    rng = np.random.default_rng(seed)
    truth = drive(rng)
    rotation, shift, scale = random_rotation(rng), rng.standard_normal(3) * 50, rng.uniform(0.01, 30)
    estimate = moved(truth, rotation, shift)
    estimate = Trajectory(estimate.positions_m * scale, estimate.quaternions_wxyz, estimate.timestamps_s)
    found = align(truth, estimate, "sim3")
    assert found.scale == pytest.approx(1 / scale)
    np.testing.assert_allclose(found.rotation, rotation.T, atol=1e-9)
    errors = absolute_errors(truth, found.apply(estimate))
    assert errors.translation_m.max() < 1e-8
    assert errors.rotation_deg.max() < 1e-6


@pytest.mark.parametrize("first", [None, 2, 40])
@pytest.mark.parametrize("seed", range(3))
def test_se3_undoes_any_rigid_motion(seed, first):
    rng = np.random.default_rng(seed)
    truth = drive(rng)
    estimate = moved(truth, random_rotation(rng), rng.standard_normal(3) * 50)
    assert ate_m(truth, align(truth, estimate, "se3", first).apply(estimate)) < 1e-7 or first == 2


@pytest.mark.parametrize("method", ["se3", "posyaw"])
def test_one_pose_aligns_by_its_orientation(method):
    rng = np.random.default_rng(0)
    truth = drive(rng)
    rotation = random_rotation(rng) if method == "se3" else rotation_from_yaw(2.0)
    estimate = moved(truth, rotation, np.array([4.0, -5.0, 6.0]))
    errors = absolute_errors(truth, align(truth, estimate, method, 1).apply(estimate))
    assert errors.translation_m.max() < 1e-9
    assert errors.rotation_deg.max() < 1e-9


def test_posyaw_undoes_a_turn_about_z_and_nothing_else():
    rng = np.random.default_rng(1)
    truth = drive(rng)
    estimate = moved(truth, rotation_from_yaw(-1.2), np.array([1.0, 2.0, 3.0]))
    found = align(truth, estimate, "posyaw")
    np.testing.assert_allclose(found.rotation, rotation_from_yaw(1.2), atol=1e-12)
    assert ate_m(truth, found.apply(estimate)) < 1e-9
    np.testing.assert_array_equal(align(truth, disturbed(rng, truth), "posyaw").rotation[2], [0, 0, 1])


@pytest.mark.parametrize("method", ["posyaw", "se3", "sim3"])
def test_alignment_is_the_best_of_its_kind(method):
    rng = np.random.default_rng(2)
    truth = drive(rng)
    estimate = disturbed(rng, truth, scale=0.9)
    found = align(truth, estimate, method)
    best = ate_m(truth, found.apply(estimate))
    for _ in range(50):
        turn = rotation_from_yaw(rng.normal(0, 0.01))
        if method != "posyaw":
            turn = turn @ rotation_from_quaternion_wxyz([1.0, *rng.normal(0, 0.005, 3)])
        scale = found.scale * (1 + rng.normal(0, 0.01)) if method == "sim3" else 1.0
        other = Alignment(scale, turn @ found.rotation, found.translation_m + rng.normal(0, 0.01, 3))
        assert ate_m(truth, other.apply(estimate)) >= best


def test_each_freedom_can_only_lower_the_error():
    rng = np.random.default_rng(3)
    truth = drive(rng)
    estimate = disturbed(rng, truth, scale=0.8)
    ates = [ate_m(truth, align(truth, estimate, m).apply(estimate)) for m in ("none", "posyaw", "se3", "sim3")]
    assert ates == sorted(ates, reverse=True)


@pytest.mark.parametrize("method", ["posyaw", "se3", "sim3"])
def test_exactly_straight_paths_align_by_the_shortest_turn(method):
    direction = np.array([3.0, 4.0, 0.0]) / 5.0
    along = np.arange(20.0)[:, None]
    identity = np.tile([1.0, 0.0, 0.0, 0.0], (20, 1))
    truth, estimate = Trajectory(along * [1.0, 0, 0] + 7.0, identity), Trajectory(along * direction, identity)
    found = align(truth, estimate, method)
    assert ate_m(truth, found.apply(estimate)) < 1e-9
    np.testing.assert_allclose(found.rotation, rotation_from_yaw(-np.arctan2(4.0, 3.0)), atol=1e-9)
    backwards = Trajectory(-along * direction, identity)
    assert ate_m(truth, align(truth, backwards, method).apply(backwards)) < 1e-9


@pytest.mark.parametrize("method", ["se3", "sim3"])
def test_a_straight_path_driven_backwards_is_turned_round(method):
    along = np.outer(np.arange(5.0), [0.6, 0.8, 0.0])
    facing = np.tile([1.0, 0, 0, 0], (5, 1))
    alignment = align(Trajectory(along, facing, None), Trajectory(-along, facing, None), method)
    assert alignment.rotation is not None
    np.testing.assert_allclose(-along @ alignment.rotation.T + alignment.translation_m, along, atol=1e-12)
    np.testing.assert_allclose(alignment.rotation @ alignment.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(alignment.rotation) == pytest.approx(1.0)


def test_standing_still_aligns_the_places_and_refuses_a_scale():
    identity = np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))
    truth, estimate = Trajectory(np.ones((5, 3)), identity), Trajectory(np.zeros((5, 3)), identity)
    assert ate_m(truth, align(truth, estimate, "se3").apply(estimate)) == 0.0
    with pytest.raises(TrajectoryError, match="moves"):
        align(truth, estimate, "sim3")


@pytest.mark.parametrize("tremble_m", [0.0, 1e-9, 0.02])
def test_sim3_refuses_a_truth_that_stands_and_does_not_score_it_zero(tremble_m):
    rng = np.random.default_rng(0)
    drives = drive(rng, 60)
    stands = replace(drives, positions_m=5.0 + tremble_m * rng.standard_normal((60, 3)))
    with pytest.raises(NoScaleError, match="a truth that moves"):
        align(stands, drives, "sim3")
    found, fell_back = align_one_of_many(stands, drives, "sim3")
    assert fell_back
    rigid = align(stands, drives, "se3")
    assert ate_m(stands, found.apply(drives)) == pytest.approx(ate_m(stands, rigid.apply(drives)))
    assert ate_m(stands, found.apply(drives)) > 1.0
    assert not align_one_of_many(drives, drives, "sim3")[1]


@pytest.mark.parametrize("tremble_m", [0.0, 1e-9])
def test_sim3_refuses_an_estimate_that_stands_nearly(tremble_m):
    rng = np.random.default_rng(0)
    drives = drive(rng, 60)
    stands = replace(drives, positions_m=5.0 + tremble_m * rng.standard_normal((60, 3)))
    with pytest.raises(NoScaleError, match="an estimate that moves"):
        align(drives, stands, "sim3")


def test_sim3_takes_a_small_scale_for_what_it_is():
    truth = drive(np.random.default_rng(0), 60)
    small = replace(truth, positions_m=1e-4 * truth.positions_m)
    assert align(truth, small, "sim3").scale == pytest.approx(1e4)


@pytest.mark.parametrize("value", [1e308, -1e308, np.inf, np.nan])
def test_alignment_refuses_what_would_hang_the_svd(value):
    truth = drive(np.random.default_rng(0), 60)
    wild = replace(truth, positions_m=truth.positions_m.copy())
    wild.positions_m[3, 1] = value
    for pair in ((truth, wild), (wild, truth)):
        for method in ("posyaw", "se3", "sim3"):
            with pytest.raises(TrajectoryError, match="finite coordinates"):
                align(*pair, method)


def test_alignment_refuses_unknown_names_and_impossible_numbers_of_poses():
    truth = drive(np.random.default_rng(0))
    with pytest.raises(ConfigurationError, match="did you mean 'sim3'"):
        align(truth, truth, "sim")
    for method, first in (("sim3", 1), ("se3", 0), ("se3", len(truth) + 1)):
        with pytest.raises(ConfigurationError, match="aligns on"):
            align(truth, truth, method, first)


def test_rotation_error_is_the_angle_of_the_difference():
    rng = np.random.default_rng(5)
    truth = drive(rng)
    estimate = moved(disturbed(rng, truth), random_rotation(rng), np.zeros(3))
    r, q = truth.matrices()[:, :3, :3], estimate.matrices()[:, :3, :3]
    expected = [literal_angle_deg(a @ b.T) for a, b in zip(q, r, strict=True)]
    np.testing.assert_allclose(absolute_errors(truth, estimate).rotation_deg, expected, atol=1e-9)


def test_planar_errors_equal_spatial_ones_and_hand_values():
    rng = np.random.default_rng(6)
    truth, estimate = rng.standard_normal((3, 50)) * 5, rng.standard_normal((3, 50)) * 5
    planar = absolute_errors_se2(PlanarPoses(*truth), PlanarPoses(*estimate))
    spatial = absolute_errors(Trajectory.from_planar(*truth), Trajectory.from_planar(*estimate))
    np.testing.assert_allclose(planar.translation_m, spatial.translation_m)
    np.testing.assert_allclose(planar.rotation_deg, spatial.rotation_deg, atol=1e-9)
    zero = np.zeros(3)
    errors = absolute_errors_se2(
        PlanarPoses(zero, zero, zero),
        PlanarPoses(np.array([3.0, 0, 0]), np.array([4.0, 0, 1]), np.array([0.1, 0, 7.0])),
    )
    np.testing.assert_allclose(errors.translation_m, [5, 0, 1])
    np.testing.assert_allclose(errors.rotation_deg, np.rad2deg([0.1, 0, 7.0 - 2 * np.pi]))
    per_scene = scene_absolute(errors, np.array([0, 1, 3]))
    np.testing.assert_allclose(per_scene.translation_m, [5.0, np.sqrt(0.5)])
    assert share_above(per_scene.translation_m) == 1.0
    assert share_above(per_scene.translation_m, 1.0) == 0.5


def test_statistics_by_hand():
    result = statistics(np.array([1.0, 2.0, 3.0, 6.0]))
    assert (result.mean, result.median, result.max, result.count) == (3.0, 2.5, 6.0, 4)
    assert result.rmse == pytest.approx(np.sqrt(12.5))
    assert result.std == pytest.approx(np.sqrt(3.5))
    assert np.isnan(statistics(np.empty(0)).rmse)
