"""Nothing recorded is lost: one writer at a time, stops at every moment, damage, full disks."""

from __future__ import annotations

import errno
import os
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, OutputError, RecordingError
from mixo_env.recordings.folder import claimed
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.store import load_recordings, save_recordings
from tests.recording_fakes import FAKES, FakeCamera, FakeDataset, make_scene
from tests.synthetic import synthetic_recordings

CONFIG = RecordConfig()
ONE = replace(CONFIG, scenes=("scene-2002",))
NAMES = ["scene-2001", "scene-2002", "scene-2003"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> FakeDataset:
    folder = tmp_path_factory.mktemp("images")
    return FakeDataset({name: make_scene(folder, name, name[-1]) for name in NAMES})


@pytest.fixture(scope="module")
def whole(dataset, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "run"
    record(dataset, CONFIG, folder, experts=FAKES)
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("[mr]*")}


def in_a_child(work: Callable[[], object]) -> int:
    """Run ``work`` in a forked process; its exit code (0 if it ends by itself)."""
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        finally:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


# One writer


def test_a_second_writer_is_refused_and_told_who_writes(dataset, whole, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    before = files(out)
    with claimed(out):
        for write in (
            lambda: record(dataset, CONFIG, out, experts=FAKES),
            lambda: save_recordings(synthetic_recordings(scenes=1), out),
        ):
            with pytest.raises(ConfigurationError, match=rf"is being written by process {os.getpid()} on \S+: wait"):
                write()
        assert len(load_recordings(out)) == 3  # who only reads needs no lock
    assert files(out) == before
    assert sorted(path.name for path in out.iterdir()) == [
        "manifest.json",
        "recordings.parquet",
        "timings.parquet",
    ]


def test_a_lock_dies_with_its_process(tmp_path):
    reading, writing = os.pipe()

    def hold():
        with claimed(tmp_path):
            os.write(writing, b"held")
            signal.pause()

    child = os.fork()
    if child == 0:
        hold()
    assert os.read(reading, 4) == b"held"
    with pytest.raises(ConfigurationError, match=f"process {child} on"), claimed(tmp_path):
        pass
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with claimed(tmp_path):
        assert (tmp_path / ".lock").exists()
    assert list(tmp_path.iterdir()) == []


# Stops


def stop_at(operation: int) -> None:
    """The process dies, without any tidying up, just before its n-th rename or removal of a file."""
    count = 0

    def counted(function):
        def call(*arguments, **options):
            nonlocal count
            count += 1
            if count > operation:
                os._exit(9)
            return function(*arguments, **options)

        return call

    os.replace, os.unlink = counted(os.replace), counted(os.unlink)


def test_a_stop_at_any_moment_loses_nothing(dataset, whole, tmp_path):
    """While two scenes are added to a recording of one: it can be read at once, and a rerun makes it whole."""
    start = tmp_path / "start"
    record(dataset, ONE, start, experts=FAKES)
    held = {1: 0, 3: 0}
    for operation in range(100):
        out = tmp_path / f"stopped-{operation}"
        shutil.copytree(start, out)

        def add(operation=operation, out=out):
            stop_at(operation)
            record(dataset, CONFIG, out, experts=FAKES)

        code = in_a_child(add)
        held[len(load_recordings(out))] += 1
        seen = []

        def camera(calibration, seen=seen):
            seen.append(calibration.channel)
            return FakeCamera(calibration)

        record(dataset, CONFIG, out, experts=replace(FAKES, camera=camera))
        assert files(out) == files(whole)
        assert len(seen) <= 2 * 4
        assert sorted(path.name for path in out.iterdir()) == sorted(path.name for path in whole.iterdir())
        if code == 0:
            break
    assert code == 0
    assert held[1] > 8
    assert held[3] > 3  # the last stops came after the manifest was renamed


@pytest.mark.parametrize("operation", range(8))
def test_a_stop_while_saving_leaves_the_old_or_the_new(tmp_path, operation):
    old, new = synthetic_recordings(seed=1, scenes=2), synthetic_recordings(seed=2, scenes=3)
    save_recordings(old, tmp_path / "run")

    def save():
        stop_at(operation)
        save_recordings(new, tmp_path / "run")

    in_a_child(save)
    assert len(load_recordings(tmp_path / "run")) == (
        2 if operation < 4 else 3
    )  # the fourth is the rename of the manifest
    save_recordings(load_recordings(tmp_path / "run"), tmp_path / "run")
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["manifest.json", "recordings.parquet"]


# Damage


@pytest.mark.parametrize("share", [0.1, 0.25, 0.4, 0.999])
def test_sound_scenes_of_a_damaged_recording_are_kept(dataset, whole, tmp_path, caplog, share):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    path = out / "recordings.parquet"
    data = bytearray(path.read_bytes())
    for i in range(int(share * len(data)), int(share * len(data)) + 8):
        data[i] ^= 0xFF
    path.write_bytes(data)
    seen = []

    def camera(calibration):
        seen.append(calibration.channel)
        return FakeCamera(calibration)

    record(dataset, ONE, out, experts=replace(FAKES, camera=camera))
    recorded = load_recordings(out)
    assert [scene.name for scene in recorded.scenes] == NAMES
    np.testing.assert_array_equal(recorded["CAM_BACK.flow_px"], load_recordings(whole)["CAM_BACK.flow_px"])
    assert len(seen) == (12 if share == 0.999 else 4)  # without a footer nothing can be read
    assert "sound and kept; recording anew: scene-200" in caplog.text
    (aside,) = out.glob("damaged-*")
    assert (aside / "recordings.parquet").read_bytes() == data


def test_what_is_lost_for_good_is_told_and_kept_aside(dataset, whole, tmp_path, caplog):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    (out / "recordings.parquet").write_bytes((out / "recordings.parquet").read_bytes()[:-20])
    broken = replace(dataset, broken={"scene-2003": "the disk is gone"})
    recorded = record(broken, CONFIG, out, experts=FAKES)
    assert [scene.name for scene in recorded.scenes] == NAMES[:2]
    assert recorded.manifest.parameters["skipped"] == {"scene-2003": "the disk is gone"}
    assert [path.name for path in out.glob("damaged-*/*.json")] == ["manifest.json"]


def test_a_recording_without_a_sound_manifest_is_left_alone(dataset, whole, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    (out / "manifest.json").write_bytes((out / "manifest.json").read_bytes()[:-9])
    before = files(out)
    with pytest.raises(RecordingError, match="not overwritten: put a copy back"):
        record(dataset, CONFIG, out, experts=FAKES)
    (out / "manifest.json").unlink()
    with pytest.raises(RecordingError, match=r"without its manifest\.json: put that back"):
        record(dataset, CONFIG, out, experts=FAKES)
    assert files(out) == {"recordings.parquet": before["recordings.parquet"]}


# The disk


def test_a_full_disk_is_told_before_the_work(dataset, tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=1 << 20))
    with pytest.raises(OutputError, match=r"expected \d+ MB free for .*, found 1 MB"):
        record(dataset, CONFIG, tmp_path / "out", experts=FAKES)


@pytest.mark.parametrize("place", ["file", "file/below", "dangling", "taken"])
def test_an_output_that_cannot_be_a_folder_is_told_before_the_work(dataset, tmp_path, place):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "dangling").symlink_to(tmp_path / "file" / "nowhere")
    (tmp_path / "taken" / ".lock").mkdir(parents=True)
    for write in (
        lambda out: record(dataset, CONFIG, out),
        lambda out: save_recordings(synthetic_recordings(scenes=1), out),
    ):
        with pytest.raises(OutputError, match="cannot write") as caught:
            write(tmp_path / place)
        assert "\n" not in str(caught.value)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("operation", range(9))
def test_a_disk_that_fills_up_keeps_what_was_recorded(dataset, whole, tmp_path, monkeypatch, operation):
    out, count = tmp_path / "out", 0
    real = os.replace

    def full(*arguments):
        nonlocal count
        count += 1
        if count > operation:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(*arguments)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left") as caught:
        record(dataset, CONFIG, out, experts=FAKES)
    assert "\n" not in str(caught.value)
    monkeypatch.undo()
    seen = []

    def camera(calibration):
        seen.append(calibration.channel)
        return FakeCamera(calibration)

    record(dataset, CONFIG, out, experts=replace(FAKES, camera=camera))
    assert files(out) == files(whole)
    assert len(seen) == 4 * max(0, 3 - operation // 2)
