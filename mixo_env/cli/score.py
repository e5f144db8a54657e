"""`mixo score`: anyone's policy on the leaderboard."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from mixo_env.cli.outside import OutsideOptions


@dataclass(frozen=True)
class Score:
    """Score your policy beside CAM_FRONT, LINEAR, HUBER and MIXO, with paired differences.

    Worked examples:

      mixo score my_policy:Mine                         a class of my_policy.py in this folder, fitted fold by fold
      mixo score my_policy.py:act --observation rich    a function of one observation
      mixo score saved/                                 a folder written by Policy.save
      mixo score shipped:TOKEN --recordings other-city  weights that come with the package, without refitting
      mixo score ppo.zip --fitted-on train --folds 3    a network of Stable-Baselines3, never unpickled
    """

    interrupted: ClassVar[str] = "nothing was written: a table is computed in one go"

    policy: Annotated[str, tyro.conf.Positional]
    """module:Class, file.py:Class (or a function), a saved folder, a zip of Stable-Baselines3, a row's name, or
    shipped:ROW (weights fitted on the bundled mixocity)."""

    track: str = "VISION"
    """Who votes besides the cameras: PAPER, VISION or CONSUMER; UNEQUAL: experts of other families."""

    recordings: Path | None = None
    """Folder written by `mixo record`, or the name of a bundled recording. None: the bundled mixocity."""

    folds: tuple[int, ...] = ()
    """Score the scenes of these folds only. Empty: all."""

    how: Annotated[OutsideOptions, tyro.conf.arg(name="")] = field(default_factory=OutsideOptions)

    seed: int = 0
    """Of everything random."""

    seeds: int = 1
    """Fits of every learned policy; its row is the mean of their errors."""

    out: Path | None = None
    """Folder for the results. None: nothing is written."""

    def run(self) -> int:
        """Print the row beside the others, and write it if asked."""
        from mixo_env.cli.progress import progress
        from mixo_env.files import writable_folder, write_json
        from mixo_env.leaderboard.report import print_leaderboard
        from mixo_env.leaderboard.stranger import Options, score

        folder = self.out and writable_folder(self.out)
        reading = self.how.reading()
        with progress("computing rows") as report:
            scored = score(
                self.policy,
                self.recordings,
                self.track,
                folds=self.folds,
                fitted_on=self.how.declared(),
                options=Options(reading.asking, reading.network, reading.policy_class, self.seed, self.seeds),
                progress=report,
            )
        print_leaderboard(scored.board)
        for line in scored.difference_lines():
            print(line)
        if folder:
            write_json(folder / "score.json", scored.to_json() | {"configuration": self._configuration()})
            print(f"Saved in {folder}: score.json")
        return 0

    def _configuration(self) -> dict[str, Any]:
        """All options as plain JSON values."""
        own = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "how"}
        own = {name: str(value) if isinstance(value, Path) else value for name, value in own.items()}
        return own | self.how.plain()
