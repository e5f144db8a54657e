"""``mixo export``: trajectories as files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro
from tyro.conf import Positional

from mixo_env.cli.outside import OutsideOptions


@dataclass(frozen=True)
class Export:
    """Write truth, experts and fused trajectories as TUM or KITTI files, one a scene: OUT/ROW/SCENE.txt.

    The truth is in OUT/groundtruth. They are what `mixo benchmark` scores: experts and policies share the recorded
    distance and start at the true first pose, lost experts are bridged, learned policies were fitted on other folds,
    and the truth is that of the headline. So `mixo evaluate` finds the leaderboard's numbers in them.

    Worked examples:

      mixo export mixocity --out ways                                         truth and every expert
      mixo export drives --out ways --policies LINEAR HUBER --format kitti    fused trajectories as well
      mixo export drives --out mine --policies my_policy:Surest saved --folds 3   policies of yours, as in `mixo score`
      mixo evaluate --groundtruth ways/groundtruth --estimate ways/HUBER      what to do next
    """

    interrupted: ClassVar[str] = "files written so far are whole, the others are missing"

    recordings: Positional[str]
    """Folder of a recording, or the name of a bundled one."""
    out: Path
    """Folder of the files; one of its own."""
    policies: tuple[str, ...] = ()
    """Besides the experts: rows of the leaderboard (case, hyphens and underscores do not matter), or what `mixo score`
    takes: module:Class, file.py:Class or function, a saved folder, a zip of Stable-Baselines3."""
    how: Annotated[OutsideOptions, tyro.conf.arg(name="")] = field(default_factory=OutsideOptions)
    folds: tuple[int, ...] = ()
    """Scenes of these folds only; a saved policy is refused on the drives it was fitted on. Empty: all."""
    format: Literal["tum", "kitti"] = "tum"
    """tum: with Unix times, z up. kitti: camera axes, no times."""
    track: Literal["PAPER", "VISION", "CONSUMER", "UNEQUAL"] | None = None
    """Who votes besides the cameras. None: CONSUMER where it can be played, else VISION."""
    seed: int = 0
    """Of learned policies."""

    def run(self) -> int:
        """Play and write."""
        from mixo_env.cli.progress import progress
        from mixo_env.errors import ConfigurationError, OutputError
        from mixo_env.files import writable_folder
        from mixo_env.leaderboard.stranger import declared
        from mixo_env.leaderboard.trajectories import chosen, ways, write_way
        from mixo_env.recordings.store import load_recordings

        recordings = load_recordings(self.recordings)
        tracks = recordings.distinct_tracks
        track = self.track or next((track for track in ("CONSUMER", *tracks) if track in tracks), "VISION")
        if self.out.is_dir() and any(self.out.iterdir()):
            raise ConfigurationError(f"{self.out} is not empty: choose another --out, or remove it first")
        fitted_on = self.how.declared()
        trained = None if fitted_on is None else declared(fitted_on, recordings)
        policies = chosen(self.policies, recordings, self.how.reading(), trained)
        folder = writable_folder(self.out)
        rows: dict[str, int] = {}
        total = 1 + len({*recordings.experts, *(policy.name for policy in policies)})
        with progress("writing rows") as report:
            for way in ways(recordings, track, policies, folds=self.folds, seed=self.seed):
                if way.row not in rows:
                    report(len(rows), total)
                try:
                    write_way(folder, way, self.format)
                except OSError as error:
                    raise OutputError(f"cannot write into {folder}: {error.strerror or error}") from None
                rows[way.row] = rows.get(way.row, 0) + 1
        print(f"{folder}: {', '.join(f'{row} ({count})' for row, count in rows.items())}; track {track}, {self.format}")
        return 0
