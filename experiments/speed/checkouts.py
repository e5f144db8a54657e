"""Two checkouts asked in turn for the same work: whether the results agree to the bit, and how the times compare.

Both answer in processes of their own and take turns piece by piece, so a machine that slows down slows both.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).parents[2]
"""Root of this checkout."""

Process = subprocess.Popen[str]
Work = Callable[[int], tuple[str, float]]


def serve(work: Work) -> None:
    """Answer each number on standard input with what ``work`` gives: a hash and milliseconds."""
    for line in sys.stdin:
        print(*work(int(line)), flush=True)


@contextmanager
def server(module: str, root: Path) -> Iterator[Process]:
    """A process that runs ``module --serve`` of the checkout ``root``."""
    command = [sys.executable, "-m", module, "--serve"]
    with subprocess.Popen(command, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process
        assert process.stdin is not None
        process.stdin.close()


def ask(process: Process, number: int) -> tuple[str, float]:
    """Hash and milliseconds of a piece of work."""
    assert process.stdin is not None
    assert process.stdout is not None
    print(number, file=process.stdin, flush=True)
    digest, took = process.stdout.readline().split()
    return digest, float(took)


def compare(
    processes: tuple[Process, Process], pieces: int, timed: Sequence[int], repeats: int
) -> tuple[list[int], NDArray[np.float64]]:
    """Ask both.

    Args:
        processes: the other checkout and this one.
        pieces: how many there are.
        timed: numbers of those whose time counts.
        repeats: how often these are asked for again.

    Returns:
        Numbers of the pieces that differ, and milliseconds ``(2, repeats, timed)``.
    """
    different = [number for number in range(pieces) if len({ask(process, number)[0] for process in processes}) > 1]
    times = np.empty((2, repeats, len(timed)))
    for repeat in range(repeats):
        for place, number in enumerate(timed):
            # Who comes second finds warmer shared caches: take turns in that as well.
            for which in ((0, 1), (1, 0))[repeat % 2]:
                times[which, repeat, place] = ask(processes[which], number)[1]
    return different, times


def ratio_of_medians(before: NDArray[np.float64], after: NDArray[np.float64]) -> tuple[float, float, float]:
    """Median over the repeats, summed over the pieces, before / after; with its 95 % interval by resampling.

    Args:
        before: ``(repeats, pieces)`` milliseconds.
        after: the same.
    """

    def ratio(chosen: NDArray[np.int64]) -> float:
        return float(np.median(before[chosen], axis=0).sum() / np.median(after[chosen], axis=0).sum())

    rng = np.random.default_rng(0)
    count = len(before)
    low, high = np.quantile([ratio(rng.integers(0, count, count)) for _ in range(2000)], (0.025, 0.975))
    return ratio(np.arange(count)), float(low), float(high)


def line(name: str, times: NDArray[np.float64]) -> str:
    """One row of the comparison, of milliseconds ``(2, repeats, pieces)``."""
    value, low, high = ratio_of_medians(times[0], times[1])
    before, after = (float(np.median(part, axis=0).mean()) for part in times)
    return f"{name:8s} {before:7.2f} -> {after:7.2f} ms each   before / after {value:.3f} [{low:.3f}, {high:.3f}]"
