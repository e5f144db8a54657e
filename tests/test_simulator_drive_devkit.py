"""The official devkit opens what we write; it lives in its own virtual environment."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from experiments.peers.environments import DEVKIT, peer_python
from mixo_env.nuscenes.selections import ALL_CAMERAS
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.dataset import simulate

SCRIPT = Path(__file__).parent.parent / "experiments" / "check_devkit.py"


@pytest.mark.integration
def test_official_devkit_opens_a_simulated_folder(tmp_path):
    python = peer_python(DEVKIT)
    if python is None:
        pytest.skip(f"{DEVKIT} cannot be installed here")
    config = SimulationConfig(scenes=2, scenes_per_log=1, seconds=3, width=320, height=180, cameras=ALL_CAMERAS)
    simulate(config, tmp_path / "city")
    result = subprocess.run([python, SCRIPT, tmp_path / "city"], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "0 findings" in result.stdout
