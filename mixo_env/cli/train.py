"""`mixo train`: fit once, keep the weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro


@dataclass(frozen=True)
class Train:
    """Fit rows of the leaderboard for every held-out fold and keep their weights.

    Worked examples:

      mixo train TOKEN --out weights                    weights/TOKEN/VISION/fold-0-seed-0 ... all-folds-seed-0
      mixo train --all --out weights --workers 2        every row that learns, every track
      mixo train PPO --tensorboard curves               ATE and RTE on the held-out fold while it learns
      mixo benchmark --weights weights                  the same table, without fitting what is there
      mixo score weights/TOKEN/VISION/all-folds-seed-0 --recordings other-city
    """

    interrupted: ClassVar[str] = "finished pieces are kept, and the same command continues"

    names: Annotated[tuple[str, ...], tyro.conf.Positional] = ()
    """Rows to fit; case, hyphens and underscores do not matter."""

    all: bool = False
    """Every row that learns."""

    recordings: Path | None = None
    """Folder written by `mixo record`, or the name of a bundled recording. None: the bundled mixocity."""

    tracks: tuple[str, ...] = ()
    """Who votes besides the cameras. Empty: all."""

    seed: int = 0
    """Of everything random."""

    seeds: int = 1
    """Fits of every row."""

    out: Path = Path("weights")
    """Folder for the weights."""

    tensorboard: Path | None = None
    """Folder for curves of what Stable-Baselines3 trains; shown by `tensorboard --logdir`. None: no curves."""

    workers: int = 1
    """Processes; what is fitted does not depend on it."""

    def run(self) -> int:
        """Fit what is not there yet."""
        from mixo_env.cli.progress import progress
        from mixo_env.errors import ConfigurationError
        from mixo_env.files import writable_folder
        from mixo_env.leaderboard.board import requested
        from mixo_env.leaderboard.crossvalidation import Trial
        from mixo_env.leaderboard.training import Training
        from mixo_env.recordings.store import load_recordings

        if self.all == bool(self.names):
            raise ConfigurationError("expected names of rows, or --all, not both: `mixo train TOKEN`")
        source = None if self.recordings is None else str(self.recordings)
        rows = requested(load_recordings(source), self.tracks, self.names)
        if self.tensorboard is not None:
            from mixo_env.leaderboard.curves import check_watched

            check_watched(rows)
        curves = self.tensorboard and writable_folder(self.tensorboard)
        training = Training(source, Trial(self.seed, self.seeds, weights=writable_folder(self.out), curves=curves))
        pieces = training.division.pieces(rows, self.tracks or training.division.recordings.distinct_tracks)
        if not pieces:
            raise ConfigurationError(f"{', '.join(rows)}: nothing to fit: name a row that learns")
        with progress("fitting") as report:
            training.fit(pieces, self.workers, report)
        size = sum(file.stat().st_size for file in self.out.rglob("*") if file.is_file())
        print(f"{self.out}: {len(pieces)} sets of weights, {size / 1e6:.2f} MB in the folder")
        return 0
