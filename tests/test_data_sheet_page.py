"""The data sheet as a whole: of a tiny simulated folder, and the one in docs/."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from docs._pages.data_sheet.__main__ import MEASURED, PAGE, STUDY
from docs._pages.data_sheet.folder import City, open_city
from docs._pages.data_sheet.measured import measure
from docs._pages.data_sheet.motion import recorded_paths
from docs._pages.data_sheet.page import FIGURES, page
from docs._pages.data_sheet.real import load_real
from docs._pages.data_sheet.samples import draw_motion
from experiments import stored_figures as stored
from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.recordings.collection import Recordings
from mixo_env.simulator.config import SimulationConfig, SituationShares
from mixo_env.simulator.dataset import simulate
from mixo_env.simulator.drive import scenes as simulator_scenes
from tests.bundle import bundled
from tests.synthetic import synthetic_recordings

DOCS = Path(__file__).parent.parent / "docs"

CAMERAS = ("CAM_FRONT", "CAM_BACK")


@pytest.fixture(scope="module")
def city(tmp_path_factory: pytest.TempPathFactory) -> City:
    """Two fast drives behind a truck, with noise for pictures that slides sideways from image to image."""
    root = tmp_path_factory.mktemp("city")
    situations = SituationShares(**dict.fromkeys(SituationShares().by_name(), 0.0) | {"lead_truck": 0.5})
    config = SimulationConfig(
        scenes=2, scenes_per_log=1, seconds=4, width=320, height=180, cameras=CAMERAS, images=False, night=0.0,
        rain=0.5, situations=situations,
    )  # fmt: skip
    simulate(config, root)
    found = open_city(root)
    rough = np.random.default_rng(0).integers(0, 256, (45, 400)).astype(np.uint8)
    texture = cv2.resize(rough, (1600, 180), interpolation=cv2.INTER_CUBIC)
    for _, plan in found.scenes():
        for channel in CAMERAS:
            for number, path in enumerate(found.dataset.reel(plan.name, channel).image_paths):
                path.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(path), texture[:, 4 * number : 4 * number + 320])
    return found


@pytest.fixture(scope="module")
def measured(city: City, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("docs")
    found = measure(city, folder / FIGURES, strip=False, told=lambda _: None)
    stored.save(folder / MEASURED, found)
    for file in found["samples"]:
        assert cv2.imread(str(folder / FIGURES / file)) is not None
    return stored.load(folder / MEASURED)


@pytest.fixture(scope="module")
def recordings(city: City) -> Recordings:
    """Random recordings that claim to be of the folder's scenes."""
    made = synthetic_recordings(0, steps=60)
    scenes = [(log, plan) for log, plan in city.scenes()]
    made = made.select(scenes=[entry.name for entry in made.scenes[: len(scenes)]])
    entries = [
        replace(entry, name=plan.name, log=log.logfile) for entry, (log, plan) in zip(made.scenes, scenes, strict=True)
    ]
    return made.replace(manifest=replace(made.manifest, scenes=tuple(entries)))


def test_what_is_measured_in_a_folder(city: City, measured: dict[str, Any]):
    assert measured["configuration"]["scenes"] == 2
    assert sorted(measured["situations"].values()) == ["lead_truck", "ordinary"]
    assert {"lead_truck.jpg", "ordinary.jpg", "rain.jpg"} <= set(measured["samples"])
    assert set(measured["covered"]) == set(CAMERAS)
    assert measured["covered"]["CAM_FRONT"] > 0.02  # half of all scenes follow a truck
    assert [log["log"] for log in measured["logs"]] == [log.logfile for log in city.logs]
    assert measured["movers"]["CAM_FRONT"]["pairs"] > 0
    assert 0.0 <= measured["movers"]["CAM_FRONT"]["inliers"] <= 1.0


def test_page_of_a_tiny_folder(recordings: Recordings, measured: dict[str, Any], tmp_path: Path):
    text = page(recordings, measured, load_real(), None)
    assert text == page(recordings, measured, load_real(), None)
    for heading in ("How it was made", "What it looks like", "Beside real data", "Known differences", "No thumb"):
        assert f"## {heading}" in text
    assert "nan" not in text
    assert "has not been run" in text
    for name in measured["situations"]:
        assert name in text
    draw_motion(recorded_paths(recordings), load_real()["motion"], tmp_path / "motion.png")
    assert cv2.imread(str(tmp_path / "motion.png")) is not None


def test_page_refuses_recordings_of_another_folder(measured: dict[str, Any]):
    with pytest.raises(ConfigurationError, match="--images"):
        page(synthetic_recordings(1, steps=60), measured, load_real(), None)


def test_page_states_the_study(recordings: Recordings, measured: dict[str, Any]):
    tau = {"0": {"mean": -1.0, "lowest": -1.0}, "1": {"mean": 1.0, "lowest": 1.0}}
    study = {
        "values_hashes": [scene.values_hash for scene in recordings.scenes],
        "draws": 3,
        "scenes": 47,
        "of_scenes": 96,
        "staged": {"0": 0, "1": 20},
        "scores": {"CONSUMER": {"rotation_deg_per_m": {"0": {"A": 0.2, "B": 0.1}, "1": {"A": 0.1, "B": 0.2}}}},
        "ranks": {"CONSUMER": {"rotation_deg_per_m": {"0": {"A": 2.0, "B": 1.0}, "1": {"A": 1.0, "B": 2.0}}}},
        "tau": {"CONSUMER": {"rotation_deg_per_m": tau}},
        "chance": {"CONSUMER": {"rotation_deg_per_m": {"mean": 0.8, "lowest": 0.3}}},
    }
    text = page(recordings, measured, load_real(), study)
    assert "| CONSUMER | RTE deg/m | -1.00 (-1.00) | 0.80 (0.30) |" in text
    assert "in 0 of 1 orders" in text
    assert "* CONSUMER: x 0 B, x 1 A" in text
    assert "in 1 beyond it; lowest mean tau -1.00" in text
    assert "| A | 2.0 (0.2000) | 1.0 (0.1000) |" in text
    assert text.index("| A | 2.0") < text.index("| B | 1.0")
    assert "has not been run" in page(recordings, measured, load_real(), study | {"values_hashes": ["others"]})


def test_a_folder_of_another_simulator_is_refused(city: City, monkeypatch: pytest.MonkeyPatch):
    log, plan = next(city.scenes())
    city.drive_again(log, plan)
    drive = simulator_scenes.scene_drive

    def elsewhere(*arguments: Any) -> Any:
        moved = copy.copy(drive(*arguments))
        object.__setattr__(moved, "x_m", moved.x_m + 1.0)
        return moved

    monkeypatch.setattr(simulator_scenes, "scene_drive", elsewhere)
    with pytest.raises(DatasetError, match="another version"):
        city.drive_again(log, plan)


def test_a_folder_of_something_else_is_refused(tmp_path: Path):
    with pytest.raises(DatasetError, match="mixo simulate"):
        open_city(tmp_path)


def test_the_page_in_docs_is_that_of_the_bundled_recordings():
    """After new recordings or another wording: python -m docs._pages.data_sheet [--images FOLDER]."""
    study = stored.load(DOCS / STUDY) if (DOCS / STUDY).exists() else None
    text = page(bundled(), stored.load(DOCS / MEASURED), load_real(), study)
    assert (DOCS / PAGE).read_text(encoding="utf-8") == text
    pictures = {path.name: path.stat().st_size for path in (DOCS / FIGURES).iterdir()}
    assert all(f"{FIGURES}/{name}" in text for name in pictures)
    assert sum(pictures.values()) < 3_000_000
