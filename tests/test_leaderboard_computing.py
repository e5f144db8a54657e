"""Rows computed in several processes are the same; agents that nobody asked for are fitted by nobody."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import joblib
import pytest

from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.leaderboard import computing
from mixo_env.leaderboard.board import Leaderboard, build
from mixo_env.leaderboard.crossvalidation import NOT_FITTED, CrossValidation, Trial
from mixo_env.leaderboard.exports import to_csv, to_json
from mixo_env.leaderboard.report import to_markdown
from mixo_env.leaderboard.weights import shipped
from mixo_env.policies.linear import Linear
from mixo_env.policies.policy import Observation, Weights
from mixo_env.policies.robust import Mean
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.processes import Killed
from mixo_env.recordings.vehicles import with_held_out_constants
from tests.synthetic import synthetic_recordings

ROWS = ("INERTIAL", "CAM_FRONT", "LINEAR", "HUBER", "STUDENT-T", "ORACLE ALL", "PERFECT YAW")


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    """The scenes of the last log are in no fold."""
    found = synthetic_recordings(0, scenes=10, logs=5, steps=80)
    scenes = tuple(replace(scene, fold=-1) if scene.log == "log-4" else scene for scene in found.scenes)
    return found.replace(replace(found.manifest, scenes=scenes))


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that exist."""
    monkeypatch.setattr(
        "mixo_env.leaderboard.board.policy_names", lambda _: ("CAM_FRONT", "MEAN", "LINEAR", "PPO", "SAC")
    )


def numbers(board: Leaderboard) -> str:
    """All of them, to the last bit; NaN is NaN here."""
    return json.dumps(to_json(board)) + to_csv(board)


class Guarded(Mean):
    """A stranger's rule; a lock cannot be sent to another process."""

    name = "GUARDED"

    def __init__(self) -> None:
        self._lock = threading.Lock()

    def act(self, observation: Observation) -> Weights:
        with self._lock:
            return super().act(observation)


def test_workers_change_no_bit_by_day_and_by_night(recordings: Recordings) -> None:
    trial, seen = Trial(seeds=2, outside={"GUARDED": Guarded}), []
    options: dict[str, Any] = {"policies": (*ROWS, "guarded"), "trial": trial}
    one = build(recordings, **options)
    two = build(recordings, **options, workers=2, progress=lambda *told: seen.append(told))
    assert one.night is not None
    assert {row.name for row in one.standings[0].rows} == {*ROWS, "GUARDED"}
    assert numbers(one) == numbers(two)
    assert seen == [(done, 2 * 3 * 8) for done in range(2 * 3 * 8 + 1)]
    for first, second in zip(one.standings[0].rows, two.standings[0].rows, strict=True):
        for truth, pair in two.truths.items():
            assert second.errors[truth].relative.start is pair.pairs.start
        assert first.run.policies.keys() == second.run.policies.keys()


def test_workers_leave_out_the_same_rows_for_the_same_reasons(recordings: Recordings, few: None) -> None:
    one, two = (build(recordings, workers=n) for n in (1, 2))
    assert one.standings[2].left_out == {"PPO": NOT_FITTED, "SAC": NOT_FITTED}
    assert numbers(one) == numbers(two)


def test_a_policy_that_does_not_fit_is_one_error_in_a_worker_too(recordings: Recordings) -> None:
    blind = recordings.replace(replace(recordings.manifest, cameras=()))
    for workers in (1, 2):
        with pytest.raises(PolicyError, match="HIGHEST MATCH needs match counts"):
            build(blind, policies=("INERTIAL", "HIGHEST MATCH"), tracks=("PAPER",), workers=workers)


def test_a_killed_worker_is_one_line(recordings: Recordings, monkeypatch: pytest.MonkeyPatch) -> None:
    def each(function: Any, tasks: dict[str, Any], workers: int) -> Iterator[tuple[str, Killed]]:
        yield next(iter(tasks)), Killed()

    monkeypatch.setattr(computing, "each", each)
    with pytest.raises(ConfigurationError, match=r"LINEAR was not computed: its worker was killed .* fewer workers"):
        build(recordings, policies=("MEAN", "LINEAR"), tracks=("VISION",), workers=2)


