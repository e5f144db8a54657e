"""`mixo benchmark` as a user runs it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from mixo_env.cli.benchmark import Benchmark
from mixo_env.cli.main import main
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings

FILES = {"leaderboard.md", "leaderboard.json", "scenes.csv", "trajectories.png", "configuration.json", "drives.json"}
FILES |= {"report.html", "trajectories.zip"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings") / "small"
    save_recordings(synthetic_recordings(0, scenes=4, steps=80), folder)
    return folder


def mixo(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1]), "COLUMNS": "80"}
    command = [sys.executable, "-W", "error", "-m", "mixo_env.cli.main", "benchmark", *arguments]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)


def test_benchmark_prints_tables_and_saves_everything(folder: Path, tmp_path: Path) -> None:
    chosen = ("--tracks", "VISION", "--policies", "cam-front", "LINEAR", "perfect-yaw")
    done = mixo("--recordings", str(folder), *chosen, "--seed", "3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Track VISION" in done.stdout
    assert "PERFECT YAW †" in done.stdout
    assert "claims no ranking" in done.stdout
    latest = tmp_path / "results/latest"
    assert latest.is_symlink()
    assert {path.name for path in latest.iterdir()} == FILES
    configuration = msgspec.json.decode((latest / "configuration.json").read_bytes())
    assert configuration["policies"] == ["CAM_FRONT", "LINEAR", "PERFECT YAW"]
    assert configuration["seed"] == 3
    assert configuration["data_version"] == "synthetic-0"
    assert len(configuration["scenes"]) == 4
    assert configuration["recordings"] == str(folder)


def test_same_seed_same_files(folder: Path, tmp_path: Path) -> None:
    for out in ("a", "b"):
        Benchmark(folder, ("CONSUMER",), ("LINEAR", "HUBER", "ORACLE ALL"), out=tmp_path / out).run()
    for name in FILES:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name
    assert not (tmp_path / "latest").exists()


BAD = [
    (("--policies", "LINAER"), 2, "mixo: unknown policy 'LINAER': did you mean 'LINEAR'? Valid: "),
    (("--tracks", "VISON"), 2, "mixo: unknown track 'VISON': did you mean 'VISION'? Valid: "),
    (("--recordings", "absent/folder"), 1, "mixo: absent/folder: expected a folder with manifest.json, found none"),
]


def given(folder: Path, arguments: tuple[str, ...]) -> tuple[str, ...]:
    return arguments if "--recordings" in arguments else ("--recordings", str(folder), *arguments)


@pytest.mark.parametrize(("arguments", "code", "message"), BAD)
def test_bad_input_is_one_clear_line(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    code: int,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["benchmark", *given(folder, arguments)]) == code
    printed = capfd.readouterr()
    assert printed.err.startswith(message)
    assert printed.err.count("\n") == 1
    assert printed.out == ""
    assert not any(tmp_path.iterdir())


def test_bad_input_ends_the_process_with_its_code_and_line(folder: Path, tmp_path: Path) -> None:
    arguments, code, message = BAD[-1]
    done = mixo(*given(folder, arguments), cwd=tmp_path)
    assert done.returncode == code
    assert done.stderr.startswith(message)
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
    assert not any(tmp_path.iterdir())
