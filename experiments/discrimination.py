"""How well scenes tell rows apart: do two halves of the logs order them alike, and how few scenes give the same order?

    mixo benchmark --out results/all
    python -m experiments.discrimination --results results/all

Both questions are asked of many random halves of the logs. Twenty scenes are chosen on one half of the logs and one
half of the rows, one by one, always the scene that brings the errors of those rows nearest to what all scenes of that
half give; they are judged by the order of the *other* rows on the *other* logs, beside twenty drawn at random.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.situation_shares import kendall_tau
from experiments.studies import print_study
from mixo_env.errors import ConfigurationError
from mixo_env.tables import Cell, Column, Table

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SCENES_FILE = "scenes.csv"


@dataclass(frozen=True)
class Errors:
    """Errors of the rows of one track, scene by scene.

    Attributes:
        rows: names.
        scenes: names.
        log: ``(scenes,)`` number of its log.
        total: ``(rows, scenes)`` sum of the errors of all pieces of path [deg/m].
        pieces: ``(scenes,)`` their number, the same for every row.
    """

    rows: tuple[str, ...]
    scenes: tuple[str, ...]
    log: IntArray
    total: FloatArray
    pieces: FloatArray

    def pooled(self, scenes: IntArray) -> FloatArray:
        """``(rows,)`` RTE [deg/m] of some scenes."""
        return self.total[:, scenes].sum(axis=1) / self.pieces[scenes].sum()

    def of_logs(self, logs: IntArray) -> IntArray:
        """Numbers of the scenes of some logs."""
        return np.flatnonzero(np.isin(self.log, logs))


@dataclass(frozen=True)
class Discrimination:
    """Order rows by halves of the logs and by a few scenes."""

    results: Path
    """Folder written by `mixo benchmark --out`."""
    tracks: tuple[str, ...] = ("PAPER", "VISION", "CONSUMER")
    """Whose tables."""
    count: int = 20
    """Scenes to choose."""
    splits: int = 100
    """Random halves of logs and rows."""
    seed: int = 0
    """Of the halves."""

    def run(self) -> Table:
        """Kendall's tau of every track, mean and 5 % quantile over the splits."""
        lines: list[list[Cell]] = []
        for track in self.tracks:
            errors = read_errors(self.results, track)
            found = np.array(list(self._splits(errors)))
            lines.append([track, len(errors.rows), len(set(errors.log.tolist()))])
            for values in found.T:
                lines[-1] += [float(values.mean()), float(np.quantile(values, 0.05))]
        caption = (
            f"Kendall's tau between orders of rows, {self.splits} random halves of logs; {self.count} scenes chosen "
            "on half of the logs and rows, judged by the other rows on the other logs"
        )
        names = ("halves", f"{self.count} chosen", f"{self.count} at random")
        taus = [Column(text, "", ".2f") for name in names for text in (name, "5 %")]
        return Table(caption, (Column("track"), Column("rows"), Column("logs"), *taus), lines)

    def _splits(self, errors: Errors) -> Iterator[list[float]]:
        random = np.random.default_rng(self.seed)
        logs = np.unique(errors.log)
        for _ in range(self.splits):
            first = errors.of_logs(random.permutation(logs)[: len(logs) // 2])
            second = np.setdiff1d(np.arange(len(errors.scenes)), first)
            rows = random.permutation(len(errors.rows))
            known, other = np.split(rows, [len(rows) // 2])
            able = first[errors.pieces[first] > 0]
            few = (
                chosen(errors, first, known, self.count),
                random.choice(able, min(self.count, len(able)), replace=False),
            )
            there = errors.pooled(second)
            yield [
                kendall_tau(errors.pooled(first), there),
                *(kendall_tau(errors.pooled(some)[other], there[other]) for some in few),
            ]


def chosen(errors: Errors, scenes: IntArray, rows: IntArray, count: int) -> IntArray:
    """The scenes whose pooled errors of some rows are nearest, in logarithms, to those of all the scenes given.

    Args:
        errors: of one track.
        scenes: to choose from.
        rows: to look at.
        count: how many; fewer if there are fewer.
    """
    target = np.log(errors.pooled(scenes)[rows])
    left = [int(scene) for scene in scenes if errors.pieces[scene] > 0]
    taken: list[int] = []
    total, pieces = np.zeros(len(rows)), 0.0
    for _ in range(min(count, len(left))):
        with np.errstate(divide="ignore"):  # a row without any error in a scene: infinitely far
            tried = np.log((total[:, None] + errors.total[rows][:, left]) / (pieces + errors.pieces[left]))
        best = int(np.argmin(((tried - target[:, None]) ** 2).sum(axis=0)))
        scene = left.pop(best)
        taken.append(scene)
        total, pieces = total + errors.total[rows, scene], pieces + errors.pieces[scene]
    return np.array(taken, np.int64)


def read_errors(results: Path, track: str) -> Errors:
    """Rows of a track that read no truth and were tested on every scene, by the headline truth.

    Raises:
        ConfigurationError: without scenes.csv, or without such rows.
    """
    try:
        with (results / SCENES_FILE).open(encoding="utf-8", newline="") as file:
            lines = [line for line in csv.DictReader(file) if line["track"] == track]
    except OSError:
        raise ConfigurationError(
            f"{results} holds no {SCENES_FILE}: write it with `mixo benchmark --out {results}`"
        ) from None
    headline = lines[0]["truth"] if lines else ""
    lines = [line for line in lines if line["truth"] == headline and line["privileged"] == "0" and line["fold"] != "-1"]
    scenes = tuple(dict.fromkeys(line["scene"] for line in lines))
    of_row: dict[str, dict[str, dict[str, str]]] = {}
    for line in lines:
        of_row.setdefault(line["policy"], {})[line["scene"]] = line
    whole = {name: found for name, found in of_row.items() if len(found) == len(scenes)}
    if len(whole) < 4:
        raise ConfigurationError(f"{results}: expected at least four rows of track {track}, got {len(whole)}")
    first = next(iter(whole.values()))
    pieces = np.array([float(first[scene]["rte_samples"]) for scene in scenes])
    total = np.array([[float(found[s]["rte_deg_per_m"] or 0.0) for s in scenes] for found in whole.values()]) * pieces
    logs = sorted({first[scene]["log"] for scene in scenes})
    log = np.array([logs.index(first[scene]["log"]) for scene in scenes])
    return Errors(tuple(whole), scenes, log, np.nan_to_num(total), pieces)


if __name__ == "__main__":
    sys.exit(print_study(Discrimination))
