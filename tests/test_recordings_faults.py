"""One bad scene, image or worker never stops a run."""

from __future__ import annotations

import logging
import os
import re
import signal
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from mixo_env.errors import DatasetError
from mixo_env.experts.expert import State
from mixo_env.nuscenes.images import BROKEN_SHARE
from mixo_env.recordings.processes import KILLED
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.steps import record_scene
from tests.nuscenes_fixture import grey_jpeg
from tests.recording_fakes import FAKES, FakeCamera, FakeDataset, make_scene, write_picture

CONFIG = RecordConfig()
NAMES = ["scene-2001", "scene-2002", "scene-2003"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> FakeDataset:
    folder = tmp_path_factory.mktemp("images")
    return FakeDataset({name: make_scene(folder, name, name[-1]) for name in NAMES})


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("[mr]*")}


# Scenes


class Overflowing(FakeCamera):
    def process(self, image, timestamp_us, distance_m):
        if timestamp_us % 7 == 0 or self.channel == "CAM_BACK":
            raise OverflowError("cannot convert\nfloat infinity to integer")
        return super().process(image, timestamp_us, distance_m)

    def __init__(self, calibration):
        super().__init__(calibration)
        self.channel = calibration.channel


@dataclass
class BrokenDataset(FakeDataset):
    """Loading one scene raises what nobody foresaw."""

    error: type[Exception] = OverflowError

    def load(self, name, cameras):
        if name == "scene-2002":
            raise self.error("1e308\nis too much")
        return super().load(name, cameras)


@pytest.mark.parametrize("error", [OverflowError, MemoryError, RecursionError, KeyError, UnicodeError])
def test_an_error_nobody_foresaw_skips_one_scene(dataset, tmp_path, caplog, error):
    caplog.set_level(logging.INFO)
    recorded = record(BrokenDataset(dataset.scenes, error=error), CONFIG, tmp_path / "out", experts=FAKES)
    assert [scene.name for scene in recorded.scenes] == ["scene-2001", "scene-2003"]
    reason = recorded.manifest.parameters["skipped"]["scene-2002"]
    assert "\n" not in reason
    if error is MemoryError:
        assert reason == "out of memory: use fewer workers"
    else:
        assert f"unexpected {error.__name__} in " in reason
        assert "Traceback" in caplog.text


def test_an_expert_that_raises_skips_the_scene(dataset, tmp_path):
    with pytest.raises(DatasetError, match=r"the first, scene-2001: unexpected OverflowError in \S+\.py:\d+ \(cannot"):
        record(dataset, CONFIG, tmp_path / "out", experts=replace(FAKES, camera=Overflowing))


def test_infinite_values_skip_the_scene(dataset, tmp_path):
    scene = dataset.scenes["scene-2002"]
    gyro = scene.can_bus.consumer_yaw_rate_radps
    gyro = replace(gyro, value=np.where(np.arange(len(gyro.value)) == 50, 1e308, gyro.value))
    hot = replace(scene, can_bus=replace(scene.can_bus, consumer_yaw_rate_radps=gyro))
    with np.errstate(over="ignore"):
        recorded = record(FakeDataset(dataset.scenes | {"scene-2002": hot}), CONFIG, tmp_path / "out", experts=FAKES)
    assert list(recorded.manifest.parameters["skipped"]) == ["scene-2002"]
    assert "INERTIAL_CONSUMER.yaw_increment_rad is infinite" in recorded.manifest.parameters["skipped"]["scene-2002"]


# Images


