"""``mixo evaluate`` as a user runs it: output forms, files written, exit codes, one line per error."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from mixo_env.cli import main as cli
from mixo_env.trajectory import Trajectory, write_kitti, write_tum
from tests.trajectories import (
    disturbed,
    drive,
    literal_angle_deg,
    literal_error,
    literal_pairs,
    literal_path,
    literal_rpg_pairs,
)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Ground truth, two estimates and a KITTI version of one scene, and two folders of scenes."""
    rng = np.random.default_rng(0)
    truth = drive(rng, 200)
    write_tum(tmp_path / "gt.txt", truth)
    write_tum(tmp_path / "orb.txt", disturbed(rng, truth))
    write_tum(tmp_path / "mixo.txt", disturbed(rng, truth, scale=1.01))
    write_kitti(tmp_path / "gt_kitti.txt", truth)
    for folder in ("truths", "estimates"):
        (tmp_path / folder).mkdir()
    for k in range(3):
        scene = drive(rng, 60)
        write_tum(tmp_path / "truths" / f"scene-{k}.txt", scene)
        write_tum(tmp_path / "estimates" / f"scene-{k}.txt", disturbed(rng, scene))
    return tmp_path


def evaluate(*arguments: str | Path) -> int:
    return cli.main(["evaluate", *map(str, arguments)])


