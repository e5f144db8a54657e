"""What rows that were fitted here are worth elsewhere: fitted once on the bundled city, played unchanged.

    python -m experiments.transfer --recordings city-of-seed-101 city-of-seed-102 --markdown
    MIXO_REAL_DATA=/data python -m experiments.transfer --weights weights

Other places are the same city at a slower clock or with two of four cameras (each scene played by a fit without its
fold), other cities the same ways, night, and the real odometries of :mod:`experiments.real_experts`. There nothing is
fitted but what a car's own drives tell of it (wheel radius, course offset, pose lag), from the other logs. Beside the
rows stand LINEAR THERE and HUBER THERE: fitted, by cross-validation over logs, where they are scored.
"""

from __future__ import annotations

import logging
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from experiments.places import Place, variants_of
from experiments.real_experts import RealExperts, imported
from experiments.studies import print_study
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.leaderboard.comparisons import Comparison
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.evaluation import Truth
from mixo_env.leaderboard.rows import Row, Scorer
from mixo_env.leaderboard.sentences import p_text, percent
from mixo_env.leaderboard.weights import shipped
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.folds import OUT_OF_DISTRIBUTION
from mixo_env.recordings.store import load_recordings
from mixo_env.tables import Cell, Column, Table

logger = logging.getLogger(__name__)

THERE = ("LINEAR", "HUBER")
"""Fitted where they are scored, too."""

FEWEST_LOGS = 6
"""With five logs no p falls below 2 / 2^5: none is printed then, and no interval."""


def there(name: str) -> str:
    """How a row is called that was fitted where it is scored."""
    return f"{name} THERE"


AGAINST = (*THERE, *map(there, THERE))


@dataclass(frozen=True)
class Transfer:
    """Play rows that were fitted on the bundled city in other places."""

    recordings: tuple[Path, ...] = ()
    """Recordings of other drives, by `mixo record`."""
    home: Path | None = None
    """Recordings that rows are fitted on. None: the bundled mixocity."""
    strides: tuple[int, ...] = (2, 3, 6)
    """Slower clocks: every second, third and sixth image of 12 Hz."""
    cameras: tuple[str, ...] = ("CAM_FRONT", "CAM_BACK")
    """Left over where a rig of fewer cameras is played; none: it is not."""
    track: str = "VISION"
    """Who votes besides the cameras."""
    rows: tuple[str, ...] = (
        *("CAM_FRONT", "MEDIAN", "LINEAR", "HUBER", "STUDENT-T", "BIAS FILTER", "MIXO", "TOKEN", "TANDEM"),
    )
    """What is fitted and played."""
    weights: Path | None = None
    """Folder of `mixo train`. None: weights that come with the package."""
    seed: int = 0
    """Of everything random."""
    markdown: bool = False
    """Print a table for a page."""

    def run(self) -> Table:
        """Fit once, play everywhere."""
        home = CrossValidation(self._load(self.home), self._trial())
        lines: list[list[Cell]] = []
        begins: list[int] = []
        for place in self._places(home):
            begins.append(len(lines))
            lines += self._lines(place, home)
            logger.info("%s: done", place.name)
        caption = (
            f"Fitted on {home.recordings.manifest.data_version}, track {self.track}, and played elsewhere without "
            "refitting; headline truth, 95 % interval by bootstrap over logs; paired differences, p after Holm over "
            f"all pairs of a place, none with fewer than {FEWEST_LOGS} logs; THERE: fitted by cross-validation where "
            "it is scored"
        )
        columns = ("place", "row", "RTE deg/m", "ATE deg", *(f"- {name}" for name in AGAINST))
        return Table(caption, tuple(map(Column, columns)), lines, begins[1:])

    def _trial(self) -> Trial:
        return Trial(self.seed, weights=self.weights or shipped())

    def _load(self, folder: Path | None) -> Recordings:
        return load_recordings(None if folder is None else str(folder))

    def _places(self, home: CrossValidation) -> Iterator[Place]:
        """Every place, the nearest first."""
        yield from variants_of(Place("here", home, own=True), self.strides, self.cameras)
        for folder in self.recordings:
            division = CrossValidation(self._load(folder), Trial(self.seed))
            yield from variants_of(Place(folder.name, division), self.strides, self.cameras)
        recordings = self._load(self.home)
        if any(scene.fold == OUT_OF_DISTRIBUTION for scene in recordings.scenes):
            yield Place("night", CrossValidation(recordings, self._trial(), out_of_distribution=True))
        if "MIXO_REAL_DATA" in os.environ:
            study = RealExperts()
            with tempfile.TemporaryDirectory() as scratch:
                out = Path(scratch) / "drives"
                imported(study.folder(), study.rate, out)
                yield Place("real odometries", CrossValidation(load_recordings(str(out)), Trial(self.seed)))

    def _lines(self, place: Place, home: CrossValidation) -> list[list[Cell]]:
        tested = place.tested()
        scorer = Scorer(tested, {"truth": Truth(tested)}, floor=0.0, seed=self.seed)
        runs = []
        for name in self.rows:
            try:
                runs.append(place.brought(name, home, tested, self.track))
            except (ConfigurationError, PolicyError) as error:  # it knows its experts by name, and others are here
                logger.info("%s, %s: %s", place.name, name, error)
        if place.name != "night":
            runs += [place.at_home_here(name, there(name), tested, self.track) for name in THERE]
        rows = [scorer.row(self.track, run) for run in runs]
        found = scorer.compare(rows)
        logs = len({scene.log for scene in tested.scenes})
        title = f"{place.name} ({len(tested)} scenes, {logs} logs)"
        told = logs >= FEWEST_LOGS
        return [[title, *_cells(row, {name: found.between(row.name, name) for name in AGAINST}, told)] for row in rows]


def _cells(row: Row, differences: Mapping[str, Comparison | None], told: bool) -> list[Cell]:
    """Cells of a row; ``told``: there are logs enough for intervals and p."""
    score = row.headline
    ends = score.rotation_deg_per_m
    interval = f" [{ends.low:.5f}, {ends.high:.5f}]" if told else ""
    cells: list[Cell] = [row.name, f"{ends.mean:.5f}{interval}", f"{score.ate_deg:.3f}"]
    for found in differences.values():
        cells.append("-" if found is None else percent(found.share) + (f" ({p_text(found.p_holm)})" if told else ""))
    return cells


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""

    def form(study: Transfer, table: Table) -> str:
        return table.markdown() if study.markdown else table.text()

    return print_study(Transfer, arguments, form)


if __name__ == "__main__":
    sys.exit(main())
