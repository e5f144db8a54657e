"""The failure suite: what goes wrong on the road and in a camera, each by itself, never pooled into the headline.

    python -m experiments.failures                 simulate, record, table: ``make mixocity-failures``

Sixteen scenes of sixteen logs for every staged situation, no two situations on the same drives; sixteen ordinary drives
once with sound cameras and once with each fault of :mod:`mixo_env.simulator.picture.faults`, so that these are paired.
Rows learn from the bundled headline alone. Recordings stay in a cache outside the repository; pictures go as soon as
nothing needs them any longer. What an interruption left is continued, and what is recorded is not recorded again.
"""

from __future__ import annotations

import logging
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from experiments.failures_table import TRACK, write_tables
from mixo_env.errors import ConfigurationError, DatasetError, MixoError, unknown
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.files import writable_folder
from mixo_env.leaderboard.conditions import SITUATIONS
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.camera_faults import told_faults
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.folds import OUT_OF_DISTRIBUTION
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.schema import HEADLINE_TRACKS
from mixo_env.recordings.store import MANIFEST_FILE, load_recordings, save_recordings
from mixo_env.simulator.config import FAULTS, CameraFault, SimulationConfig, staging
from mixo_env.simulator.dataset import simulate

logger = logging.getLogger(__name__)

Stage = Literal["record", "table", "sample"]

SEEDS = {"table": 1700, "development": 2700}
"""First of the drives that are printed, and of those that a method may be tried on; every situation has the next one.
The headline's is 0."""

STAGED_KINDS = {
    "side_queue": ("side_queue", 0.0),
    "side_queue_rain": ("side_queue", 1.0),
    **{name: (name, 0.0) for name in ("lead_truck", "following_van", "blank_wall", "oncoming_platoon")},
    "tight_turn": ("tight_turn", 0.0),
    "majority_wrong": ("majority_wrong", 0.0),
    "low_texture": ("low_texture", 0.0),
    "ordinary": ("ordinary", 0.0),
}
"""Kind -> situation and share of rain, with sound cameras."""

KINDS = (*STAGED_KINDS, *FAULTS[1:])
"""Columns of the table; the faults are those of the drives of ``ordinary``."""

SOUND = "ordinary"
"""The kind whose pictures the faults spoil."""


SAMPLED = {"ordinary": 2, "frozen": 2, "side_queue": 2}
"""Kind -> how many of its scenes lie beside the tests."""


