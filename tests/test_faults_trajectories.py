"""Faults in files and options of ``mixo evaluate``: each ends with exit code 1 or 2 and exactly one line."""

from __future__ import annotations

import gzip
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from experiments.fuzz.trajectories import fuzz
from mixo_env.cli import main as cli
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.formats import kitti_text, tum_text

POSES = 40
K = np.arange(POSES)
YAW = 0.05 * K
DRIVE = Trajectory.from_planar(
    40 * np.sin(YAW), 40 - 40 * np.cos(YAW), YAW, np.asarray(1.7e9 + 0.1 * K, dtype=np.float64)
)
TUM = tum_text(DRIVE)
KITTI = kitti_text(DRIVE)
LINES = TUM.splitlines(keepends=True)
STILL = "".join(f"{1.7e9 + 0.1 * k:.1f} 5 5 5 0 0 0 1\n" for k in K)
STRAIGHT_NS = "".join(f"{1700000000000000000 + 100000000 * k},{k},0,0,0.6,0,0,0.8\n" for k in K)
MATRIX = "".join(line + " 0 0 0 1\n" for line in KITTI.splitlines())


def column(number: int, value: str, text: str = TUM, row: int = 5) -> str:
    """The text with one cell replaced."""
    lines = [line.split(" ") for line in text.splitlines()]
    lines[row][number] = value
    return "".join(" ".join(line) + "\n" for line in lines)


def columns(function: Callable[[list[str]], list[str]], text: str = TUM) -> str:
    """The text with every row changed."""
    return "".join(" ".join(function(line.split(" "))) + "\n" for line in text.splitlines())


def scaled(power: int) -> str:
    return columns(lambda row: [f"{float(row[0]) * 10**power:.0f}", *row[1:]])