@pytest.mark.parametrize(
    ("words", "break_it"),
    [
        ("no JPEG", lambda path: path.write_bytes(b"no JPEG")),
        ("missing", lambda path: path.unlink()),
        (r"17 x 9 \(the tables say 16 x 9\)", lambda path: path.write_bytes(grey_jpeg(17, 9))),
        ("not to be decoded", lambda path: path.write_bytes(path.read_bytes()[:-40] + path.read_bytes()[-2:])),
    ],
)
def test_a_broken_image_costs_its_step_only(tmp_path, words, break_it, caplog):
    scene = make_scene(tmp_path)
    before, _ = record_scene(scene, FAKES)
    break_it(scene.cameras["CAM_BACK"].image_paths[6])
    row = 7  # image 4 of CAM_BACK was dropped
    after, timings = record_scene(scene, FAKES)
    assert after["CAM_BACK.state"][row] == State.NO_IMAGE
    assert before["CAM_BACK.state"][row] != State.NO_IMAGE
    for name, values in after.items():
        camera, _, column = name.partition(".")
        if camera != "CAM_BACK":
            np.testing.assert_array_equal(values, before[name])
        elif column != "state":
            assert np.isnan(values[row])
            np.testing.assert_array_equal(values[:row], before[name][:row])
    # The window of the next image reaches back over the broken one, and so does the distance its expert is told.
    times = scene.cameras["CAM_BACK"].timestamp_us
    assert after["CAM_BACK.own_window_s"][row + 1] == pytest.approx(1e-6 * (times[7] - times[5]), abs=1e-7)
    assert np.isnan(after["CAM_BACK.yaw_increment_rad"][row + 1])
    recorded = record(FakeDataset({scene.name: scene}), CONFIG, tmp_path / "out", experts=FAKES)
    assert recorded.manifest.parameters["broken_images"] == {scene.name: {"CAM_BACK": 1}}
    path = scene.cameras["CAM_BACK"].image_paths[6]
    assert re.search(f"scene-2001: images: CAM_BACK: 1 of 11 images are {words}, first {path}: no", caplog.text)
    again = record(FakeDataset({scene.name: scene}), CONFIG, tmp_path / "out", experts=FAKES)
    assert again.manifest.parameters["broken_images"] == {scene.name: {"CAM_BACK": 1}}
    assert int(np.isnan(timings["expert_ms"]).sum()) == 1


def test_too_many_broken_images_skip_the_scene(tmp_path):
    assert max(1, BROKEN_SHARE * 12) < 2
    scene = make_scene(tmp_path)
    for i in (2, 9):
        scene.cameras["CAM_BACK"].image_paths[i].write_bytes(b"no JPEG")
    with pytest.raises(DatasetError, match=r"CAM_BACK: 2 of 11 images are no JPEG, first .*: at most 5% \(one in"):
        record_scene(scene, FAKES)


# Workers


class Deadly(FakeCamera):
    """Kills its own process when it sees a picture of level 131, as often as a file says."""

    def __init__(self, calibration, lives):
        super().__init__(calibration)
        self.lives = lives

    def process(self, image, timestamp_us, distance_m):
        if round(float(image.mean())) == 131 and (left := int(self.lives.read_text())):
            self.lives.write_text(str(left - 1))
            os.kill(os.getpid(), signal.SIGKILL)
        return super().process(image, timestamp_us, distance_m)


@pytest.mark.parametrize("kills", [1, 100])
def test_a_killed_worker_costs_no_scene_but_one_that_kills_it_always(tmp_path, caplog, kills):
    dataset = FakeDataset({name: make_scene(tmp_path / "images", name) for name in NAMES})
    for name, scene in dataset.scenes.items():
        for path in scene.cameras["CAM_FRONT"].image_paths:
            write_picture(path, 131 if name == "scene-2002" else 90)
        for camera in ("CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT"):
            for path in scene.cameras[camera].image_paths:
                write_picture(path, 200)
    (tmp_path / "lives").write_text("0")
    experts = replace(FAKES, camera=partial(Deadly, lives=tmp_path / "lives"))
    record(dataset, CONFIG, tmp_path / "calm", experts=experts)
    (tmp_path / "lives").write_text(str(kills))
    recorded = record(dataset, CONFIG, tmp_path / "out", workers=2, experts=experts)
    assert "a worker was killed (out of memory?): trying " in caplog.text
    if kills == 1:
        assert files(tmp_path / "out") == files(tmp_path / "calm")
    else:
        assert [scene.name for scene in recorded.scenes] == ["scene-2001", "scene-2003"]
        assert recorded.manifest.parameters["skipped"] == {"scene-2002": KILLED}
