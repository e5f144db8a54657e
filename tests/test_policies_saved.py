"""Saved folders of classes that are not of this package, and `mixo score` from its command line to its file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import mixo_env
from mixo_env.cli.main import main
from mixo_env.errors import PolicyError
from mixo_env.leaderboard.stranger import Options
from mixo_env.policies import registry
from mixo_env.policies.fitting import prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.single import Single
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings
from tests.test_policies_outside import distribution
from tests.test_policies_sb3 import WAYS, hostile

STRANGER = """
from pathlib import Path
import numpy as np
from mixo_env.policies.policy import Policy

Path("imported").touch()


class Constant(Policy):
    name = "CONSTANT"
    learns = True
    {expensive}

    def fit(self, training, track, *, seed=0):
        super().fit(training, track, seed=seed)
        self.weights = np.full(len(self.experts), 1.0 / len(self.experts))

    def act(self, observation):
        return np.tile(self.weights, (len(observation["yaw_rates"]), 1))

    def tensors(self):
        return {{"weights": self.weights}}

    def restore(self, tensors):
        self.weights = tensors["weights"]


def equal(observation):
    return np.zeros(4, np.float32)
"""


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(0, scenes=4, steps=80)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, recordings: Recordings) -> None:
    """An empty folder with small recordings and a stranger's file, and no slow row beside it."""
    monkeypatch.setattr("mixo_env.leaderboard.stranger.BESIDE", ("CAM_FRONT", "LINEAR"))
    monkeypatch.chdir(tmp_path)
    save_recordings(recordings, tmp_path / "small")
    (tmp_path / "strange.py").write_text(STRANGER.format(expensive=""), encoding="utf-8")
    (tmp_path / "slow.py").write_text(STRANGER.format(expensive="expensive = True"), encoding="utf-8")


def score(*arguments: str) -> int:
    return main(["score", *arguments, "--recordings", "small"])


def fitted(policy: Policy, recordings: Recordings, folder: Path) -> Policy:
    prepare(policy, recordings.select(folds=[0, 1, 2]), "VISION")
    policy.save(folder)
    return policy


class Own(Policy):
    """Has tensors, and no shapes."""

    name = "OWN"
    learns = True

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        super().fit(training, track, seed=seed)
        self.gains = np.arange(3.0)

    def act(self, observation: Observation) -> Weights:
        return np.full(observation["yaw_rates"].shape, 1.0 / observation["yaw_rates"].shape[1])

    def tensors(self) -> dict[str, NDArray[Any]]:
        return {"gains": self.gains}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        self.gains = tensors["gains"]


class Forgetful(Own):
    name = "FORGETFUL"
    restore = Policy.restore


class Clumsy(Own):
    name = "CLUMSY"

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        assert not tensors, "two\nlines"


def test_a_class_without_shapes_saves_and_loads(recordings: Recordings, tmp_path: Path) -> None:
    fitted(Own(), recordings, tmp_path / "own")
    np.testing.assert_array_equal(Own.load(tmp_path / "own").gains, [0, 1, 2])
    scored = mixo_env.score(tmp_path / "own", recordings, folds=[3], options=Options(policy_class=f"{__name__}:Own"))
    assert scored.name == "OWN (saved)"
    for kind, message in ((Forgetful, "no `restore`"), (Clumsy, "two lines")):
        fitted(kind(), recordings, tmp_path / kind.name)
        with pytest.raises(PolicyError, match=message):
            kind.load(tmp_path / kind.name)