FILES: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "empty"),
    "blank lines only": ("\n \n\t\n", "empty"),
    "comments only": ("# a\n% b\n", "empty"),
    "heading only": ("t x y z qx qy qz qw\n", "empty"),
    "two headings": ("t x y z\nqx qy qz qw\n" + TUM, "line 2: expected numbers"),
    "one pose": (LINES[0], "at least 2 poses"),
    "two poses": ("".join(LINES[:2]), "at least 3 pairs"),
    "heading with a number": ("t x y z qx qy qz 1\n" + TUM, "line 1: expected numbers"),
    "a word": (column(2, "two"), "line 6: expected numbers, got 'two'"),
    "terminal codes": (column(2, "\x1b[31mRED\x1b]0;owned\x07"), r"\x1b[31mRED\x1b]0;owned\x07"),
    "direction marks": (column(2, "\u202e1"), r"\u202e1"),
    "not a number": (column(2, "nan"), "line 6: expected finite"),
    "infinity": (column(3, "-inf"), "line 6: expected finite"),
    "more than a double": (column(3, "1e999"), "line 6: expected finite"),
    "a missing cell": (columns(lambda row: row[:5] + row[6:] if row[0].endswith("0.5") else row), "expected 8 columns"),
    "a cell too many": (column(3, "1 2"), "line 6: expected 8 columns as in line 1, got 9"),
    "an empty cell": (TUM.replace(" ", ",").replace(",", ",,", 1), "line 1: expected a number in every cell"),
    "an empty column": (columns(lambda row: [",".join([row[0], "", *row[1:]])]), "in every cell"),
    "decimal commas": (TUM.replace(".", ","), "decimal"),
    "decimal commas and semicolons": (TUM.replace(" ", ";").replace(".", ","), "decimal"),
    "three columns": (columns(lambda row: row[:3]), "expected 8 columns (TUM"),
    "seven columns": (columns(lambda row: row[:7]), "expected 8 columns (TUM"),
    "nine columns": (columns(lambda row: [*row, "0"]), "expected 8 columns (TUM"),
    "row numbers that do not count": (columns(lambda row: ["7", *row]), "expected 8 columns (TUM"),
    "matrices over four lines": (MATRIX.replace(" 0 0 0 1\n", "\n0 0 0 1\n"), "columns"),
    "four columns": (columns(lambda row: row[:4]), "one matrix a line"),
    "ten columns": (columns(lambda row: [*row, "0", "0"]), "expected 8 columns (TUM"),
    "cut in a line": (TUM[:-30], "columns"),
    "utf-16": (TUM.encode("utf-16"), "UTF-16"),
    "utf-16 without mark": (TUM.encode("utf-16-le"), "not a text file"),
    "latin-1": (b"# gr\xf6\xdfe\n" + TUM.encode(), "UTF-8"),
    "binary": (bytes(range(256)) * 20, "not a text file"),
    "a cut gzip": (gzip.compress(TUM.encode())[:-20], "gzip"),
    "a damaged gzip": (b"\x1f\x8b" + TUM.encode(), "gzip"),
    "no line ends": (TUM.replace("\n", " ") * 10, "one pose a line"),
    "quaternion of zeros": (columns(lambda row: [*row[:4], "0", "0", "0", "0"]), "length 1, got 0"),
    "quaternion too long": (columns(lambda row: [*row[:7], "7"]), "length 1"),
    "a huge quaternion": (column(5, "1e308"), "length 1"),
    "a huge coordinate": (column(2, "-1e308"), "line 6: expected coordinates up to"),
    "a coordinate off the Earth": (column(1, "1e10"), "out of range"),
    "times unsorted": ("".join(LINES[::-1]), "increasing times"),
    "times twice": ("".join(LINES[:5] + LINES[4:]), "line 6: expected increasing times"),
    "times all equal": (columns(lambda row: ["1", *row[1:]]), "line 2: expected increasing times"),
    "times in milliseconds": (scaled(3), "milliseconds"),
    "times in microseconds": (scaled(6), "microseconds"),
    "times beyond int64": (columns(lambda row: ["1e22", *row[1:]], LINES[0]) + TUM, "out of range"),
    "a time of 1e308": (column(0, "1e308", row=POSES - 1), "out of range"),
    "steps of hours": (columns(lambda row: [str((float(row[0]) - 1.7e9) * 1e5), *row[1:]]), "steps of"),
    "other day": (columns(lambda row: [str(float(row[0]) - 86400.0), *row[1:]]), "do not overlap"),
    "columns in another order": ("t qw qx qy qz x y z\n" + TUM, "the heading says t qw"),
    "w in the middle": ("t x y z qx qw qy qz\n" + TUM, "the heading says t x"),
    "quaternions w first in TUM": (
        columns(lambda row: [*row[:4], row[7], *row[4:7]]),
        "only w x y z fits the motion",
    ),
    "quaternion order open": (STRAIGHT_NS, "--quaternions"),
    "matrix without rotation": (columns(lambda row: ["2", *row[1:]], KITTI), "expected a rotation"),
    "mirrored matrix": (columns(lambda row: [*row[:8], *(str(-float(x)) for x in row[8:])], KITTI), "rotation"),
    "huge matrix": (column(0, "1e200", KITTI), "line 6: expected a rotation"),
    "huge translation": (column(3, "1e200", KITTI), "line 6: expected coordinates"),
    "last row wrong": (column(15, "2", MATRIX), "line 6: expected a 4x4 matrix"),
    "last row all wrong": (MATRIX.replace(" 0 0 0 1\n", " 1 2 3 4\n"), "last row 0 0 0 1"),
    "columns before rows": (
        columns(lambda row: [row[4 * i + j] for j in range(4) for i in range(4)], MATRIX),
        "transpose",
    ),
    "kitti without times": (KITTI, "has none"),
    "decoded as numbers in words": (column(2, "1_0"), "line 6: expected numbers"),
    "hexadecimal": (column(2, "0x1p3"), "line 6: expected numbers"),
}

