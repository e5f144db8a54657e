"""`mixo simulate` as a user runs it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import tyro

from mixo_env.cli.main import main
from mixo_env.cli.simulate import Simulate
from mixo_env.simulator.config import SimulationConfig

ROOT = Path(__file__).parent.parent


def test_fields_of_the_configuration_are_the_command_line():
    command = tyro.cli(
        Simulate,
        args=["out", "--scenes", "3", "--seed", "5", "--no-images", "--workers", "2"],
    )
    assert command.out == Path("out")
    assert (command.config.scenes, command.config.seed, command.config.images, command.workers) == (3, 5, False, 2)
    command = tyro.cli(Simulate, args=["out", "--situations.lead-truck", "0.5", "--cameras", "CAM_FRONT", "CAM_BACK"])
    assert command.config.situations.lead_truck == 0.5
    assert command.config.cameras == ("CAM_FRONT", "CAM_BACK")
    assert tyro.cli(Simulate, args=["out"]).config == SimulationConfig()


def test_simulates_continues_and_refuses(tmp_path, capsys):
    out = str(tmp_path / "city")
    options = ("--scenes", "2", "--seconds", "2", "--no-images")
    first = subprocess.run(
        [sys.executable, "-m", "mixo_env.cli.main", "simulate", out, *options],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert first.returncode == 0, first.stderr
    assert "2 scenes" in first.stdout
    assert (tmp_path / "city" / "v1.0-mixo" / "scene.json").exists()
    assert main(["simulate", out, *options]) == 0
    capsys.readouterr()
    assert main(["simulate", out, *options, "--seed", "9"]) == 2
    message = capsys.readouterr().err
    assert "seed" in message
    assert len(message.strip().splitlines()) == 1


def test_disk_errors_end_with_exit_code_1(tmp_path, capsys):
    (tmp_path / "file").write_bytes(b"")
    assert main(["simulate", str(tmp_path / "file" / "city"), "--scenes", "1", "--no-images"]) == 1
    assert "cannot write" in capsys.readouterr().err


@pytest.mark.parametrize(
    "options", [["--scenes", "0"], ["--width", "640", "--height", "480"], ["--cameras", "CAM_FRNT"]]
)
def test_impossible_configurations_are_one_line(tmp_path, capsys, options):
    """The configuration is checked while the command line is read."""
    assert main(["simulate", str(tmp_path / "city"), *options]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (tmp_path / "city").exists()
