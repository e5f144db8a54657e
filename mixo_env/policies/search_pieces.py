"""The pieces of a grid search: done in parallel, each kept in a file of its own, so that a killed search goes on."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from mixo_env.errors import ConfigurationError, OutputError
from mixo_env.files import writable_folder, write_json
from mixo_env.policies.gates import FloatArray, Lesson, Schedule, Setting, errors_after
from mixo_env.policies.search import BATCH, Grid, Piece, lessons, updates_of
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.processes import KILLED, Killed, each

IDENTITY = "search.json"
"""What the pieces of a folder belong to."""

SAMPLED_UPDATES = 4
"""Of every size of network, to tell how long a search takes."""


class Pieces:
    """Computes pieces on some recordings, or finds them in the folder.

    Attributes:
        folds: of the recordings, each held out once.
        updates: of the whole schedule.
        linear: LINEAR's error on each fold [deg/s].
    """

    def __init__(
        self, recordings: Recordings, track: str, folder: Path, workers: int, scheduler: str | None = None
    ) -> None:
        """Look at the folds.

        Raises:
            ConfigurationError: with fewer than three folds, of which pairs could be held out.
            OutputError: the folder cannot be written.
        """
        self.folds = tuple(sorted({scene.fold for scene in recordings.scenes if scene.fold >= 0}))
        if len(self.folds) < 3:
            raise ConfigurationError(
                f"a search needs three folds or more, got {len(self.folds)}: record scenes of more logs"
            )
        if workers < 1:
            raise ConfigurationError(f"workers must be at least 1, got {workers}")
        self._recordings, self._track = recordings, track
        self._folder, self._workers, self._scheduler = writable_folder(folder), workers, scheduler
        self._seen: dict[tuple[int, ...], tuple[Lesson, list[Lesson]]] = {}
        self.linear = tuple(self._look((fold,))[0] for fold in self.folds)
        self.updates = max(updates_of(self._seen[(fold,)][0]) for fold in self.folds)

    def claim(self, grid: Grid) -> None:
        """Make the folder that of this search.

        Raises:
            ConfigurationError: it holds another one, or what another version of the data gave.
        """
        scenes = {scene.name: scene.values_hash for scene in self._recordings.scenes if scene.fold >= 0}
        own = {
            "data_version": self._recordings.manifest.data_version,
            "track": self._track,
            "updates": self.updates,
            "data": hashlib.sha256(json.dumps(scenes, sort_keys=True).encode()).hexdigest(),
            "grid": [list(values) for values in astuple(grid)],
        }
        path = self._folder / IDENTITY
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            write_json(path, own)
            return
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"{path} cannot be read ({error}): choose another folder by --out") from None
        if not isinstance(found, dict) or found != own:
            other = [key for key in own if not isinstance(found, dict) or found.get(key) != own[key]]
            raise ConfigurationError(
                f"{self._folder} holds a search of another {', '.join(other)}: choose another folder by --out"
            )

    def compute(
        self, pieces: Sequence[Piece], report: Callable[[int, int], None] = lambda *_: None
    ) -> list[FloatArray]:
        """Errors of all pieces, in order; those that the folder has are not done again.

        Args:
            pieces: to do.
            report: told how much is done, and of how much, in updates of gates.

        Raises:
            ConfigurationError: a worker was killed again and again.
        """
        names = [_name(piece) for piece in pieces]
        found = {name: self._kept(name, piece) for name, piece in zip(names, pieces, strict=True)}
        size = {name: len(piece.settings) * piece.updates for name, piece in zip(names, pieces, strict=True)}
        todo = {name: self._task(piece) for name, piece in zip(names, pieces, strict=True) if found[name] is None}
        done = sum(size[name] for name in names if name not in todo)
        for name, errors in each(_work, todo, self._workers, self._scheduler):
            if isinstance(errors, Killed):
                raise ConfigurationError(f"a piece of the search failed: {KILLED}")
            write_json(self._folder / "pieces" / f"{name}.json", errors.tolist())
            found[name] = errors
            done += size[name]
            report(done, sum(size.values()))
        return [found[name] for name in names]  # type: ignore[misc]

    def expected_s(self, settings: Sequence[Setting], updates_of_all: float) -> float:
        """Seconds that a search takes on cores of its own, told from a few updates of a few gates of every size.

        Args:
            settings: of the grid; one in a hundred is tried.
            updates_of_all: updates of every setting on every fold, on average.
        """
        training, others = self._seen[(self.folds[0],)]
        schedule = Schedule(BATCH, self.updates, seed=0)
        judged = [Lesson(*(values[..., :BATCH] for values in others[0]))]
        total = 0.0
        for sizes in sorted({setting.sizes for setting in settings}):
            alike = [setting for setting in settings if setting.sizes == sizes]
            sample = alike[:: max(1, len(alike) // 4)][:4]
            errors_after(sample, training, judged, schedule, 1)
            begun = time.process_time()
            errors_after(sample, training, judged, schedule, SAMPLED_UPDATES)
            total += (time.process_time() - begun) / SAMPLED_UPDATES / len(sample) * len(alike)
        return total * updates_of_all * len(self.folds) / self._workers

    def _look(self, held_out: tuple[int, ...]) -> list[float]:
        training, others, linear = lessons(self._recordings, self._track, held_out)
        self._seen[held_out] = training, others
        return linear

    def _task(self, piece: Piece) -> tuple[Any, ...]:
        if piece.held_out not in self._seen:
            self._look(piece.held_out)
        return piece, *self._seen[piece.held_out], Schedule(BATCH, self.updates, piece.seed)

    def _kept(self, name: str, piece: Piece) -> FloatArray | None:
        """What an earlier run left; nothing if it is not whole."""
        try:
            rows = json.loads((self._folder / "pieces" / f"{name}.json").read_text(encoding="utf-8"))
            errors = np.array([[np.inf if value is None else value for value in row] for row in rows], np.float64)
        except FileNotFoundError:
            return None
        except (ValueError, TypeError):
            return None
        except OSError as error:
            raise OutputError(f"{self._folder} cannot be read ({error}): set permissions, or choose another") from error
        return errors if errors.shape == (len(piece.held_out), len(piece.settings)) else None


def _name(piece: Piece) -> str:
    return hashlib.sha256(json.dumps(astuple(piece)).encode()).hexdigest()[:20]


def _work(piece: Piece, training: Lesson, held_out: list[Lesson], schedule: Schedule) -> FloatArray:
    return errors_after(piece.settings, training, held_out, schedule, piece.updates)
