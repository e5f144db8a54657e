"""`mixo` itself: its version, its help, and an output that nobody reads to the end."""

from __future__ import annotations

import subprocess
import sys

import pytest

from mixo_env import __version__

MIXO = [sys.executable, "-m", "mixo_env.cli.main"]


def test_version() -> None:
    done = subprocess.run([*MIXO, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"mixo {__version__}\n", "")


def test_help_tells_of_version_and_completion() -> None:
    done = subprocess.run([*MIXO, "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "--version" in done.stdout
    assert "mixo --tyro-print-completion bash" in " ".join(done.stdout.split())


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts_know_the_subcommands(shell: str) -> None:
    done = subprocess.run([*MIXO, "--tyro-print-completion", shell], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "train-vocabulary" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "advice"),
    [
        (["--tyro-print-completion", "tcsh"], "bash, zsh and fish"),
        (["--tyro-write-completion", "bash", "/no/x"], "folder"),
    ],
    ids=["unknown shell", "unknown folder"],
)
def test_a_completion_that_cannot_be_written_is_one_line(arguments: list[str], advice: str) -> None:
    done = subprocess.run([*MIXO, *arguments], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert advice in done.stderr


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["benchmark", "--help"]], ids=" ".join)
def test_a_reader_that_goes_away_is_no_traceback(arguments: list[str]) -> None:
    with subprocess.Popen([*MIXO, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()  # long before the interpreter has started
        complaint = process.stderr.read()
    assert (process.returncode, complaint) == (141, "")