OPTIONS: dict[str, tuple[tuple[str, ...], str]] = {
    "no estimate there": (("--estimate", "none.txt"), "found nothing there"),
    "a name with a line end": (("--estimate", "no\nne.txt"), r"no\nne.txt"),
    "a name far too long": (("--estimate", "n" * 5000), "too long"),
    "a name with NUL": (("--estimate", "a\0b"), "found nothing there"),
    "an empty folder": (("--estimate", "folder"), "found none"),
    "an endless device": (("--estimate", "/dev/zero"), "at most"),
    "standard input twice": (("--groundtruth", "-", "--estimate", "-"), "several times"),
    "the same estimate twice": (("--estimate", "gt.txt", "gt.txt"), "given twice"),
    "a folder against a file": (("--groundtruth", "many", "--estimate", "gt.txt"), "missing"),
    "times for a file with times": (("--estimate", "gt.txt", "--times", "gt.txt"), "its own times"),
    "sim3 of a standing truth": (("--groundtruth", "still.txt", "--estimate", "gt.txt", "--align", "sim3"), "truth"),
    "sim3 of a trembling truth": (("--groundtruth", "tremble.txt", "--estimate", "gt.txt", "--align", "sim3"), "truth"),
    "sim3 of a standing estimate": (("--estimate", "still.txt", "--align", "sim3"), "an estimate that moves"),
    "more poses to align on than there are": (("--estimate", "gt.txt", "--align", "se3", "--align-poses", "99"), "99"),
    "out is a file": (("--estimate", "gt.txt", "--out", "still.txt"), "cannot write still.txt"),
    "out below a file": (("--estimate", "gt.txt", "--out", "still.txt/a/b"), "cannot write still.txt/a/b"),
    "out far too long": (("--estimate", "gt.txt", "--out", "n" * 300), "cannot write"),
    "out is a device": (("--estimate", "gt.txt", "--out", "/dev/full"), "cannot write /dev/full"),
    "out with NUL": (("--estimate", "gt.txt", "--out", "a\0b"), "cannot write"),
    "scores in the way": (("--estimate", "gt.txt", "--out", "blocked"), "in the way"),
    "figures without out": (("--estimate", "gt.txt", "--figures"), "--out"),
    "tolerance a word": (("--estimate", "gt.txt", "--tolerance", "\x1b[2J"), r"\x1b[2J"),
    "time difference negative": (("--estimate", "gt.txt", "--max-difference-s", "-1"), "above 0"),
    "time difference nan": (("--estimate", "gt.txt", "--max-difference-s", "nan"), "above 0"),
    "lengths falling": (("--estimate", "gt.txt", "--lengths", "20", "10"), "increasing"),
    "lengths nan": (("--estimate", "gt.txt", "--lengths", "nan"), "lengths"),
    "index beyond the truth": (("--groundtruth", "kitti.txt", "--estimate", "index1.txt"), "frames count from 0"),
    "index beyond the times": (
        ("--groundtruth", "kitti.txt", "--estimate", "index1.txt", "--times", "times.txt"),
        "frames count from 0",
    ),
    "one time": (("--groundtruth", "kitti.txt", "--estimate", "kitti.txt", "--times", "one.txt"), "expected 40"),
    "too few times": (("--groundtruth", "kitti.txt", "--estimate", "kitti.txt", "--times", "few.txt"), "expected 40"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gt.txt").write_text(TUM)
    (tmp_path / "still.txt").write_text(STILL)
    tremble = [line.split(" ") for line in STILL.splitlines()]
    (tmp_path / "tremble.txt").write_text(
        "".join(f"{row[0]} {5 + 0.02 * (k % 2)} {' '.join(row[2:])}\n" for k, row in enumerate(tremble))
    )
    (tmp_path / "kitti.txt").write_text(KITTI)
    (tmp_path / "index1.txt").write_text("".join(f"{k + 1} {row}\n" for k, row in enumerate(KITTI.splitlines())))
    (tmp_path / "times.txt").write_text("".join(f"{0.1 * k}\n" for k in K))
    (tmp_path / "one.txt").write_text("0\n")
    (tmp_path / "few.txt").write_text("0\n1\n2\n")
    (tmp_path / "folder").mkdir()
    (tmp_path / "blocked" / "scores.json").mkdir(parents=True)
    (tmp_path / "many").mkdir()
    for name in "ab":
        (tmp_path / "many" / f"{name}.txt").write_text(TUM)
    return tmp_path


def one_line(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    code = cli.main(["evaluate", *arguments])
    output = capsys.readouterr()
    assert code in (1, 2), output
    assert output.out == ""
    assert output.err.count("\n") == 1, output.err
    assert output.err.startswith("mixo: ")
    assert output.err[:-1].isprintable()
    return output.err


def test_there_are_many_faults():
    assert len(FILES) + len(OPTIONS) >= 60


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("fault", FILES)
def test_a_faulty_estimate_is_one_line(folder, capsys, fault):
    content, words = FILES[fault]
    (folder / "bad.txt").write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "replace"))
    error = one_line(capsys, "--groundtruth", "gt.txt", "--estimate", "bad.txt", "--align", "se3")
    assert words in error


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("fault", FILES)
def test_a_faulty_truth_is_one_line_and_nothing_is_written(folder, capsys, fault):
    content, words = FILES[fault]
    (folder / "bad.csv").write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "replace"))
    error = one_line(capsys, "--groundtruth", "bad.csv", "--estimate", "gt.txt", "--out", "results")
    assert words in error
    assert list((folder / "results").iterdir()) == []


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("fault", OPTIONS)
def test_a_faulty_option_is_one_line(folder, capsys, fault):
    arguments, words = OPTIONS[fault]
    truth = () if "--groundtruth" in arguments else ("--groundtruth", "gt.txt")
    assert words in one_line(capsys, *truth, *arguments)


