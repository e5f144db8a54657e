"""The pages for someone with a real folder, followed word by word; only the path of the folder is another."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import simplejpeg

from mixo_env.cli.main import main
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.dataset import VERSION, simulate

REPOSITORY = Path(__file__).parent.parent
PAGES = ("nuscenes.md", "faults.md", "faults-recordings.md")
WIDTH, HEIGHT = 320, 180
FOLDER = "/data/nuscenes"
NAMES = {"scene-2001": "scene-0061", "scene-2002": "scene-0103"}
"""Of the simulated scenes -> as the pages call them."""


def commands(page: str) -> list[str]:
    """Lines of the page's blocks of commands, in order."""
    blocks = re.findall(r"```sh\n(.*?)```", (REPOSITORY / "docs" / page).read_text(), re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line]


def stand_in(folder: Path) -> Path:
    """A small simulated folder with two names and the version of a real one, and pictures that cost nothing."""
    root = folder / "nuscenes"
    config = SimulationConfig(
        scenes=4, scenes_per_log=1, seconds=2, width=WIDTH, height=HEIGHT, night=0.0, images=False
    )
    simulate(config, root)
    (root / VERSION).rename(root / "v1.0-trainval")
    table = root / "v1.0-trainval" / "scene.json"
    table.write_text(
        json.dumps([row | {"name": NAMES.get(row["name"], row["name"])} for row in json.loads(table.read_text())])
    )
    for path in [*(root / "can_bus").iterdir(), *(root / "exact").iterdir()]:
        for old, new in NAMES.items():
            if path.name.startswith(old):
                path.rename(path.with_name(path.name.replace(old, new)))
    names = [row["filename"] for row in json.loads((root / "v1.0-trainval" / "sample_data.json").read_text())]
    write_pictures(root, sorted((name for name in names if name.endswith(".jpg")), key=lambda name: Path(name).name))
    return root


def write_pictures(root: Path, names: list[str]) -> None:
    """One texture that slides to the right, from picture to picture, whatever the camera."""
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT // 6, WIDTH // 3), np.uint8)
    texture = cv2.resize(noise, (2 * WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    for number, name in enumerate(names):
        left = WIDTH - 4 * number % WIDTH
        picture = np.ascontiguousarray(texture[:, left : left + WIDTH, None])
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(simplejpeg.encode_jpeg(picture, quality=70, colorspace="GRAY"))


def test_every_page_has_commands():
    assert all(len(commands(page)) >= 3 for page in PAGES)
    assert all(line.startswith(("mixo ", "python -m ")) for page in PAGES for line in commands(page))


def test_every_command_of_the_pages_is_understood(tmp_path, monkeypatch, capsys):
    """Options and names are right: a folder that is not there is the first thing each complains about."""
    monkeypatch.chdir(tmp_path)
    for line in {line for page in PAGES for line in commands(page) if line.startswith("mixo ")}:
        words = list(shlex.split(line.split(" > ")[0])[1:])
        assert main(words) in (1, 2)
        message = capsys.readouterr().err
        assert re.search(r"/data/nuscenes is not a folder|recorded|no folder 'inertial'", message), (line, message)


@pytest.mark.site
def test_the_pages_are_followed_word_by_word(tmp_path):
    root = stand_in(tmp_path)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(REPOSITORY), "OMP_NUM_THREADS": "1"}
    for page in PAGES:
        work = tmp_path / page
        work.mkdir()
        for line in commands(page):
            done = subprocess.run(
                ["bash", "-c", line.replace(FOLDER, str(root))],
                cwd=work,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
            )
            if "paper736" in line:
                assert done.returncode == 1
                assert "paper736 is 850 scenes" in done.stderr
            else:
                assert done.returncode == 0, (line, done.stdout, done.stderr)
        if page == "nuscenes.md":
            assert json.loads((work / "report.json").read_text())["is_sound"]
            assert (work / "results" / "leaderboard.md").stat().st_size > 500
