"""TUTORIAL in a recording: asked for by name, and nothing of the others changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mixo_env.experts.expert import State
from mixo_env.experts.tutorial import TutorialConfig, TutorialOdometry
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.recordings.record import RecordConfig, default_experts, record
from mixo_env.recordings.schema import HEADLINE_TRACKS, UNEQUAL, VARIANT_COLUMNS
from mixo_env.recordings.steps import record_scene
from mixo_env.recordings.store import load_recordings
from tests.recording_fakes import FakeCamera, FakeDataset, FakeInertial, make_scene

NAMES = ("TUTORIAL_FRONT", "TUTORIAL_FRONT_LEFT", "TUTORIAL_BACK", "TUTORIAL_BACK_RIGHT")
OFF, ON = RecordConfig(), RecordConfig(tutorial=TutorialConfig())


def test_off_by_default() -> None:
    assert "tutorial" not in OFF.parameters()
    assert OFF.parameters().items() <= ON.parameters().items()
    assert OFF.recorded_variants() == default_experts(OFF, "scene-2001").variants == {}


def test_one_of_every_camera() -> None:
    assert set(ON.recorded_variants()) == set(NAMES)
    made = default_experts(RecordConfig(cameras=("CAM_BACK",), tutorial=TutorialConfig(features=77)), "scene-2001")
    assert list(made.variants) == ["TUTORIAL_BACK"]
    camera, make = made.variants["TUTORIAL_BACK"]
    assert camera == "CAM_BACK"
    assert make.func is TutorialOdometry  # type: ignore[attr-defined]
    assert make.keywords["config"].features == 77  # type: ignore[attr-defined]


def test_other_columns_keep_their_bits_and_blind_pictures_are_lost(tmp_path) -> None:
    scene = make_scene(tmp_path)
    bare = replace(default_experts(OFF, scene.name), camera=FakeCamera, inertial=FakeInertial)
    alone, _ = record_scene(scene, bare)
    table, timings = record_scene(scene, replace(bare, variants=default_experts(ON, scene.name).variants))
    assert set(table) - set(alone) == {f"{expert}.{name}" for expert in NAMES for name in VARIANT_COLUMNS}
    for name, values in alone.items():
        np.testing.assert_array_equal(table[name], values)
    for expert in NAMES:  # pictures of one grey level
        assert table[f"{expert}.state"][0] in (State.INITIALISING, State.NO_IMAGE)
        assert np.isin(table[f"{expert}.state"][1:], (State.LOST, State.NO_IMAGE)).all()
        assert np.isnan(table[f"{expert}.yaw_increment_rad"]).all()
    assert set(timings["camera"]) == {*CAMERAS, *NAMES}


def test_recorded_loaded_and_asked_for(tmp_path) -> None:
    dataset = FakeDataset({name: make_scene(tmp_path, name) for name in ("scene-2001", "scene-2002")})
    experts = replace(default_experts(ON, "scene-2001"), camera=FakeCamera, inertial=FakeInertial)
    made = record(dataset, ON, tmp_path / "out", experts=experts)
    loaded = load_recordings(tmp_path / "out")
    assert loaded.column_names == made.column_names
    assert set(loaded.further) == set(NAMES)
    assert loaded.tracks == (*HEADLINE_TRACKS, UNEQUAL)
