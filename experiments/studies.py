"""What studies that print one table share: their command line, and the truth they measure against."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import MixoError, RecordingError
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import truths_of, with_truth
from mixo_env.tables import Table

logger = logging.getLogger(__name__)


class Study(Protocol):
    """A frozen dataclass that is a command line, too."""

    def run(self) -> Table:
        """What it prints."""
        ...


StudyKind = TypeVar("StudyKind", bound=Study)


def print_study(
    kind: type[StudyKind],
    arguments: Sequence[str] | None = None,
    form: Callable[[StudyKind, Table], str] = lambda _, table: table.text(),
) -> int:
    """Run the command line of a study.

    Args:
        kind: of study.
        arguments: of the command line; None: those of the process.
        form: how the table of a study is written.

    Returns:
        Exit code: 1 after an error of the user or of the data, which is one line of the log.
    """
    import tyro

    try:
        study = tyro.cli(kind, args=arguments)
        print(form(study, study.run()), end="")
    except MixoError as error:
        logger.error("%s", error)
        return 1
    return 0


def exact_turn(recordings: Recordings) -> NDArray[np.float64]:
    """``(rows,)`` exact yaw increments [rad], NaN at the start of a scene.

    Raises:
        RecordingError: without noise-free truth: the poses of real drives err as much as experts do.
    """
    if "exact" not in truths_of(recordings):
        raise RecordingError("expected recordings with exact truth (a simulated folder), got none")
    return with_truth(recordings, "exact")["truth.yaw_increment_rad"]
