"""The paper's tables and figures: printed numbers as docs/paper.md has them, files for recordings of every kind."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from mixo_env.cli.benchmark import Benchmark
from mixo_env.cli.main import commands, main
from mixo_env.leaderboard.board import Leaderboard, build
from mixo_env.leaderboard.paper import printed, tables
from mixo_env.leaderboard.paper.pages import FIGURES, OTHER_FIGURES, write_paper
from mixo_env.leaderboard.paper.parts import median_spent_ms, subject_of
from mixo_env.policies.gate import Mixo
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import VARIANT_COLUMNS
from mixo_env.recordings.store import TIMINGS_FILE, save_recordings, write_columns
from tests.synthetic import synthetic_recordings

ROOT = Path(__file__).parent.parent
FACTS = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
MAP = (ROOT / "docs" / "paper-to-code.md").read_text(encoding="utf-8")
ENTRIES = [line.strip("|").split(" | ") for line in MAP.splitlines() if line.startswith("|") and "`" in line]
COMMANDS = sorted({entry[-1].strip().strip("`") for entry in ENTRIES})
ROWS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT", "HIGHEST MATCH", "LINEAR", "HUBER", "MIXO")
PICTURES = {*FIGURES, *OTHER_FIGURES}


def with_joint(recordings: Recordings) -> Recordings:
    """JOINT says what the back camera says."""
    columns = {f"JOINT.{name}": recordings[f"CAM_BACK.{name}"] for name in VARIANT_COLUMNS}
    return recordings.replace(replace(recordings.manifest, variants={"JOINT": "CAM_FRONT"}), columns)


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return with_joint(synthetic_recordings(0, scenes=8, logs=4, steps=100))


@pytest.fixture(scope="module")
def board(recordings: Recordings) -> Leaderboard:
    """MIXO learns briefly: nothing here depends on how well."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Mixo.__init__, "__kwdefaults__", Mixo.__init__.__kwdefaults__ | {"min_updates": 20})
        return build(recordings, tracks=("VISION", "PAPER"), policies=(*ROWS, "JOINT"))


@pytest.fixture
def timed(tmp_path: Path) -> Path:
    """A folder with 10 ms for an image of every camera, and 7 ms for a step of JOINT."""
    names = np.repeat(["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT", "JOINT"], 3).astype(object)
    spent = np.where(names == "JOINT", 7.0, 10.0) + np.tile([-1.0, 0.0, 5.0], 5)
    folder = tmp_path / "timed"
    write_columns(folder / TIMINGS_FILE, {"camera": names, "expert_ms": spent}, [len(names)])
    return folder


def numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"(?<![\w.])\d*\.\d+|\b\d+\b", text)]


def test_printed_table_1_is_that_of_the_facts() -> None:
    section = FACTS.split("## Table I as printed")[1].split("## ")[0]
    found = [line.strip("| ").split(" | ") for line in section.splitlines() if re.match(r"\| [A-Z]", line)]
    ours = [
        (row.label, [row.translation_percent, row.rotation_deg_per_m, row.lost_mean, row.lost_std])
        for row in printed.TABLE_1
    ]
    assert [(label, numbers(" ".join(values))) for label, *values in found] == ours


def test_printed_table_2_is_that_of_the_facts() -> None:
    line = FACTS.split("## Table II as printed")[1].splitlines()[2]
    told = dict(re.findall(r"(\d+-\d+|overall):? (\d[\d.]+ / [\d.]+)", line))
    ours = {split.removeprefix("scenes "): values for split, values in printed.TABLE_2.items()}
    assert {split: tuple(numbers(pair)) for split, pair in told.items()} == ours


def test_printed_shares_and_weights_are_those_of_the_facts() -> None:
    shares = re.search(r"front camera (\d+) %, the other cameras about (\d+) % each", FACTS)
    assert shares
    assert [float(share) / 100 for share in shares.groups()] == sorted(set(printed.BEST_SHARE.values()), reverse=True)
    line = re.search(r"least RMSE \((.*?); their sum, ([\d.]+)", FACTS, re.DOTALL)
    assert line
    assert numbers(line[1]) == [
        printed.LINEAR_WEIGHTS[name]
        for name in ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT", "INERTIAL_POSE")
    ]
    assert sum(printed.LINEAR_WEIGHTS.values()) == pytest.approx(float(line[2]), abs=5e-4)


