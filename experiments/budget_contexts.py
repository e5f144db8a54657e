"""Should the set of cameras change with the drive? What is known without any camera, against the best constant set.

    python -m experiments.budget_contexts

A rule chooses a set by cells of speed and inertial turn; which set suits a cell is fitted on the training folds. It is
flattered: its cameras wake in no time, while in ``MixoOdometryBudget-v0`` they deliver one step late. A clairvoyant,
who chooses every step's set by the error itself, bounds every policy with these weights.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.studies import print_study
from mixo_env.envs.budget import BudgetReplay
from mixo_env.envs.stepping import CAP, DISTANCE, DT, SUBSTITUTE, TRUTH
from mixo_env.leaderboard.paper.cost import PRICES_PER_MS, Division
from mixo_env.policies.budget import LinearByPattern
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.presets import data_label
from mixo_env.recordings.store import load_recordings
from mixo_env.tables import Cell, Column, Table

SPEEDS_MPS = (0.2, 3.0, 6.0, 9.0)
TURNS_RADPS = (0.01, 0.05, 0.15)
"""Borders of the cells."""
LEAST_STEPS = 100
"""A cell with fewer training steps takes the constant set."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Steps:
    """All steps of some scenes.

    Attributes:
        losses: ``(steps, sets)`` squared capped error of every set of delivering cameras, in units of sigma_0.
        cells: ``(steps,)`` number of the cell of speed and turn.
    """

    losses: FloatArray
    cells: NDArray[np.int64]


def steps_of(recordings: Recordings, track: str, linear: LinearByPattern, sigma_rad: float) -> Steps:
    """Errors of LINEAR's weights for every set, in the order of ``linear.weights``; poses free of lag in, or exact."""
    replay = BudgetReplay(recordings, track=track)
    table, said = replay.table, replay.votes.increments_rad
    fused = np.stack([said @ weights for weights in linear.weights.values()], axis=1)
    losses = np.minimum(np.abs(fused - table[:, TRUTH, None]) / sigma_rad, CAP) ** 2
    speed = np.digitize(np.abs(table[:, DISTANCE] / table[:, DT]), SPEEDS_MPS)
    turn = np.digitize(np.abs(table[:, SUBSTITUTE] / table[:, DT]), TURNS_RADPS)
    return Steps(losses, speed * (len(TURNS_RADPS) + 1) + turn)


@dataclass(frozen=True)
class Outcome:
    """Mean reward of a step on held-out scenes.

    Attributes:
        constant: of the best constant set.
        by_cell: of the best set of every cell.
        clairvoyant: of the best set of every step, in hindsight.
        changed: share of steps in which the cell's set is not the constant one.
    """

    constant: float
    by_cell: float
    clairvoyant: float
    changed: float


def outcome(training: Steps, test: Steps, prices: FloatArray) -> Outcome:
    """Choose on training steps, earn on test steps; ``prices`` ``(sets,)`` is what a step of each set costs."""
    constant = int(np.argmin(training.losses.mean(axis=0) + prices))
    choice = np.full(max(training.cells.max(), test.cells.max()) + 1, constant)
    for cell in np.unique(training.cells):
        here = training.cells == cell
        if here.sum() >= LEAST_STEPS:
            choice[cell] = np.argmin(training.losses[here].mean(axis=0) + prices)
    paid = test.losses + prices
    chosen = choice[test.cells]
    return Outcome(
        constant=-float(paid[:, constant].mean()),
        by_cell=-float(paid[np.arange(len(paid)), chosen].mean()),
        clairvoyant=-float(paid.min(axis=1).mean()),
        changed=float(np.mean(chosen != constant)),
    )


@dataclass(frozen=True)
class ContextStudy:
    """Print what a change of sets could gain, at three prices."""

    recordings: Path | None = None
    """Folder of recordings; default: the bundled ones."""
    tracks: tuple[str, ...] = ("CONSUMER", "VISION")
    """Who votes."""

    def run(self) -> Table:
        """Fit on the other folds, earn on each."""
        recordings = load_recordings(self.recordings)
        folds = sorted({scene.fold for scene in recordings.scenes} - {-1})
        rows: list[list[Cell]] = []
        for track in self.tracks:
            found = [self._of_fold(Division(recordings, fold, track)) for fold in folds]
            for i, price in enumerate(PRICES_PER_MS):
                parts = [of_fold[i] for of_fold in found]
                names = ("constant", "by_cell", "clairvoyant", "changed")
                constant, by_cell, clairvoyant, changed = (
                    float(np.mean([getattr(part, name) for part in parts])) for name in names
                )
                rows.append([track, price, constant, by_cell, clairvoyant, 100.0 * changed])
        columns = Column("track"), Column("price", "per ms", ".3f"), Column("constant set", "", ".3f")
        columns = *columns, Column("by speed and turn", "", ".3f"), Column("clairvoyant", "", ".3f")
        caption = f"Reward of a step, {data_label(recordings.manifest)}, mean over {len(folds)} held-out folds"
        return Table(caption, (*columns, Column("changed", "% of steps", ".0f")), rows)

    def _of_fold(self, division: Division) -> list[Outcome]:
        sigma_rad = division.training.manifest.reward_scale_rad[division.track]
        training, test = (
            steps_of(part, division.track, division.linear, sigma_rad) for part in (division.training, division.test)
        )
        costs = division.training.manifest.camera_cost_ms
        each_ms = np.array([costs[camera] for camera in division.linear.cameras])
        sets_ms = np.array([each_ms[list(pattern)].sum() for pattern in division.linear.weights])
        return [outcome(training, test, price * sets_ms) for price in PRICES_PER_MS]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; see :class:`ContextStudy`."""
    return print_study(ContextStudy, arguments)


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    raise SystemExit(main())
