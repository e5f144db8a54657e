"""Where runs leave their files: one folder per run, and ``results/latest`` pointing at the last one."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

RESULTS = Path("results")


def run_folder(command: str, out: Path | None) -> Path:
    """The folder of a new run: ``out``, or ``results/<command>-<date>-<time>``; it exists afterwards."""
    folder = out or RESULTS / f"{command}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def point_latest(folder: Path) -> None:
    """Make ``results/latest`` a link to ``folder`` if that lies directly in ``results``; else leave it alone."""
    if folder.resolve().parent != RESULTS.resolve():
        return
    link, part = RESULTS / "latest", RESULTS / f".latest-{os.getpid()}"
    part.unlink(missing_ok=True)
    part.symlink_to(folder.resolve().name, target_is_directory=True)
    part.replace(link)


def write_text(path: Path, text: str) -> None:
    """Write a whole file atomically."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def write_json(path: Path, value: Any) -> None:
    """Write plain values or dataclasses as indented JSON, atomically; what is not a number becomes null."""
    import msgspec

    write_text(path, msgspec.json.format(msgspec.json.encode(value), indent=2).decode() + "\n")