def scores(capsys, *arguments: str | Path) -> dict:
    assert evaluate(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_json_holds_every_statistic_of_the_definition(files, capsys):
    numbers = scores(capsys, "--groundtruth", files / "gt.txt", "--estimate", files / "orb.txt", "--lengths", 10, 30)
    method = numbers["methods"]["orb"]
    truth, estimate = (np.loadtxt(files / name) for name in ("gt.txt", "orb.txt"))
    error = np.linalg.norm(truth[:, 1:4] - estimate[:, 1:4], axis=1)
    ate = method["scenes"]["gt"]["ate"]["translation_m"]
    expected = (np.sqrt(np.mean(error**2)), error.mean(), np.median(error), error.std(), error.max())
    assert [ate[key] for key in ("rmse", "mean", "median", "std", "max")] == pytest.approx(expected)
    g, e = as_matrices(truth), as_matrices(estimate)
    angle = [literal_angle_deg(a[:3, :3] @ b[:3, :3].T) for a, b in zip(e, g, strict=True)]
    assert method["scenes"]["gt"]["ate"]["rotation_deg"]["mean"] == pytest.approx(np.mean(angle))
    percent, per_metre = [], []
    distance = literal_path(truth[:, 1:4])
    for length in (10.0, 30.0):
        errors = [literal_error(g, e, i, j) for i, j in literal_pairs(distance, length)]
        percent += [100 * translation / length for translation, _ in errors]
        per_metre += [rotation / length for _, rotation in errors]
    pooled = method["rte"]["pooled"]
    assert pooled["samples"] == len(percent)
    assert pooled["translation_percent"] == pytest.approx(np.mean(percent), abs=1e-9)
    assert pooled["rotation_deg_per_m"] == pytest.approx(np.mean(per_metre), abs=1e-9)
    assert numbers["convention"]["pair_rule"]["lengths_m"] == [10.0, 30.0]
    assert method["kitti"]["t_rel_percent"] is not None
    i, j = 0, len(truth) - 1
    drift = literal_error(g, e, i, j)[0] / distance[-1]
    assert method["end_drift"]["translation_percent"] == pytest.approx(100 * drift)


def as_matrices(rows: np.ndarray) -> np.ndarray:
    quaternions = np.roll(rows[:, 4:8], 1, axis=1)
    return Trajectory(rows[:, 1:4], quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).matrices()


def test_rpg_pairs_and_tolerance_reach_the_scores(files, capsys):
    distance = literal_path(np.loadtxt(files / "gt.txt")[:, 1:4])
    base = ("--groundtruth", files / "gt.txt", "--estimate", files / "orb.txt", "--lengths", "10", "100")
    for extra, pairs in (
        (("--pairs", "rpg"), lambda length: literal_rpg_pairs(distance, length)),
        (("--tolerance", "0.2"), lambda length: literal_pairs(distance, length, 0.2)),
        (("--min-start-spacing-m", "0"), lambda length: literal_pairs(distance, length, "step", 0.0)),
    ):
        per_length = scores(capsys, *base, *extra)["methods"]["orb"]["rte"]["per_length"]
        assert [entry["samples"] for entry in per_length] == [len(pairs(10.0)), len(pairs(100.0))]


def test_several_estimates_in_every_form(files, capsys):
    base = ("--groundtruth", files / "gt.txt", "--estimate", files / "orb.txt", files / "mixo.txt")
    assert evaluate(*base) == 0
    text = capsys.readouterr().out
    assert "no alignment" in text
    assert "orb" in text
    assert evaluate(*base, "--format", "csv") == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [row["Method"] for row in rows] == ["orb", "mixo"]
    numbers = scores(capsys, *base)["methods"]
    assert float(rows[1]["RTE [%]"]) == numbers["mixo"]["rte"]["pooled"]["translation_percent"]
    assert evaluate(*base, "--format", "markdown") == 0
    assert "| orb |" in capsys.readouterr().out
    assert evaluate(*base, "--format", "latex", "--align", "sim3") == 0
    latex = capsys.readouterr().out
    assert r"\toprule" in latex
    assert r"RTE [\%]" in latex


def test_alignment_lowers_the_error_and_is_saved(files, capsys):
    base = ("--groundtruth", files / "gt.txt", "--estimate", files / "mixo.txt")
    found = [scores(capsys, *base, "--align", align) for align in ("none", "posyaw", "se3", "sim3")]
    ates = [one["methods"]["mixo"]["ate_over_scenes"]["translation_m"]["mean"] for one in found]
    assert ates == sorted(ates, reverse=True)
    assert found[3]["methods"]["mixo"]["scenes"]["gt"]["scale"] == pytest.approx(1 / 1.01, rel=0.02)
    assert found[3]["convention"]["align"] == "sim3"


def test_folders_of_scenes(files, capsys):
    base = ("--groundtruth", files / "truths", "--estimate", files / "estimates")
    method = scores(capsys, *base)["methods"]["estimates"]
    assert list(method["scenes"]) == ["scene-0", "scene-1", "scene-2"]
    scene_ates = [scene["ate"]["translation_m"]["rmse"] for scene in method["scenes"].values()]
    assert method["ate_over_scenes"]["translation_m"]["mean"] == pytest.approx(np.mean(scene_ates))
    parts = [
        scores(
            capsys, "--groundtruth", files / f"truths/scene-{k}.txt", "--estimate", files / f"estimates/scene-{k}.txt"
        )
        for k in range(3)
    ]
    pooled = [next(iter(part["methods"].values()))["rte"]["pooled"] for part in parts]
    weights = [part["samples"] for part in pooled]
    means = [part["translation_percent"] for part in pooled]
    assert method["rte"]["pooled"]["samples"] == sum(weights)
    assert method["rte"]["pooled"]["translation_percent"] == pytest.approx(np.average(means, weights=weights))


def test_out_folder_holds_every_form(files, capsys, tmp_path):
    out = tmp_path / "out"
    estimates = ("--estimate", files / "orb.txt", files / "mixo.txt")
    assert evaluate("--groundtruth", files / "gt.txt", *estimates, "--out", out, "--figures") == 0
    names = {path.name for path in out.iterdir()}
    assert {"scores.json", "scores.csv", "lengths.csv", "scenes.csv", "scores.md", "scores.tex"} <= names
    assert {"top_view", "rte_by_length.png", "ate_by_scene.png", "error_by_distance.png"} <= names
    assert not [name for name in names if name.startswith(".")]
    with zipfile.ZipFile(out / "evo" / "orb.zip") as archive:
        assert {"info.json", "stats.json", "error_array.npy", "timestamps.npy"} <= set(archive.namelist())
        rmse = json.loads(archive.read("stats.json"))["rmse"]
    saved = json.loads((out / "scores.json").read_text())
    assert saved["methods"]["orb"]["scenes"]["gt"]["ate"]["translation_m"]["rmse"] == rmse


def test_a_standing_scene_has_an_ate_and_no_rte(tmp_path, capsys):
    still = Trajectory(np.zeros((30, 3)), np.tile([1.0, 0, 0, 0], (30, 1)), np.arange(30.0))
    write_tum(tmp_path / "gt.txt", still)
    write_tum(
        tmp_path / "est.txt",
        Trajectory(still.positions_m + np.array([0.3, 0, 0.4]), still.quaternions_wxyz, still.timestamps_s),
    )
    base = ("--groundtruth", tmp_path / "gt.txt", "--estimate", tmp_path / "est.txt")
    method = scores(capsys, *base)["methods"]["est"]
    assert method["ate_over_scenes"]["translation_m"]["mean"] == pytest.approx(0.5)
    assert method["rte"]["pooled"] == {
        "translation_percent": None,
        "rotation_deg_per_m": None,
        "samples": 0,
        "scenes": 0,
    }
    assert evaluate(*base) == 0
    assert " - " in capsys.readouterr().out


def test_an_estimate_in_its_own_frame_is_pointed_out(files, tmp_path, capsys):
    truth = drive(np.random.default_rng(0), 200)
    away = Trajectory(truth.positions_m + 100.0, truth.quaternions_wxyz, truth.timestamps_s)
    write_tum(tmp_path / "away.txt", away)
    assert evaluate("--groundtruth", files / "gt.txt", "--estimate", tmp_path / "away.txt") == 0
    assert "--align se3 --align-poses 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--groundtruth", "gt.txt", "--estimate", "none.txt"), 1, "found nothing there"),
        (("--groundtruth", "gt.txt", "--estimate", "gt_kitti.txt"), 1, "has none"),
        (("--groundtruth", "gt.txt", "--estimate", "bad.txt"), 1, "bad.txt, line 2: expected finite numbers"),
        (("--groundtruth", "gt.txt", "--estimate", "later.txt"), 1, "do not overlap"),
        (("--groundtruth", "truths", "--estimate", "orb.txt"), 1, "missing"),
        (("--groundtruth", "gt.txt", "--estimate", "orb.txt", "--tolerance", "loose"), 2, "step or a number"),
        (("--groundtruth", "gt.txt", "--estimate", "orb.txt", "--lengths", "20", "10"), 2, "increasing path lengths"),
        (("--groundtruth", "gt.txt", "--estimate", "orb.txt", "orb.txt"), 2, "given twice"),
        (("--groundtruth", "gt.txt", "--estimate", "orb.txt", "--figures"), 2, "--out"),
        (("--groundtruth", "gt.txt", "--estimate", "orb.txt", "--align", "sim3", "--align-poses", "1"), 2, "aligns on"),
        (("--groundtruth", "gt.txt", "--estimate", "orb.txt", "--max-difference-s", "0"), 2, "above 0"),
    ],
)
def test_errors_are_one_line_with_the_right_exit_code(files, capsys, monkeypatch, arguments, code, words):
    monkeypatch.chdir(files)
    Path("bad.txt").write_text("0 0 0 0 0 0 0 1\n1 nan 0 0 0 0 0 1\n")
    write_tum(Path("later.txt"), Trajectory(np.zeros((5, 3)), np.tile([1.0, 0, 0, 0], (5, 1)), 9e3 + np.arange(5.0)))
    assert evaluate(*arguments) == code
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_the_installed_command_runs(files):
    arguments = ["evaluate", "--groundtruth", files / "gt.txt", "--estimate", files / "orb.txt", "--json"]
    run = subprocess.run(
        [sys.executable, "-m", "mixo_env.cli.main", *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout)["methods"]["orb"]["poses"] == 200
