"""What rows that were fitted here are worth elsewhere: fitted once on the bundled city, played unchanged.

    python -m experiments.transfer --recordings city-of-seed-101 city-of-seed-102 --markdown
    MIXO_REAL_DATA=/data python -m experiments.transfer --weights weights

Other places are the same city at a slower clock or with two of four cameras (each scene played by a fit without its
fold), other cities the same ways, night, and the real odometries of :mod:`experiments.real_experts`. There nothing is
fitted but what a car's own drives tell of it (wheel radius, course offset, pose lag), from the other logs. Beside the
rows stand LINEAR THERE, and HUBER THERE among strange experts: fitted, by cross-validation over logs, where they are
scored.
"""

from __future__ import annotations

import logging
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.closing import FROM, TO, absolute, closed, relative
from experiments.places import Place, variants_of
from experiments.real_experts import RealExperts, imported
from experiments.studies import print_study
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.leaderboard.comparisons import Comparison
from mixo_env.leaderboard.crossvalidation import CrossValidation, Run, Trial
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
"""What everyone is compared with, beside MIXO. LINEAR is fitted where scored, too; HUBER where it cannot be brought."""

NIGHT = "night"

FEWEST_LOGS = 6
"""With five logs no p falls below 2 / 2^5: none is printed then."""


def there(name: str) -> str:
    """How a row is called that was fitted where it is scored."""
    return f"{name} THERE"


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
        *("CAM_FRONT", "MEDIAN", "LINEAR", "HUBER", "STUDENT-T", "BIAS FILTER", "MIXO", "TOKEN", "TANDEM", "TRIO"),
    )
    """What is fitted and played."""
    weights: Path | None = None
    """Folder of `mixo train`. None: weights that come with the package."""
    seed: int = 0
    """Of everything random."""
    intervals: bool = False
    """Print 95 % intervals over logs: of what is closed, and of differences, these instead of their p after Holm."""
    markdown: bool = False
    """Print a table for a page."""

    def run(self) -> Table:
        """Fit once, play everywhere."""
        home = CrossValidation(self._load(self.home), self._trial())
        shown = (*self.rows, *map(there, THERE))
        lines: list[list[Cell]] = []
        begins: list[int] = []
        for place in self._places(home):
            begins.append(len(lines))
            lines += self._lines(place, home, shown)
            logger.info("%s: done", place.name)
        told = "their 95 % interval over logs" if self.intervals else "p after Holm over all pairs of a place"
        caption = (
            f"Fitted on {home.recordings.manifest.data_version}, track {self.track}, and played elsewhere without "
            f"refitting: headline RTE [10⁻³ deg/m]; share of the way from {FROM} to {TO} (privileged), by RTE and "
            f"by ATE [deg]; paired differences with {told}, none with fewer than {FEWEST_LOGS} logs; THERE: fitted by "
            "cross-validation where it is scored"
        )
        return Table(caption, tuple(map(Column, ("place", "what", *shown))), lines, begins[1:])

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
            yield Place(NIGHT, CrossValidation(recordings, self._trial(), out_of_distribution=True))
        if "MIXO_REAL_DATA" in os.environ:
            study = RealExperts()
            with tempfile.TemporaryDirectory() as scratch:
                out = Path(scratch) / "drives"
                imported(study.folder(), study.rate, out)
                yield Place("real odometries", CrossValidation(load_recordings(str(out)), Trial(self.seed)))

    def _lines(self, place: Place, home: CrossValidation, shown: Sequence[str]) -> list[list[Cell]]:
        """RTE of every row, then its differences to those that everyone knows."""
        tested = place.tested()
        runs = {name: run for name in self.rows if (run := self._brought(place, name, home, tested)) is not None}
        if place.name != NIGHT:
            needed = [name for name in THERE if name == "LINEAR" or name not in runs]
            runs |= {there(name): place.at_home_here(name, there(name), tested, self.track) for name in needed}
        scorer = Scorer(tested, {"truth": Truth(tested)}, floor=0.0, seed=self.seed)
        rows = {name: scorer.row(self.track, run) for name, run in runs.items()}
        found = scorer.compare(list(rows.values()))
        logs = len({scene.log for scene in tested.scenes})
        title = f"{place.name} ({len(tested)} scenes, {logs} logs)"
        errors = {name: f"{1e3 * row.headline.rotation_deg_per_m.mean:.2f}" for name, row in rows.items()}
        lines: list[list[Cell]] = [[title, "RTE", *(errors.get(name, "-") for name in shown)]]
        if FROM in rows:
            best = scorer.row(self.track, place.brought(TO, home, tested, self.track))
            of_scenes = np.array([scene.log for scene in tested.scenes])
            way = {name: self._closed(row, rows[FROM], best, of_scenes) for name, row in rows.items()}
            lines.append([title, "closed, RTE / ATE", *(way.get(name, "-") for name in shown)])
        for other in (name for name in (*THERE, "MIXO", *map(there, THERE)) if name in rows):
            differences = (found.between(name, other) for name in shown)
            lines.append([title, f"- {other}", *(self._difference(one, logs >= FEWEST_LOGS) for one in differences)])
        return lines

    def _brought(self, place: Place, name: str, home: CrossValidation, tested: Recordings) -> Run | None:
        """``None`` for a row that knows its experts by name, where others are."""
        try:
            return place.brought(name, home, tested, self.track)
        except (ConfigurationError, PolicyError) as error:
            logger.info("%s, %s: %s", place.name, name, error)
            return None

    def _difference(self, found: Comparison | None, told: bool) -> str:
        """With its p or interval where there are logs enough for one."""
        if found is None:
            return "-"
        if not told:
            return percent(found.share)
        if self.intervals:
            low, high = (100.0 * end / found.second_error for end in (found.difference.low, found.difference.high))
            return f"{percent(found.share)} [{low:+.1f}, {high:+.1f}]"
        return f"{percent(found.share)} ({p_text(found.p_holm)})"

    def _closed(self, row: Row, worst: Row, best: Row, logs: NDArray[np.str_]) -> str:
        """Share of the way from one row to another, by RTE and by ATE; ``logs`` ``(scenes,)``."""
        told = []
        for errors_of in (relative, absolute):
            share = closed(*(errors_of(one.errors["truth"], logs) for one in (row, worst, best)), seed=self.seed)
            sure = self.intervals and share.groups >= FEWEST_LOGS
            told.append(f"{round(share.mean)} %" + (f" [{round(share.low)}, {round(share.high)}]" if sure else ""))
        return " / ".join(told)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""

    def form(study: Transfer, table: Table) -> str:
        return table.markdown() if study.markdown else table.text()

    return print_study(Transfer, arguments, form)


if __name__ == "__main__":
    sys.exit(main())
