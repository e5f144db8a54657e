"""How many drives does a row need? Fitted on a few logs of the other folds, scored on every fold.

    python -m experiments.few_drives                            VISION, bundled recordings: 15 CPU minutes
    python -m experiments.few_drives --track CONSUMER --logs 15 --rows "BIAS FILTER" TANDEM

Logs are drawn several times, few of a draw being among the many of the same draw, and a draw is also the seed of the
fit. Constants of the vehicles are those of all training logs, whatever the number that a row is fitted on.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.studies import print_study
from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import Truth, rollout
from mixo_env.policies.fitting import prepare
from mixo_env.policies.registry import create
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import with_truth
from mixo_env.tables import Cell, Column, Table

ROWS = ("LINEAR", "MIXO", "HUBER", "STUDENT-T", "SOFTMIN", "BIAS FILTER", "TOKEN", "TANDEM", "TRIO")


@dataclass(frozen=True)
class FewDrives:
    """Print the relative error of rows by the number of logs that they were fitted on."""

    recordings: Path | None = None
    """Folder of recordings with folds. None: the bundled mixocity."""
    track: str = "VISION"
    """Who votes besides the cameras."""
    rows: tuple[str, ...] = ROWS
    """Rows that learn."""
    logs: tuple[int, ...] = (4, 15, 30, 60)
    """Numbers of logs to fit on."""
    draws: int = 3
    """Of the logs, in every fold."""

    def run(self) -> Table:
        """A line a row, a column a number of logs.

        Raises:
            ConfigurationError: for fewer than two folds, fewer logs than are asked for, or no draw.
        """
        protocol = CrossValidation(load_recordings(None if self.recordings is None else str(self.recordings)))
        if protocol.foreign:
            raise ConfigurationError(
                f"expected recordings of 2 or more folds, got {len(protocol.folds)}: record more logs"
            )
        have = min(len(_logs(protocol.training(fold))) for fold in protocol.folds)
        if self.draws < 1 or not self.logs or not 1 <= min(self.logs) <= max(self.logs) <= have:
            raise ConfigurationError(
                f"expected 1 or more draws of 1 to {have} logs, got {self.draws} draws of {self.logs or 'no number'}"
            )
        scenes = with_truth(protocol.recordings, protocol.truths[0])
        lines: list[list[Cell]] = [[row] for row in self.rows]
        for count in self.logs:
            errors = np.array([self._errors(protocol, scenes, count, draw) for draw in range(self.draws)])
            for line, mean, spread in zip(lines, errors.mean(axis=0), errors.std(axis=0), strict=True):
                line.append(f"{1e3 * mean:.2f} ± {1e3 * spread:.2f}")
        return Table(
            f"{protocol.recordings.manifest.data_version}, track {self.track}, {protocol.truths[0]} truth: mean over "
            f"{len(protocol.folds)} folds, {len(scenes)} scenes in all, of the RTE [10⁻³ deg/m] of rows fitted on so "
            f"many logs of the other folds; mean and standard deviation over {self.draws} draws",
            (Column("row"), *(Column(f"{count} logs") for count in self.logs)),
            lines,
        )

    def _errors(self, protocol: CrossValidation, scenes: Recordings, count: int, draw: int) -> list[float]:
        """RTE [deg/m] of all rows, mean over the folds."""
        found = []
        for fold in protocol.folds:
            tested, few = scenes.select(folds=[fold]), draw_logs(protocol.training(fold), count, draw)
            truth = Truth(tested)
            found.append([self._error(row, few, tested, truth, draw) for row in self.rows])
        return np.mean(found, axis=0).tolist()

    def _error(self, row: str, few: Recordings, tested: Recordings, truth: Truth, seed: int) -> float:
        policy = create(row, few)
        prepare(policy, few, self.track, seed=seed)
        errors = truth.measure(rollout(policy, tested, self.track, privileged=policy.privileged))
        return float(errors.relative.rotation_deg_per_m.mean())


def draw_logs(training: Recordings, count: int, draw: int) -> Recordings:
    """All scenes of ``count`` logs; those of a smaller count are among them, another draw has others."""
    chosen = set(np.random.default_rng(draw).permutation(_logs(training))[:count].tolist())
    return training.select(scenes=[scene.name for scene in training.scenes if scene.log in chosen])


def _logs(training: Recordings) -> list[str]:
    return sorted({scene.log for scene in training.scenes})


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    return print_study(FewDrives, arguments, lambda study, table: table.markdown())


if __name__ == "__main__":
    sys.exit(main())
