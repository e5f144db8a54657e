"""Oracles of the sizes of errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.bounds import SMALLEST_RAD, Bounds, Window, by_log, by_size, main, study
from experiments.closing import FROM, TO
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import save_recordings
from mixo_env.recordings.substitutes import substituted_increments
from tests.synthetic import synthetic_recordings

NONE = np.nan


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(0, scenes=8, steps=120)


def test_sizes_by_hand() -> None:
    """Two scenes of three rows; errors of 1 and 2, then of 3 and 1, in milliradians."""
    errors = 1e-3 * np.array([[NONE, NONE], [1, -2], [-1, 2], [NONE, NONE], [3, 1], [3, NONE]])
    offsets = np.array([0, 3, 6])
    around = by_size(errors, offsets, Window(1, 1))
    np.testing.assert_allclose(around[1:3], [[0.8, 0.2], [0.8, 0.2]])  # 1 : 1/4
    np.testing.assert_allclose(around[4:], [[1, 0], [1, 0]])  # the second says nothing around the one, and in the other
    before = by_size(errors, offsets, Window(1, 0))
    np.testing.assert_allclose(before[[1, 4]], 0.5)  # nothing is known yet: neither of the scene before
    np.testing.assert_allclose(before[2], [0.8, 0.2])
    np.testing.assert_allclose(by_size(errors, offsets, Window(0, 0, itself=True))[4], [0.1, 0.9])
    np.testing.assert_allclose(around[[0, 3]], 0.5)  # no step ends there


def test_a_perfect_expert_has_finite_weights() -> None:
    errors = np.array([[0.0, SMALLEST_RAD], [0.0, SMALLEST_RAD], [0.0, 3 * SMALLEST_RAD]])
    weights = by_size(errors, np.array([0, 3]), Window(1, 0, itself=True))
    np.testing.assert_allclose(weights, [[1 / 2, 1 / 2], [1 / 2, 1 / 2], [5 / 6, 1 / 6]])


@given(st.integers(0, 2**32 - 1), st.integers(0, 4), st.integers(0, 4), st.booleans())
def test_weights_are_convex_and_know_the_window_alone(seed: int, before: int, after: int, itself: bool) -> None:
    rng = np.random.default_rng(seed)
    errors = np.where(rng.random((12, 3)) < 0.2, np.nan, rng.normal(0.0, 1e-2, (12, 3)))
    offsets, window = np.array([0, 5, 12]), Window(before, after, itself)
    weights = by_size(errors, offsets, window)
    assert (weights >= 0.0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_array_equal(weights, by_size(-errors, offsets, window))  # sizes, no signs
    for row in range(12):
        known = slice(max(row - before, 0 if row < 5 else 5), min(row + after + 1, 5 if row < 5 else 12))
        seen = np.where(np.isfinite(errors), 7.0, np.nan)  # who says something is seen by everyone
        seen[known] = errors[known]
        if not itself:
            seen[row] = np.where(np.isfinite(errors[row]), 7.0, np.nan)
        np.testing.assert_allclose(by_size(seen, offsets, window)[row], weights[row])


def test_constant_weights_of_a_log_are_its_least_squares(recordings: Recordings) -> None:
    votes = substituted_increments(recordings, "VISION")
    turns = recordings["truth.yaw_increment_rad"].astype(np.float64)
    weights = by_log(recordings, votes, turns)
    for log in {scene.log for scene in recordings.scenes}:
        rows = np.repeat([scene.log == log for scene in recordings.scenes], np.diff(recordings.offsets))
        usable = rows & np.isfinite(turns) & np.isfinite(votes).all(axis=1)
        expected, *_ = np.linalg.lstsq(votes[usable], turns[usable], rcond=None)
        np.testing.assert_allclose(weights[rows], np.tile(expected, (rows.sum(), 1)), rtol=1e-6, atol=1e-9)


def test_who_knows_more_comes_further(recordings: Recordings) -> None:
    found = dict(study(CrossValidation(recordings), "VISION"))
    by_rte = {row: rotation for row, (rotation, _) in found.items()}
    around = f"1 / size², {Window(6, 6)}"
    assert by_rte[around] < by_rte[f"1 / size², {Window(6, 6, itself=True)}"]
    assert by_rte[f"1 / size², {Window(6, 6, itself=True)}"] < by_rte[f"1 / size², {Window(1, 1, itself=True)}"]


def test_the_command_prints_both_tracks(
    recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_recordings(recordings, tmp_path / "recordings")
    assert main(["--recordings", str(tmp_path / "recordings")]) == 0
    text = capsys.readouterr().out
    assert f"from {FROM} to {TO}" in text
    assert "| weights | VISION, RTE [%] | VISION, ATE [%] | CONSUMER, RTE [%] | CONSUMER, ATE [%] |" in text
    assert main(["--recordings", str(tmp_path / "nowhere")]) == 1
    assert len(Bounds(tmp_path / "recordings", ("PAPER",)).run().rows) == 6
