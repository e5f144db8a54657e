"""Where parallel work runs: processes of this machine, or a Dask cluster; the code that uses them is the same."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
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
        scheduler: address of a Dask scheduler, e.g. ``"tcp://10.0.0.1:8786"``, to use instead.

    Yields:
        Name of a task, and its result or :class:`Killed`.
    """
    if scheduler is not None:
        yield from _each_on_cluster(function, tasks, scheduler)
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    def results(names: list[str]) -> Iterator[tuple[str, Any]]:
        jobs = (delayed(_named)(name, function, tasks[name]) for name in names)
        parallel = Parallel(return_as="generator_unordered", batch_size=cast("str", 1))  # it takes numbers, too
        yield from cast("Iterator[tuple[str, Any]]", parallel(jobs))

    waiting = dict.fromkeys(tasks)
    with processes(workers):
        while waiting:
            try:
                for name, result in results(list(waiting)):
                    del waiting[name]
                    yield name, result
            except TerminatedWorkerError:
                suspects = list(waiting)[: 2 * workers]
                _warn(suspects)
                for name in suspects:
                    del waiting[name]
                    yield name, _alone(lambda name=name: next(results([name]))[1], TerminatedWorkerError)


def _each_on_cluster(
    function: Callable[..., Any], tasks: Mapping[str, tuple[Any, ...]], scheduler: str
) -> Iterator[tuple[str, Any]]:
    """:func:`each` by Dask itself: joblib runs in this process while fewer than two workers are up."""
    with _client(scheduler) as client:
        from distributed import KilledWorker, as_completed  # pyright: ignore[reportMissingImports]

        names = {client.submit(function, *arguments, pure=False): name for name, arguments in tasks.items()}
        suspects: list[str] = []
        for future in as_completed(list(names)):
            name = names.pop(future)  # a finished future that nobody holds frees its memory on the cluster
            try:
                result = future.result()
            except KilledWorker:
                suspects.append(name)
                continue
            yield name, result
        if suspects:
            _warn(suspects)
        for name in suspects:
            again = partial(client.submit, function, *tasks[name], pure=False)
            yield name, _alone(lambda again=again: again().result(), KilledWorker)


def _warn(suspects: list[str]) -> None:
    logger.warning("a worker was killed (out of memory?): trying %s again alone", ", ".join(suspects))


def _alone(attempt: Callable[[], Any], killed: type[Exception]) -> Any:
    for _ in range(ATTEMPTS_ALONE):
        try:
            return attempt()
        except killed:
            continue
    return Killed()


def _named(name: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[str, Any]:
    return name, function(*arguments)


def check_workers(workers: int) -> None:
    """See that there are any.

    Raises:
        ConfigurationError: for none.
    """
    if workers < 1:
        raise ConfigurationError(f"workers must be at least 1, got {workers}")


@contextmanager
def processes(workers: int) -> Iterator[None]:
    """Inside the block, ``joblib.Parallel()`` runs there.

    Args:
        workers: processes on this machine, one thread each; 1 stays in this process.

    Raises:
        ConfigurationError: for no workers.
    """
    from joblib import parallel_config

    check_workers(workers)
    with parallel_config(backend="loky", n_jobs=workers, inner_max_num_threads=1):
        yield


def _client(scheduler: str) -> Any:
    """Connected to a Dask scheduler; all its workers are used, and they must see the data under the same paths.

    Raises:
        ConfigurationError: it cannot be reached.
    """
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise ConfigurationError("a scheduler needs Dask: pip install 'mixo-env[cluster]'") from None
    try:
        return Client(scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"no Dask scheduler at {scheduler} ({error}): start one or leave it out") from None
