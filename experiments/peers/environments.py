"""Virtual environments of peers, created once per machine in the user's cache folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

EVO = "evo==1.38.1"
DEVKIT = "nuscenes-devkit==1.2.0"
ORBSLAM3 = "pyorbslam3==0.1.1"


def peer_python(requirement: str) -> Path | None:
    """The interpreter of an environment that holds ``requirement``, or ``None`` when pip cannot provide it.

    ``MIXO_PEERS`` names another folder than ``~/.cache/mixo-peers`` for the environments.

    Args:
        requirement: one pinned package, e.g. ``"evo==1.38.1"``; the environment is named after it.
    """
    root = Path(os.environ.get("MIXO_PEERS", "~/.cache/mixo-peers")).expanduser()
    folder = root / requirement.replace("==", "-")
    python, complete = folder / "bin" / "python", folder / "complete"
    if complete.exists():
        return python
    steps = ([sys.executable, "-m", "venv", "--clear", str(folder)], [str(python), "-m", "pip", "install", requirement])
    try:
        for step in steps:
            subprocess.run(step, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    complete.touch()
    return python
