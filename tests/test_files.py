"""Writing whole files or none, and text that a terminal shows but does not obey."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest

from mixo_env.errors import OutputError, printable
from mixo_env.files import atomic_path, writable_folder, write_json, write_text


def test_a_file_is_written_whole_with_its_folders(tmp_path):
    path = tmp_path / "a" / "b" / ("n" * 250 + ".txt")
    write_text(path, "grün\n")
    assert path.read_bytes() == "grün\n".encode()
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def fail(error: Exception) -> None:
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(KeyError):
        fail(KeyError())
    with pytest.raises(OutputError, match=r"cannot write .*a\.txt: No space left"):
        fail(OSError(28, os.strerror(28)))
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"]


def test_json_is_indented_and_knows_no_nan(tmp_path):
    write_json(tmp_path / "a.json", {"x": float("nan"), "y": (1, 2)})
    text = (tmp_path / "a.json").read_text()
    assert json.loads(text) == {"x": None, "y": [1, 2]}
    assert text.startswith('{\n  "x"')


def test_a_name_that_is_no_text_is_spelt_out(tmp_path):
    write_text(tmp_path / "a.txt", "scene-\udcff")
    assert (tmp_path / "a.txt").read_text() == "scene-\\udcff"


def test_a_folder_is_made_and_left_empty(tmp_path):
    assert writable_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert list((tmp_path / "a" / "b").iterdir()) == []


@pytest.mark.parametrize("name", ["file", "file/below", "file/below/that", "n" * 300, "nul\0"])
def test_what_cannot_be_a_folder_is_said_in_one_line(tmp_path, name):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write") as caught:
        writable_folder(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_folder_in_the_way_of_a_file_is_said(tmp_path):
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(OutputError, match="in the way"):
        write_text(tmp_path / "a.txt", "")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_a_full_disk_is_noticed_before_the_work():
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full")
    with pytest.raises(OutputError):
        writable_folder(full)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("\x1b[31mRED\x1b]0;owned\x07", r"\x1b[31mRED\x1b]0;owned\x07"),
        ("a\nb\r\tc", r"a\nb\r\tc"),
        ("\x9b2J\x7f", r"\x9b2J\x7f"),
        ("\u202egnp.exe", r"\u202egnp.exe"),
        ("a\u2028b\u200b", r"a\u2028b\u200b"),
        ("\udcff", r"\udcff"),
        ("Zürich – 日本 [bold] \\ 🚗", "Zürich – 日本 [bold] \\ 🚗"),
    ],
)
def test_what_a_terminal_would_obey_is_spelt_out(text, shown):
    assert printable(text) == shown
