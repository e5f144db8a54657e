"""`mixo train-vocabulary` as a user runs it."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import simplejpeg

from mixo_env.cli.main import main
from mixo_env.experts.monocular.vocabulary import load_vocabulary
from mixo_env.nuscenes.tables import open_dataset
from tests.nuscenes_fixture import DRIVES, write_nuscenes
from tests.recording_fakes import write_sliding_texture

SCENES = (DRIVES[0].name, DRIVES[1].name)
CAMERA = "CAM_BACK_RIGHT"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes of one second in which every camera sees a texture."""
    folder = tmp_path_factory.mktemp("nuscenes")
    write_sliding_texture(folder, write_nuscenes(folder, DRIVES[:2], duration_s=1.0, images=False))
    return folder


def train(root: Path, out: Path, *options: str) -> int:
    return main(["train-vocabulary", str(root), "--out", str(out), "--cameras", CAMERA, *options])


def test_trains_the_same_words_again_and_others_from_another_seed(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, two, other = (tmp_path / f"{name}.npy" for name in ("one", "two", "other"))
    assert train(root, one, "--share", "0.5", "--seed", "4") == 0
    message = "".join(capsys.readouterr().out.split())
    assert "10x10wordsfrom" in message
    assert "50%oftheimages" in message
    assert train(root, two, "--share", "0.5", "--seed", "4") == 0
    assert train(root, other, "--share", "0.5", "--seed", "5") == 0
    assert one.read_bytes() == two.read_bytes() != other.read_bytes()
    assert len(load_vocabulary(one)) == 100
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.npy", "other.npy", "two.npy"]  # no parts


def test_learns_from_the_scenes_and_cameras_asked_for_only(root: Path, tmp_path: Path) -> None:
    """Nothing else is even read: the other images may be broken."""
    broken = tmp_path / "broken"
    shutil.copytree(root, broken)
    dataset = open_dataset(broken)
    for scene in SCENES:
        for camera, track in dataset.load(scene, ("CAM_FRONT", CAMERA)).cameras.items():
            if (scene, camera) != (SCENES[1], CAMERA):
                for path in track.image_paths:
                    path.write_bytes(b"no picture")
    whole, part = tmp_path / "whole.npy", tmp_path / "part.npy"
    assert train(root, whole, "--share", "1", "--scenes", SCENES[1]) == 0
    assert train(broken, part, "--share", "1", "--scenes", SCENES[1]) == 0
    assert whole.read_bytes() == part.read_bytes()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--share", "0"], 2, "share must be above 0"),
        (["--share", "1.5"], 2, "share must be above 0"),
        (["--share", "nan"], 2, "share must be above 0"),
        (["--share", "1e-9"], 2, "needs 2000 descriptors, got 0"),
        (["--scenes", "scene-9999"], 2, "scene-9999"),
        (["--cameras", "CAM_FRNT"], 2, "did you mean 'CAM_FRONT'"),
        (["--version", "v1.0-none"], 2, "v1.0-none"),
    ],
)
def test_wrong_usage_is_one_line(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], code: int, words: str
) -> None:
    assert train(root, tmp_path / "words.npy", *options) == code
    message = capsys.readouterr().err
    assert words in message
    assert len(message.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("level", "code", "words"), [(0, 2, "give more images"), (None, 1, "can be used, the first")])
def test_images_that_show_nothing(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], level: int | None, code: int, words: str
) -> None:
    dark = tmp_path / "dark"
    shutil.copytree(root, dark)
    for scene in SCENES:
        track = open_dataset(dark).load(scene, (CAMERA,)).cameras[CAMERA]
        shape = (track.calibration.height, track.calibration.width, 1)
        for path in track.image_paths:
            image = b"" if level is None else simplejpeg.encode_jpeg(np.full(shape, level, np.uint8), colorspace="GRAY")
            path.write_bytes(image)
    assert train(dark, tmp_path / "words.npy", "--share", "1") == code
    message = capsys.readouterr().err
    assert words in message
    assert len(message.strip().splitlines()) == 1
    assert not (tmp_path / "words.npy").exists()


def test_the_folder_is_made_or_refused_at_once(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train(root, tmp_path / "new" / "words.npy", "--share", "1") == 0
    capsys.readouterr()
    (tmp_path / "file").write_bytes(b"")
    assert train(root, tmp_path / "file" / "words.npy", "--share", "1") == 1
    message = capsys.readouterr().err
    assert "cannot write" in message
    assert len(message.strip().splitlines()) == 1
