"""Write docs/play.html: one recorded drive, to be played by hand in a browser without a network.

    python -m docs._pages.play

The drive is the one of :func:`~docs._pages.play.drive.telling_drive`. Its pictures are simulated where the cache of
``make mixocity`` lacks them, in a minute.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from docs._pages.play.drive import drive_json, telling_drive
from docs._pages.play.page import page
from docs._pages.play.pictures import camera_sheets
from mixo_env.errors import ConfigurationError
from mixo_env.files import write_text
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings


@dataclass(frozen=True)
class Play:
    """Write the page of one drive."""

    out: Path = Path("docs/play.html")
    """File to write."""
    recordings: Path | None = None
    """Folder of the recordings; default: the bundled ones."""
    dataroot: Path | None = None
    """The nuScenes folder that was recorded; default: the simulated city of the bundled recordings, where
    ``make mixocity`` keeps it; what it lacks of the drive is simulated."""
    scene: str | None = None
    """Scene to play, of a fold; default: the telling one."""
    track: str = "VISION"
    """Whose experts vote."""

    def run(self) -> int:
        """Choose, play the references, cut the pictures, write."""
        recordings = load_recordings(self.recordings)
        scene = self.scene or telling_drive(recordings, self.track)
        drive = drive_json(recordings, scene, self.track)
        drive["pictures"] = camera_sheets(recordings, scene, self.dataroot or _simulated(recordings, scene))
        write_text(self.out, page(drive))
        print(f"wrote {self.out}: {scene}, {self.out.stat().st_size / 1e6:.2f} MB")
        return 0


def _simulated(recordings: Recordings, scene: str) -> Path:
    """The city of the bundled recordings, with this scene in it.

    Raises:
        ConfigurationError: when this simulator makes other drives than those recorded.
    """
    from experiments.mixocity import CONFIG, DATA_VERSION, Build
    from mixo_env.simulator.dataset import simulate

    if recordings.manifest.data_version != f"mixocity-{DATA_VERSION}":
        raise ConfigurationError(
            f"this simulator makes the drives of mixocity-{DATA_VERSION}, the recordings are "
            f"{recordings.manifest.data_version}: give the folder that was recorded with --dataroot"
        )
    city = Build().cache / "city"
    simulate(CONFIG, city, only=(scene,))
    return city


if __name__ == "__main__":
    import tyro

    raise SystemExit(tyro.cli(Play).run())
