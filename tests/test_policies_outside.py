"""Anyone's policy gets a row: classes, functions, saved folders, installed plug-ins, and the page that says how."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mixo_env
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.leaderboard.board import build
from mixo_env.leaderboard.stranger import Options
from mixo_env.policies import registry
from mixo_env.policies.agent import Asking
from mixo_env.policies.fitting import prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(0, scenes=4, steps=80)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """MIXO takes long to fit and is not needed here."""
    monkeypatch.setattr("mixo_env.leaderboard.stranger.BESIDE", ("CAM_FRONT", "LINEAR", "HUBER"))


class Equal(Policy):
    name = "EQUAL"

    def act(self, observation: Observation) -> Weights:
        return np.full(observation["yaw_rates"].shape, 1.0 / observation["yaw_rates"].shape[1])


class Relearnt(Linear):
    name = "RELEARNT"


def increments(scored: object) -> np.ndarray:
    return scored.row.run.travel.yaw_increment_rad  # type: ignore[attr-defined]


def test_a_class_that_learns_is_fitted_fold_by_fold_like_the_row_beside_it(recordings: Recordings) -> None:
    scored = mixo_env.score(Relearnt, recordings)
    linear = next(row for row in scored.board.standings[0].rows if row.name == "LINEAR")
    np.testing.assert_array_equal(increments(scored), linear.run.travel.yaw_increment_rad)
    assert set(scored.row.run.policies) == {0, 1, 2, 3}
    assert [c.second for c in scored.differences] == ["CAM_FRONT", "LINEAR", "HUBER"]
    assert scored.differences[1].difference.mean == 0.0


@pytest.mark.parametrize("observation", ["paper", "rich", "dict"])
def test_a_function_of_one_scene_and_of_all_are_the_equal_weights_they_mean(
    recordings: Recordings, observation: str
) -> None:
    def one(seen: object) -> np.ndarray:
        assert isinstance(seen, dict) == (observation == "dict")
        return np.zeros(4, np.float32)

    def every(seen: object) -> np.ndarray:
        first = next(iter(seen.values())) if isinstance(seen, dict) else seen
        return np.zeros((len(first), 4), np.float32)  # type: ignore[arg-type]

    expected = increments(mixo_env.score(Equal(), recordings))
    for function, vectorised in ((one, False), (every, True)):
        asking = Asking(observation=observation, vectorised=vectorised)  # type: ignore[arg-type]
        np.testing.assert_allclose(increments(mixo_env.score(function, recordings, options=Options(asking))), expected)


def test_frozen_policies_are_refused_on_their_own_training_drives(recordings: Recordings, tmp_path: Path) -> None:
    policy = Linear()
    prepare(policy, recordings.select(folds=[0, 1, 2]), "VISION")
    policy.save(tmp_path)
    assert mixo_env.score(tmp_path, recordings, folds=[3]).name == "LINEAR (saved)"
    with pytest.raises(PolicyError, match="was fitted on the drive of"):
        mixo_env.score(tmp_path, recordings)
    for fitted_on in ("train", recordings.select(folds=[1]), [recordings.scenes[1].name]):
        with pytest.raises(PolicyError, match="one was fitted on the drive of"):
            mixo_env.score(one, recordings, fitted_on=fitted_on)


def one(seen: np.ndarray) -> np.ndarray:
    return np.zeros(4, np.float32)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ("nothing", ConfigurationError, "found none of these"),
        ("no_module_of_mine:X", PolicyError, "cannot be imported"),
        (int, PolicyError, "expected a subclass of Policy"),
        (3, PolicyError, "expected a policy, its class or a function, got int"),
        (Linear, PolicyError, "is the name of a row"),
        (lambda seen: seen[9999], PolicyError, "failed when asked"),
        (lambda seen: np.zeros(3, np.float32), PolicyError, "expected shape"),
        (lambda seen: np.full(4, np.nan, np.float32), PolicyError, "expected numbers in"),
    ],
)
def test_what_is_no_policy_is_one_line(recordings: Recordings, given: object, error: type, message: str) -> None:
    with pytest.raises(error, match=message) as raised:
        mixo_env.score(given, recordings)
    assert "\n" not in str(raised.value)


def distribution(folder: Path, points: dict[str, str]) -> None:
    """An installed distribution of a tiny module."""
    (folder / "tiny_policies.py").write_text((ROOT / "examples/own_policy.py").read_text(encoding="utf-8"))
    info = folder / "tiny_policies-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tiny-policies\nVersion: 1.0\n")
    lines = "\n".join(f"{name} = {target}" for name, target in points.items())
    (info / "entry_points.txt").write_text(f"[mixo_env.policies]\n{lines}\n")


def test_rows_of_an_installed_distribution_and_broken_ones(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    points = {"SUREST": "tiny_policies:Surest", "BROKEN": "tiny_policies:Nothing", "LINEAR": "tiny_policies:Surest"}
    distribution(tmp_path, points | {"OTHER": "tiny_policies:Surest"})
    monkeypatch.syspath_prepend(str(tmp_path))
    assert registry.names(recordings)[-3:] == ("SUREST", "BROKEN", "OTHER")
    assert "distribution tiny-policies: the name LINEAR is taken" in caplog.text
    assert isinstance(registry.create("LINEAR", recordings), Linear)
    board = build(recordings, tracks=("VISION",), policies=("surest", "linear"))
    assert [row.name for row in board.standings[0].rows] == ["LINEAR", "SUREST"]
    for name in ("BROKEN", "OTHER"):
        with pytest.raises(PolicyError, match=f"distribution tiny-policies, policy {name}: "):
            build(recordings, tracks=("VISION",), policies=(name,))


def run(*command: str, cwd: Path) -> str:
    done = subprocess.run(
        command, cwd=cwd, env=os.environ | {"PYTHONPATH": f"{ROOT}:{cwd}"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_mixo_benchmark_shows_the_row_of_a_plug_in(recordings: Recordings, tmp_path: Path) -> None:
    distribution(tmp_path, {"SUREST": "tiny_policies:Surest"})
    save_recordings(recordings, tmp_path / "small")
    options = ("--recordings", "small", "--tracks", "VISION", "--policies", "SUREST")
    assert "SUREST" in run(sys.executable, "-m", "mixo_env.cli.main", "benchmark", *options, cwd=tmp_path)


@pytest.mark.site
def test_the_ten_lines_of_the_page_give_a_row(tmp_path: Path) -> None:
    page = (ROOT / "docs/policies.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (command,) = re.findall(r"```console\n\$ mixo (.*?)\n```", page, re.DOTALL)
    (tmp_path / "my_policy.py").write_text(code, encoding="utf-8")
    out = run(sys.executable, "-m", "mixo_env.cli.main", *command.split(), cwd=tmp_path)
    assert "SUREST - MIXO: " in out


@pytest.mark.site
def test_the_example_runs(tmp_path: Path) -> None:
    (tmp_path / "own_policy.py").write_text((ROOT / "examples/own_policy.py").read_text(encoding="utf-8"))
    printed = run(sys.executable, "own_policy.py", cwd=tmp_path)
    assert "SUREST - LINEAR: " in printed
    assert {"SUREST", "CAM_FRONT", "LINEAR", "HUBER", "MIXO"} <= {line.split("  ")[0] for line in printed.splitlines()}
