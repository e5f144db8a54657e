"""Folds by log, the paper's contiguous folds, and what is fitted on them."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixo_env.envs.replay import Replay
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.fitting import DEFAULT_REWARD_SCALE_RAD, with_fits
from mixo_env.recordings.folds import contiguous_folds, folds_by_log, with_folds
from mixo_env.recordings.schema import HEADLINE_TRACKS, TRACKS, SceneEntry, VehicleConstants
from mixo_env.recordings.substitutes import substituted_increments
from mixo_env.recordings.vehicles import fit_vehicle_constants, training_constants, with_held_out_constants
from tests.synthetic import synthetic_recordings


def entries(logs: list[int], night: set[int] = frozenset()) -> list[SceneEntry]:
    return [
        SceneEntry(f"scene-{i + 1:04d}", f"log-{log}", "n", "x", ("night" if i in night else "day",), 0, 1)
        for i, log in enumerate(logs)
    ]


def refolded(recordings: Recordings, folds: list[int]) -> Recordings:
    scenes = tuple(replace(s, fold=f) for s, f in zip(recordings.scenes, folds, strict=True))
    return recordings.replace(replace(recordings.manifest, scenes=scenes))


def test_folds_by_log_by_hand():
    # Log sizes 3, 2, 2, 1, 1: the last two go to the two smallest folds in turn.
    assert folds_by_log(entries([0, 0, 0, 1, 1, 2, 2, 3, 4])) == [0, 0, 0, 1, 1, 2, 2, 3, 3]
    assert folds_by_log(entries([0, 0])) == [0, 0]
    assert folds_by_log(entries([0, 1, 1], night={0})) == [-1, 0, 0]
    assert folds_by_log(entries([0, 0], night={0, 1})) == [-1, -1]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 15), min_size=1, max_size=80), st.integers(0, 99))
def test_a_log_never_straddles_folds_and_order_does_not_matter(logs, seed):
    scenes = entries(logs)
    folds = folds_by_log(scenes)
    by_log = defaultdict(set)
    for scene, fold in zip(scenes, folds, strict=True):
        by_log[scene.log].add(fold)
    assert all(len(found) == 1 for found in by_log.values())
    largest = max(logs.count(log) for log in logs)
    sizes = np.bincount(folds, minlength=4)
    assert sizes.max() - sizes.min() <= largest
    order = np.random.default_rng(seed).permutation(len(scenes))
    assert folds_by_log([scenes[i] for i in order]) == [folds[i] for i in order]


def test_contiguous_folds_are_the_papers_blocks():
    folds = contiguous_folds(entries([0] * 740, night={0, 5, 6, 700}))
    assert folds.count(-1) == 4
    day = [fold for fold in folds if fold >= 0]
    assert day == sorted(day)
    assert [day.count(fold) for fold in range(4)] == [184] * 4
    assert [scene.fold for scene in with_folds(entries([0, 1, 2, 3]), "contiguous")] == [0, 1, 2, 3]


def test_lost_cameras_are_replaced_by_the_tracks_own_inertial_expert():
    recordings = synthetic_recordings(scenes=2)
    for track in HEADLINE_TRACKS:
        inertial = TRACKS[track]
        votes = substituted_increments(recordings, track)
        voters = recordings.voters(track)
        raw = np.stack([recordings[f"{voter}.yaw_increment_rad"] for voter in voters], axis=1)
        lost = np.isnan(raw)
        replacement = recordings[f"{inertial or 'INERTIAL'}.yaw_increment_rad"]
        np.testing.assert_array_equal(votes, np.where(lost, replacement[:, None], raw))
        assert lost[1:].any()
        assert np.isnan(votes[recordings.offsets[:-1]]).all()


def test_weights_are_the_least_squares_solution_without_the_fold_held_out():
    fitted = with_fits(synthetic_recordings())
    weights = fitted.manifest.linear_weights["CONSUMER"]
    assert set(weights) == {"none", "0", "1", "2", "3"}
    assert tuple(weights["2"]) == fitted.voters("CONSUMER")
    training = fitted.select(folds=[0, 1, 3])
    votes = substituted_increments(training, "CONSUMER")
    truth = training["truth.yaw_increment_rad"]
    used = np.isfinite(truth)
    gram = votes[used].T @ votes[used]
    expected = np.linalg.solve(gram, votes[used].T @ truth[used])
    np.testing.assert_allclose(list(weights["2"].values()), expected, rtol=1e-6)


def test_held_out_weights_ignore_the_fold_and_night():
    recordings = synthetic_recordings()
    changed = recordings["truth.yaw_increment_rad"].copy()
    for i, scene in enumerate(recordings.scenes):
        if scene.fold == 2:
            changed[recordings.offsets[i] : recordings.offsets[i + 1]] *= -3.0
    other = with_fits(recordings.replace(columns={"truth.yaw_increment_rad": changed}))
    same = with_fits(recordings)
    for track in HEADLINE_TRACKS:
        assert other.manifest.linear_weights[track]["2"] == same.manifest.linear_weights[track]["2"]
        assert other.manifest.linear_weights[track]["0"] != same.manifest.linear_weights[track]["0"]
    night = with_fits(refolded(recordings, [scene.fold if scene.fold != 2 else -1 for scene in recordings.scenes]))
    assert night.manifest.linear_weights["PAPER"]["none"] == same.manifest.linear_weights["PAPER"]["2"]
    assert "2" not in night.manifest.linear_weights["PAPER"]


def test_reward_scale_is_the_spread_of_errors_out_of_fold():
    fitted = with_fits(synthetic_recordings())
    errors = []
    for i, scene in enumerate(fitted.scenes):
        only = fitted.select(scenes=[scene.name])
        w = list(fitted.manifest.linear_weights["PAPER"][str(scene.fold)].values())
        errors.append((substituted_increments(only, "PAPER") @ w - only["truth.yaw_increment_rad"])[1:])
        assert len(errors[i]) == scene.rows - 1
    error = np.concatenate(errors)
    expected = 1.4826 * np.median(np.abs(error - np.median(error)))
    assert fitted.manifest.reward_scale_rad["PAPER"] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("fold", "keys"), [(0, {"none"}), (-1, set())])
def test_a_single_log_or_night_alone(fold, keys):
    recordings = synthetic_recordings(scenes=2, logs=1)
    fitted = with_fits(refolded(recordings, [fold, fold])).manifest
    assert set(fitted.linear_weights["VISION"]) == keys
    assert (fitted.reward_scale_rad["VISION"] == DEFAULT_REWARD_SCALE_RAD) == (not keys)


def scaled_recordings() -> Recordings:
    """Two vehicles in four folds; in fold f every true distance is f per cent longer than the wheels say."""
    recordings = synthetic_recordings(scenes=16, logs=4)
    distance = np.concatenate(
        [recordings.rows(i)["truth.distance_m"] / (1 + 0.01 * scene.fold) for i, scene in enumerate(recordings.scenes)]
    )
    scenes = tuple(replace(scene, vehicle="ab"[i // 8]) for i, scene in enumerate(recordings.scenes))
    manifest = replace(recordings.manifest, scenes=scenes)
    return recordings.replace(manifest, {"distance_m": distance.astype(np.float32)})


def test_vehicle_constants_of_a_fold_come_from_the_others():
    recordings = scaled_recordings()
    prepared = with_held_out_constants(recordings)
    assert len(prepared.manifest.vehicles) == 8
    for before, after in zip(recordings.scenes, prepared.scenes, strict=True):
        others = [fold for fold in range(4) if fold != before.fold]
        scale = prepared.manifest.vehicles[after.vehicle].wheel_scale
        assert 1 + 0.01 * min(others) < scale < 1 + 0.01 * max(others)
        training = recordings.select(folds=others)
        assert prepared.manifest.vehicles[after.vehicle] == fit_vehicle_constants(training, "ab")[before.vehicle]
        assert replace(after, vehicle=before.vehicle) == before
    for vehicle, constants in training_constants(recordings).items():
        assert constants == fit_vehicle_constants(recordings.select(split="train"), "ab")[vehicle]
    one_fold = recordings.select(folds=[2])
    assert set(with_held_out_constants(one_fold).manifest.vehicles.values()) == {VehicleConstants()}


def test_vehicle_constants_are_nominal_where_nothing_moves():
    recordings = synthetic_recordings(scenes=4)
    columns = {name: np.zeros_like(recordings[name]) for name in ("truth.distance_m", "truth.x_m", "truth.y_m")}
    still = recordings.replace(columns=columns)
    assert training_constants(still) == {"n099": VehicleConstants()}
    assert set(with_held_out_constants(still).manifest.vehicles.values()) == {VehicleConstants()}
    night = refolded(recordings, [-1] * 4)
    assert training_constants(night) == {"n099": VehicleConstants()}


@pytest.mark.parametrize("missing", [("INERTIAL_CONSUMER",), ("INERTIAL", "INERTIAL_CONSUMER")])
def test_a_lost_camera_is_fitted_with_what_it_is_played_with(missing):
    recordings = synthetic_recordings(scenes=2)
    row = 7
    for expert in (*missing, "CAM_FRONT"):
        recordings[f"{expert}.yaw_increment_rad"][row] = np.nan
    fitted = substituted_increments(recordings, "CONSUMER")
    played = Replay(recordings, track="CONSUMER").votes.increments_rad
    np.testing.assert_array_equal(np.delete(fitted, recordings.offsets[:-1], axis=0), played)
    column = recordings.voters("CONSUMER").index("CAM_FRONT")
    left = recordings["INERTIAL.yaw_increment_rad"][row] if len(missing) == 1 else 0.0
    assert fitted[row, column] == left
    assert np.isnan(fitted[recordings.offsets[:-1]]).all()
