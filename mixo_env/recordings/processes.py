"""Where parallel work runs: processes of this machine, or a Dask cluster; the code that uses them is the same."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

from mixo_env.errors import ConfigurationError

logger = logging.getLogger(__name__)

ATTEMPTS_ALONE = 2
"""How often a task that may have killed its worker is tried again with the machine to itself."""

KILLED = "its worker was killed (out of memory?): use fewer workers"


@dataclass(frozen=True)
class Killed:
    """Stands for the result of a task whose worker was killed again and again."""


def each(
    function: Callable[..., Any], tasks: Mapping[str, tuple[Any, ...]], workers: int, scheduler: str | None = None
) -> Generator[tuple[str, Any], None, None]:
    """Call ``function`` for every task in parallel; results come as they are ready.

    A killed worker takes those down that work beside it, and nobody knows whose fault it was. So the tasks that were
    under way are tried again one by one, and the others go on in parallel.

    Args:
        function: of a task's arguments; must not raise but for what is to end the run.
        tasks: name -> arguments.
        workers: as in :func:`processes`.
        scheduler: likewise.

    Yields:
        Name of a task, and its result or :class:`Killed`.
    """
    from joblib import Parallel, delayed

    def results(names: list[str]) -> Iterator[tuple[str, Any]]:
        jobs = (delayed(_named)(name, function, tasks[name]) for name in names)
        parallel = Parallel(return_as="generator_unordered", batch_size=cast("str", 1))  # it takes numbers, too
        yield from cast("Iterator[tuple[str, Any]]", parallel(jobs))

    waiting = dict.fromkeys(tasks)
    with processes(workers, scheduler):
        while waiting:
            try:
                for name, result in results(list(waiting)):
                    del waiting[name]
                    yield name, result
            except _worker_killed(scheduler):
                suspects = list(waiting)[: 2 * workers]
                logger.warning("a worker was killed (out of memory?): trying %s again alone", ", ".join(suspects))
                for name in suspects:
                    del waiting[name]
                    yield name, _alone(lambda name=name: next(results([name]))[1], scheduler)


def _alone(attempt: Callable[[], Any], scheduler: str | None) -> Any:
    for _ in range(ATTEMPTS_ALONE):
        try:
            return attempt()
        except _worker_killed(scheduler):
            continue
    return Killed()


def _named(name: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[str, Any]:
    return name, function(*arguments)


def _worker_killed(scheduler: str | None) -> type[Exception]:
    """What joblib raises when a worker dies."""
    if scheduler is not None:
        from distributed import KilledWorker  # pyright: ignore[reportMissingImports]

        return KilledWorker
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    return TerminatedWorkerError


@contextmanager
def processes(workers: int, scheduler: str | None = None) -> Iterator[None]:
    """Inside the block, ``joblib.Parallel()`` runs there.

    Args:
        workers: processes on this machine, one thread each; 1 stays in this process.
        scheduler: address of a Dask scheduler, e.g. ``"tcp://10.0.0.1:8786"``; all its workers are used then, and they
            must see the data under the same paths.

    Raises:
        ConfigurationError: for no workers, or a scheduler that cannot be reached.
    """
    from joblib import parallel_config

    if workers < 1:
        raise ConfigurationError(f"workers must be at least 1, got {workers}")
    if scheduler is None:
        with parallel_config(backend="loky", n_jobs=workers, inner_max_num_threads=1):
            yield
        return
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ConfigurationError("a scheduler needs Dask: pip install 'mixo-env[cluster]'") from None
    try:
        client = Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"no Dask scheduler at {scheduler} ({error}): start one or leave it out") from None
    with client, parallel_config(backend="dask", n_jobs=-1):
        yield
