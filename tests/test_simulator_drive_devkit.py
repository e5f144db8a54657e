"""The official devkit opens what we write; it lives in its own virtual environment, named by MIXO_DEVKIT_PYTHON."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from mixo_env.nuscenes.selections import ALL_CAMERAS
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.dataset import simulate

SCRIPT = Path(__file__).parent.parent / "experiments" / "check_devkit.py"


@pytest.mark.integration
@pytest.mark.skipif("MIXO_DEVKIT_PYTHON" not in os.environ, reason="MIXO_DEVKIT_PYTHON: python with nuscenes-devkit")
def test_official_devkit_opens_a_simulated_folder(tmp_path):
    config = SimulationConfig(scenes=2, scenes_per_log=1, seconds=3, width=320, height=180, cameras=ALL_CAMERAS)
    simulate(config, tmp_path / "city")
    python = os.environ["MIXO_DEVKIT_PYTHON"]
    result = subprocess.run([python, SCRIPT, tmp_path / "city"], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "0 findings" in result.stdout
