"""Pairs and relative errors: hand-worked cases, properties, and a literal O(n^2) oracle."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.metrics import pairs as pairs_module
from mixo_env.metrics import relative as relative_module
from mixo_env.metrics.aggregate import mean_of_length_means, per_length, pooled, rmse_over_length
from mixo_env.metrics.pairs import PairRule, Pairs, find_end_pairs, find_kitti_pairs, find_pairs, path_length
from mixo_env.metrics.relative import relative_errors, relative_errors_se2, relative_samples_se2
from mixo_env.trajectory import Trajectory, read_trajectory
from mixo_env.trajectory.planar import PlanarPoses
from tests.trajectories import (
    disturbed,
    drive,
    literal_error,
    literal_pairs,
    literal_path,
    literal_rpg_pairs,
    moved,
    random_rotation,
)

LENGTHS = (5.0, 10.0, 20.0, 37.3, 60.0)
SHAPES = [{}, {"stop": True}, {"gap": True}, {"stop": True, "gap": True}]


def listed(pairs: Pairs, length: float) -> list[tuple[int, int]]:
    here = pairs.length_m == length
    return list(zip(pairs.start[here].tolist(), pairs.end[here].tolist(), strict=True))


def straight(positions: list[float]) -> np.ndarray:
    x = np.array(positions)
    return np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=-1)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("tolerance", "spacing"), [("step", 1.0), ("step", 0.0), (0.2, 0.0), (0.05, 2.5)])
def test_pairs_equal_the_literal_definition(shape, tolerance, spacing):
    for seed in range(5):
        truth = drive(np.random.default_rng(seed), **shape)
        distance = path_length(truth.positions_m)
        assert distance.tolist() == literal_path(truth.positions_m)
        found = find_pairs(distance, PairRule(LENGTHS, tolerance=tolerance, min_start_spacing_m=spacing))
        for length in LENGTHS:
            assert listed(found, length) == literal_pairs(distance.tolist(), length, tolerance, spacing)


@pytest.mark.parametrize("shape", SHAPES)
def test_rpg_pairs_equal_the_reference_tools_shifted_ones(shape):
    distance = path_length(drive(np.random.default_rng(3), **shape).positions_m)
    found = find_pairs(distance, PairRule(LENGTHS, pairs="rpg"))
    for length in LENGTHS:
        assert listed(found, length) == literal_rpg_pairs(distance.tolist(), length)


def test_rpg_pairs_shift_after_a_start_without_an_end():
    # From 0 m nothing lies within 2 m of 10 m; from 5 m the pose at 15 m does, and the tool calls its start row 0.
    distance = path_length(straight([0.0, 5.0, 6.0, 15.0, 16.0]))
    assert listed(find_pairs(distance, PairRule((10.0,), tolerance=0.2, min_start_spacing_m=0.0)), 10.0) == [
        (1, 3),
        (2, 4),
    ]
    assert listed(find_pairs(distance, PairRule((10.0,), pairs="rpg")), 10.0) == [(0, 3), (1, 4)]


def test_pairs_by_hand():
    distance = path_length(straight([0.0, 4.0, 8.0, 11.0, 15.0]))
    # From 0: |8-10| = 2, |11-10| = 1 -> row 3. From 4: |15-14| = 1 -> but only 11 m are left: fine, 11 >= 10.
    # From 8: 7 m are left.
    assert listed(find_pairs(distance, PairRule((10.0,))), 10.0) == [(0, 3), (1, 4)]
    # A tolerance of 0.4 also accepts the 7 m from row 2 as "10 m": the reference tool's defect.
    assert listed(find_pairs(distance, PairRule((10.0,), tolerance=0.4)), 10.0) == [(0, 3), (1, 4), (2, 4)]


def test_equally_near_ends_take_the_first():
    distance = path_length(straight([0.0, 9.0, 11.0, 20.0]))
    assert listed(find_pairs(distance, PairRule((10.0,))), 10.0) == [(0, 1), (1, 3)]


def test_standstill_takes_the_first_pose_of_the_plateau_and_starts_once():
    distance = path_length(straight([0.0, 0.0, 0.0, 5.0, 10.0, 10.0, 10.0, 15.0]))
    assert listed(find_pairs(distance, PairRule((10.0,))), 10.0) == [(0, 4), (3, 7)]
    dense = PairRule((10.0,), min_start_spacing_m=0.0)
    assert listed(find_pairs(distance, dense), 10.0) == [(0, 4), (1, 4), (2, 4), (3, 7)]
    # The first pose of the plateau also when the target lies beyond it.
    assert listed(find_pairs(distance, PairRule((11.0,))), 11.0) == [(0, 4)]


def test_pieces_cross_a_gap_but_never_stand_still():
    distance = path_length(straight([0.0, 1.0, 2.0, 40.0, 41.0]))
    found = find_pairs(distance, PairRule((10.0,), end_length="actual"))
    assert listed(found, 10.0) == [(0, 2), (1, 2), (2, 3)]
    assert found.path_m.tolist() == [2.0, 1.0, 38.0]
    assert listed(find_pairs(distance, PairRule((10.0,), tolerance=0.2)), 10.0) == []


def test_a_scene_that_stands_still_has_no_sample():
    offsets = np.array([0, 4, 8])
    positions = np.concatenate([straight([7.0] * 4), straight([0.0, 6.0, 12.0, 18.0])])
    distance = path_length(positions, offsets)
    assert distance.tolist() == [0.0] * 4 + [0.0, 6.0, 12.0, 18.0]
    found = find_pairs(distance, PairRule((10.0,)), offsets)
    assert found.scene.tolist() == [1, 1]
    assert find_end_pairs(distance, offsets).scene.tolist() == [1]


def test_scenes_never_share_a_piece():
    rng = np.random.default_rng(5)
    scenes = [drive(rng, poses) for poses in (80, 2, 120, 60)]
    offsets = np.concatenate([[0], np.cumsum([len(scene) for scene in scenes])])
    together = find_pairs(path_length(np.concatenate([s.positions_m for s in scenes]), offsets), PairRule(), offsets)
    for i, scene in enumerate(scenes):
        alone = find_pairs(path_length(scene.positions_m))
        here = together.scene == i
        np.testing.assert_array_equal(together.start[here] - offsets[i], alone.start)
        np.testing.assert_array_equal(together.end[here] - offsets[i], alone.end)


def test_kitti_pairs_end_strictly_beyond_the_length():
    positions = straight([float(10 * k) for k in range(41)])
    found = find_kitti_pairs(path_length(positions))
    assert listed(found, 100.0) == [(0, 11), (10, 21), (20, 31)]
    assert listed(found, 300.0) == [(0, 31)]
    assert listed(found, 400.0) == []


@pytest.mark.parametrize("shape", SHAPES)
def test_errors_equal_four_by_four_products(shape):
    rng = np.random.default_rng(11)
    truth = drive(rng, **shape)
    estimate = disturbed(rng, truth, scale=0.7)
    pairs = find_pairs(path_length(truth.positions_m), PairRule(LENGTHS))
    samples = relative_errors(truth, estimate, pairs, scale=1.3)
    g, e = truth.matrices(), estimate.matrices()
    expected = [literal_error(g, e, i, j, 1.3) for i, j in zip(pairs.start, pairs.end, strict=True)]
    np.testing.assert_allclose(samples.translation_m, [t for t, _ in expected], atol=1e-9)
    np.testing.assert_allclose(samples.rotation_deg, [r for _, r in expected], atol=1e-9)
    np.testing.assert_allclose(samples.translation_percent, 100 * samples.translation_m / pairs.length_m)


def test_actual_length_divides_by_the_path_between_the_poses():
    rng = np.random.default_rng(2)
    truth = drive(rng)
    estimate = disturbed(rng, truth)
    pairs = find_pairs(path_length(truth.positions_m), PairRule(LENGTHS))
    actual = relative_errors(truth, estimate, pairs, end_length="actual")
    np.testing.assert_allclose(actual.rotation_deg_per_m, actual.rotation_deg / pairs.path_m)


def test_moving_either_world_changes_nothing():
    rng = np.random.default_rng(4)
    truth = drive(rng)
    estimate = disturbed(rng, truth)
    pairs = find_pairs(path_length(truth.positions_m), PairRule(LENGTHS))
    before = relative_errors(truth, estimate, pairs)
    after = relative_errors(
        moved(truth, random_rotation(rng), rng.standard_normal(3)),
        moved(estimate, random_rotation(rng), rng.standard_normal(3)),
        pairs,
    )
    np.testing.assert_allclose(after.translation_m, before.translation_m, atol=1e-9)
    np.testing.assert_allclose(after.rotation_deg, before.rotation_deg, atol=1e-9)


def test_reversal_keeps_rotation_errors_and_swapping_keeps_both_kinds_of_rotation():
    rng = np.random.default_rng(6)
    truth = drive(rng)
    estimate = disturbed(rng, truth)
    pairs = find_pairs(path_length(truth.positions_m), PairRule(LENGTHS))
    last = len(truth) - 1
    turned = Pairs(
        last - pairs.end, last - pairs.start, pairs.scene, pairs.length_m, pairs.path_m, LENGTHS, pairs.offsets
    )
    back = slice(None, None, -1)
    forward = relative_errors(truth, estimate, pairs)
    backward = relative_errors(truth[back], estimate[back], turned)
    np.testing.assert_allclose(backward.rotation_deg, forward.rotation_deg, atol=1e-9)
    swapped = relative_errors(estimate, truth, pairs)
    np.testing.assert_allclose(swapped.translation_m, forward.translation_m, atol=1e-9)


def test_a_perfect_estimate_has_no_error_whatever_the_quaternion_signs():
    rng = np.random.default_rng(8)
    truth = drive(rng)
    signs = rng.choice([-1.0, 1.0], size=(len(truth), 1))
    estimate = Trajectory(truth.positions_m, truth.quaternions_wxyz * signs, truth.timestamps_s)
    samples = relative_errors(truth, estimate, find_pairs(path_length(truth.positions_m)))
    assert samples.translation_m.max() < 1e-10
    assert samples.rotation_deg.max() < 1e-10


def test_tiny_rotations_keep_their_digits():
    positions = straight([0.0, 10.0, 20.0])
    yaw = np.array([0.0, 1e-9, 3e-9])
    truth, estimate = (
        Trajectory.from_planar(*positions[:, :2].T, np.zeros(3)),
        Trajectory.from_planar(*positions[:, :2].T, yaw),
    )
    samples = relative_errors(truth, estimate, find_pairs(path_length(positions), PairRule((10.0,))))
    np.testing.assert_allclose(samples.rotation_deg, np.rad2deg([1e-9, 2e-9]), rtol=1e-6)


def test_scale_error_on_a_straight_road_is_that_percentage():
    truth = Trajectory.from_planar(np.arange(200.0), np.zeros(200), np.zeros(200))
    estimate = Trajectory.from_planar(1.02 * np.arange(200.0), np.zeros(200), np.zeros(200))
    samples = relative_errors(truth, estimate, find_pairs(path_length(truth.positions_m)))
    score = pooled(samples)
    assert score.translation_percent == pytest.approx(2.0, abs=1e-9)
    assert score.rotation_deg_per_m == 0.0
    assert relative_errors(
        truth, estimate, find_pairs(path_length(truth.positions_m)), scale=1 / 1.02
    ).translation_m.max() == pytest.approx(0.0, abs=1e-9)


def test_planar_path_equals_the_spatial_one():
    rng = np.random.default_rng(9)
    offsets = np.array([0, 70, 150])
    yaw = np.cumsum(0.05 * rng.standard_normal(150)) + 3.0
    x, y = np.cumsum(np.cos(yaw)), np.cumsum(np.sin(yaw))
    other = (x + rng.standard_normal(150), y + rng.standard_normal(150), yaw + 0.1 * rng.standard_normal(150) + 12.0)
    both = PlanarPoses(x, y, yaw), PlanarPoses(*other)
    planar = relative_samples_se2(*both, PairRule(LENGTHS), offsets)
    truth, estimate = Trajectory.from_planar(x, y, yaw), Trajectory.from_planar(*other)
    pairs = find_pairs(path_length(truth.positions_m, offsets), PairRule(LENGTHS), offsets)
    spatial = relative_errors(truth, estimate, pairs)
    np.testing.assert_allclose(planar.translation_m, spatial.translation_m, atol=1e-9)
    np.testing.assert_allclose(planar.rotation_deg, spatial.rotation_deg, atol=1e-9)
    scaled = relative_errors_se2(*both, pairs, scale=np.array([1.1, 0.9]))
    np.testing.assert_allclose(
        scaled.translation_m, relative_errors(truth, estimate, pairs, scale=np.array([1.1, 0.9])).translation_m
    )


def test_compiled_and_interpreted_loops_agree(monkeypatch):
    rng = np.random.default_rng(10)
    truth = drive(rng, stop=True)
    estimate = disturbed(rng, truth)
    distance = path_length(truth.positions_m)
    rules = [PairRule(LENGTHS), PairRule(LENGTHS, tolerance=0.2), PairRule(LENGTHS, pairs="rpg")]
    interpreted = [relative_errors(truth, estimate, find_pairs(distance, rule)) for rule in rules]
    monkeypatch.setattr(pairs_module, "_COMPILE_ABOVE", 0)
    monkeypatch.setattr(relative_module, "_COMPILE_ABOVE", 0)
    for rule, slow in zip(rules, interpreted, strict=True):
        fast = relative_errors(truth, estimate, find_pairs(distance, rule))
        np.testing.assert_array_equal(fast.start, slow.start)
        np.testing.assert_array_equal(fast.end, slow.end)
        np.testing.assert_allclose(fast.translation_m, slow.translation_m, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(fast.rotation_deg, slow.rotation_deg, rtol=1e-12, atol=1e-12)


def test_aggregates_by_hand():
    distance = path_length(straight([0.0, 10.0, 20.0, 30.0]))
    truth = Trajectory.from_planar([0.0, 10.0, 20.0, 30.0], np.zeros(4), np.zeros(4))
    estimate = Trajectory.from_planar([0.0, 11.0, 21.0, 33.0], np.zeros(4), np.zeros(4))
    samples = relative_errors(truth, estimate, find_pairs(distance, PairRule((10.0, 20.0, 40.0))))
    # 10 m: 1, 0, 2 m; 20 m: 1, 2 m; 40 m: none.
    ten, twenty, forty = per_length(samples)
    assert (ten.samples, twenty.samples, forty.samples) == (3, 2, 0)
    assert (ten.scenes, forty.scenes) == (1, 0)
    assert ten.translation_m.mean == pytest.approx(1.0)
    assert ten.translation_m.rmse == pytest.approx(np.sqrt(5 / 3))
    assert ten.translation_m.std == pytest.approx(np.sqrt(2 / 3))
    assert ten.translation_m.max == pytest.approx(2.0)
    assert np.isnan(forty.translation_m.mean)
    assert pooled(samples).translation_percent == pytest.approx((10 + 0 + 20 + 5 + 10) / 5)
    assert mean_of_length_means(samples).translation_percent == pytest.approx((10 + 7.5) / 2)
    expected = 100 * (np.sqrt(5 / 3) + np.sqrt(5 / 2)) / 30
    assert rmse_over_length(samples).translation_percent == pytest.approx(expected)


def test_no_sample_gives_nan_not_zero():
    still = Trajectory.from_planar(np.ones(5), np.ones(5), np.zeros(5))
    samples = relative_errors(still, still, find_pairs(path_length(still.positions_m)))
    score = pooled(samples)
    assert np.isnan(score.translation_percent)
    assert (score.samples, score.scenes) == (0, 0)
    assert np.isnan(mean_of_length_means(samples).translation_percent)
    assert np.isnan(rmse_over_length(samples).rotation_deg_per_m)


@pytest.mark.parametrize(
    "wrong",
    [
        {"lengths_m": ()},
        {"lengths_m": (10.0, 5.0)},
        {"lengths_m": (0.0, 5.0)},
        {"lengths_m": (float("nan"),)},
        {"tolerance": "frame"},
        {"tolerance": 0.0},
        {"min_start_spacing_m": -1.0},
        {"end_length": "real"},
        {"pairs": "evo"},
    ],
)
def test_rules_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ConfigurationError):
        PairRule(**wrong)


def test_offsets_must_cover_the_rows():
    with pytest.raises(ConfigurationError, match="offsets"):
        find_pairs(np.arange(5.0), None, np.array([0, 4]))


def real_truths() -> list[Path]:
    """A dozen real ground-truth paths, standing scenes among them, where real data is at hand."""
    root = os.environ.get("MIXO_REAL_DATA")
    return sorted((Path(root) / "nuscenes_val_poses").glob("*.txt"))[::6] if root else []


@pytest.mark.parametrize("path", real_truths(), ids=lambda path: path.stem)
def test_real_paths_give_the_literal_pairs(path):
    distance = path_length(read_trajectory(path).positions_m)
    found = find_pairs(distance)
    for length in found.lengths_m:
        assert listed(found, length) == literal_pairs(distance.tolist(), length)
