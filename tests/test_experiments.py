"""Evaluation, protocol and leaderboard on random recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mixo_env.envs.replay import Replay
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.experts.expert import State
from mixo_env.fusion import dead_reckon
from mixo_env.leaderboard.board import build, choose
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import FLOORS, Truth, lost_tracks, poses, rollout
from mixo_env.policies.fitting import prepare
from mixo_env.policies.gate import Mixo
from mixo_env.policies.playing import play
from mixo_env.policies.registry import POLICIES, create, names
from mixo_env.policies.reinforcement import AGENTS
from mixo_env.policies.single import Single
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.pose_lag import lag_corrected
from mixo_env.recordings.schema import VehicleConstants
from mixo_env.recordings.substitutes import substituted_increments
from mixo_env.recordings.vehicles import with_training_constants
from tests.synthetic import synthetic_recordings

ELSEWHERE = synthetic_recordings(9)
"""Drives on which nothing is scored."""

QUICK = tuple(name for name in POLICIES if name not in ("MIXO", *AGENTS))


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    constants = VehicleConstants(wheel_scale=1.01, course_offset_rad=-0.007)
    drawn = synthetic_recordings(0)
    manifest = replace(drawn.manifest, vehicles={"n099": constants})
    return Recordings(manifest, {name: drawn[name] for name in drawn.column_names})


def changed(recordings: Recordings, change: Callable[[str, np.ndarray], np.ndarray]) -> Recordings:
    columns = {name: change(name, recordings[name].copy()) for name in recordings.column_names}
    return Recordings(recordings.manifest, columns)


def hashed(recordings: Recordings) -> Recordings:
    scenes = tuple(replace(scene, values_hash=f"hash of {scene.name}") for scene in recordings.scenes)
    return Recordings(replace(recordings.manifest, scenes=scenes), {c: recordings[c] for c in recordings.column_names})


def never() -> Recordings:
    raise AssertionError("the bundled recordings must not be opened")


def test_single_expert_is_reproduced_bit_for_bit(recordings: Recordings) -> None:
    for track in ("PAPER", "VISION"):
        votes = substituted_increments(recordings, track)
        for j, expert in enumerate(recordings.voters(track)):
            policy = Single(expert)
            prepare(policy, ELSEWHERE, track)
            travel = rollout(policy, recordings, track)
            np.testing.assert_array_equal(travel.yaw_increment_rad, votes[:, j], err_msg=expert)


def test_reference_expert_is_itself_where_it_does_not_vote(recordings: Recordings) -> None:
    policy = Single("INERTIAL")
    prepare(policy, ELSEWHERE, "CONSUMER")
    travel = rollout(policy, recordings, "CONSUMER")
    np.testing.assert_array_equal(travel.yaw_increment_rad, recordings["INERTIAL.yaw_increment_rad"].astype(np.float64))


@pytest.mark.parametrize("name", ["LINEAR", "MEDIAN", "ORACLE HULL"])
def test_rollout_ends_where_the_replay_ends(recordings: Recordings, name: str) -> None:
    policy = create(name, recordings)
    prepare(policy, ELSEWHERE, "CONSUMER")
    travel = rollout(policy, recordings, "CONSUMER", privileged=policy.privileged)
    estimate = poses(travel, Truth(recordings).poses, recordings.offsets)
    replay = Replay(recordings, track="CONSUMER", privileged=policy.privileged)
    for _ in play(policy, replay):
        pass
    for scene, (first, stop) in enumerate(zip(recordings.offsets[:-1], recordings.offsets[1:], strict=True)):
        expected = replay.trajectory(scene)
        for mine, theirs in zip((estimate.x_m, estimate.y_m, estimate.yaw_rad), expected, strict=True):
            np.testing.assert_allclose(mine[first:stop], theirs, atol=1e-9)


def test_batch_of_scenes_equals_each_scene_alone(recordings: Recordings) -> None:
    policy = create("HUBER", recordings)
    prepare(policy, ELSEWHERE, "CONSUMER")
    together = rollout(policy, recordings, "CONSUMER").yaw_increment_rad
    alone = [
        rollout(policy, recordings.select(scenes=[scene.name]), "CONSUMER").yaw_increment_rad
        for scene in recordings.scenes
    ]
    np.testing.assert_array_equal(together, np.concatenate(alone))


def test_floors_hold_the_true_yaw_and_the_stated_distance(recordings: Recordings) -> None:
    truth = Truth(recordings)
    wheels, true, _ = (truth.measure(FLOORS[name](recordings)) for name in FLOORS)
    np.testing.assert_allclose(wheels.absolute.rotation_deg, 0.0, atol=1e-9)
    assert (wheels.absolute.translation_m > 0.05).all()  # wheels 1 % too long, travelling askew
    assert (true.absolute.translation_m < wheels.absolute.translation_m).all()
    straight = Recordings(
        replace(recordings.manifest, vehicles={}), {c: recordings[c] for c in recordings.column_names}
    )
    perfect = Truth(straight).measure(FLOORS["PERFECT YAW + TRUE DISTANCE"](straight))
    np.testing.assert_allclose(perfect.absolute.translation_m, 0.0, atol=1e-6)


def test_measures_agree_with_plain_loops(recordings: Recordings) -> None:
    policy = create("MEAN", recordings)
    prepare(policy, ELSEWHERE, "VISION")
    travel = rollout(policy, recordings, "VISION")
    errors = Truth(recordings).measure(travel)
    rows = recordings.rows(2)
    steps = slice(recordings.offsets[2] + 1, recordings.offsets[3])
    x, y, yaw = dead_reckon(
        travel.yaw_increment_rad[steps],
        rows["distance_m"][1:].astype(np.float64) * 1.01,
        start=(rows["truth.x_m"][0], rows["truth.y_m"][0], rows["truth.yaw_rad"][0]),
        course_offset_rad=-0.007,
    )
    squared = [
        (a - b) ** 2 + (c - d) ** 2 for a, b, c, d in zip(x, rows["truth.x_m"], y, rows["truth.y_m"], strict=True)
    ]
    assert errors.absolute.translation_m[2] == pytest.approx(np.sqrt(np.mean(squared)))
    degrees = np.degrees(yaw - rows["truth.yaw_rad"])
    assert errors.absolute.rotation_deg[2] == pytest.approx(np.sqrt(np.mean(degrees**2)))
    step_error = np.degrees(travel.yaw_increment_rad[steps] - rows["truth.yaw_increment_rad"][1:])
    assert errors.squared_yaw_increment_deg2[2] == pytest.approx(np.sum(step_error**2), rel=1e-6)
    assert errors.steps[2] == len(step_error)


def test_exact_truth_starts_from_its_own_first_pose(recordings: Recordings) -> None:
    def moved(name: str, values: np.ndarray) -> np.ndarray:
        return values + 5.0 if name == "exact.x_m" else values

    policy = create("MEAN", recordings)
    prepare(policy, ELSEWHERE, "PAPER")
    travel = rollout(policy, recordings, "PAPER")
    written = Truth(recordings).measure(travel).absolute.translation_m
    exact = Truth(changed(recordings, moved), "exact").measure(travel).absolute.translation_m
    np.testing.assert_allclose(exact, written, atol=1e-9)


def test_lost_tracks_of_camera_fusion_and_inertial(recordings: Recordings) -> None:
    lost = lost_tracks(recordings, "CAM_FRONT")
    assert lost is not None
    assert lost.mean == 1.0  # one lost stretch per synthetic scene
    fused = lost_tracks(recordings, "MEDIAN")
    assert fused is not None
    tracking = np.any([recordings[f"{c}.state"] == State.TRACKING for c in recordings.manifest.cameras], axis=0)
    assert fused.steps.sum() == np.count_nonzero(~tracking)
    assert lost_tracks(recordings, "INERTIAL") is None
    assert lost_tracks(recordings, "PERFECT YAW") is None


@pytest.mark.parametrize("name", [*QUICK[: QUICK.index("MULTICAMERA GT")], "MIXO"])
def test_truth_of_the_tested_scenes_never_reaches_a_policy(
    recordings: Recordings, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Mixo.__init__, "__kwdefaults__", Mixo.__init__.__kwdefaults__ | {"min_updates": 20})
    fold = recordings.scenes[1].fold
    held_out = np.repeat([scene.fold == fold for scene in recordings.scenes], np.diff(recordings.offsets))

    def shifted(column: str, values: np.ndarray) -> np.ndarray:
        if column.startswith(("truth", "exact")):
            values[held_out] += 0.3
        return values

    runs = [
        CrossValidation(data, bundled=never).run(name, "PAPER", folds=[fold])
        for data in (recordings, changed(recordings, shifted))
    ]
    before, after = (run.travel.yaw_increment_rad[held_out] for run in runs)
    np.testing.assert_array_equal(before, after)
    assert np.isfinite(before).sum() > 100


def test_learned_policies_are_fitted_once_per_fold(recordings: Recordings) -> None:
    protocol = CrossValidation(recordings, bundled=never)
    run = protocol.run("LINEAR", "CONSUMER")
    assert sorted(run.policies) == [0, 1, 2, 3]
    assert len({policy.weights.tobytes() for policy in run.policies.values()}) == 4
    for fold, policy in run.policies.items():
        others = protocol.training(fold)
        assert {scene.fold for scene in others.scenes} == {0, 1, 2, 3} - {fold}
        again = create("LINEAR", recordings)
        prepare(again, others, "CONSUMER")
        np.testing.assert_array_equal(again.weights, policy.weights)


def test_night_is_left_out_of_the_folds(recordings: Recordings) -> None:
    scenes = tuple(replace(scene, fold=-1) if i < 2 else scene for i, scene in enumerate(recordings.scenes))
    dark = Recordings(replace(recordings.manifest, scenes=scenes), {c: recordings[c] for c in recordings.column_names})
    protocol = CrossValidation(dark, bundled=never)
    assert (protocol.left_out, len(protocol.recordings), protocol.folds) == (2, 6, (0, 1, 2, 3))
    assert all(scene.fold >= 0 for scene in protocol.training(1).scenes)


def test_with_one_fold_learned_policies_come_from_the_bundled_recordings(recordings: Recordings) -> None:
    alone = recordings.select(folds=[2])
    bundled = hashed(synthetic_recordings(7))
    protocol = CrossValidation(alone, bundled=lambda: bundled)
    run = protocol.run("LINEAR", "PAPER")
    assert protocol.foreign
    assert run.tested.all()
    expected = create("LINEAR", bundled)
    prepare(expected, lag_corrected(with_training_constants(bundled, range(4))), "PAPER")
    (policy,) = run.policies.values()
    np.testing.assert_array_equal(policy.weights, expected.weights)


def test_tested_scenes_are_never_training_scenes_even_from_the_bundle(recordings: Recordings) -> None:
    bundled = hashed(recordings)
    alone = bundled.select(folds=[2])
    names = {scene.name for scene in CrossValidation(alone, bundled=lambda: bundled).training(-1).scenes}
    assert names == {scene.name for scene in bundled.scenes} - {scene.name for scene in alone.scenes}
    with pytest.raises(PolicyError, match="found none"):
        CrossValidation(alone, bundled=lambda: alone).run("LINEAR", "PAPER")


def test_policy_names_are_found_however_they_are_spelt(recordings: Recordings) -> None:
    valid = names(recordings)
    assert choose(["linear", "highest-match", "cam front", "CAM_FRONT"], valid) == (
        "CAM_FRONT",
        "HIGHEST MATCH",
        "LINEAR",
    )
    assert choose([], valid) == choose(["all"], valid) == choose(["LINEAR", "ALL"], valid) == valid
    with pytest.raises(ConfigurationError, match="did you mean 'LINEAR'"):
        choose(["linaer"], valid)


def test_unknown_track_is_refused_before_anything_runs(recordings: Recordings) -> None:
    with pytest.raises(ConfigurationError, match=r"unknown track 'PAPPER': did you mean 'PAPER'"):
        build(recordings, tracks=["PAPPER"])


def test_imported_expert_votes_and_has_a_row_of_its_own(recordings: Recordings) -> None:
    columns = {c: recordings[c] for c in recordings.column_names}
    columns["DROID.yaw_increment_rad"] = recordings["INERTIAL.yaw_increment_rad"].copy()
    columns["DROID.yaw_increment_rad"][5:9] = np.nan
    columns["DROID.state"] = np.where(np.isfinite(columns["DROID.yaw_increment_rad"]), State.TRACKING, State.LOST)
    more = Recordings(replace(recordings.manifest, imported=("DROID",)), columns)
    board = build(more, tracks=("PAPER",), policies=("DROID", "LINEAR", "MEDIAN", "HIGHEST MATCH"))
    (table,) = board.standings
    assert [row.run.name for row in table.rows] == ["DROID", "HIGHEST MATCH", "MEDIAN", "LINEAR"]
    assert table.rows[0].lost is not None
    assert list(table.linear_weights()[0]) == [*recordings.manifest.cameras, "DROID", "INERTIAL_POSE"]
