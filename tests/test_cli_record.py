"""`mixo record` from a nuScenes folder to a recording, with the project's own experts."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.experts.expert import State
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.recordings.store import load_recordings
from tests.nuscenes_fixture import DRIVES, write_nuscenes
from tests.recording_fakes import write_sliding_texture


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """One second of a turning car and of one without CAN bus; every camera sees a texture that slides to the right."""
    folder = tmp_path_factory.mktemp("nuscenes")
    truth = write_nuscenes(folder, (DRIVES[0], DRIVES[3]), duration_s=1.0, images=False)
    write_sliding_texture(folder, truth)
    return folder


def test_a_folder_becomes_a_recording(root, tmp_path, capsys, caplog):
    assert main(["record", str(root), "--out", str(tmp_path / "run")]) == 1  # a scene was skipped
    assert "skipped scene-2757: can-bus: no CAN bus" in caplog.text
    said = capsys.readouterr().out
    assert "1 scenes" in said
    assert "1 skipped for the reasons above: the same command tries them again" in said
    assert main(["record", str(root), "--out", str(tmp_path / "run"), "--scenes", "scene-2061"]) == 0
    recordings = load_recordings(tmp_path / "run")
    assert [scene.name for scene in recordings.scenes] == ["scene-2061"]
    assert recordings.manifest.parameters["skipped"] == {}  # the second run asked for the other one only
    assert recordings.manifest.parameters["preset"] == "fast"
    assert recordings.manifest.parameters["monocular"]["features"] == MonocularConfig.preset("fast").features
    truth = recordings["truth.yaw_increment_rad"][1:]
    np.testing.assert_allclose(recordings["INERTIAL.yaw_increment_rad"][1:], truth, atol=2e-3)
    np.testing.assert_allclose(recordings["distance_m"][1:], 8.0 * recordings["dt_s"][1:], atol=1e-3)
    assert recordings["CAM_BACK.state"].tolist().count(State.NO_IMAGE) == 1
    assert np.all(recordings["CAM_FRONT.matches"][2:] > 50)


def test_inertial_experts_need_no_images_and_say_what_they_say_beside_cameras(root, tmp_path, capsys):
    bare = tmp_path / "bare"
    write_nuscenes(bare, (DRIVES[0], DRIVES[1]), duration_s=1.0, images=False)
    assert not list(bare.rglob("*.jpg"))
    assert main(["record", str(bare), "--out", str(tmp_path / "refused")]) == 1
    assert "see --no-images" in capsys.readouterr().err
    assert main(["record", str(bare), "--out", str(tmp_path / "run"), "--no-images"]) == 0
    assert "2 scenes" in capsys.readouterr().out
    alone = load_recordings(tmp_path / "run")
    assert alone.manifest.cameras == ()
    assert alone.tracks == ("PAPER", "CONSUMER")
    assert main(["record", str(root), "--out", str(tmp_path / "all"), "--scenes", "scene-2061"]) == 0
    beside = load_recordings(tmp_path / "all")
    rows = alone.select(scenes=["scene-2061"])
    for column in rows.column_names:
        np.testing.assert_array_equal(rows[column], beside[column], err_msg=column)

    assert main(["export", str(tmp_path / "run"), "--out", str(tmp_path / "ways")]) == 0
    added = ["--expert", f"CAM_FRONT={tmp_path / 'ways' / 'INERTIAL'}", "--out", str(tmp_path / "with-mine")]
    assert main(["import", str(tmp_path / "run"), *added]) == 0
    mine = load_recordings(tmp_path / "with-mine")
    assert mine.voters("PAPER") == ("CAM_FRONT", "INERTIAL_POSE")
    assert mine.voters("VISION") == ("CAM_FRONT",)
    increment = mine["INERTIAL.yaw_increment_rad"]
    np.testing.assert_allclose(mine["CAM_FRONT.yaw_increment_rad"], increment, atol=1e-5)


@pytest.mark.parametrize("needs", [["--experts", "JOINT"], ["--retrained", "CAM_FRONT"]])
def test_what_needs_images_is_refused_without(root, tmp_path, capsys, needs):
    assert main(["record", str(root), "--out", str(tmp_path / "run"), "--no-images", *needs]) == 2
    assert "need images" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_exit_codes(root, tmp_path, capsys):
    out = str(tmp_path / "run")
    assert main(["record", str(root), "--out", out, "--scenes", "scene-2757"]) == 1
    assert "none of 1 scenes could be recorded" in capsys.readouterr().err
    assert main(["record", str(root / "nothing"), "--out", out]) == 1
    assert "is not a folder" in capsys.readouterr().err
    for wrong in (["--scenes", "scene-9999"], ["--cameras", "CAM_FORNT"], ["--workers", "0"]):
        assert main(["record", str(root), "--out", out, *wrong]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    with pytest.raises(SystemExit) as caught:
        main(["record", str(root), "--out", out, "--preset", "fasst"])
    assert caught.value.code == 2
    assert not (tmp_path / "run" / "recordings.parquet").exists()
