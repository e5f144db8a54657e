"""Fitting many pieces of a folder of weights, in parallel; what is there already is not fitted again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache

from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.weights import part
from mixo_env.recordings.processes import KILLED, Killed, each
from mixo_env.recordings.store import load_recordings

Piece = tuple[str, str, int, int]
"""Row, track, held-out fold, repetition."""


class Training:
    """What is fitted, on what, into which folder.

    Args:
        source: folder or name of the recordings; ``None``: the bundled ones.
        trial: with a folder of weights.
    """

    def __init__(self, source: str | None, trial: Trial) -> None:
        """Nothing is opened yet, so that workers are handed little."""
        self._source, self._trial = source, trial

    @cached_property
    def division(self) -> CrossValidation:
        """The recordings, divided.

        Raises:
            RecordingError: when they cannot be read.
        """
        return CrossValidation(load_recordings(self._source), self._trial)

    def fit(self, pieces: Sequence[Piece], workers: int, report: Callable[[int, int], None] = lambda *_: None) -> None:
        """Fit the pieces that are not in the folder; the slow rows first, so that no worker waits for one at the end.

        Args:
            pieces: of :meth:`~mixo_env.leaderboard.crossvalidation.CrossValidation.pieces`.
            workers: processes, one thread each.
            report: told how many are done, and of how many.

        Raises:
            ConfigurationError: for no workers, or when one was killed again and again.
            PolicyError: when a fit fails.
            OutputError: when a piece cannot be written.
        """
        _division.cache_clear()
        slow_first = sorted(pieces, key=lambda piece: not self.division.expensive(piece[0]))
        tasks = {str(part(*piece)): (self._source, self._trial, piece) for piece in slow_first}
        report(0, len(tasks))
        for done, (name, result) in enumerate(each(_fit, tasks, workers), 1):
            if isinstance(result, Killed):
                raise ConfigurationError(f"{name} was not fitted: {KILLED}")
            report(done, len(tasks))


@lru_cache(maxsize=1)
def _division(source: str | None, trial: Trial) -> CrossValidation:
    """Opened once in every worker."""
    return CrossValidation(load_recordings(source), trial)


def _fit(source: str | None, trial: Trial, piece: Piece) -> None:
    _division(source, trial).fitted(*piece, keep=True)
