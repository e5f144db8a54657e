"""Pipes, devices, loops and full disks where files and folders of trajectories and cities should be."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from mixo_env.cli.main import main
from mixo_env.recordings.store import load_recordings
from tests.fault_ways import NO_FILES
from tests.odometry_files import import_command, write_set

KINDS = {name: make for name, make in NO_FILES.items() if name != "folder"} | {
    "link to nothing": lambda path: path.symlink_to(path.parent / "nothing")
}
CITY = ("--no-images", "--scenes", "2", "--seconds", "2")


@pytest.fixture
def folders(tmp_path: Path) -> dict[str, Path]:
    return write_set(tmp_path / "files", {"A": 1e-3, "B": 3e-3}, sequences=2, poses=200)


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    return message


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("place", ["an expert's file", "the truth", "quality", "times", "wheels"])
def test_what_is_no_file_among_trajectories_is_named(folders, tmp_path, capsys, kind, place):
    first = sorted(folders["A"].iterdir())[0]
    options = ["--rate", "10"]
    if place == "an expert's file":
        path = first
    elif place == "the truth":
        path = folders["groundtruth"] / first.name
    elif place == "quality":
        path = first.with_suffix(".quality.csv")
    elif place == "times":
        path, options = folders["groundtruth"] / f"{first.stem}.times", []
    else:
        (tmp_path / "wheels").mkdir()
        path = tmp_path / "wheels" / first.name
        options += ["--distance", str(tmp_path / "wheels")]
    path.unlink(missing_ok=True)
    KINDS[kind](path)
    assert main(import_command(folders, tmp_path / "out", *options)) == 1
    message = one_line(capsys)
    assert f"{path} is no file but a pipe, a device or a link to nothing" in message
    assert not (tmp_path / "out" / "manifest.json").exists()


def test_links_to_files_and_folders_are_followed(folders, tmp_path, capsys):
    first = sorted(folders["A"].iterdir())[0]
    moved = first.rename(tmp_path / "elsewhere.txt")
    first.symlink_to(moved)
    (tmp_path / "linked").symlink_to(folders["B"])
    linked = folders | {"B": tmp_path / "linked"}
    assert main(import_command(linked, tmp_path / "out", "--rate", "10")) == 0
    assert len(load_recordings(tmp_path / "out")) == 2


@pytest.mark.parametrize("kind", [*KINDS, "file", "below a file"])
@pytest.mark.parametrize("command", ["import", "simulate"])
def test_an_output_that_can_be_no_folder_is_one_line(folders, tmp_path, capsys, command, kind):
    out = tmp_path / "out"
    if kind in KINDS:
        KINDS[kind](out)
    else:
        out.write_text("mine")
        out = out / "below" if kind == "below a file" else out
    before = sorted(tmp_path.rglob("*"))
    words = ["simulate", str(out), *CITY] if command == "simulate" else import_command(folders, out, "--rate", "10")
    assert main(words) in (1, 2)
    assert str(out) in one_line(capsys)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_that_is_no_folder_is_one_line(folders, tmp_path, capsys, kind):
    KINDS[kind](tmp_path / "recording")
    expert = f"C={folders['A']}"
    assert main(["import", str(tmp_path / "recording"), "--expert", expert, "--out", str(tmp_path / "out")]) in (1, 2)
    one_line(capsys)


@pytest.mark.parametrize("writes", [0, 1, 4, 9, 15])
def test_a_disk_that_fills_up_while_simulating_is_one_line_and_the_same_command_goes_on(
    tmp_path, capsys, monkeypatch, writes
):
    real, count = os.replace, 0

    def full(*arguments, **options):
        nonlocal count
        count += 1
        if count > writes:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(*arguments, **options)

    monkeypatch.setattr(os, "replace", full)
    assert main(["simulate", str(tmp_path / "city"), *CITY]) == 1
    assert "No space left on device; free space" in one_line(capsys)
    monkeypatch.undo()
    assert main(["simulate", str(tmp_path / "city"), *CITY]) == 0
    assert main(["simulate", str(tmp_path / "whole"), *CITY]) == 0

    def content(root: Path) -> dict[str, bytes]:
        return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}

    assert content(tmp_path / "city") == content(tmp_path / "whole")
