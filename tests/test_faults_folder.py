"""Every named fault of a folder ends in exit code 1, one line that names it, and nothing written elsewhere."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

import pytest

from mixo_env.cli.main import main
from tests.fault_ways import SCENE, can, each
from tests.folder_faults import BORDER_FAULTS
from tests.nuscenes_fixture import DRIVES, write_nuscenes
from tests.scene_faults import SCENE_FAULTS

FAULTS = BORDER_FAULTS | SCENE_FAULTS

# A fault of one camera's rows may also be met as "this camera is not there", where the folder is taken as it is.
INSPECTED_AS_IT_IS = {"camera-absent", "empty-sample_data"}


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("sound") / "data"
    write_nuscenes(root, DRIVES[:1], duration_s=3.5)
    return root


def copy(source: str, target: str) -> None:
    """Images are linked (faults unlink them first), the rest is copied."""
    (os.link if source.endswith(".jpg") else shutil.copy)(source, target)


@pytest.fixture
def folder(sound, tmp_path, monkeypatch) -> Path:
    root = tmp_path / "in" / "data"
    shutil.copytree(sound, root, copy_function=copy)
    (tmp_path / "secret.jpg").write_bytes(b"secret")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "200")
    return root


def around(tmp_path: Path) -> set[str]:
    """What stands beside the folder and the recording."""
    return {path.name for place in (tmp_path, tmp_path / "in") for path in place.iterdir()} - {"cache", "run"}


def test_the_folder_is_sound_without_a_fault(folder, capsys):
    assert main(["inspect", str(folder), "--cameras", "all"]) == 0
    out = capsys.readouterr().out
    assert "problem" not in out.replace("0 with problems", "")
    assert "1 scenes, 0.03 km, 0 with problems: sound" in out


@pytest.mark.parametrize("name", FAULTS)
def test_fault(name, folder, tmp_path, capsys):
    apply, words = FAULTS[name]
    apply(folder)
    before = around(tmp_path)
    if name not in INSPECTED_AS_IT_IS:
        assert main(["inspect", str(folder)]) == 1
        shown = "".join(capsys.readouterr())
        assert re.search(words, shown), shown
        assert "Traceback" not in shown
        assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f\u202e]", shown)
    assert main(["record", str(folder), "--out", str(tmp_path / "run")]) == 1
    message = capsys.readouterr().err
    assert re.search(words, message), message
    assert message.count("\n") == 1, message
    assert message[:-1].isprintable()
    assert around(tmp_path) == before
    written = {path.name for path in (tmp_path / "run").rglob("*.parquet")} if (tmp_path / "run").exists() else set()
    assert not written


def test_record_skips_in_the_words_of_inspect(folder, tmp_path, capsys):
    FAULTS["gyro-doubled"][0](folder)
    assert main(["inspect", str(folder), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)["scenes"][0]["problems"]
    assert found[0]["check"] == "gyro-size"
    assert main(["record", str(folder), "--out", str(tmp_path / "run")]) == 1
    assert f"{SCENE}: gyro-size: {found[0]['text']}" in capsys.readouterr().err


def test_an_accepted_problem_does_not_stop_but_another_does(folder, tmp_path, capsys):
    can("ms_imu", each("rotation_rate", lambda r: [0, 0, 2 * r[2]]))(folder)
    FAULTS["wheel-sentinel"][0](folder)
    arguments = ["record", str(folder), "--out", str(tmp_path / "run"), "--despite", "gyro-size"]
    assert main(arguments) == 1
    assert "wheel-range" in (message := capsys.readouterr().err)
    assert "gyro-size" not in message
    assert main([*arguments, "weel-range"]) == 2
    assert "did you mean 'wheel-range'" in capsys.readouterr().err


def test_a_folder_with_one_camera_is_inspected_as_it_is(folder, capsys):
    for place in ("samples", "sweeps"):
        for camera in (folder / place).iterdir():
            if camera.name != "CAM_FRONT":
                shutil.rmtree(camera)
    assert main(["inspect", str(folder)]) == 0
    assert "cameras: CAM_FRONT\n" in capsys.readouterr().out
    assert main(["inspect", str(folder), "--cameras", "CAM_FRONT", "CAM_BACK"]) == 1
    assert re.search(r"CAM_BACK: (\d+) of \1 images are missing", capsys.readouterr().out)
    assert main(["inspect", str(folder), "--cameras", "CAM_FORNT"]) == 2


def test_links_of_the_user_are_followed(folder, tmp_path, capsys):
    """People keep images on another disk."""
    (folder / "samples").rename(tmp_path / "samples")
    (folder / "samples").symlink_to(tmp_path / "samples")
    assert main(["inspect", str(folder)]) == 0


def test_a_cache_that_comes_with_the_folder_is_not_trusted(folder, tmp_path, capsys):
    """Neither its names nor a link in its place."""
    import numpy as np

    from mixo_env.nuscenes.tables import open_dataset

    open_dataset(folder)
    path = folder / ".mixo-cache" / "v1.0-mini.npz"
    with np.load(path) as archive:
        columns = dict(archive)
    header = columns["header"].tobytes().replace(b'"name":"scene-2061"', b'"name":"../escapes"')
    np.savez(path, **(columns | {"header": np.frombuffer(header, np.uint8)}))
    assert open_dataset(folder).scene_names == (SCENE,)
    shutil.rmtree(folder / ".mixo-cache")
    (tmp_path / "elsewhere").mkdir()
    (folder / ".mixo-cache").symlink_to(tmp_path / "elsewhere")
    open_dataset(folder)
    assert not list((tmp_path / "elsewhere").iterdir())


def test_a_version_is_the_name_of_a_folder(folder, capsys):
    assert main(["inspect", str(folder), "--version", "../data/v1.0-mini"]) == 2
    assert "--version must be the name of a folder" in capsys.readouterr().err
