"""Recording whole data sets: resuming, skipping, workers, and what the manifest says."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.steps import Experts
from mixo_env.recordings.store import load_recordings, read_columns
from tests.recording_fakes import FAKES, FakeCamera, FakeDataset, make_scene

CONFIG = RecordConfig()


@pytest.fixture
def dataset(tmp_path):
    logs = ["a", "a", "b", "c", "d", "e"]
    scenes = {}
    for i, log in enumerate(logs):
        name = f"scene-{2001 + i}"
        conditions = ("night",) if log == "e" else ("day",)
        scenes[name] = make_scene(tmp_path / "images", name, log, conditions)
    return FakeDataset(scenes)


def files(folder):
    return {path.name: path.read_bytes() for path in folder.glob("[mr]*")}


def counting(seen: list[str]) -> Experts:
    """Fakes that note every camera they are made for."""

    def camera(calibration):
        seen.append(calibration.channel)
        return FakeCamera(calibration)

    return replace(FAKES, camera=camera)


def test_a_recording_is_complete(dataset, tmp_path):
    out = tmp_path / "out"
    calls = []
    recordings = record(dataset, CONFIG, out, progress=lambda *call: calls.append(call), experts=FAKES)
    assert sorted(path.name for path in out.iterdir()) == ["manifest.json", "recordings.parquet", "timings.parquet"]
    assert calls == [(i, 6) for i in range(1, 7)]
    manifest = recordings.manifest
    assert manifest.data_version == "v1.0-fake"
    assert manifest.cameras == CAMERAS
    assert [scene.name for scene in recordings.scenes] == list(dataset.scene_names)
    assert [scene.fold for scene in recordings.scenes] == [0, 0, 1, 2, 3, -1]
    assert set(manifest.linear_weights["CONSUMER"]) == {"none", "0", "1", "2", "3"}
    assert all(scale > 0 for scale in manifest.reward_scale_rad.values())
    assert {"python", "numpy", "cv2"} <= set(manifest.software)
    assert set(manifest.parameters["inputs"]) == set(dataset.scene_names)
    assert manifest.parameters["skipped"] == {}
    assert manifest.parameters["monocular"]["features"] == MonocularConfig().features
    assert set(manifest.vehicles) == {"n099"}
    assert set(manifest.camera_cost_ms) == set(CAMERAS)
    timings, _, _ = read_columns((out / "timings.parquet").read_bytes())
    assert list(timings) == ["scene", "camera", "timestamp_us", "decode_ms", "expert_ms"]
    assert len(timings["scene"]) == 6 * (4 * 12 - 2)


def test_the_number_of_workers_changes_no_byte(dataset, tmp_path):
    record(dataset, CONFIG, tmp_path / "one", workers=1, experts=FAKES)
    record(dataset, CONFIG, tmp_path / "two", workers=2, experts=FAKES)
    assert files(tmp_path / "one") == files(tmp_path / "two")


def test_an_interrupted_run_continues(dataset, tmp_path):
    record(dataset, CONFIG, tmp_path / "whole", experts=FAKES)
    out = tmp_path / "out"

    def interrupt(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(dataset, CONFIG, out, progress=interrupt, experts=FAKES)
    (folder,) = out.iterdir()
    assert sorted(path.name for path in folder.glob("*.parquet")) == sorted(
        f"scene-{i}{suffix}.parquet" for i in (2001, 2002, 2003) for suffix in ("", ".timings")
    )
    damaged = folder / "scene-2002.parquet"
    damaged.write_bytes(damaged.read_bytes()[:-100])
    seen = []
    record(dataset, CONFIG, out, experts=counting(seen))
    assert len(seen) == 4 * len(CAMERAS)  # scene-2002 and the three that were missing
    assert files(out) == files(tmp_path / "whole")


def test_parts_of_another_configuration_do_not_count(dataset, tmp_path):
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(dataset, CONFIG, tmp_path / "out", progress=interrupt, experts=FAKES)
    seen = []
    other = RecordConfig(monocular=MonocularConfig(features=999))
    record(dataset, other, tmp_path / "out", experts=counting(seen))
    assert len(seen) == 6 * len(CAMERAS)


def test_a_finished_recording_takes_in_more_scenes(dataset, tmp_path):
    record(dataset, CONFIG, tmp_path / "whole", experts=FAKES)
    out = tmp_path / "out"
    record(dataset, replace(CONFIG, scenes=("scene-2004", "scene-2002")), out, experts=FAKES)
    assert [scene.name for scene in load_recordings(out).scenes] == ["scene-2002", "scene-2004"]
    seen = []
    record(dataset, CONFIG, out, experts=counting(seen))
    assert len(seen) == 4 * len(CAMERAS)
    assert files(out) == files(tmp_path / "whole")
    timings, _, _ = read_columns((out / "timings.parquet").read_bytes())
    assert set(timings["scene"]) == set(dataset.scene_names)


def test_a_finished_recording_of_something_else_is_left_alone(dataset, tmp_path):
    out = tmp_path / "out"
    record(dataset, CONFIG, out, experts=FAKES)
    before = files(out)
    with pytest.raises(ConfigurationError, match="another configuration, version or set"):
        record(dataset, replace(CONFIG, cameras=CAMERAS[:2]), out, experts=FAKES)
    with pytest.raises(ConfigurationError, match="scenes that are not in this data set"):
        record(FakeDataset({"scene-2009": make_scene(tmp_path, "scene-2009")}), CONFIG, out, experts=FAKES)
    assert files(out) == before


def test_a_scene_simulated_anew_is_recorded_anew(dataset, tmp_path):
    out = tmp_path / "out"
    record(dataset, CONFIG, out, experts=FAKES)
    dataset.scenes["scene-2003"] = make_scene(tmp_path / "images", "scene-2003", "b", seed=1)
    seen = []
    changed = record(dataset, CONFIG, out, experts=counting(seen))
    assert len(seen) == len(CAMERAS)
    fresh = record(dataset, CONFIG, tmp_path / "fresh", experts=FAKES)
    np.testing.assert_array_equal(changed["CAM_BACK.flow_px"], fresh["CAM_BACK.flow_px"])


def test_a_damaged_recording_is_recorded_anew(dataset, tmp_path, caplog):
    out = tmp_path / "out"
    record(dataset, CONFIG, out, experts=FAKES)
    before = files(out)
    (out / "recordings.parquet").write_bytes(b"PAR1")
    record(dataset, CONFIG, out, experts=FAKES)
    assert "0 of 6 scenes are sound and kept; recording anew: scene-2001, " in caplog.text
    assert files(out) == before
    (aside,) = out.glob("damaged-*")
    assert files(aside) == before | {"recordings.parquet": b"PAR1"}


def test_broken_scenes_are_skipped_and_listed(dataset, tmp_path, caplog):
    dataset.broken = {"scene-2001": "no ego poses"}
    dataset.scenes["scene-2002"] = replace(dataset.scenes["scene-2002"], can_bus=None)
    for i in (5, 6):
        dataset.scenes["scene-2003"].cameras["CAM_BACK"].image_paths[i].write_bytes(b"no JPEG")
        dataset.scenes["scene-2004"].cameras["CAM_FRONT"].image_paths[i - 5].unlink()
    with caplog.at_level(logging.WARNING):
        recordings = record(dataset, CONFIG, tmp_path / "out", experts=FAKES)
    assert [scene.name for scene in recordings.scenes] == ["scene-2005", "scene-2006"]
    skipped = recordings.manifest.parameters["skipped"]
    assert list(skipped) == ["scene-2001", "scene-2002", "scene-2003", "scene-2004"]
    for name, reason in zip(skipped, ("no ego poses", "no CAN bus", "are no JPEG", "are missing"), strict=True):
        assert reason in skipped[name]
        assert f"skipped {name}: {skipped[name]}" in caplog.text
    assert set(recordings.manifest.linear_weights["PAPER"]) == {"none"}


def test_a_scene_that_breaks_later_keeps_its_rows(dataset, tmp_path, caplog):
    out = tmp_path / "out"
    record(dataset, CONFIG, out, experts=FAKES)
    before = files(out)
    dataset.broken = {"scene-2001": "the disk is gone"}
    record(dataset, CONFIG, out, experts=FAKES)
    assert "kept scene-2001 as recorded earlier: the disk is gone" in caplog.text
    assert files(out) == before


def test_nothing_to_record_is_an_error(dataset, tmp_path):
    dataset.broken = dict.fromkeys(dataset.scene_names, "no ego poses")
    with pytest.raises(DatasetError, match="none of 6 scenes could be recorded; the first, scene-2001: no ego poses"):
        record(dataset, CONFIG, tmp_path / "out", experts=FAKES)


def test_wrong_usage(dataset, tmp_path):
    with pytest.raises(ConfigurationError, match=r"unknown scene 'scene-9999'"):
        record(dataset, RecordConfig(scenes=("scene-9999",)), tmp_path, experts=FAKES)
    with pytest.raises(ConfigurationError, match="workers"):
        record(dataset, CONFIG, tmp_path, workers=0, experts=FAKES)
    with pytest.raises(ConfigurationError, match="did you mean 'log'"):
        RecordConfig(folds="logs")
    with pytest.raises(ConfigurationError, match="cameras must be given once"):
        RecordConfig(cameras=("CAM_FRONT", "CAM_FRONT"))


def test_folds_and_version_can_be_chosen(dataset, tmp_path):
    config = RecordConfig(folds="contiguous", data_version="mixocity-0.1")
    manifest = record(dataset, config, tmp_path / "out", experts=FAKES).manifest
    assert manifest.data_version == "mixocity-0.1"
    assert [scene.fold for scene in manifest.scenes] == [0, 0, 1, 2, 3, -1]
