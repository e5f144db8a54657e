"""docs/own-odometry.md followed word by word in a folder with somebody's files, and its example."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from mixo_env.cli.main import main
from tests.odometry_files import write_set

REPOSITORY = Path(__file__).parent.parent
PAGE = (REPOSITORY / "docs" / "own-odometry.md").read_text(encoding="utf-8")
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines() if line]


def files(folder: Path) -> None:
    """What the page takes for granted."""
    write_set(folder / "odometry", {"ORB": 1e-3, "DSO": 2e-3}, sequences=5, poses=300)


def test_the_page_imports_mixes_and_exports() -> None:
    assert {shlex.split(line)[1] for line in COMMANDS} == {"import", "benchmark", "export", "evaluate"}
    assert len(COMMANDS) >= 8


@pytest.mark.parametrize("line", [line for line in COMMANDS if "--groundtruth odometry" in line])
def test_recordings_are_made_as_the_page_says(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    files(tmp_path)
    assert main(shlex.split(line)[1:]) == 0


def run(command: list[str], cwd: Path) -> str:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        command, cwd=cwd, env=os.environ | {"PATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (command, done.stdout, done.stderr)
    return done.stdout


@pytest.mark.site
def test_the_page_is_followed_word_by_word(tmp_path: Path) -> None:
    files(tmp_path)
    for line in COMMANDS:
        run(shlex.split(line), tmp_path)
    assert "HIGHEST MATCH left out" in (tmp_path / "results" / "leaderboard.md").read_text()


def test_the_example_prints_a_row(tmp_path: Path) -> None:
    printed = run([sys.executable, str(REPOSITORY / "examples" / "own_odometry.py")], tmp_path)
    assert re.search(r"LINEAR - HUBER: [-+][\d.]+ deg/m", printed)
