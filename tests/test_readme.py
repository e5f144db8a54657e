"""What README.md says can be run: its Python as written, its commands with small folders in place of big ones."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mixo_env.cli.main import main
from mixo_env.cli.simulate import Simulate
from tests.odometry_files import write_set
from tests.test_pages_folders import FOLDER, stand_in

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
PYTHON = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
BLOCKS = [
    [line.removeprefix("$ ") for line in block.splitlines() if line.startswith("$ ")]
    for block in re.findall(r"```console\n(.*?)```", README, re.DOTALL)
]
LINES = [line for block in BLOCKS for line in block]
COMMANDS = [line for line in LINES if line.startswith("mixo ")]
SIMULATE = "mixo simulate "
"""Draws two scenes at full size, minutes: only parsed; a smaller city stands in for what it would write."""
ABSENT = "is not a folder", "no folder '", "No module named 'my_policy'", "found nothing there"


def test_every_line_is_of_a_kind_that_is_tested() -> None:
    assert len(PYTHON) >= 1
    assert len(COMMANDS) >= 8
    assert all(line.startswith(("mixo ", "make ")) for line in LINES)
    marks = re.findall(r"^```(\w*)$", README, re.MULTILINE)
    assert set(marks) == {"python", "console", ""}
    assert len(marks) == 2 * (len(PYTHON) + README.count("```console"))


@pytest.mark.parametrize("code", PYTHON)
def test_python_runs_as_written(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(code, "README.md", "exec"), {"__name__": "__main__"})
    assert re.fullmatch(r"scene-\d+: return -?[\d.]+, ATE [\d.]+ m\n", capsys.readouterr().out)


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_is_understood(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Options and names are right: a file that is not there is the first thing it complains about."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Simulate, "run", lambda self: 0)  # needs no file
    code = main(shlex.split(line, comments=True)[1:])
    complaint = capsys.readouterr().err
    if line.startswith(SIMULATE):
        assert (code, complaint) == (0, "")
    else:
        assert code == 1, (line, complaint)
        assert any(absent in complaint for absent in ABSENT), (line, complaint)


def prepare(work: Path) -> None:
    """What a reader has: a nuScenes folder, a simulated one, a policy, somebody's trajectories."""
    stand_in(work)
    (work / "city").symlink_to(work / "nuscenes")
    policy = (ROOT / "examples" / "own_policy.py").read_text(encoding="utf-8")
    (work / "my_policy.py").write_text(policy.replace("Surest", "Mine"), encoding="utf-8")
    folders = write_set(work, {"orb": 1e-3, "dso": 2e-3}, sequences=5, poses=300)
    folders["groundtruth"].rename(work / "truth")
    for name, source in {"truth": "truth", "mine": "orb", "theirs": "dso"}.items():
        shutil.copy(work / source / "drive00.txt", work / f"{name}.txt")


@pytest.mark.site
@pytest.mark.parametrize("block", [block for block in BLOCKS if block[0] in COMMANDS], ids=lambda block: block[0][:20])
def test_the_commands_are_followed_word_by_word(block: list[str], tmp_path: Path) -> None:
    """In order, as one reader would; only the path of the real folder is another."""
    prepare(tmp_path)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    printed = {}
    for line in block:
        if line.startswith(SIMULATE):
            continue
        done = subprocess.run(
            ["bash", "-c", line.replace(FOLDER, str(tmp_path / "nuscenes"))],
            cwd=tmp_path,
            env=os.environ | {"PATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, (line, done.stdout, done.stderr)
        printed[line] = done.stdout
    tables = [out for line, out in printed.items() if line.startswith("mixo benchmark")]
    assert len(tables) == 1
    assert "LINEAR" in tables[0]
    assert ("ORB" in tables[0]) == ("mixo import" in block[0])
    scores = [out for line, out in printed.items() if line.startswith("mixo score")]
    assert all("SUREST - MIXO: " in out for out in scores)
    assert bool(scores) == ("mixo inspect" in block[0])


def test_what_make_is_asked_for_is_in_the_makefile() -> None:
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    asked = re.findall(r"(?:^\$ |`)make ([\w-]+)", README, re.MULTILINE)
    assert {"benchmark", "test"} <= set(asked)
    assert set(asked) <= set(targets)


def test_modules_and_files_that_it_names_exist() -> None:
    for module in re.findall(r"`python -m ([\w.]+)`", README):
        assert (ROOT / f"{module.replace('.', '/')}.py").is_file() or (ROOT / module.replace(".", "/")).is_dir(), module
    for path in re.findall(r"\]\(([^):#]+)(?:#[\w-]*)?\)", README):
        assert (ROOT / path).exists(), path
