"""Rows of the tables, computed in this process or in several: the same to the last bit."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.files import write_bytes
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import Truth, noisy_truth
from mixo_env.leaderboard.noise import NOISE_FLOOR
from mixo_env.leaderboard.rows import Row, Scorer
from mixo_env.recordings.processes import KILLED, Killed, check_workers, each

MOST_WORKERS = 4
"""Each holds the recordings and what is learned from: 0.55 GB with the bundled ones."""

ROWS_A_WORKER = 10
"""A process takes some 4 s to start, and a bundled row about half of one: fewer do not pay."""


@dataclass(frozen=True)
class Place:
    """Where a row stands.

    Attributes:
        night: in the tables of the scenes that are in no fold.
        track: whose experts vote.
        name: of the row.
    """

    night: bool
    track: str
    name: str

    def __str__(self) -> str:
        """For messages."""
        return f"{'night, ' if self.night else ''}{self.track}: {self.name}"


class Contest:
    """What the rows of all tracks share: scenes, truths, and how a run is scored.

    Args:
        protocol: scenes, folds, seeds.
        lenient: a policy that does not fit the recordings has no row.
        patient: nor has one that is too slow to fit, unless patient.
    """

    def __init__(self, protocol: CrossValidation, lenient: bool, patient: bool = False) -> None:
        """Prepare the truths."""
        self.protocol, self._lenient, self._patient = protocol, lenient, patient
        self.truths = {truth: Truth(protocol.recordings, truth) for truth in protocol.truths}
        headline = protocol.truths[0]
        self.floor = 0.0
        self.noisy = headline != "exact" and "INERTIAL" in protocol.recordings.manifest.inertial
        if self.noisy:
            noisy = self.truths[headline].measure(noisy_truth(protocol.recordings))
            samples = noisy.relative.rotation_deg_per_m
            self.floor = float(samples.mean()) if len(samples) else 0.0
        self.scorer = Scorer(protocol.recordings, self.truths, self.floor, protocol.trial.seed)

    def shows(self, name: str) -> bool:
        """Whether its tables have a row at all."""
        return (self.noisy or name != NOISE_FLOOR) and not (
            self.protocol.out_of_distribution and self.protocol.expensive(name)
        )

    def row(self, track: str, name: str) -> Row | PolicyError:
        """One row, or why there is none.

        Raises:
            PolicyError: the same, unless lenient.
        """
        folds = self.protocol.tested_folds[-1:] if self.protocol.expensive(name) else None
        try:
            if self._lenient and not self._patient and self.protocol.slow(name):
                self.protocol.check_fitted(name, track, folds)
            return self.scorer.row(track, self.protocol.run(name, track, folds=folds))
        except PolicyError as error:
            if not self._lenient:
                raise
            return error


def usual_workers(rows: int) -> int:
    """As many processes as pay for so many rows."""
    from joblib import cpu_count  # knows of containers and of cores that are set apart

    return max(1, min(cpu_count(), MOST_WORKERS, rows // ROWS_A_WORKER))


def compute(
    contests: Sequence[Contest], places: Sequence[Place], workers: int, progress: Callable[[int, int], None]
) -> dict[Place, Row | PolicyError]:
    """Every row, or why there is none.

    Args:
        contests: by day, and by night where there is one.
        places: of the rows.
        workers: processes; 1 stays in this one.
        progress: told how many rows are done, and of how many.

    Raises:
        PolicyError: when a policy asked for by name does not fit the recordings.
        ConfigurationError: for no workers, or when one was killed again and again.
    """
    check_workers(workers)
    protocol = contests[0].protocol
    at_home = {place: workers == 1 or protocol.strange(place.name) for place in places}
    found: dict[Place, Row | PolicyError] = {}

    def note(place: Place, row: Row | PolicyError) -> None:
        found[place] = row
        progress(len(found), len(places))

    progress(0, len(places))
    for place in (place for place, here in at_home.items() if here):
        note(place, contests[place.night].row(place.track, place.name))
    abroad = [place for place, here in at_home.items() if not here]
    if not abroad:
        return found
    with TemporaryDirectory(prefix="mixo-") as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "A worker stopped while some jobs")  # it grew much, and another goes on
        given = Path(folder) / "contests"
        write_bytes(given, pickle.dumps(tuple(contests), pickle.HIGHEST_PROTOCOL))
        slow_first = sorted(abroad, key=lambda place: (not protocol.slow(place.name), not protocol.learns(place.name)))
        tasks = {str(place): (given, place) for place in slow_first}
        for name, result in each(_row, tasks, workers):
            if isinstance(result, Killed):
                raise ConfigurationError(f"{name} was not computed: {KILLED}")
            place = tasks[name][1]
            row = result if isinstance(result, PolicyError) else _whole(result, contests[place.night])
            note(place, row)
    return found


def _row(given: Path, place: Place) -> Row | PolicyError:
    row = _contests(given)[place.night].row(place.track, place.name)
    return row if isinstance(row, PolicyError) else _lean(row)


@lru_cache(maxsize=1)
def _contests(given: Path) -> tuple[Contest, ...]:
    """Opened once in every worker; written by its own parent."""
    import torch  # noqa: F401  # imported by a later row, it would look like a leak to joblib, which ends such a worker

    return pickle.loads(given.read_bytes())


def _lean(row: Row) -> Row:
    """Without the pieces of path, half of its bytes: all rows share them."""
    none = np.zeros(0)
    shared = {"length_m": none, "scene": none, "start": none, "end": none}
    errors = {
        truth: replace(errors, relative=replace(errors.relative, **shared)) for truth, errors in row.errors.items()
    }
    return replace(row, errors=errors)


def _whole(row: Row, contest: Contest) -> Row:
    """With them again."""
    errors = {}
    for truth, lean in row.errors.items():
        pairs = contest.truths[truth].pairs
        shared = {"length_m": pairs.length_m, "scene": pairs.scene, "start": pairs.start, "end": pairs.end}
        errors[truth] = replace(lean, relative=replace(lean.relative, **shared))
    return replace(row, errors=errors)
