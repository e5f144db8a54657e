"""``mixo search``: the paper's grid of gate settings, on your recordings."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from mixo_env.policies.search import Grid


@dataclass(frozen=True)
class Search:
    """Search the paper's grid for the gate's best setting, by successive halving over four folds.

    Every piece of work is kept: the same command goes on where it was stopped.

    Worked examples:

      mixo search                                              10,000 settings on the bundled mixocity
      mixo search --exhaustive --workers 16                    all of them to the end of their schedule
      mixo search --grid.n1 8 16 --grid.n2 8 16                fewer
      mixo search --recordings recordings --track CONSUMER     your drives, five experts
    """

    interrupted: ClassVar[str] = "finished pieces are kept, and the same command continues"

    recordings: Path | None = None
    """Folder written by `mixo record`, or the name of a bundled recording. None: the bundled mixocity."""
    track: str = "VISION"
    """Who votes besides the cameras: PAPER, VISION or CONSUMER."""
    exhaustive: bool = False
    """Train every setting to the end, instead of the best of each stage."""
    grid: Annotated[Grid, tyro.conf.arg(name="grid")] = field(default_factory=Grid)
    """The values that are combined."""
    finalists: int = 20
    """Settings that are trained again."""
    seeds: int = 3
    """Trainings of each finalist."""
    workers: int = 2
    """Processes; the result does not depend on it."""
    scheduler: str | None = None
    """Address of a Dask scheduler to use instead, e.g. tcp://10.0.0.1:8786."""
    out: Path | None = None
    """Folder for pieces and results. None: results/search-TRACK."""

    def run(self) -> int:
        """Search, print the finalists and save everything."""
        from mixo_env.cli.progress import duration, progress
        from mixo_env.cli.results import RESULTS
        from mixo_env.errors import ConfigurationError
        from mixo_env.files import write_json, write_text
        from mixo_env.leaderboard.landscape import Landscape
        from mixo_env.policies.search import EXHAUSTIVE, HALVING, finals, judge
        from mixo_env.policies.search_pieces import Pieces
        from mixo_env.recordings.store import load_recordings

        if self.finalists < 1 or self.seeds < 1:
            raise ConfigurationError(f"finalists and seeds are at least 1, got {self.finalists} and {self.seeds}")
        recordings = load_recordings(None if self.recordings is None else str(self.recordings))
        folder = self.out or RESULTS / f"search-{self.track.lower()}"
        pieces = Pieces(recordings, self.track, folder, self.workers, self.scheduler)
        pieces.claim(self.grid)
        settings, stages = self.grid.settings(), EXHAUSTIVE if self.exhaustive else HALVING
        share = sum((schedule * kept for schedule, kept in stages), 0.0)
        expected_s = pieces.expected_s(settings, pieces.updates * share)
        print(
            f"{len(settings)} settings on {len(pieces.folds)} folds, {share:.0%} of {pieces.updates} updates each on "
            f"average: about {duration(expected_s)} with {self.workers} workers, told from a sample; pieces that "
            f"{folder} holds are not done again",
            flush=True,
        )
        with progress("updating gates") as report:
            judged = judge(
                settings, pieces.folds, pieces.updates, lambda p: pieces.compute(p, report), stages, self.finalists
            )
            final = finals(
                judged, pieces.folds, pieces.updates, lambda p: pieces.compute(p, report), self.finalists, self.seeds
            )
        about = f"{recordings.manifest.data_version}, track {self.track}, {len(settings)} settings"
        landscape = Landscape(judged, final, pieces.linear, about)
        write_json(folder / "landscape.json", landscape.to_json())
        write_text(
            folder / "landscape.md", landscape.table().markdown() + "\n" + "\n".join(landscape.sentences()) + "\n"
        )
        landscape.draw(folder / "landscape.png")
        print(landscape.table().text(), end="")
        for sentence in landscape.sentences():
            print(sentence)
        print(f"Saved in {folder}: landscape.md, landscape.json, landscape.png, and every piece")
        return 0
