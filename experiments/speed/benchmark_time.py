"""What `mixo benchmark` costs: wall and CPU seconds of the whole command, start of Python and figures included.

Run ``python -m experiments.speed.benchmark_time``. The first run in a fresh checkout compiles and is not counted; other
programs on the machine lengthen the wall time, hardly the CPU time: both are printed, with the load they met.
"""

from __future__ import annotations

import hashlib
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from mixo_env.errors import ConfigurationError


@dataclass(frozen=True)
class BenchmarkTime:
    """Time the command, in processes of its own."""

    runs: int = 1
    """Timed runs, after one that compiles."""
    warm_up: bool = True
    """Without, the first timed run compiles what is not yet in the cache."""
    arguments: tuple[str, ...] = ()
    """Further arguments of `mixo benchmark`, e.g. ``--arguments=--tracks=VISION``; none: everything."""

    def run(self) -> int:
        """Measure and print; all runs must write the same leaderboard.json."""
        written = set()
        with tempfile.TemporaryDirectory() as folder:
            for number in range(not self.warm_up, self.runs + 1):
                out = Path(folder) / str(number)
                wall_s, cpu_s = timed([str(Path(sys.executable).with_name("mixo")), "benchmark", *self.arguments], out)
                written.add(hashlib.sha256((out / "leaderboard.json").read_bytes()).hexdigest()[:16])
                kind = f"run {number}" if number else "warm-up"
                print(
                    f"{kind:8s} wall {wall_s:6.1f} s  CPU {cpu_s:6.1f} s  {os.cpu_count()} cores, "
                    f"load {os.getloadavg()[0]:.1f}  leaderboard.json {', '.join(sorted(written))}",
                    flush=True,
                )
        return int(len(written) != 1)


def timed(command: list[str], out: Path) -> tuple[float, float]:
    """Wall and CPU seconds of a command and its children, which is to write into ``out``.

    Raises:
        ConfigurationError: if it fails.
    """
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True, check=False)
    wall_s, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise ConfigurationError(f"{' '.join(command)} failed: {done.stderr.strip()[-300:]}")
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    sys.exit(tyro.cli(BenchmarkTime, description=__doc__).run())
