"""evo (Michael Grupp, GPL) as a yardstick for absolute and relative errors."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments.peers.environments import EVO, peer_python


def evo_python() -> Path | None:
    """The interpreter of evo's environment, created if need be; ``None`` when it cannot be."""
    return peer_python(EVO)


def evo_scores(
    python: Path,
    pairs: Sequence[tuple[Path, Path]],
    lengths_m: Sequence[float],
    align: str = "none",
    *,
    details: bool = True,
) -> dict[str, Any]:
    """Let evo score pairs of TUM files whose times agree; see :mod:`experiments.peers.evo_api` for the result.

    Args:
        python: from :func:`evo_python`.
        pairs: truth and estimate.
        lengths_m: path lengths of the relative errors.
        align: ``"none"``, ``"se3"``, ``"sim3"``, or ``"origin"`` (the first pose).
        details: return the statistics, not only the time.
    """
    job = {
        "pairs": [[str(file) for file in pair] for pair in pairs],
        "lengths": list(lengths_m),
        "align": align,
        "details": details,
    }
    run = subprocess.run(
        [str(python), str(Path(__file__).with_name("evo_api.py"))],
        input=json.dumps(job),
        capture_output=True,
        text=True,
        check=True,
        # evo writes its settings into the home folder: give it one of its own.
        env={**os.environ, "OMP_NUM_THREADS": "1", "HOME": str(python.parents[1])},
    )
    return json.loads(run.stdout)
