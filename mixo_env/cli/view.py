"""`mixo view`: one drive in the viewer Rerun, or as a film."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from mixo_env.cli.outside import OutsideOptions

if TYPE_CHECKING:
    from mixo_env.policies.outside import Outside
    from mixo_env.recordings.collection import Recordings

SHOWN = ("HUBER", "MIXO")
"""Policies in the viewer unless others are asked for; a film shows the last of them."""


@dataclass(frozen=True)
class View:
    """Show one drive: the rig, images, matches, true and estimated ways, weights and lost marks over time.

    Writes a file for the viewer Rerun (https://rerun.io; pip install 'mixo-env[view]'), opens that viewer, or writes a
    film of one policy as MP4, which needs nothing further. Rows are played as `mixo benchmark` plays them: policies
    that learn were fitted on other drives.

    Worked examples:

      mixo view                                               the most winding bundled drive: scene-....rrd
      mixo view --scene scene-2062 --policies HUBER TANDEM --spawn        in Rerun's viewer, now
      mixo view --scene scene-2062 --policies MIXO --out drive.mp4        a film
      mixo view drives --images /data/nuscenes --out drive.rrd            with the rig, its images and its matches
    """

    interrupted: ClassVar[str] = "nothing was written"

    recordings: Annotated[str | None, tyro.conf.Positional] = None
    """Folder of a recording, or the name of a bundled one. None: the bundled mixocity."""
    scene: str | None = None
    """Which drive. None: the one that turns most."""
    policies: tuple[str, ...] = ()
    """Besides the experts: rows of the leaderboard (case, hyphens and underscores do not matter), or what `mixo score`
    takes. Empty: HUBER and MIXO; MIXO in a film."""
    how: Annotated[OutsideOptions, tyro.conf.arg(name="")] = field(default_factory=OutsideOptions)
    images: Path | None = None
    """The nuScenes folder that was recorded: for the rig, its images and the matches in them."""
    out: Path | None = None
    """File to write: .rrd for Rerun, .mp4 for a film. None: SCENE.rrd in this folder, unless --spawn."""
    spawn: bool = False
    """Open Rerun's viewer, which needs a display."""
    track: Literal["PAPER", "VISION", "CONSUMER", "UNEQUAL"] | None = None
    """Who votes besides the cameras. None: CONSUMER where it can be played, else VISION."""
    seed: int = 0
    """Of learned policies."""

    def run(self) -> int:
        """Play the drive and show it."""
        from mixo_env.errors import ConfigurationError
        from mixo_env.leaderboard.one_drive import most_winding
        from mixo_env.leaderboard.rerun_file import require_rerun
        from mixo_env.leaderboard.stranger import declared
        from mixo_env.leaderboard.trajectories import chosen
        from mixo_env.recordings.store import load_recordings

        film = self.out is not None and self.out.suffix == ".mp4"
        if self.out is not None and self.out.suffix not in (".rrd", ".mp4"):
            raise ConfigurationError(f"--out: expected a file .rrd or .mp4, got {self.out}")
        if film and (self.spawn or len(self.policies) > 1):
            raise ConfigurationError("a film shows one policy and opens no viewer: give one of --policies, no --spawn")
        if not film:
            require_rerun()
        recordings = load_recordings(self.recordings)
        tracks = recordings.distinct_tracks
        track = self.track or next((track for track in ("CONSUMER", *tracks) if track in tracks), "VISION")
        scene = self.scene or most_winding(recordings)
        recordings.index(scene)
        fitted_on = self.how.declared()
        trained = None if fitted_on is None else declared(fitted_on, recordings)
        names = self.policies or (SHOWN[-1:] if film else SHOWN)
        policies = chosen(names, recordings, self.how.reading(), trained)
        if film:
            self._film(recordings, scene, track, policies[0])
        else:
            self._view(recordings, scene, track, policies)
        return 0

    def _film(self, recordings: Recordings, scene: str, track: str, policy: Outside) -> None:
        from mixo_env.cli.progress import progress
        from mixo_env.leaderboard.film import FRAMES_PER_S, frames, write_film

        assert self.out is not None
        rows = recordings.scenes[recordings.index(scene)].rows
        with progress("drawing") as report:
            pictures = frames(recordings, scene, track, policy, images=self.images, seed=self.seed)
            count = write_film(self.out, pictures, lambda done: report(done, rows))
        print(f"{self.out}: {policy.name} on {scene}, track {track}, {count} pictures at {FRAMES_PER_S} a second")

    def _view(self, recordings: Recordings, scene: str, track: str, policies: tuple[Outside, ...]) -> None:
        from mixo_env.cli.progress import progress
        from mixo_env.leaderboard.one_drive import one_drive
        from mixo_env.leaderboard.rerun_file import open_viewer, write_rerun
        from mixo_env.leaderboard.rig import Rig

        played: list[str] = []
        with progress("playing rows") as report:

            def next_row(name: str) -> None:
                report(len(played), len(recordings.experts) + len(policies))
                played.append(name)

            drive = one_drive(recordings, scene, track, policies, seed=self.seed, progress=next_row)
        rig = Rig(drive.recordings, self.images) if self.images else None
        without = "" if rig and rig.has_images else "; no images" + (" in that folder" if rig else "")
        with progress("reading cameras") as report:
            if self.spawn:
                open_viewer(drive, rig, report)
            if self.out is not None or not self.spawn:
                out = self.out or Path(f"{scene}.rrd")
                write_rerun(out, drive, rig, report)
                print(f"{out}: open it with `rerun {out}`")
        rows = ", ".join(way.name for way in drive.ways)
        print(f"{scene}, track {track}: {rows}{without}")
