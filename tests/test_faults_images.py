"""One broken image of any kind costs its step and not the scene, and both commands say so in the same words."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.experts.expert import State
from mixo_env.nuscenes.checks.judge import JudgedDataset
from mixo_env.nuscenes.images import jpeg_size
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.store import load_recordings
from tests.fault_ways import NO_FILES, SCENE, bomb, images
from tests.nuscenes_fixture import DRIVES, grey_jpeg, write_nuscenes
from tests.recording_fakes import FAKES

Damage = Callable[[Path], object]


def becomes(content: bytes | Callable[[bytes], bytes]) -> Damage:
    def damage(path: Path) -> None:
        new = content(path.read_bytes()) if callable(content) else content
        path.unlink()  # it may be a link to that of another test
        path.write_bytes(new)

    return damage


def instead(make: Damage) -> Damage:
    def damage(path: Path) -> None:
        path.unlink()
        make(path)

    return damage


def unreadable(path: Path) -> None:
    becomes(lambda jpeg: jpeg)(path)
    path.chmod(0)


DAMAGES: dict[str, tuple[Damage, str]] = {
    "missing": (Path.unlink, "missing"),
    "empty": (becomes(b""), "empty"),
    "one-byte": (becomes(b"\xff"), "no JPEG"),
    "text": (becomes(b"<html>404</html>" * 99), "no JPEG"),
    "png": (becomes(b"\x89PNG\r\n\x1a\n" + bytes(2000)), "no JPEG"),
    "zeros": (becomes(bytes(3000)), "no JPEG"),
    "header-only": (becomes(lambda jpeg: jpeg[:12]), "no JPEG"),
    "cut": (becomes(lambda jpeg: jpeg[:-200]), "cut short"),
    "cut-by-a-byte": (becomes(lambda jpeg: jpeg[:-1]), "cut short"),
    "zeros-at-the-end": (becomes(lambda jpeg: jpeg[:-400] + bytes(400)), "cut short"),
    "one-pixel": (becomes(grey_jpeg(1, 1)), "1 x 1 (the tables say 1600 x 900)"),
    "half-size": (becomes(grey_jpeg(800, 450)), "800 x 450 (the tables say 1600 x 900)"),
    "on-its-side": (becomes(grey_jpeg(900, 1600)), "900 x 1600 (the tables say 1600 x 900)"),
    "bomb": (becomes(bomb), "65500 x 65500 (the tables say 1600 x 900)"),
    "endless-header": (becomes(b"\xff\xd8" + b"\xff" * 6_000_000), "no JPEG"),
    "no-size": (becomes(lambda jpeg: re.sub(rb"(\xff[\xc0\xc2]...)....", rb"\1\0\0\0\0", jpeg)), "0 x 0"),
    "unreadable": (unreadable, "unreadable or no files"),
    **{name: (instead(make), "unreadable or no files") for name, make in NO_FILES.items()},
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("sound") / "data"
    write_nuscenes(root, DRIVES[:1], duration_s=3.5)
    return root


@pytest.fixture
def folder(sound, tmp_path) -> Path:
    root = tmp_path / "data"
    shutil.copytree(
        sound, root, copy_function=lambda a, b: (os.link if a.endswith(".jpg") else shutil.copy)(a, b) and None
    )
    return root


def notes_and_problems(folder: Path, capsys) -> tuple[int, list[str], list[str]]:
    code = main(["inspect", str(folder), "--cameras", "CAM_FRONT", "--json"])
    scene = json.loads(capsys.readouterr().out)["scenes"][0]
    notes, problems = ([f"{found['check']}: {found['text']}" for found in scene[key]] for key in ("notes", "problems"))
    return code, notes, problems


@pytest.mark.parametrize("name", DAMAGES)
def test_one_broken_image_costs_its_step_only(name, folder, tmp_path, capsys, caplog):
    if name == "unreadable" and os.geteuid() == 0:
        pytest.skip("root reads everything")
    damage, words = DAMAGES[name]
    path = images(folder)[3]
    damage(path)
    code, notes, problems = notes_and_problems(folder, capsys)
    assert (code, problems) == (0, [])
    assert len(notes) == 1
    first = re.escape(f"{path}: no image in these steps")
    assert re.fullmatch(rf"images: CAM_FRONT: 1 of 43 images are {re.escape(words)}.*, first {first}", notes[0])
    dataset = JudgedDataset(open_dataset(folder))
    recorded = record(dataset, RecordConfig(cameras=("CAM_FRONT",)), tmp_path / "out", experts=FAKES)
    assert np.count_nonzero(recorded["CAM_FRONT.state"] == State.NO_IMAGE) == 1
    assert recorded.manifest.parameters["broken_images"] == {SCENE: {"CAM_FRONT": 1}}
    assert f"{SCENE}: {notes[0]}" in caplog.messages


@pytest.mark.parametrize("fill", [0, 1, 2, *range(1010, 1030), 5000])
def test_fill_bytes_before_the_size_are_passed_over(fill):
    """As many as fill what is read at once, and more."""
    jpeg = grey_jpeg(48, 32)
    assert jpeg_size(io.BytesIO(jpeg[:2] + fill * b"\xff" + jpeg[2:])) == (48, 32)


@pytest.mark.parametrize("name", ["missing", "cut", "bomb", "folder"])
def test_too_many_skip_the_scene_in_the_words_of_inspect(name, folder, tmp_path, capsys):
    for path in images(folder)[1:4]:
        DAMAGES[name][0](path)
    code, notes, problems = notes_and_problems(folder, capsys)
    assert (code, notes) == (1, [])
    assert len(problems) == 1
    assert problems[0].endswith(": at most 5% (one in any case) and 10 in a row may be broken")
    assert main(["record", str(folder), "--out", str(tmp_path / "out"), "--cameras", "CAM_FRONT"]) == 1
    assert f"{SCENE}: {problems[0]}" in capsys.readouterr().err


def test_the_command_records_a_scene_with_a_few_broken_images(folder, tmp_path, capsys):
    """With the real odometry, from the command line; mending the images records the scene anew."""
    arguments = ["record", str(folder), "--out", str(tmp_path / "out"), "--cameras", "CAM_FRONT"]
    paths = images(folder)
    whole = paths[4].read_bytes()
    paths[4].unlink()
    becomes(bomb)(paths[6])
    assert main(arguments) == 0
    assert (
        "1 scenes, 43 rows, 1 logs, v1.0-mini (preset fast); no image in 2 steps for the reasons"
        in capsys.readouterr().out
    )
    state = load_recordings(tmp_path / "out")["CAM_FRONT.state"]
    assert np.count_nonzero(state == State.NO_IMAGE) == 2
    for path in (paths[4], paths[6]):
        path.unlink(missing_ok=True)
        path.write_bytes(whole)
    assert main(arguments) == 0
    mended = load_recordings(tmp_path / "out")
    assert not np.any(mended["CAM_FRONT.state"] == State.NO_IMAGE)
    assert mended.manifest.parameters["broken_images"] == {}
