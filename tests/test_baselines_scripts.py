"""Every script in ``baselines/`` runs as a reader would run it, wherever they stand, and saves what it made."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mixo_env.policies.registry import POLICIES, load

ROOT = Path(__file__).parent.parent
SCRIPTS = sorted(path.name for path in (ROOT / "baselines").glob("*.py"))

SMALL = {
    "single_and_match.py": ("--policy", "INERTIAL"),
    "linear.py": ("--track", "PAPER"),
    "robust.py": ("--policy", "MEDIAN"),
    "oracle.py": ("--policy", "ORACLE HULL"),
    "mixo.py": ("--min-updates", "1", "--seed", "1"),
    "rl.py": ("--steps", "1024", "--environments", "16", "--parts", "1"),
    "budget.py": ("--on", "CAM_FRONT", "CAM_BACK"),
}
"""Script -> arguments that show a variant and keep it short."""

SAVED = {
    "single_and_match.py": "INERTIAL",
    "linear.py": "LINEAR",
    "robust.py": "MEDIAN",
    "oracle.py": "ORACLE HULL",
    "mixo.py": "MIXO",
    "rl.py": "PPO",
}
"""Script -> name of the policy it saves and prints."""


def run(script: Path, cwd: Path, *arguments: str) -> str:
    command = [sys.executable, str(script), "--recordings", "mixocity-paper", *arguments]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_every_script_has_its_test() -> None:
    assert set(SCRIPTS) == set(SMALL)


@pytest.mark.parametrize("script", sorted(SAVED))
def test_a_script_prints_its_row_beside_linear_and_saves_its_policy(script: str, tmp_path: Path) -> None:
    name = SAVED[script]
    printed = run(ROOT / "baselines" / script, tmp_path, *SMALL[script])  # another working directory
    rows = {line.split("  ")[0]: line for line in printed.splitlines()}
    privileged = name in POLICIES and POLICIES[name].privileged
    mark = " †" if privileged else " *" if name == "INERTIAL" else ""
    assert name + mark in rows, printed
    assert "LINEAR" in rows
    folder = tmp_path / "results" / "baselines" / Path(script).stem
    assert load(folder).name == name
    assert f"saved in {folder.relative_to(tmp_path)}" in printed


def test_more_cameras_cost_more_and_drive_better(tmp_path: Path) -> None:
    printed = run(ROOT / "baselines" / "budget.py", tmp_path, *SMALL["budget.py"])
    table = re.findall(r"^(none|CAM_FRONT CAM_BACK|all \(LINEAR\)) +([\d.]+) +([\d.]+) +([\d.]+)$", printed, re.M)
    cost_ms, yaw_deg, _ = zip(*(map(float, row[1:]) for row in table), strict=True)
    assert cost_ms[0] == 0.0 < cost_ms[1] < cost_ms[2]
    assert yaw_deg[0] > yaw_deg[1]
    assert (tmp_path / "results/baselines/budget/weights.json").is_file()


def test_a_script_runs_from_the_repository(tmp_path: Path) -> None:
    assert "LINEAR" in run(Path("baselines/linear.py"), ROOT, "--out", str(tmp_path / "here"))
    assert (tmp_path / "here" / "policy.safetensors").is_file()


@pytest.mark.parametrize("script", SCRIPTS)
def test_no_script_is_named_like_a_module(script: str) -> None:
    """Python puts a script's folder before everything else: a ``token.py`` there would break every neighbour."""
    name = Path(script).stem
    assert name not in sys.stdlib_module_names
    assert importlib.util.find_spec(name) is None


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_is_short(script: str) -> None:
    assert len((ROOT / "baselines" / script).read_text(encoding="utf-8").splitlines()) <= 110
