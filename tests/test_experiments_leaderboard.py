"""The leaderboard's tables, texts and picture on random recordings."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from mixo_env.leaderboard import exports, report
from mixo_env.leaderboard.board import Leaderboard, build
from mixo_env.leaderboard.figures import draw_trajectories
from mixo_env.leaderboard.sentences import mean_std_text
from mixo_env.metrics.tracks import LostTracks
from mixo_env.policies.registry import POLICIES
from mixo_env.policies.robust import Huber
from mixo_env.recordings.collection import Recordings
from tests.synthetic import synthetic_recordings

ROWS = ("INERTIAL", "INERTIAL_CONSUMER", "CAM_FRONT", "MEDIAN", "LINEAR", "ORACLE ALL", "PERFECT YAW")


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(0, steps=120)


@pytest.fixture(scope="module")
def board(recordings: Recordings) -> Leaderboard:
    return build(recordings, policies=ROWS, tracks=("VISION", "CONSUMER"))


def test_every_track_has_its_own_table_in_the_order_of_the_registry(board: Leaderboard) -> None:
    assert [table.track for table in board.standings] == ["VISION", "CONSUMER"]
    for table in board.standings:
        assert [row.run.name for row in table.rows] == list(ROWS)
        assert [row.run.name for row in table.rows if row.run.privileged] == ["ORACLE ALL", "PERFECT YAW"]
    vision, consumer = board.standings
    assert [row.run.name for row in vision.rows if not row.votes] == ["INERTIAL", "INERTIAL_CONSUMER"]
    assert [row.run.name for row in consumer.rows if not row.votes] == ["INERTIAL"]


def test_pooled_score_is_the_mean_of_all_samples_and_lies_in_its_interval(board: Leaderboard) -> None:
    for row in itertools.chain.from_iterable(table.rows for table in board.standings):
        score, samples = row.scores["truth"], row.errors["truth"].relative
        assert score.translation_percent.mean == pytest.approx(np.mean(samples.translation_percent))
        assert score.translation_percent.low <= score.translation_percent.mean <= score.translation_percent.high
        assert score.samples == len(samples.scene)
        assert score.scenes == len(board.recordings)


def test_same_seed_same_numbers(recordings: Recordings, board: Leaderboard) -> None:
    again = build(recordings, policies=ROWS, tracks=("VISION", "CONSUMER"))
    assert report.to_markdown(again) == report.to_markdown(board)
    assert json.dumps(exports.to_json(again)) == json.dumps(exports.to_json(board))  # NaN is NaN here
    assert exports.to_csv(again) == exports.to_csv(board)


def test_markdown_says_what_the_numbers_rest_on(board: Leaderboard) -> None:
    text = report.to_markdown(board)
    for phrase in (
        "Data synthetic-0: 8 scenes of 4 logs; seed 0.",
        "Alignment: none",
        "starts 1 m apart; pieces (scenes) per length: 10 m ",
        "Intervals: bootstrap over 4 logs. 4 folds by log",
        "claims no ranking",
        "| PERFECT YAW † |",
        "| INERTIAL * |",
        "LINEAR weights, mean over folds: CAM_FRONT",
        "## Track VISION",
    ):
        assert phrase in text
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert len({line.count("|") for line in tables}) == 1
    assert len(tables) == 2 * (len(ROWS) + 2)


def test_json_is_plain_and_complete(board: Leaderboard) -> None:
    decoded = msgspec.json.decode(msgspec.json.encode(exports.to_json(board)))
    rows = decoded["tracks"]["CONSUMER"]["rows"]
    assert [row["policy"] for row in rows] == list(ROWS)
    linear = rows[ROWS.index("LINEAR")]
    assert linear["scores"]["truth"]["ate_m"] > 0
    assert set(decoded["tracks"]["CONSUMER"]["linear_weights"]) == {"0", "1", "2", "3"}
    assert rows[0]["lost_per_scene"] is None
    assert rows[ROWS.index("CAM_FRONT")]["lost_per_scene"]["mean"] == 1.0


def test_lost_tracks_are_spread_over_the_tested_scenes() -> None:
    tested = np.array([True, True, False, True])
    row = SimpleNamespace(run=SimpleNamespace(tested=tested))
    lost = LostTracks(np.array([0, 2, 9, 1]), *[np.zeros(4, np.int64)] * 2, 3.0, 3.5)
    assert mean_std_text(row, lost) == "1.00 ± 0.82"  # sqrt(2 / 3): three scenes, divided by three
    assert mean_std_text(row, None) == "-"


def test_scene_lines_average_to_the_table(board: Leaderboard) -> None:
    lines = list(csv.DictReader(io.StringIO(exports.to_csv(board))))
    assert len(lines) == 2 * len(ROWS) * len(board.truths) * len(board.recordings)
    for row in board.standings[0].rows:
        mine = [x for x in lines if (x["track"], x["policy"], x["truth"]) == ("VISION", row.run.name, "truth")]
        score = row.scores["truth"]
        assert math.fsum(float(x["ate_m"]) for x in mine) / len(mine) == pytest.approx(score.ate_m)
        samples = [int(x["rte_samples"]) for x in mine]
        pooled = sum(float(x["rte_percent"]) * n for x, n in zip(mine, samples, strict=True) if n) / sum(samples)
        assert pooled == pytest.approx(score.translation_percent.mean)


def test_policies_tested_on_one_fold_are_compared_on_that_fold_alone(
    recordings: Recordings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Huber, "expensive", True)
    board = build(recordings, policies=("MEDIAN", "LINEAR", "HUBER"), tracks=("VISION",))
    (table,) = board.standings
    assert [row.run.name for row in table.rows] == ["MEDIAN", "LINEAR"]
    assert [row.run.name for row in table.one_fold_rows] == ["LINEAR", "HUBER"]
    assert table.one_fold == 3
    assert {row.scores["truth"].scenes for row in table.one_fold_rows} == {2}
    assert "VISION, learned policies on fold 3 alone" in report.to_markdown(board)


def test_unfit_policies_are_left_out_with_a_reason_unless_asked_for(
    recordings: Recordings, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mixo_env.errors import PolicyError

    other = recordings.select(folds=[0])

    def none() -> Recordings:
        return other

    monkeypatch.setattr(
        "mixo_env.leaderboard.crossvalidation.CrossValidation.training", lambda self, fold: _no_training()
    )
    with pytest.raises(PolicyError, match="nothing to learn from"):
        build(none(), policies=("LINEAR",), tracks=("VISION",))
    board = build(none(), tracks=("VISION",))
    assert set(board.standings[0].left_out) == {
        name for name, kind in POLICIES.items() if kind.learns and kind.only_track in ("", "VISION")
    }
    assert re.search(
        r"\nLINEAR, LINEAR SIMPLEX, .*, TANDEM, .* left out: nothing to learn from\.\n", report.to_markdown(board)
    )


def _no_training() -> Recordings:
    from mixo_env.errors import PolicyError

    raise PolicyError("nothing to learn from")


def test_terminal_keeps_to_the_essentials_when_narrow(board: Leaderboard, capsys: pytest.CaptureFixture[str]) -> None:
    report.print_leaderboard(board)
    printed = capsys.readouterr().out
    assert "PERFECT YAW †" in printed
    assert "written deg/m" in printed
    assert "…" not in printed
    assert max(len(line) for line in printed.splitlines()) <= report.WIDE


def test_figure_is_drawn_without_a_window(board: Leaderboard, tmp_path: Path) -> None:
    draw_trajectories(board, tmp_path / "trajectories.png")
    picture = (tmp_path / "trajectories.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 20_000
    assert [path.name for path in tmp_path.iterdir()] == ["trajectories.png"]


def test_standing_scenes_have_an_ate_but_no_relative_error(recordings: Recordings, tmp_path: Path) -> None:
    columns = {name: recordings[name].copy() for name in recordings.column_names}
    for name in columns:
        if name.endswith(("distance_m", "speed_mps", "x_m", "y_m")):
            columns[name] = np.where(np.isnan(columns[name]), columns[name], 0).astype(columns[name].dtype)
    standing = Recordings(recordings.manifest, columns).select(folds=[0, 1])
    board = build(standing, policies=ROWS, tracks=("CONSUMER",))
    assert "| LINEAR | - | - | - | - | - | 0.00 |" in report.to_markdown(board)
    assert exports.to_csv(board).count("nan") == 2 * 2 * len(ROWS) * len(standing)
    draw_trajectories(board, tmp_path / "standing.png")
