"""Where runs leave their files: one folder per run, and ``results/latest`` pointing at the last one."""

from __future__ import annotations

import os
import time
from pathlib import Path

from mixo_env.files import writable_folder

RESULTS = Path("results")


def run_folder(command: str, out: Path | None) -> Path:
    """The folder of a new run: ``out``, or ``results/<command>-<date>-<time>``; it exists and takes files.

    Raises:
        OutputError: when it does not: call this before the work.
    """
    return writable_folder(out or RESULTS / f"{command}-{time.strftime('%Y%m%d-%H%M%S')}")


def point_latest(folder: Path) -> None:
    """Make ``results/latest`` a link to ``folder`` if that lies directly in ``results``; else leave it alone."""
    if folder.resolve().parent != RESULTS.resolve():
        return
    link, part = RESULTS / "latest", RESULTS / f".latest-{os.getpid()}"
    part.unlink(missing_ok=True)
    part.symlink_to(folder.resolve().name, target_is_directory=True)
    part.replace(link)
