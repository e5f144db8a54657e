"""A truth of 200 Hz beside experts of 10 to 20 Hz: steps as long as the experts', and how many of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mixo_env.cli.main import main
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.thinning import thinned
from mixo_env.trajectory import Trajectory, write_tum

TRUTH_S: NDArray[np.float64] = np.linspace(1.4e9, 1.4e9 + 19.995, 4_000)


def test_steps_end_at_the_true_poses_nearest_to_those_of_the_densest_expert():
    sparse, dense = TRUTH_S[5::40] + 0.001, TRUTH_S[7::20] - 0.002
    kept = thinned(TRUTH_S, [sparse, dense])
    assert kept is not None
    np.testing.assert_array_equal(kept, np.arange(7, 4_000, 20))


def test_where_the_densest_expert_is_lost_steps_go_on():
    dense = TRUTH_S[7::10]
    there = (dense < TRUTH_S[1_000]) | (dense > TRUTH_S[3_000])
    kept = thinned(TRUTH_S, [dense[there][30:]])
    assert kept is not None
    assert kept[0] == 0
    assert np.all(np.diff(kept) >= 5)
    assert np.all(np.diff(kept) <= 15)
    assert kept[-1] >= 3_990
    assert set(np.searchsorted(TRUTH_S, dense[there][30:])) <= set(kept.tolist())


def test_rare_key_frames_leave_steps_of_a_tenth_of_a_second_at_most():
    kept = thinned(TRUTH_S, [TRUTH_S[::200]])
    assert kept is not None
    assert np.diff(kept).max() <= 30
    assert len(kept) == pytest.approx(200, rel=0.05)


@pytest.mark.parametrize("experts_s", [[], [TRUTH_S[:1]]])
def test_a_sequence_without_experts_has_steps_like_the_others(experts_s):
    np.testing.assert_array_equal(thinned(TRUTH_S, experts_s), np.arange(0, 4_000, 20))


@pytest.mark.parametrize(
    ("truth_s", "experts_s"),
    [
        (0.1 * np.arange(50), [0.5 * np.arange(10)]),  # KITTI, with key frames
        (TRUTH_S, [TRUTH_S]),
        (0.1 * np.arange(50), []),
        (TRUTH_S[:2], [TRUTH_S[::20]]),
    ],
)
def test_a_truth_that_is_no_denser_than_needed_is_left_alone(truth_s, experts_s):
    assert thinned(truth_s, experts_s) is None


def test_a_wrong_stamp_asks_for_no_more_steps_than_there_are_poses():
    wrong = np.concatenate([[0.0], TRUTH_S])
    for experts in ([TRUTH_S[::20]], [np.concatenate([[0.0], TRUTH_S[::20]])]):
        kept = thinned(wrong, experts)
        assert kept is not None
        assert len(kept) <= 202


def test_any_times_give_increasing_positions_within():
    rng = np.random.default_rng(3)
    for _ in range(300):
        truth = np.cumsum(rng.exponential(0.005, size=int(rng.integers(3, 400))))
        experts = [np.cumsum(rng.exponential(0.05, size=int(rng.integers(1, 60)))) + rng.normal() for _ in range(2)]
        kept = thinned(truth, experts)
        if kept is not None:
            assert np.all(np.diff(kept) > 0)
            assert kept[0] >= 0
            assert kept[-1] < len(truth)


def test_an_import_of_such_files_keeps_the_experts_own_turns(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    yaw_rad = 0.4 * np.sin((TRUTH_S - TRUTH_S[0]) / 2.0)
    x_m, y_m = np.cumsum(0.05 * np.cos(yaw_rad)), np.cumsum(0.05 * np.sin(yaw_rad))
    seen = np.arange(3, 4_000, 20)
    noise = np.cumsum(1e-3 * np.random.default_rng(0).standard_normal(len(seen)))
    truth = Trajectory.from_planar(x_m, y_m, yaw_rad, TRUTH_S)
    orb = Trajectory.from_planar(x_m[seen], y_m[seen], yaw_rad[seen] + noise, TRUTH_S[seen])
    for name, trajectory in (("gt", truth), ("orb", orb)):
        (tmp_path / name).mkdir()
        write_tum(tmp_path / name / "hall.txt", trajectory)
    files = ["--groundtruth", str(tmp_path / "gt"), "--expert", f"ORB={tmp_path / 'orb'}"]
    assert main(["import", *files, "--out", str(tmp_path / "out")]) == 0
    assert "hall: steps from 200 of 4000 true poses" in capsys.readouterr().err
    made = load_recordings(tmp_path / "out")
    np.testing.assert_allclose(made["dt_s"][1:], 0.1, atol=1e-6)
    turns = np.diff(yaw_rad[seen] + noise)
    np.testing.assert_allclose(made["ORB.yaw_increment_rad"][1:], turns, atol=1e-6)  # not smoothed by interpolation