def test_a_full_disk_is_one_line(folder, capsys, monkeypatch):
    def full(*_: object) -> int:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(Path, "write_bytes", full)
    error = one_line(capsys, "--groundtruth", "gt.txt", "--estimate", "gt.txt", "--out", "results")
    assert "No space left" in error
    assert list((folder / "results").iterdir()) == []


def test_an_unwritable_folder_is_noticed_before_files_are_read(folder, capsys):
    error = one_line(capsys, "--groundtruth", "none.txt", "--estimate", "gt.txt", "--out", "still.txt")
    assert "cannot write still.txt" in error


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_one_line(folder, capsys):
    (folder / "folder").chmod(0o500)
    assert "Permission" in one_line(capsys, "--groundtruth", "gt.txt", "--estimate", "gt.txt", "--out", "folder/a")


def test_standard_input_and_pipes_are_read_once(folder, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(TUM.encode())))
    read, write = os.pipe()
    os.write(write, TUM.encode())
    os.close(write)
    (folder / "again.txt").write_text(TUM)
    code = cli.main(["evaluate", "--groundtruth", f"/dev/fd/{read}", "--estimate", "-", "again.txt", "--format", "csv"])
    os.close(read)
    rows = capsys.readouterr().out.splitlines()
    assert code == 0
    assert [row.split(",")[0] for row in rows[1:]] == ["stdin", "again"]


def test_a_method_named_like_a_formula_is_text_in_csv(folder, capsys):
    (folder / "=1+1.txt").write_text(TUM)
    assert cli.main(["evaluate", "--groundtruth", "gt.txt", "--estimate", "=1+1.txt", "--format", "csv"]) == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("'=1+1,1,")


def test_a_scene_name_acts_on_no_terminal(folder, capsys):
    name = "\x1b[31mRED\x1b]0;owned\x07\udcff.txt"
    (folder / name).write_text(TUM)
    arguments = ["evaluate", "--groundtruth", name, "--estimate", name, "--out", "results", "--figures"]
    assert cli.main(arguments) == 0
    output = capsys.readouterr().out
    assert r"\x1b[31mRED\x1b]0;owned\x07\udcff" in output
    assert "\x1b" not in output
    assert "\x1b" not in (folder / "results" / "scores.csv").read_text()


def test_standing_scenes_among_several_are_aligned_without_scale_and_named(folder, capsys):
    for side in ("truths", "estimates"):
        (folder / side).mkdir()
        (folder / side / "drives.txt").write_text(TUM)
        (folder / side / "stands.txt").write_text(STILL)
    code = cli.main(["evaluate", "--groundtruth", "truths", "--estimate", "estimates", "--align", "sim3", "--json"])
    output = capsys.readouterr()
    assert code == 0
    assert output.err == (
        "note: estimates: sim3 has no scale where truth or estimate stands; 1 of 2 scenes are aligned by se3: stands\n"
    )
    assert '"scale": null' in output.out


def test_random_damage_ends_in_a_result_or_an_error(tmp_path):
    outcome = fuzz(600, 1, tmp_path)
    assert outcome.faults == []
    assert outcome.counts["refused"] > 100
    assert outcome.counts["aligned"] > 10