def test_a_class_is_imported_only_when_it_is_named(
    recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fitted(Own(), recordings, tmp_path / "own")
    data = (tmp_path / "own/policy.safetensors").read_bytes()
    old, new = (f"{__name__}:Own".encode(), b"strange:Constant".ljust(len(f"{__name__}:Own")))
    (tmp_path / "own/policy.safetensors").write_bytes(data.replace(old, new))
    assert score("own", "--folds", "3") == 1
    error = capsys.readouterr().err.strip()
    assert "\n" not in error
    assert "was saved by strange:Constant" in error
    assert "--policy-class module:Class" in error
    assert not (tmp_path / "imported").exists()


def test_a_file_of_a_stranger_reads_what_it_saved(
    recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import runpy

    kind = runpy.run_path("strange.py", run_name="strange")["Constant"]
    fitted(kind(), recordings, tmp_path / "saved")
    assert score("saved", "--folds", "3", "--policy-class", "strange.py:Constant") == 0
    assert "CONSTANT (saved) - LINEAR: " in capsys.readouterr().out
    assert score("saved", "--folds", "3", "--policy-class", "strange.py:equal") == 1
    assert "expected a subclass of Policy" in capsys.readouterr().err


def test_a_plug_in_is_loaded_by_its_name(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distribution(tmp_path, {"SUREST": "tiny_policies:Surest"})
    monkeypatch.syspath_prepend(str(tmp_path))
    fitted(registry.create("SUREST", recordings), recordings, tmp_path / "saved")
    assert registry.load(tmp_path / "saved").name == "SUREST"


def test_a_saved_expert_without_a_vote_is_shown(recordings: Recordings, tmp_path: Path) -> None:
    fitted(Single("INERTIAL"), recordings, tmp_path / "saved")
    scored = mixo_env.score(tmp_path / "saved", recordings)
    (row,) = (r for r in scored.board.standings[0].rows if r.name == "INERTIAL (saved)")
    alone = synthetic_single(recordings)
    np.testing.assert_array_equal(row.run.travel.yaw_increment_rad, alone)


def synthetic_single(recordings: Recordings) -> NDArray[np.float64]:
    from mixo_env.leaderboard.crossvalidation import CrossValidation

    return CrossValidation(recordings).run("INERTIAL", "VISION").travel.yaw_increment_rad


def network(path: Path) -> None:
    """A PPO of the environment's spaces, as SB3 saves it."""
    import gymnasium as gym
    from stable_baselines3 import PPO

    env = gym.make("mixo_env:MixoOdometry-v0", recordings="small", track="VISION", observation="paper")
    PPO("MlpPolicy", env, policy_kwargs={"net_arch": [4]}, seed=0, device="cpu").save(path)


def test_training_drives_are_checked_before_anything_is_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    network(tmp_path / "net.zip")
    monkeypatch.setattr("mixo_env.leaderboard.stranger.build", lambda *a, **k: pytest.fail("rows were computed"))
    assert score("net.zip", "--fitted-on", "train") == 1
    error = capsys.readouterr().err.strip()
    assert "was fitted on the drive of" in error
    assert "\n" not in error


def test_a_zip_from_the_command_line_to_the_file(
    recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    network(tmp_path / "net.zip")
    (tmp_path / "drives.txt").write_text("\n".join(s.name for s in recordings.scenes if s.fold == 0), encoding="utf-8")
    options = ("net.zip", "--fitted-on", "drives.txt")
    assert score(*options) == 1
    assert "was fitted on the drive of" in capsys.readouterr().err
    assert score(*options, "--folds", "1", "2", "3", "--out", "out") == 0
    printed = capsys.readouterr().out
    assert "net (zip) - LINEAR: " in printed
    assert "[" in next(line for line in printed.splitlines() if "net (zip)" in line)
    saved = json.loads((tmp_path / "out/score.json").read_text(encoding="utf-8"))
    assert saved["policy"] == "net (zip)"
    assert saved["configuration"]["fitted_on"] == "drives.txt"
    assert saved["data_version"] == recordings.manifest.data_version
    assert saved["scenes"] == [scene.name for scene in recordings.scenes if scene.fold in (1, 2, 3)]
    table = saved["tracks"]["VISION"]
    assert [row["policy"] for row in table["rows"]] == ["CAM_FRONT", "LINEAR", "net (zip)"]
    assert [(c["first"], c["second"]) for c in saved["differences"]] == [
        ("net (zip)", n) for n in ("CAM_FRONT", "LINEAR")
    ]
    mean, low, high = (saved["differences"][1]["difference"][key] for key in ("mean", "low", "high"))
    assert low < mean < high
    assert f"net (zip) - LINEAR: {mean:+.5f} deg/m [{low:+.5f}, {high:+.5f}]" in printed
    assert score(*options[:2], "missing.txt") == 2
    assert "--fitted-on: expected none, train or a file" in capsys.readouterr().err


@pytest.mark.parametrize("way", WAYS)
def test_a_hostile_zip_is_one_line_and_runs_nothing(
    tmp_path: Path, way: str, capsys: pytest.CaptureFixture[str]
) -> None:
    network(tmp_path / "net.zip")
    hostile(tmp_path, tmp_path / "net.zip", way)
    assert score("net.zip", "--fitted-on", "none") == 1
    assert "\n" not in capsys.readouterr().err.strip()
    assert not (tmp_path / "ran").exists()


def test_functions_and_expensive_classes_of_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert score("strange.py:equal") == 0
    assert "equal - LINEAR: " in capsys.readouterr().out
    assert score("slow.py:Constant", "--out", "slow") == 0
    assert score("strange.py:Constant", "--out", "quick") == 0
    folds = []
    for name in ("slow", "quick"):
        scored = json.loads((tmp_path / name / "score.json").read_text(encoding="utf-8"))
        folds.append(len(scored["scenes"]))
    assert folds == [1, 4]


def test_linear_keeps_its_shapes() -> None:
    assert Policy.shapes(Single("INERTIAL"), 0) == {}
    assert Policy.shapes(Linear(), 0) is None
