"""How far can weighting go? Oracles that know how large every expert's errors are, but not the error of the step.

    python -m experiments.bounds                     VISION and CONSUMER, bundled recordings

A gate sees what goes along with an error: its size at best, never its sign. So what is measured here is what knowing
the sizes would gain: weights 1 / mean square of every expert's true errors in the steps around the one to be decided,
which itself is left out; then in past steps alone; then with that step told as well. And constant weights, fitted on
the log that they are scored on. The way from LINEAR to MULTICAMERA GT is the scale. None is a strict bound: a dozen
squares tell a size roughly, and whoever estimates biases uses their signs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.closing import FROM, TO, share
from experiments.studies import print_study
from mixo_env.fusion import least_squares_weights, mix
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import Errors, Truth, with_wheels
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.substitutes import substituted_increments
from mixo_env.recordings.truths import with_truth
from mixo_env.tables import Cell, Column, Table

FloatArray = NDArray[np.float64]

SMALLEST_RAD = 1e-6
"""An error below this is no smaller: weights stay finite."""


@dataclass(frozen=True)
class Window:
    """Steps whose errors an oracle knows.

    Attributes:
        before, after: how many on either side of the step to be decided.
        itself: whether that step is among them.
    """

    before: int
    after: int
    itself: bool = False

    def __str__(self) -> str:
        told = f"{self.before} steps before, {self.after} after"
        return f"{told}, and the step itself" if self.itself else told


WINDOWS = (Window(6, 6), Window(12, 0), Window(6, 0), Window(6, 6, itself=True), Window(1, 1, itself=True))
"""Twelve steps are a second."""


@dataclass(frozen=True)
class Bounds:
    """Print how far oracles of the sizes of errors come."""

    recordings: Path | None = None
    """Folder of recordings. None: the bundled mixocity."""
    tracks: tuple[str, ...] = ("VISION", "CONSUMER")
    """Who votes besides the cameras."""

    def run(self) -> Table:
        """A line an oracle, two columns a track."""
        protocol = CrossValidation(load_recordings(None if self.recordings is None else str(self.recordings)))
        found = [dict(study(protocol, track)) for track in self.tracks]
        lines: list[list[Cell]] = [[row, *(value for of in found for value in of[row])] for row in found[0]]
        columns = (Column(f"{track}, {score}", "%", ".0f") for track in self.tracks for score in ("RTE", "ATE"))
        return Table(
            f"{protocol.recordings.manifest.data_version}, {len(protocol.recordings)} scenes, {protocol.truths[0]} "
            f"truth: share of the way from {FROM} to {TO} by RTE in deg/m and by ATE in deg. All rows read the truth",
            (Column("weights"), *columns),
            lines,
        )


def study(protocol: CrossValidation, track: str) -> Iterator[tuple[str, tuple[float, float]]]:
    """Row -> share of the way by RTE and by ATE [%]."""
    recordings = with_truth(protocol.recordings, protocol.truths[0])
    truth = Truth(recordings)
    worst, best = (_scores(truth.measure(protocol.run(name, track).travel)) for name in (FROM, TO))
    votes, turns = substituted_increments(recordings, track), recordings["truth.yaw_increment_rad"]

    def closed(weights: FloatArray) -> tuple[float, float]:
        own = _scores(truth.measure(with_wheels(recordings, mix(weights, votes))))
        rotation, heading = share(np.stack([own, worst, best]))
        return float(rotation), float(heading)

    yield "constant, of every log in hindsight", closed(by_log(recordings, votes, turns))
    told = np.stack([np.isfinite(recordings[f"{e}.yaw_increment_rad"]) for e in recordings.voters(track)], axis=-1)
    errors = np.where(told, votes - turns[:, None], np.nan)
    for window in WINDOWS:
        yield f"1 / size², {window}", closed(by_size(errors, recordings.offsets, window))


def _scores(errors: Errors) -> FloatArray:
    """RTE [deg/m] of all pieces and mean ATE [deg] of the scenes."""
    return np.array([errors.relative.rotation_deg_per_m.mean(), errors.absolute.rotation_deg.mean()])


def by_log(recordings: Recordings, votes: FloatArray, turns: FloatArray) -> FloatArray:
    """Constant weights ``(rows, experts)`` of least squared error on the log that they are scored on.

    Args:
        recordings: tell where each log is.
        votes: ``(rows, experts)`` yaw increments [rad], NaN in row 0 of a scene.
        turns: ``(rows,)`` the true ones [rad].
    """
    weights = np.zeros(votes.shape)
    log_of_row = np.repeat([scene.log for scene in recordings.scenes], np.diff(recordings.offsets))
    usable = np.isfinite(turns) & np.isfinite(votes).all(axis=1)
    for log in np.unique(log_of_row):
        here = log_of_row == log
        weights[here] = least_squares_weights(votes[here & usable], turns[here & usable])
    return weights


def by_size(errors_rad: FloatArray, offsets: NDArray[np.int64], window: Window) -> FloatArray:
    """Weights ``(rows, experts)``, 1 / mean square of the errors in a window around each row, within its scene.

    Args:
        errors_rad: ``(rows, experts)`` of the yaw increments, NaN where an expert has none of its own; it has no weight
            there, unless none has one: then all share.
        offsets: ``(scenes + 1,)`` first row of each scene, and the end.
        window: which steps count.
    """
    told = np.isfinite(errors_rad)
    squares = np.where(told, errors_rad, 0.0) ** 2
    scene, row = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets)), np.arange(len(errors_rad))
    total, count = np.zeros(squares.shape), np.zeros(squares.shape)
    for shift in range(-window.before, window.after + 1):
        if shift or window.itself:
            near = np.clip(row + shift, 0, len(row) - 1)
            within = ((near == row + shift) & (scene[near] == scene))[:, None]
            total += within * squares[near]
            count += within & told[near]
    mean = np.maximum(total / np.maximum(count, 1.0), SMALLEST_RAD**2)
    weights = np.where(told & (count > 0.0), 1.0 / mean, 0.0)
    for candidates in (told.astype(np.float64), np.ones(told.shape)):
        weights = np.where(weights.sum(axis=1, keepdims=True) > 0.0, weights, candidates)
    return weights / weights.sum(axis=1, keepdims=True)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    return print_study(Bounds, arguments, lambda study, table: table.markdown())


if __name__ == "__main__":
    sys.exit(main())
