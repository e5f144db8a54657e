"""The scripts around the environments, run as a user runs them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs._pages.episode_gif import EpisodeGif
from experiments.budget import BudgetStudy
from experiments.budget_contexts import Steps, outcome
from experiments.budget_contexts import main as contexts
from mixo_env.envs import rendering
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings")
    save_recordings(synthetic_recordings(scenes=4, steps=30), path)
    return path


def test_budget_study(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study = BudgetStudy(folder, out=tmp_path / "budget.png", ppo_steps=0)
    assert study.run() == 0
    rows = (line.rsplit(maxsplit=6) for line in capsys.readouterr().out.splitlines())
    cost = {row[0].partition(": ")[2]: float(row[1]) for row in rows if row and ": " in row[0]}
    assert cost["no camera"] == 0.0
    assert 3 * cost["CAM_FRONT"] < cost["all cameras"] <= 80.0
    assert cost["best 2 above 5.7 deg/s"] < cost["best 2 above 0.6 deg/s"] < cost["best 2"]
    assert (tmp_path / "budget.png").stat().st_size > 10_000


def test_episode_gif(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    written: list[str] = []
    plainly = rendering.write

    def noted(canvas: rendering.Image, text: str, *place: Any) -> None:
        written.append(text)
        plainly(canvas, text, *place)

    monkeypatch.setattr(rendering, "write", noted)
    out = tmp_path / "episode.gif"
    script = EpisodeGif(out, recordings=folder, scene="scene-2004", policy="LINEAR", every=10, width=320)
    assert script.run() == 0
    with Image.open(out) as picture:
        assert picture.size == (320, 180)
        frames = picture.n_frames  # type: ignore[attr-defined]
    assert 3 <= frames <= 5
    assert written.count("weights of LINEAR") == frames


def test_cells_choose_on_training_steps_and_the_clairvoyant_on_test_steps() -> None:
    calm, wild = np.array([[0.1, 0.0]]), np.array([[5.0, 1.0]])  # loss without and with the camera
    cells = np.array([0] * 200 + [1] * 200)
    training = Steps(np.concatenate([calm.repeat(200, 0), wild.repeat(200, 0)]), cells)
    test = Steps(np.array([[0.3, 0.0], [4.0, 1.0], [0.0, 1.0]]), np.array([0, 1, 1]))
    found = outcome(training, test, np.array([0.0, 0.5]))
    assert found.constant == pytest.approx(-(0.5 + 1.5 + 1.5) / 3)  # the camera earns its price over all
    assert found.by_cell == pytest.approx(-(0.3 + 1.5 + 1.5) / 3)
    assert found.clairvoyant == pytest.approx(-(0.3 + 1.5 + 0.0) / 3)
    assert found.changed == pytest.approx(1 / 3)


def test_the_study_of_contexts_prints_three_prices(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert contexts(["--recordings", str(folder), "--tracks", "CONSUMER"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("CONSUMER")]
    assert [row[1] for row in rows] == ["0.003", "0.010", "0.030"]
    for row in rows:
        constant, _, clairvoyant = map(float, row[2:5])
        assert constant <= clairvoyant <= 0.0
