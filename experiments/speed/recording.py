"""How much faster do two workers record than one, and how much faster could they on this machine?

    python -m experiments.speed.recording city --scenes 8

The bound is two commands of one worker side by side, each with half of the scenes: where it is below 2, cores share
memory, caches or the host with others, and no program can do better.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from mixo_env.nuscenes.tables import open_dataset


@dataclass(frozen=True)
class Recording:
    """Record the same scenes with one worker, with two, and as two commands."""

    folder: tyro.conf.Positional[Path]
    """A nuScenes folder with images, real or simulated."""
    scenes: int = 8
    """Of its scenes, from the first; an even number."""

    def run(self) -> int:
        """Print seconds and ratios."""
        names = open_dataset(self.folder).scene_names[: self.scenes]
        half = len(names) // 2
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder)
            self._seconds([(names[:1], out / "warm", 1)])  # compiled code and file cache
            one = self._seconds([(names, out / "one", 1)])
            two = self._seconds([(names, out / "two", 2)])
            apart = self._seconds([(names[:half], out / "first", 1), (names[half:], out / "second", 1)])
            same = (out / "one" / "recordings.parquet").read_bytes() == (
                out / "two" / "recordings.parquet"
            ).read_bytes()
        print(f"{len(names)} scenes: one worker {one:.1f} s, two {two:.1f} s, two commands side by side {apart:.1f} s")
        print(f"two workers {one / two:.2f} x one; the machine's own bound {one / apart:.2f} x")
        print(f"recordings {'equal to the byte' if same else 'DIFFER'}")
        return 0 if same else 1

    def _seconds(self, runs: Sequence[tuple[Sequence[str], Path, int]]) -> float:
        start = time.perf_counter()
        running = [
            subprocess.Popen(
                [
                    *(sys.executable, "-m", "mixo_env.cli.main", "record", str(self.folder), "--out", str(out)),
                    *("--workers", str(workers), "--scenes", *names),
                ],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            for names, out, workers in runs
        ]
        if any(process.wait() for process in running):
            raise SystemExit("a recording failed: run `mixo record` by hand")
        return time.perf_counter() - start


if __name__ == "__main__":
    sys.exit(tyro.cli(Recording).run())
