"""Association of timestamps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixo_env.errors import TrajectoryError
from mixo_env.metrics.association import associate, match
from mixo_env.trajectory import Trajectory


def literal(first: list[float], second: list[float], limit: float) -> list[tuple[int, int]]:
    """All near pairs, the closest taken first."""
    near = sorted((abs(a - b), i, j) for i, a in enumerate(first) for j, b in enumerate(second) if abs(a - b) < limit)
    taken: list[tuple[int, int]] = []
    for _, i, j in near:
        if all(i != k and j != m for k, m in taken):
            taken.append((i, j))
    return sorted(taken)


def still(times: list[float] | np.ndarray | None, poses: int = 0) -> Trajectory:
    n = poses if times is None else len(times)
    stamps = None if times is None else np.asarray(times, dtype=float)
    return Trajectory(np.zeros((n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)), stamps)


def numbered(frames: list[int]) -> Trajectory:
    """With numbers of frames where times would stand."""
    return replace(still(frames), counted=True)


@pytest.mark.parametrize("seed", range(20))
def test_equals_the_literal_greedy_rule(seed):
    rng = np.random.default_rng(seed)
    first = np.unique(np.round(rng.uniform(0, 2, 60), 3))
    second = np.unique(np.round(rng.uniform(0, 2, 40), 3))
    rows, columns = associate(first, second, 0.05)
    assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == literal(first.tolist(), second.tolist(), 0.05)


def test_each_pose_is_used_once_and_the_closest_wins():
    rows, columns = associate(np.array([0.0, 0.010]), np.array([0.009, 0.5]))
    assert (rows.tolist(), columns.tolist()) == ([1], [0])


def test_the_limit_itself_is_too_far():
    assert len(associate(np.array([0.0]), np.array([0.5]), 0.5)[0]) == 0


def test_matched_poses_keep_their_order():
    truth, estimate = match(still(np.arange(0, 10, 0.1)), still(np.arange(2.005, 4, 0.2)))
    np.testing.assert_allclose(truth.timestamps_s, np.arange(2.0, 4, 0.2))
    assert len(estimate) == len(truth)


def test_files_without_times_match_by_index():
    truth, estimate = still(None, 5), still(None, 5)
    assert match(truth, estimate) == (truth, estimate)


def test_numbers_of_frames_choose_poses_of_the_file_without_times():
    whole = Trajectory(np.arange(18.0).reshape(6, 3), np.tile([1.0, 0, 0, 0], (6, 1)), None)
    truth, estimate = match(whole, numbered([1, 3, 4]))
    np.testing.assert_array_equal(truth.positions_m, whole.positions_m[[1, 3, 4]])
    assert (len(estimate), estimate.timestamps_s) == (3, None)
    truth, estimate = match(numbered([0, 2, 5]), whole)
    np.testing.assert_array_equal(estimate.positions_m, whole.positions_m[[0, 2, 5]])
    assert (len(truth), truth.timestamps_s) == (3, None)


def test_a_limit_that_pairs_everything_is_refused_before_memory_is_full():
    times = np.arange(6000.0)
    with pytest.raises(TrajectoryError, match="expected a time difference that leaves few choices"):
        associate(times, times, 1e4)


@pytest.mark.parametrize(
    ("truth", "estimate", "words"),
    [
        (still([0.0, 1, 2, 3]), still([10.0, 11, 12]), r"0\.000 to 3\.000 s .*10\.000 to 12\.000 s .*do not overlap"),
        (still([0.0, 1, 2, 3]), still([0.5, 1.5, 2.5]), "shift one clock"),
        (still([0.0, 1, 2, 3]), still([0.0, 1, 9]), "got 2"),
        (still(np.arange(20.0)), still(np.arange(20.0) * 1e3 + 5e6), "milliseconds"),
        (still(np.arange(20.0)), still(np.arange(20.0) * 1e9 + 5e9), "nanoseconds"),
        (still(None, 5), still(None, 4), "expected 5 poses as in G, got 4 in E"),
        (still(None, 2), still(None, 2), "at least 3"),
        (still([0.0, 1, 2]), still(None, 3), "G has times, E has none"),
        (still(None, 3), still([0.0, 1, 2]), "E has times, G has none"),
        (still(None, 9), numbered([0, 1]), "at least 3 poses, got 2 in E"),
        (still(None, 9), numbered([1, 2, 9]), "E numbers frames up to 9, G holds 9 without times"),
    ],
)
def test_errors_say_both_ranges_and_the_likely_cause(truth, estimate, words):
    with pytest.raises(TrajectoryError, match=words):
        match(truth, estimate, names=("G", "E"))