def test_every_table_and_figure_is_written(board: Leaderboard, recordings: Recordings, tmp_path: Path) -> None:
    page = write_paper(board, recordings, tmp_path).read_text(encoding="utf-8")
    assert {path.name for path in tmp_path.iterdir()} == {"paper.md", *PICTURES}
    assert all(f"]({name})" in page for name in PICTURES)
    assert "Not made" not in page
    assert "track PAPER" in page
    assert "track VISION" not in page


def test_our_numbers_are_those_of_the_board(board: Leaderboard, recordings: Recordings) -> None:
    subject = subject_of(board, recordings, None)
    told = {line[0]: line for line in tables.table_1(subject).rows}
    assert len(told) == 11
    for row in board.standings[1].rows:
        if row.name in told:
            score = row.headline
            assert told[row.name][2] == score.translation_percent.mean
            assert told[row.name][4] == score.rotation_deg_per_m.mean
    assert np.isnan(float(told["CAM_BACK_RIGHT w/ retrained vocab."][2] or 0.0))
    overall = {line[0]: line[-1] for line in tables.table_2(subject).rows}
    assert overall["MIXO"] == pytest.approx(subject.row("MIXO").headline.rotation_deg_per_m.mean)


def test_a_fold_is_the_mean_over_its_pieces(board: Leaderboard, recordings: Recordings) -> None:
    subject = subject_of(board, recordings, None)
    relative = subject.row("LINEAR").errors[board.headline].relative
    in_fold = [board.recordings.scenes[i].fold == 2 for i in relative.scene]
    line = next(line for line in tables.table_2(subject).rows if line[0] == "LINEAR")
    assert line[1 + 2 * 2 + 1] == pytest.approx(np.mean(relative.rotation_deg_per_m[in_fold]))


def test_shares_of_equation_2_add_up(board: Leaderboard, recordings: Recordings) -> None:
    lines = tables.equation_2(subject_of(board, recordings, None)).rows
    assert np.nansum([float(line[2] or 0.0) for line in lines]) == pytest.approx(100.0)
    assert sum(float(line[3] or 0.0) for line in lines) == pytest.approx(100.0)
    ours = {line[0]: float(line[2] or 0.0) for line in lines[:4]}
    assert max(ours, key=ours.__getitem__) == "CAM_FRONT"  # the least noise of all cameras


def test_shares_of_equation_2_step_by_step(board: Leaderboard, recordings: Recordings) -> None:
    """Only moving steps in which no camera is silent; noise leaves no ties."""
    subject = subject_of(board, recordings, None)
    judged, cameras = subject.judged, board.recordings.manifest.cameras
    wins = dict.fromkeys(cameras, 0)
    for k in range(len(judged["dt_s"])):
        errors = {c: abs(judged[f"{c}.yaw_increment_rad"][k] - judged["truth.yaw_increment_rad"][k]) for c in cameras}
        if judged["truth.distance_m"][k] >= 0.2 * judged["dt_s"][k] and not np.isnan(list(errors.values())).any():
            wins[min(errors, key=errors.__getitem__)] += 1
    table = tables.equation_2(subject)
    assert f" {sum(wins.values())} moving steps" in table.caption
    for name, _, share, _ in table.rows[:4]:
        assert share == pytest.approx(100.0 * wins[str(name)] / sum(wins.values()))


def test_coupling_costs_all_cameras_and_the_solve(board: Leaderboard, recordings: Recordings, timed: Path) -> None:
    assert median_spent_ms(timed)["CAM_BACK"] == 10.0
    told = {line[0]: line for line in tables.coupling(subject_of(board, recordings, timed)).rows}
    assert [told[name][-1] for name in ("CAM_BACK", "HUBER", "JOINT")] == [10.0, 40.0, 47.0]
    assert told["JOINT"][3] == subject_of(board, recordings, None).row("JOINT").headline.rotation_deg_per_m.mean