@dataclass(frozen=True)
class Failures:
    """Make the failure suite and its table, or what is still missing of them.

    Worked examples:

      python -m experiments.failures                                        everything
      python -m experiments.failures --drives development                   other drives, to work with
      python -m experiments.failures --kinds ordinary frozen --scenes 4     two columns of four scenes
      python -m experiments.failures --stages record --kinds side_queue     a piece; the table comes when all are there
      python -m experiments.failures --stages table --track CONSUMER --out with-gyro
    """

    cache: Path = Path.home() / ".cache" / "mixocity-failures"
    """Where recordings are kept, and pictures while they are needed."""
    out: Path = Path("results/failures")
    """Folder of failures.json, failures.md and failures.png."""
    stages: tuple[Stage, ...] = ("record", "table")
    """record: simulate and record; table: score what is recorded; sample: put a few scenes beside the tests, which are
    of the drives of the table."""
    kinds: tuple[str, ...] = KINDS
    """Columns; all by default."""
    drives: Literal["table", "development"] = "table"
    """Which drives: the seed of one is never that of the other."""
    policies: tuple[str, ...] = ()
    """Rows; all but the expensive ones by default."""
    track: str = TRACK
    """Of the table: who votes besides the cameras."""
    scenes: int = 16
    """Of every kind, a log each."""
    seconds: int = 20
    """Length of a scene [s]."""
    width: int = 800
    """Of the images [px]; 9/16 of it is their height."""
    workers: int = 2
    """Processes; the result does not depend on it."""
    samples: Path = Path("tests/data/failures")
    """Folder for a few of the recorded scenes."""

    def __post_init__(self) -> None:
        for kind in self.kinds:
            if kind not in KINDS:
                raise ConfigurationError(unknown("kind of failure", kind, KINDS))
        if self.track not in HEADLINE_TRACKS:
            raise ConfigurationError(unknown("track", self.track, HEADLINE_TRACKS))
        if "sample" in self.stages and (self.drives != "table" or not set(SAMPLED) <= set(self.kinds)):
            raise ConfigurationError(
                f"--stages sample is of the drives of the table, {', '.join(SAMPLED)}: leave --drives and --kinds out"
            )

    def run(self) -> None:
        """Go through the stages.

        Raises:
            DatasetError: when a scene could not be recorded.
            RecordingError: when a kind is not recorded yet, and only the table is asked for.
        """
        if "record" in self.stages:
            for kind in self.kinds:
                if not self.recorded(kind):
                    self.simulate(kind)
                    self.record(kind)
                self.tidy(kind)
        if "table" in self.stages:
            recorded = {kind: load_recordings(str(self.folder(kind) / "recordings")) for kind in self.kinds}
            write_tables(recorded, load_recordings(), writable_folder(self.out), self.policies, self.track)
            logger.info("table: %s", self.out)
        if "sample" in self.stages:
            for kind in SAMPLED:
                self.sample(kind)

    def sample(self, kind: str) -> None:
        """Copy the first scenes of one kind to where the tests find them.

        Raises:
            RecordingError: when the kind is not recorded yet.
        """
        recordings = load_recordings(str(self.folder(kind) / "recordings"))
        names = [scene.name for scene in recordings.scenes[: SAMPLED[kind]]]
        save_recordings(recordings.select(scenes=names), self.samples / kind)

    def recorded(self, kind: str) -> bool:
        """Whether a kind is done."""
        return (self.folder(kind) / "recordings" / MANIFEST_FILE).exists()

    def simulate(self, kind: str) -> None:
        """Make the pictures of one kind; a fault spoils those of the ordinary drives."""
        sound = None
        if kind in FAULTS:
            sound = self.folder(SOUND) / "images"
            simulate(self.config(SOUND), sound, self.workers, _told("simulate", SOUND))
        simulate(self.config(kind), self.folder(kind) / "images", self.workers, _told("simulate", kind), sound=sound)

    def tidy(self, kind: str) -> None:
        """Delete pictures that nothing needs any longer; those of the ordinary drives when all faults are recorded."""
        done = [kind] if kind != SOUND else []
        if all(self.recorded(other) for other in (SOUND, *FAULTS[1:])):
            done.append(SOUND)
        for name in done:
            for left in ("images", "unfinished"):
                shutil.rmtree(self.folder(name) / left, ignore_errors=True)

    def folder(self, kind: str) -> Path:
        """Of one kind in the cache; drives of another seed or size never meet."""
        return self.cache / f"{self.drives}-{self.scenes}x{self.seconds}s-{self.width}" / kind

    def seed(self, kind: str) -> int:
        """Of the drives of a kind: situations share none, faults have those of the ordinary drives."""
        return SEEDS[self.drives] + list(STAGED_KINDS).index(SOUND if kind in FAULTS else kind)

    def config(self, kind: str) -> SimulationConfig:
        """What is simulated for one kind."""
        situation, rain = STAGED_KINDS.get(kind, STAGED_KINDS[SOUND])
        basis = SimulationConfig(
            scenes=self.scenes,
            seed=self.seed(kind),
            seconds=self.seconds,
            width=self.width,
            height=self.width * 9 // 16,
            rain=rain,
            night=0.0,
            fault=CameraFault(kind if kind in FAULTS else "none"),
        )
        return staging(basis, situation)

    def record(self, kind: str) -> Recordings:
        """Record one kind with the experts of the headline, and note what was staged and which camera failed.

        Raises:
            DatasetError: when a scene could not be recorded.
        """
        home, images = self.folder(kind) / "recordings", self.folder(kind) / "images"
        config = RecordConfig(
            monocular=MonocularConfig.preset("fast"),
            joint=JointConfig(),
            data_version=f"mixocity-failures-{kind}-{self.seed(kind)}",
            camera_faults=told_faults(images),
        )
        parts = self.folder(kind) / "unfinished"
        recordings = record(open_dataset(images), config, parts, self.workers, _told("record", kind))
        if skipped := recordings.manifest.parameters["skipped"]:
            raise DatasetError(f"{kind} is not whole: {len(skipped)} scenes could not be recorded, see above")
        scenes = tuple(replace(scene, fold=OUT_OF_DISTRIBUTION) for scene in recordings.scenes)
        told: dict[str, Any] = {SITUATIONS: {scene.name: kind for scene in scenes}}
        manifest = replace(recordings.manifest, scenes=scenes, parameters=recordings.manifest.parameters | told)
        recordings = recordings.replace(manifest)
        save_recordings(recordings, home)
        return recordings


def _told(stage: str, kind: str) -> Callable[[int, int], None]:
    return lambda done, total: logger.info("%s %s: %d of %d scenes", stage, kind, done, total)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    import tyro

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    try:
        tyro.cli(Failures, args=arguments).run()
    except MixoError as error:
        logger.error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
