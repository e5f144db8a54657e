"""``mixo import``: trajectories of other programs become experts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from tyro.conf import Positional


@dataclass(frozen=True)
class Import:
    """Add an expert from trajectory files to a recording.

    Files are named after the scenes (scene-0061.txt) and hold one pose a line: TUM, EuRoC, or KITTI with times, either
    as a first column or in scene-0061.times. Times are Unix seconds, as in nuScenes file names (microseconds there).

    Worked examples:

      mixo import recorded --expert WHEELS --trajectories wheels/ --out with-wheels
      mixo import mixocity --expert ORB-SLAM3 --trajectories tum/ --axes camera --out with-orb
      mixo benchmark --recordings with-orb                                what to do next
    """

    interrupted: ClassVar[str] = "nothing was written"

    recordings: Positional[str]
    """Folder written by `mixo record`, or the name of a bundled recording."""
    expert: str
    """Name of the new expert."""
    trajectories: Path
    """Folder of the files."""
    out: Path
    """Folder of the extended recording."""
    axes: Literal["file", "vehicle", "camera"] = "file"
    """Axes of the poses: as the format defines them (KITTI: camera, others: vehicle, z up), or said here. Visual SLAM
    mostly writes camera poses (x right, y down, z forward) into TUM files."""
    quaternions: Literal["file", "xyzw", "wxyz"] = "file"
    """Order of quaternions in files that do not tell it (docs/trajectories.md)."""

    def run(self) -> int:
        """Extend the recording and say how much of it the new expert covers."""
        import numpy as np

        from mixo_env.errors import ConfigurationError
        from mixo_env.recordings.folder import claimed
        from mixo_env.recordings.importing import read_trajectories, with_imported
        from mixo_env.recordings.store import load_recordings, settled, write_recordings

        with claimed(self.out) as home:
            if settled(home) is not None and home.resolve() != Path(self.recordings).resolve():
                raise ConfigurationError(f"{home} holds another recording: choose another --out, or remove it first")
            trajectories = read_trajectories(self.trajectories, self.axes, self.quaternions)
            extended = with_imported(load_recordings(self.recordings), self.expert, trajectories)
            write_recordings(extended, home)
        available = np.isfinite(extended[f"{self.expert}.yaw_increment_rad"])
        covered = sum(bool(available[a:b].any()) for a, b in zip(extended.offsets, extended.offsets[1:], strict=False))
        share = available.sum() / (len(available) - len(extended))
        print(f"{self.out}: {self.expert} in {covered} of {len(extended)} scenes, {share:.1%} of the steps")
        return 0