def test_coupling_says_what_is_not_recorded(recordings: Recordings) -> None:
    plain = synthetic_recordings(0, scenes=4, steps=60)
    few = build(plain, tracks=("PAPER",), policies=("CAM_FRONT", "LINEAR"))
    told = {line[0]: line for line in tables.coupling(subject_of(few, plain, None)).rows}
    assert told["JOINT"][2] == told["JOINT"][-1] == told["LINEAR"][-1] == "not recorded"
    assert told["MIXO"][2] == "not run"
    missing = {line[0]: line for line in tables.coupling(subject_of(few, recordings, None)).rows}
    assert missing["JOINT"][2] == "not run"


def missing_lines(page: str) -> dict[str, str]:
    """Heading -> the one line that says why there is nothing."""
    blocks = re.findall(r"^## (.+)\n\n(.+)\n*(?=^##|\Z)", page, re.MULTILINE)
    return {heading: line for heading, line in blocks if line.startswith("Not made")}


def test_without_cameras_one_line_each_says_so(tmp_path: Path) -> None:
    recorded = synthetic_recordings(1, scenes=4, steps=60)
    names = [name for name in recorded.column_names if not name.startswith("CAM_")]
    blind = Recordings(replace(recorded.manifest, cameras=()), {name: recorded[name] for name in names})
    board = build(blind, tracks=("PAPER",), policies=("INERTIAL", "LINEAR"))
    page = write_paper(board, blind, tmp_path).read_text(encoding="utf-8")
    lines = missing_lines(page)
    for heading in ("Equation 2", "Loose against tight coupling", "Figure 3", "Figure 4", "Accuracy against cost"):
        assert lines[heading] == "Not made: these recordings have no cameras.", heading
    assert lines["Figure 5"] == "Not made: row CAM_FRONT was not run or is not recorded."
    assert {path.name for path in tmp_path.glob("*.png")} == set(re.findall(r"\]\((paper-.*?png)\)", page))


def test_one_log_says_so(tmp_path: Path) -> None:
    single = synthetic_recordings(2, scenes=2, logs=1, steps=60)
    board = build(single, tracks=("PAPER",), policies=("CAM_FRONT", "HIGHEST MATCH"))
    lines = missing_lines(write_paper(board, single, tmp_path).read_text(encoding="utf-8"))
    said = "Not made: these recordings have fewer than two folds (one log, or no fold at all)."
    assert lines["Table II"] == lines["Accuracy against cost"] == said
    assert lines["MIXO against the front camera"] == "Not made: row MIXO was not run or is not recorded."
    assert "Figure 6" not in lines


def test_figures_of_an_earlier_run_do_not_stay(tmp_path: Path) -> None:
    single = synthetic_recordings(2, scenes=2, logs=1, steps=60)
    (tmp_path / "paper-cost.png").write_bytes(b"old")
    write_paper(build(single, tracks=("PAPER",), policies=("CAM_FRONT",)), single, tmp_path)
    assert not (tmp_path / "paper-cost.png").exists()


def test_the_command_writes_it_beside_the_rest(tmp_path: Path) -> None:
    save_recordings(synthetic_recordings(0, scenes=4, steps=80), tmp_path / "own")
    Benchmark(tmp_path / "own", ("PAPER",), ("CAM_FRONT", "LINEAR"), paper=True, out=tmp_path / "out").run()
    assert {"paper.md", "paper-fig6.png", "leaderboard.md", "report.html"} <= {
        path.name for path in (tmp_path / "out").iterdir()
    }


def test_the_map_names_every_equation_table_and_figure() -> None:
    named = {entry[0].strip() for entry in ENTRIES}
    numbered = {*(f"eq. {k}" for k in range(1, 6)), "table I", "table II", *(f"figure {k}" for k in range(3, 8))}
    assert numbered <= named


def test_the_map_names_files_that_exist() -> None:
    for paper, _, module, test, _ in ENTRIES:
        for path in (module, test):
            assert (ROOT / path.strip().strip("`")).is_file(), (paper, path)


@pytest.mark.parametrize("line", COMMANDS)
def test_the_map_names_commands_that_are_understood(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if line.startswith("python -m "):
        assert find_spec(line.split()[2])
        return
    for command in commands().values():
        monkeypatch.setattr(command, "run", lambda self: 0)
    words = shlex.split(line)
    assert words[0] == "mixo"
    assert main(words[1:]) == 0