def test_no_workers_are_refused(recordings: Recordings) -> None:
    trial = Trial(outside={"GUARDED": Guarded})  # stays in this process
    for name in ("MEAN", "GUARDED"):
        with pytest.raises(ConfigurationError, match="workers must be at least 1, got 0"):
            build(recordings, policies=(name,), tracks=("VISION",), trial=trial, workers=0)


def test_processes_are_as_many_as_pay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joblib, "cpu_count", lambda: 16)
    assert [computing.usual_workers(rows) for rows in (0, 19, 20, 39, 1000)] == [1, 1, 2, 3, 4]
    monkeypatch.setattr(joblib, "cpu_count", lambda: 2)
    assert computing.usual_workers(1000) == 2


def test_slow_rows_are_fitted_for_whom_names_them_and_taken_where_they_lie(
    recordings: Recordings, few: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Linear, "expensive", True)
    unasked = build(recordings, tracks=("VISION",))
    assert set(unasked.standings[0].left_out) == {"LINEAR", "PPO"}
    assert f"\nLINEAR, PPO left out: {NOT_FITTED}.\n" in to_markdown(unasked)
    named = build(recordings, tracks=("VISION",), policies=("MEAN", "LINEAR"))
    assert [row.name for row in named.standings[0].one_fold_rows] == ["LINEAR"]
    trial = Trial(weights=tmp_path)
    CrossValidation(recordings, trial).fitted("LINEAR", "VISION", 3, 0, keep=True)
    kept = build(recordings, tracks=("VISION",), trial=trial)
    assert set(kept.standings[0].left_out) == {"PPO"}
    (taken,), (fitted,) = (board.standings[0].one_fold_rows for board in (kept, named))
    assert repr(taken.scores) == repr(fitted.scores)  # NaN is NaN here
    other = build(recordings, tracks=("VISION",), trial=replace(trial, seed=1))
    assert set(other.standings[0].left_out) == {"LINEAR", "PPO"}


def test_all_rows_are_fitted_for_whom_asks_for_all_and_misfits_left_out(
    recordings: Recordings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mixo_env.leaderboard.board.policy_names", lambda _: ("MEAN", "LINEAR", "HIGHEST MATCH"))
    monkeypatch.setattr(Linear, "expensive", True)
    blind = recordings.replace(replace(recordings.manifest, cameras=()))
    unasked, asked = (build(blind, tracks=("PAPER",), policies=names) for names in ((), ("All",)))
    assert unasked.policies == asked.policies
    assert set(unasked.standings[0].left_out) == {"LINEAR", "HIGHEST MATCH"}
    assert set(asked.standings[0].left_out) == {"HIGHEST MATCH"}
    assert [row.name for row in asked.standings[0].one_fold_rows] == ["LINEAR"]


def test_with_one_fold_weights_of_the_package_are_taken(recordings: Recordings) -> None:
    if shipped() is None:
        pytest.skip("this tree has none: `make weights`")
    alone = CrossValidation(recordings.select(folds=[2]), Trial(weights=shipped()))
    assert alone.foreign
    for name in ("LINEAR", "TOKEN", "PPO"):
        alone.check_fitted(name, "VISION", None)
    with pytest.raises(PolicyError, match="slow to fit"):
        alone.check_fitted("A2C", "CONSUMER", None)


def test_constants_of_the_night_come_from_all_folds(recordings: Recordings) -> None:
    """As with a fit for every fold of the day, which the night has no use for."""
    fitted = with_held_out_constants(recordings).manifest
    of = {scene.name: fitted.vehicles[scene.vehicle] for scene in fitted.scenes}
    night = CrossValidation(recordings, out_of_distribution=True).recordings
    assert {scene.fold for scene in night.scenes} == {-1}
    assert all(night.manifest.vehicles[scene.vehicle] == of[scene.name] for scene in night.scenes)
