"""What every table and figure of the paper is made from, and what is said where one cannot be made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from mixo_env.errors import RecordingError
from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.board import Leaderboard, Standings
from mixo_env.leaderboard.figures import shown_rows
from mixo_env.leaderboard.paper.printed import TABLE_1
from mixo_env.leaderboard.rows import Row
from mixo_env.metrics.absolute import SceneAbsolute
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.presets import data_label
from mixo_env.recordings.schema import UNEQUAL
from mixo_env.recordings.store import DEFAULT_RECORDINGS, TIMINGS_FILE, bundled_recordings, read_columns
from mixo_env.recordings.truths import with_truth
from mixo_env.recordings.variants import variants

PAPER_TRACK = "PAPER"
FRONT = "CAM_FRONT"


class NotHereError(RecordingError):
    """A table or figure needs what these recordings, or the rows asked for, do not have; one line says what."""


@dataclass(frozen=True)
class Subject:
    """One track of a leaderboard.

    Attributes:
        board: with its protocol.
        standings: of the track.
        recordings: as they were opened, with all folds.
        spent_ms: camera, or JOINT -> median CPU time of an image or of a step; empty: not recorded.
    """

    board: Leaderboard
    standings: Standings
    recordings: Recordings
    spent_ms: Mapping[str, float]

    @property
    def track(self) -> str:
        """Who votes."""
        return self.standings.track

    @property
    def rows(self) -> dict[str, Row]:
        """Name -> row; one that was tested on one fold alone comes last."""
        everywhere = {row.name: row for row in self.standings.rows}
        return everywhere | {row.name: row for row in self.standings.one_fold_rows if row.name not in everywhere}

    @property
    def judged(self) -> Recordings:
        """The scored scenes, with the headline's truth."""
        return with_truth(self.board.recordings, self.board.headline)

    @property
    def data(self) -> str:
        """What captions call our data."""
        scenes, logs = len(self.board.recordings), self.board.logs
        label = data_label(self.board.recordings.manifest)
        clock = ", key frames" if self.board.protocol.trial.ground_truth == "keyframes" else ""
        return f"{label}, {scenes} scenes of {logs} logs, track {self.track}{clock}"

    def row(self, name: str) -> Row:
        """A row by name.

        Raises:
            NotHereError: when it was not run.
        """
        if name not in self.rows:
            raise NotHereError(f"row {name} was not run or is not recorded")
        return self.rows[name]

    def by_length(self) -> list[Row]:
        """The rows of Fig. 7: the paper's without its variants, and HUBER; of imports alone those that fit a picture.

        Raises:
            NotHereError: when no scene is long enough for a piece.
        """
        alike = variants(self.board.recordings)
        names = [name for name in (*(line.name for line in TABLE_1), "HUBER") if name not in alike]
        found = [self.rows[name] for name in names if name in self.rows] or shown_rows(self.board, self.standings)
        long = [row for row in found if any(at.samples for at in row.lengths)]
        if not long:
            raise NotHereError("no scene is long enough for a piece")
        return long

    def cameras(self) -> tuple[str, ...]:
        """The cameras.

        Raises:
            NotHereError: without any.
        """
        if not self.board.recordings.manifest.cameras:
            raise NotHereError("these recordings have no cameras")
        return self.board.recordings.manifest.cameras

    def absolute(self, row: Row) -> SceneAbsolute:
        """Of every scene, against the headline's truth."""
        return row.errors[self.board.headline].absolute


def subject_of(board: Leaderboard, recordings: Recordings, folder: Path | None) -> Subject:
    """The paper's own track where it was run, else the first.

    Args:
        board: that was built of the recordings.
        recordings: as they were opened.
        folder: they lie in, for their timings; ``None``: none are known.
    """
    by_track = {standings.track: standings for standings in board.standings}
    first = next((one for one in board.standings if one.track != UNEQUAL), board.standings[0])
    spent_ms = {} if folder is None else median_spent_ms(folder)
    return Subject(board, by_track.get(PAPER_TRACK, first), recordings, spent_ms)


def folder_of(source: Path | None) -> Path:
    """Where recordings lie that :func:`~mixo_env.recordings.store.load_recordings` opens."""
    name = DEFAULT_RECORDINGS if source is None else str(source)
    return Path(str(files("mixo_env.recordings") / "data" / name)) if name in bundled_recordings() else Path(name)


def median_spent_ms(folder: Path) -> dict[str, float]:
    """Camera -> median CPU time of an image [ms], JOINT -> of the solve of a step; empty without timings."""
    path = folder / TIMINGS_FILE
    if not path.exists():
        return {}
    timings, _, _ = read_columns(path.read_bytes())
    names = timings["camera"].astype(str)
    spent = {str(name): timings["expert_ms"][names == name] for name in np.unique(names)}
    return {name: float(np.nanmedian(values)) for name, values in spent.items() if np.isfinite(values).any()}


def marked(row: Row) -> str:
    """Its name, with the mark of rows that read the truth."""
    return row.name + (" †" if row.run.privileged else "")


def yaw_error_rad(subject: Subject, row: Row) -> FloatArray:
    """``(rows,)`` of the row's yaw increments against the headline's truth."""
    return row.run.travel.yaw_increment_rad - subject.judged["truth.yaw_increment_rad"]
