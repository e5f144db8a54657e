"""Poses without their lag: what changes, what does not, and who sees it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from mixo_env.errors import RecordingError
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import Truth, with_wheels
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.keyframes import at_keyframes
from mixo_env.recordings.pose_curve import Curve
from mixo_env.recordings.pose_lag import as_written, lag_corrected
from mixo_env.recordings.schema import VehicleConstants
from mixo_env.recordings.store import load_recordings, save_recordings
from mixo_env.recordings.truths import for_learning
from tests.bundle import few_drives
from tests.late_poses import CAMERAS, late_recordings

LAG_S = 0.03


def knowing(recordings: Recordings, lag_s: float | dict[str, float]) -> Recordings:
    lags = lag_s if isinstance(lag_s, dict) else {"n099": lag_s}
    vehicles = {name: VehicleConstants(pose_lag_s=value) for name, value in lags.items()}
    return recordings.replace(replace(recordings.manifest, vehicles=vehicles))


def same_bits(one: Recordings, other: Recordings) -> bool:
    return one.column_names == other.column_names and all(
        one[name].tobytes() == other[name].tobytes() for name in one.column_names
    )


@pytest.mark.parametrize(("spacing_s", "yaw_rad", "place_m"), [(0.1, 2e-5, 5e-4), (0.5, 3e-4, 0.01)])
@pytest.mark.parametrize("lag_s", [LAG_S, -0.02])
def test_late_poses_become_those_of_the_moment(spacing_s, yaw_rad, place_m, lag_s):
    late = late_recordings(lag_s, scenes=3, spacing_s=spacing_s)
    true = late_recordings(0.0, scenes=3, spacing_s=spacing_s)
    found = lag_corrected(knowing(late, lag_s))
    inner = np.ones(len(late["step"]), bool)
    inner[late.offsets[1:] - 1] = inner[late.offsets[:-1]] = (
        False  # at the ends of a scene there is no pose on one side
    )
    for name, atol in {"x_m": place_m, "y_m": place_m, "yaw_rad": yaw_rad}.items():
        np.testing.assert_allclose(found[f"truth.{name}"][inner], true[f"truth.{name}"][inner], atol=atol)
        written = np.abs(late[f"truth.{name}"] - true[f"truth.{name}"])[inner].max()
        assert written > 10 * atol
    np.testing.assert_array_equal(found["exact.yaw_rad"], late["exact.yaw_rad"])
    for i in range(3):  # the ends: the last rate goes on
        ends = np.abs(found.rows(i)["truth.yaw_rad"] - true.rows(i)["truth.yaw_rad"])[[0, -1]]
        assert ends.max() < 0.3 * abs(lag_s) * spacing_s + yaw_rad


def test_increments_distances_and_own_windows_follow_the_poses():
    late, true = late_recordings(LAG_S), late_recordings(0.0)
    found = lag_corrected(knowing(late, LAG_S))
    names = ["truth.yaw_increment_rad", *(f"{camera}.own_window_truth_yaw_increment_rad" for camera in CAMERAS)]
    for i in range(len(late)):
        rows, expected = found.rows(i), true.rows(i)
        for name in names:
            assert np.isnan(rows[name][0])
            np.testing.assert_allclose(rows[name][2:-1], expected[name][2:-1], atol=4e-5)
        np.testing.assert_array_equal(np.diff(rows["truth.yaw_rad"]), rows["truth.yaw_increment_rad"][1:])
        np.testing.assert_allclose(rows["truth.distance_m"][2:-1], expected["truth.distance_m"][2:-1], atol=2e-3)
        way = np.hypot(np.diff(rows["truth.x_m"]), np.diff(rows["truth.y_m"]))
        np.testing.assert_allclose(rows["truth.distance_m"][1:], way, atol=1e-9)


def test_lag_zero_leaves_every_bit():
    recordings = late_recordings({"a": LAG_S, "b": LAG_S})
    assert same_bits(lag_corrected(knowing(recordings, 0.0)), recordings)
    found = lag_corrected(knowing(recordings, {"a": LAG_S, "b": 0.0}))
    for name in recordings.column_names:
        late, still = recordings.rows(0)[name], recordings.rows(1)[name]
        assert found.rows(1)[name].tobytes() == still.tobytes()
        assert name.startswith("truth.") <= (found.rows(0)[name].tobytes() != late.tobytes())


def test_what_was_written_stays_and_is_what_is_corrected_and_saved(tmp_path: Path):
    recordings = knowing(late_recordings(LAG_S), LAG_S)
    once = lag_corrected(recordings)
    assert same_bits(lag_corrected(once), once)
    assert same_bits(lag_corrected(knowing(once, 0.02)), lag_corrected(knowing(recordings, 0.02)))
    assert {name: as_written(once)[name].tobytes() for name in recordings.column_names} == {
        name: recordings[name].tobytes() for name in recordings.column_names
    }
    assert set(as_written(once).column_names) == set(recordings.column_names)
    save_recordings(once, tmp_path)
    loaded = load_recordings(tmp_path)
    assert same_bits(loaded, recordings)
    assert loaded.manifest.vehicles["n099"].pose_lag_s == LAG_S


def test_one_scene_is_corrected_as_among_others():
    recordings = knowing(late_recordings(LAG_S), LAG_S)
    together = lag_corrected(recordings).rows(2)
    alone = lag_corrected(recordings.select(scenes=["scene-2003"])).rows(0)
    for name, values in alone.items():
        np.testing.assert_allclose(values, together[name], rtol=0, atol=1e-12)


def test_key_frames_are_corrected_from_their_own_poses_alone():
    recordings = knowing(late_recordings(LAG_S), LAG_S)
    slow = at_keyframes(lag_corrected(recordings))
    found, again = lag_corrected(slow), lag_corrected(at_keyframes(recordings))
    np.testing.assert_array_equal(found["truth.yaw_rad"], again["truth.yaw_rad"])


@pytest.mark.parametrize("rows", [1, 2, 3, 4, 5])
def test_curve_is_a_polynomial_where_one_was_sampled(rows):
    time = np.array([0.0, 0.1, 0.15, 0.25, 0.35])[:rows]
    recordings = late_recordings(scenes=1)
    entry = replace(recordings.scenes[0], rows=rows)
    few = Recordings(replace(recordings.manifest, scenes=(entry,)), {"time_s": time})
    degree = min(rows - 1, 3)
    values = np.full(rows, 2.0) + sum((power + 1) * time**power for power in range(1, degree + 1))
    at = np.linspace(0.0, time[-1], 7)
    expected = 2.0 + sum((power + 1) * at**power for power in range(1, degree + 1))
    np.testing.assert_allclose(Curve(few, values).at(at, np.zeros(7, int)), expected, atol=1e-12)


@pytest.mark.parametrize("lag_s", [np.nan, 0.2, -0.1])
def test_an_impossible_lag_is_one_line(lag_s):
    with pytest.raises(RecordingError, match="pose_lag_s of vehicle 'n099': expected"):
        lag_corrected(knowing(late_recordings(scenes=1), lag_s))


def test_a_policy_does_not_see_the_lag_but_is_rewarded_without_it():
    seen, rewards = [], []
    for lag_s in (0.0, LAG_S):
        recordings = knowing(late_recordings(LAG_S), lag_s)
        env = gym.make("mixo_env:MixoOdometry-v0", recordings=recordings, observation="rich", order="fixed")
        observation, _ = env.reset(seed=0)
        seen.append([observation])
        rewards.append([])
        for k in range(30):
            action = np.float32(np.sin(k)) * np.ones_like(env.action_space.sample())
            observation, reward, *_ = env.step(action)
            seen[-1].append(observation)
            rewards[-1].append(reward)
    np.testing.assert_array_equal(*seen)
    assert np.sum(rewards[1]) > 0.1 * np.sum(rewards[0])  # the experts are exact: what is left is interpolation


def test_what_a_policy_learns_from_is_corrected_once():
    protocol = CrossValidation(late_recordings(LAG_S, scenes=8))
    targets = protocol.training(0)["truth.yaw_increment_rad"]
    learnt_from = for_learning(protocol.training(0))
    for again in (learnt_from, lag_corrected(learnt_from)):
        assert again["truth.yaw_increment_rad"].tobytes() == targets.tobytes()
    assert learnt_from.manifest.reward_scale_rad["VISION"] < 5e-5  # the experts are exact


def test_fits_of_the_manifest_know_the_lag():
    recordings = late_recordings(LAG_S)
    raw, known = (with_fits(knowing(recordings, lag)).manifest for lag in (0.0, LAG_S))
    assert known.reward_scale_rad["VISION"] < 0.1 * raw.reward_scale_rad["VISION"]


def test_written_poses_stay_a_course_of_their_own():
    protocol = CrossValidation(late_recordings(LAG_S, scenes=8))
    exact = np.diff(protocol.recordings["exact.yaw_rad"], prepend=np.nan)
    exact[protocol.recordings.offsets[:-1]] = np.nan
    travel = with_wheels(protocol.recordings, exact)
    written, corrected = (
        Truth(protocol.recordings, truth).measure(travel).absolute.rotation_deg.mean() for truth in ("written", "truth")
    )
    assert corrected < 0.2 * written


def test_bundled_exact_yaw_is_nearly_perfect():
    protocol = CrossValidation(few_drives(12))
    exact = np.diff(protocol.recordings["exact.yaw_rad"], prepend=np.nan)
    exact[protocol.recordings.offsets[:-1]] = np.nan
    errors = Truth(protocol.recordings).measure(with_wheels(protocol.recordings, exact))
    assert errors.relative.rotation_deg_per_m.mean() < 0.003
    assert errors.absolute.rotation_deg.mean() < 0.09
