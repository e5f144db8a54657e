"""How far a command is and how long it still takes: a bar on a terminal, now and then a line anywhere else."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

EVERY_S = 10.0
"""Between two lines where there is no terminal (a log file wants no bar)."""

Report = Callable[[int, int], None]
"""Called with what is done and with how much there is in all."""


@contextmanager
def progress(what: str) -> Iterator[Report]:
    """Report on standard error while the block runs.

    Args:
        what: is being done, e.g. ``"recording scenes"``.

    Yields:
        Call it as ``report(done, total)``, as often as there is news.
    """
    if not sys.stderr.isatty():
        yield _Lines(what)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


class _Lines:
    """A line every ``EVERY_S`` seconds; quick work stays silent."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._started = self._said = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        now = time.monotonic()
        if now - self._said < EVERY_S:
            return
        self._said = now
        left = f", {duration((now - self._started) / done * (total - done))} left" if done else ""
        print(f"{self._what}: {done} of {total}{left}", file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """A time to wait, as people say it: ``"40 s"``, ``"3 min 20 s"``, ``"2 h 5 min"``."""
    whole = max(round(seconds), 0)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
