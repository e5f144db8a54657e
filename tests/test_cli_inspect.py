"""`mixo inspect` as a user runs it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.nuscenes_fixture import DRIVES, write_nuscenes


def mixo(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mixo_env.cli.main", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("city")
    write_nuscenes(root, duration_s=2.0)
    return root


def test_problem_gives_exit_code_1(folder):
    done = mixo("inspect", folder)
    assert done.returncode == 1, done.stderr
    assert "scene-2757: can-bus: no CAN bus data" in done.stdout
    assert "4 scenes, 0.05 km, 1 with problems: not sound" in done.stdout


def test_sound_scenes_give_exit_code_0_and_json(folder):
    done = mixo("inspect", folder, "--json", "--cameras", "all", "--scenes", "scene-2061", "scene-2103")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["is_sound"]
    assert [scene["name"] for scene in report["scenes"]] == ["scene-2061", "scene-2103"]
    assert len(report["scenes"][0]["images"]) == 6


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("v1.0-mini",), 1, "give the folder above it"),
        (("nowhere",), 1, "is not a folder"),
        (("", "--scenes", "scene-2062"), 2, "did you mean 'scene-2061'"),
        (("", "--version", "v1.0-minni"), 2, "did you mean 'v1.0-mini'"),
    ],
)
def test_one_line_for_wrong_input(folder, arguments, code, message):
    done = mixo("inspect", folder / arguments[0], *arguments[1:])
    assert done.returncode == code
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_truncated_table(tmp_path):
    write_nuscenes(tmp_path, DRIVES[:1], duration_s=0.5)
    table = tmp_path / "v1.0-mini" / "ego_pose.json"
    table.write_bytes(table.read_bytes()[:-50])
    done = mixo("inspect", tmp_path)
    assert done.returncode == 1
    assert "ego_pose.json is not a valid nuScenes file" in done.stderr
