"""`mixo export`: what the leaderboard scored, as files in which other tools find its numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.policies import registry
from mixo_env.policies.fitting import prepare
from mixo_env.recordings.store import load_recordings
from mixo_env.trajectory import read_trajectory
from tests.odometry_files import import_command, write_set

POLICIES = ("LINEAR", "HUBER")


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording made from three drives of two odometries."""
    root = tmp_path_factory.mktemp("drives")
    folders = write_set(root / "files", {"A": 1e-3, "B": 3e-3}, sequences=3, poses=400)
    assert main(import_command(folders, root / "drives", "--rate", "10", "--leave-one-out")) == 0
    return root / "drives"


@pytest.mark.parametrize("form", ["tum", "kitti"])
def test_evaluate_finds_the_leaderboards_numbers(
    drives: Path, form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "ways"
    assert main(["export", str(drives), "--out", str(out), "--policies", *POLICIES, "--format", form]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["A", "B", "HUBER", "LINEAR", "groundtruth"]
    table = ["benchmark", "--recordings", str(drives), "--policies", "A", "B", *POLICIES, "--out", str(tmp_path / "b")]
    assert main(table) == 0
    capsys.readouterr()
    estimates = [str(out / row) for row in ("A", "B", *POLICIES)]
    assert main(["evaluate", "--groundtruth", str(out / "groundtruth"), "--estimate", *estimates, "--json"]) == 0
    methods = json.loads(capsys.readouterr().out)["methods"]
    board = json.loads((tmp_path / "b" / "leaderboard.json").read_text())
    rows = {row["policy"]: row["scores"]["truth"] for row in board["tracks"]["VISION"]["rows"]}
    assert set(methods) == set(rows) == {"A", "B", *POLICIES}
    for name, score in rows.items():
        pooled = methods[name]["rte"]["pooled"]
        assert pooled["samples"] == score["samples"] > 100
        assert pooled["rotation_deg_per_m"] == pytest.approx(score["rotation_deg_per_m"]["mean"], rel=1e-5)
        assert pooled["translation_percent"] == pytest.approx(score["translation_percent"]["mean"], rel=1e-5)
    assert len({round(score["rotation_deg_per_m"]["mean"], 6) for score in rows.values()}) == 4  # rows do differ


SUREST = """
import numpy as np
from mixo_env.policies.policy import Policy

class First(Policy):
    name = "FIRST"
    def act(self, observation):
        weights = np.zeros(observation["yaw_rates"].shape)
        weights[:, 0] = 1.0
        return weights

def second(observation):
    return np.array([-1.0, 1.0])
"""


def test_policies_from_outside_are_written_as_mixo_score_plays_them(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("first_policy.py").write_text(SUREST)
    recordings = load_recordings(drives)
    linear = registry.create("LINEAR", recordings)
    prepare(linear, recordings.select(folds=[0, 1]), "VISION")
    linear.save(Path("saved"))
    (tmp_path / "HUBER").mkdir()  # of a row's name: the row is meant
    given = ["first_policy.py:First", "first_policy.py:second", "saved", "HUBER"]
    assert main(["export", str(drives), "--out", "refused", "--policies", *given]) == 1
    assert "was fitted on the drive of" in capsys.readouterr().err
    assert main(["export", str(drives), "--out", "ways", "--policies", *given, "--folds", "2"]) == 0
    assert {path.name for path in Path("ways").iterdir()} == {
        *("groundtruth", "A", "B", "FIRST", "second", "LINEAR_saved", "HUBER")
    }
    held_out = [scene.name for scene in recordings.scenes if scene.fold == 2]
    assert [path.stem for path in Path("ways/FIRST").iterdir()] == held_out

    def way(row: str) -> str:
        return Path("ways", row, f"{held_out[0]}.txt").read_text()

    assert way("FIRST") == way("A") != way("B")
    assert main(["export", str(drives), "--out", "rows", "--policies", "LINEAR"]) == 0
    assert way("LINEAR_saved") == Path("rows", "LINEAR", f"{held_out[0]}.txt").read_text()


def test_two_policies_of_one_name_are_one_line(
    drives: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("first_policy.py").write_text(SUREST)
    Path("third_policy.py").write_text(SUREST)
    given = ["first_policy.py:First", "third_policy.py:First"]
    assert main(["export", str(drives), "--out", "ways", "--policies", *given]) == 2
    assert "two of the policies would be written to first" in capsys.readouterr().err
    assert not Path("ways").exists()


def test_an_expert_alone_turns_as_it_was_recorded(drives: Path, tmp_path: Path) -> None:
    assert main(["export", str(drives), "--out", str(tmp_path / "ways")]) == 0
    recordings = load_recordings(drives)
    for scene in recordings.scenes:
        _, _, yaw_rad = read_trajectory(tmp_path / "ways" / "B" / f"{scene.name}.txt").planar()
        recorded = recordings.rows(scene.name)["B.yaw_increment_rad"][1:]
        np.testing.assert_allclose(np.diff(np.unwrap(yaw_rad)), recorded, atol=1e-6)


def test_a_folder_that_holds_something_is_left_alone(
    drives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert main(["export", str(drives), "--out", str(tmp_path)]) == 2
    assert "is not empty: choose another --out" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--policies", "LINAER"], "did you mean 'LINEAR'"),
        (["--policies", "HIGHEST MATCH"], "needs match counts"),
    ],
)
def test_a_row_that_cannot_be_is_one_line(
    drives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    assert main(["export", str(drives), "--out", str(tmp_path / "ways"), *options]) in (1, 2)
    message = capsys.readouterr().err.strip().splitlines()
    assert words in message[-1]
