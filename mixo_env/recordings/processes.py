"""Where parallel work runs: processes of this machine, or a Dask cluster; the code that uses them is the same."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mixo_env.errors import ConfigurationError


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
