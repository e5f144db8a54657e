"""Recordings that lack something, through `mixo benchmark`: a table with its fallback stated, or one clear line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixo_env.cli.benchmark import Benchmark
from mixo_env.errors import ConfigurationError, RecordingError
from mixo_env.leaderboard import report
from mixo_env.leaderboard.board import build
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.complete import check_complete
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings

ROWS = ("INERTIAL", "HIGHEST MATCH", "MEDIAN", "LINEAR", "MULTICAMERA GT", "PERFECT YAW")
OPTIONS: tuple[dict[str, Any], ...] = (
    {"by": ("condition",), "sort": "deg/m", "seeds": 2},
    {"ground_truth": "keyframes", "sort": "written"},
)


def without_cameras(recordings: Recordings) -> Recordings:
    return Recordings(
        replace(recordings.manifest, cameras=(), variants={}, camera_cost_ms={}),
        {name: recordings[name] for name in recordings.column_names if not name.startswith("CAM_")},
    )


def standing(recordings: Recordings) -> Recordings:
    """Truth and wheels stand still; what the experts saw turn is their error."""
    names = ("truth.x_m", "truth.y_m", "truth.distance_m", "distance_m", "speed_mps", "exact.x_m", "exact.y_m")
    return recordings.replace(columns={name: np.zeros_like(recordings[name]) for name in names})


def with_nothing_in(recordings: Recordings, *names: str) -> Recordings:
    return recordings.replace(columns={name: np.full_like(recordings[name], np.nan) for name in names})


@pytest.fixture(scope="module")
def eight() -> Recordings:
    return synthetic_recordings(0, scenes=8, logs=8, steps=80)


def run(
    recordings: Recordings,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    tracks: tuple[str, ...] = ("PAPER", "VISION"),
    **options: Any,
) -> str:
    """What `mixo benchmark` prints of all rows that may be left out."""
    save_recordings(recordings, folder / "recordings")
    assert Benchmark(folder / "recordings", tracks, out=folder / "out", **options).run() == 0
    assert (folder / "out" / "trajectories.png").stat().st_size > 10_000
    assert "NaN" not in (folder / "out" / "leaderboard.json").read_text()
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("options", OPTIONS)
def test_inertial_alone_is_a_table_of_its_own(
    eight: Recordings, options: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    monkeypatch.setattr("mixo_env.leaderboard.board.policy_names", lambda _: ROWS[:-1])
    monkeypatch.setattr("mixo_env.leaderboard.board.FLOORS", {"PERFECT YAW": None})
    printed = run(without_cameras(eight), tmp_path, capsys, tracks=(), **options)
    assert "HIGHEST MATCH left out: HIGHEST MATCH needs match counts" in printed
    assert "Track VISION" not in printed
    assert "LINEAR weights, mean over folds: INERTIAL_POSE 1.0" in printed


def test_a_track_in_which_nobody_votes_is_one_clear_line(eight: Recordings) -> None:
    with pytest.raises(ConfigurationError, match="track VISION needs a camera or an imported expert"):
        build(without_cameras(eight), tracks=("VISION",), policies=("MEDIAN",))


@pytest.mark.parametrize("options", OPTIONS)
def test_too_little_driving_gives_no_rte_and_no_letter(
    eight: Recordings, options: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    monkeypatch.setattr("mixo_env.leaderboard.board.policy_names", lambda _: ROWS[:-1])
    still = with_nothing_in(standing(eight), "exact.x_m", "exact.y_m", "exact.yaw_rad")
    printed = run(still, tmp_path, capsys, **options)
    assert "no cameras, or too little driving, to tell more" in printed
    assert "10 m 0 (0)" in printed


@pytest.mark.parametrize(
    "column", ["truth.x_m", "truth.yaw_increment_rad", "truth.distance_m", "speed_mps", "distance_m", "time_s", "dt_s"]
)
def test_a_column_without_a_number_is_named(eight: Recordings, column: str) -> None:
    with pytest.raises(RecordingError, match=f"{column}: expected a number in every row, got none in any scene"):
        build(with_nothing_in(eight, column), tracks=("VISION",), policies=("CAM_FRONT",))


def test_one_missing_number_is_found_in_its_row(eight: Recordings) -> None:
    distance = eight["distance_m"].copy()
    distance[eight.offsets[2] + 5] = np.nan
    with pytest.raises(RecordingError, match=f"distance_m: .* got none in {eight.scenes[2].name}, row 5:"):
        build(eight.replace(columns={"distance_m": distance}), tracks=("VISION",), policies=("CAM_FRONT",))


def test_a_first_row_has_a_pose_and_a_speed_but_no_step(eight: Recordings) -> None:
    """It belongs to its own scene, not to the one before."""
    check_complete(eight)
    first = eight.offsets[2]
    speed, distance = eight["speed_mps"].copy(), eight["distance_m"].copy()
    distance[first] = np.nan
    check_complete(eight.replace(columns={"distance_m": distance}))
    speed[first] = np.nan
    with pytest.raises(RecordingError, match=f"speed_mps: .* got none in {eight.scenes[2].name}, row 0:"):
        check_complete(eight.replace(columns={"speed_mps": speed}))


def test_an_expert_that_never_says_anything_is_named_below_the_table(eight: Recordings) -> None:
    silent = with_nothing_in(eight, "INERTIAL_POSE.yaw_increment_rad")
    board = build(silent, tracks=("PAPER",), policies=("INERTIAL_POSE", "MEDIAN"))
    assert "No increment in any step: INERTIAL_POSE; such a row shows what stands in for it." in report.to_markdown(
        board
    )
    assert "No increment" not in report.to_markdown(build(eight, tracks=("PAPER",), policies=("MEDIAN",)))


@pytest.mark.parametrize("width", [80, 100, 120, 156, 200])
def test_every_terminal_shows_intervals_letters_and_the_difference(
    eight: Recordings, width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    named = ("CAM_FRONT", "CAM_BACK_RIGHT", "LINEAR", "MEDIAN", "PERFECT YAW + TRUE DISTANCE")
    board = build(eight, tracks=("VISION",), policies=named)
    monkeypatch.setattr("mixo_env.leaderboard.report.WIDE", width)
    report.print_leaderboard(board)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    header = next(line for line in lines if line.strip().startswith("policy"))
    assert all(column in header for column in report.LEAST_COLUMNS)
    row = next(line for line in lines if line.strip().startswith("CAM_BACK_RIGHT"))
    comparisons = board.standings[0].comparisons
    text = report.cells(next(r for r in board.standings[0].rows if r.name == "CAM_BACK_RIGHT"), comparisons)
    assert "[" in text["RTE deg/m"]
    assert all(text[column] in row for column in report.LEAST_COLUMNS)
    assert ("For want of width without" in "\n".join(lines)) == (report.WRITTEN_COLUMN not in header)
