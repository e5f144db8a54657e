"""How the bundled recordings are made: ``make mixocity``, or stage by stage with ``python -m experiments.mixocity``.

Images stay in a cache outside the repository, so that experts can be recorded anew without rendering. Processes share
the work log by log when they simulate, scene by scene when they record, and every stage may be interrupted: the same
command continues with the scene it was at. Once a stage has recorded its scenes, their images are needed no more.
"""

from __future__ import annotations

import logging
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

import mixo_env
from experiments.peers.orbslam3_client import orbslam3_python
from experiments.peers.orbslam3_expert import FAMILY, Orbslam3Expert
from mixo_env.errors import DatasetError, MixoError
from mixo_env.experts.families import family_expert
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.learned import LearnedConfig
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.tutorial import TutorialConfig
from mixo_env.leaderboard.conditions import SITUATIONS
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.folds import FOLDS, folds_by_log
from mixo_env.recordings.importing import import_into
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.schema import SceneEntry
from mixo_env.recordings.sequence_files import Reading
from mixo_env.recordings.store import TIMINGS_FILE, load_recordings, read_columns, save_recordings, write_columns
from mixo_env.recordings.vehicles import training_constants
from mixo_env.recordings.vocabularies import Retrained, retrain
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.dataset import simulate
from mixo_env.simulator.drive.scenario import LOCATION, LogPlan, plan_logs

logger = logging.getLogger(__name__)

CONFIG = SimulationConfig(scenes=344, scenes_per_log=4, seed=0, seconds=20, rain=0.2, night=6 / 86)
"""86 drives of 4 scenes, the paper's four cameras at 800 x 450: 63 by day, 17 in rain, 6 at night (``ood``)."""

FULL_SIZE = replace(CONFIG, width=1600, height=900)
"""The same drives at the size of nuScenes; only the scenes of :func:`full_size_scenes` are rendered."""

RETRAINED = ("CAM_BACK_RIGHT", "CAM_FRONT_LEFT")
"""Cameras that the paper gives a vocabulary of their own."""

DATA_VERSION = "1.0"

Stage = Literal["simulate", "record", "vocabularies", "record-rows", "import-peer", "simulate-paper", "record-paper"]

PEER_GAP_S = 0.15
"""Between two images of ORB-SLAM3, at most: a longer gap would go on from poses before lost images."""


def row_scenes() -> tuple[str, ...]:
    """The subset on which further rows stand: the first scene of 28 of the 80 drives that are not at night."""
    return tuple(sorted(log.scenes[0].name for log in _row_logs()))


def full_size_scenes() -> tuple[str, ...]:
    """Two scenes of every fold: of its first and its last drive, in order of the logs' names, in ``row_scenes``."""
    names = [log.scenes[0].name for log in _row_logs()]
    return tuple(sorted(names[:FOLDS] + names[-FOLDS:]))


def _row_logs() -> list[LogPlan]:
    """Folds deal out logs in order of name, one each in turn; of every twelve in that order these are the first four.

    So the rule of the folds says the same of the subset alone, and retrained words stay in their folds.
    """
    logs = sorted((log for log in plan_logs(CONFIG) if log.weather != "night"), key=lambda log: log.logfile)
    return [log for number, log in enumerate(logs) if number % 12 < FOLDS]


def planned_folds() -> dict[str, int]:
    """Scene -> fold, known before anything is driven."""
    conditions = {"day": ("day",), "rain": ("day", "rain"), "night": ("night",)}
    scenes = [
        SceneEntry(scene.name, log.logfile, log.vehicle, LOCATION, conditions[log.weather], -1, 0)
        for log in plan_logs(CONFIG)
        for scene in log.scenes
    ]
    return {scene.name: fold for scene, fold in zip(scenes, folds_by_log(scenes), strict=True)}


def planned_situations() -> dict[str, str]:
    """Scene -> what is staged in it."""
    return {scene.name: scene.situation for log in plan_logs(CONFIG) for scene in log.scenes}


@dataclass(frozen=True)
class Build:
    """Make the bundled recordings anew: about three hours on 2 cores.

    Worked examples:

      python -m experiments.mixocity                                   everything, or what is still missing
      python -m experiments.mixocity --stages simulate --workers 8     images only
      python -m experiments.mixocity --stages record record-rows       other experts, the same images
    """

    cache: Path = Path.home() / ".cache" / "mixocity"
    """Where images, vocabularies and unfinished recordings are kept (about 22 GB, nearly all images)."""
    out: Path = Path(mixo_env.__file__).parent / "recordings" / "data"
    """Where finished recordings go: ``mixocity``, ``mixocity-rows`` (28 scenes with all rows) and ``mixocity-paper`` (8
    scenes at 1600 x 900, preset "paper")."""
    stages: tuple[Stage, ...] = get_args(Stage)
    """What to do, in this order; all by default."""
    workers: int = 2
    """Processes; the result does not depend on it."""

    def run(self) -> None:
        """Go through the stages."""
        city, full_size = self.cache / "city", self.cache / "full-size"
        for stage in self.stages:
            progress = _told(stage)
            match stage:
                case "simulate":
                    simulate(CONFIG, city, self.workers, progress)
                case "record":
                    self._record(city, "mixocity", RecordConfig(joint=JointConfig()), progress)
                case "vocabularies":
                    self._vocabularies(city)
                case "record-rows":
                    rows = RecordConfig(
                        scenes=row_scenes(),
                        variants=self._vocabularies(city),
                        joint=JointConfig(),
                        tutorial=TutorialConfig(),
                        learned=LearnedConfig(),
                    )
                    self._record(city, "mixocity-rows", rows, progress)
                case "import-peer":
                    self._import_peer(city)
                case "simulate-paper":
                    simulate(FULL_SIZE, full_size, self.workers, progress, only=full_size_scenes())
                case "record-paper":
                    paper = RecordConfig(monocular=MonocularConfig.preset("paper"))
                    self._record(full_size, "mixocity-paper", paper, progress)

    def _vocabularies(self, city: Path) -> dict[str, Retrained]:
        """Trained on a random 20 % of the images of the folds that a scene is not in."""
        settings, scenes = MonocularConfig.preset("fast"), row_scenes()
        return retrain(open_dataset(city), RETRAINED, settings, self.cache, scenes=scenes, workers=self.workers)

    def _import_peer(self, city: Path) -> None:
        """ORB-SLAM3 over the row scenes, beside their other rows; nothing where that program cannot be installed.

        Its threads race: another run differs a little.
        """
        if orbslam3_python() is None:
            logger.warning("import-peer: ORB-SLAM3 cannot be installed here, mixocity-rows stays without it")
            return
        files, home = self.cache / "orbslam3", self.out / "mixocity-rows"
        if Orbslam3Expert(city, files, scenes=row_scenes()).run():
            raise DatasetError("ORB-SLAM3 died in some scenes, see above: the same command tries them again")
        names = [family_expert(FAMILY, camera) for camera in CAMERAS]
        rows = load_recordings(home)
        old = [name for name in names if name in rows.manifest.imported]
        experts = {name: files / name for name in names}
        live = Reading(live=True)
        save_recordings(import_into(rows, experts, live, PEER_GAP_S, old, names, logger.info), home)

    def _record(self, root: Path, name: str, config: RecordConfig, progress: Callable[[int, int], None]) -> None:
        """Record into the cache, and put the finished recording in its place."""
        config = replace(config, data_version=f"{name}-{DATA_VERSION}")
        recordings = record(open_dataset(root), config, self.cache / name, self.workers, progress)
        if skipped := recordings.manifest.parameters["skipped"]:
            raise DatasetError(f"{name} is not whole: {len(skipped)} scenes could not be recorded, see above")
        shutil.rmtree(self.out / name, ignore_errors=True)  # of an older schema, perhaps, which is never overwritten
        save_recordings(with_planned_folds(recordings), self.out / name)
        keep_timings(self.cache / name, self.out / name)
        logger.info("%s: %d scenes, %d rows in %s", name, len(recordings), len(recordings["step"]), self.out / name)


def keep_timings(recorded: Path, home: Path) -> None:
    """CPU times of the scenes of ``row_scenes`` alone: enough for medians, and a fraction of the bytes."""
    timings, _, _ = read_columns((recorded / TIMINGS_FILE).read_bytes())
    kept = np.isin(timings["scene"].astype(str), row_scenes())
    write_columns(home / TIMINGS_FILE, {name: column[kept] for name, column in timings.items()}, [int(kept.sum())])


def with_planned_folds(recordings: Recordings) -> Recordings:
    """The recordings with the folds of the whole plan, even if they hold but some: nothing leaks between them."""
    fold_of, staged = planned_folds(), planned_situations()
    scenes = tuple(replace(scene, fold=fold_of[scene.name]) for scene in recordings.scenes)
    parameters = recordings.manifest.parameters | {SITUATIONS: {scene.name: staged[scene.name] for scene in scenes}}
    recordings = recordings.replace(replace(recordings.manifest, scenes=scenes, parameters=parameters))
    return with_fits(recordings.replace(replace(recordings.manifest, vehicles=training_constants(recordings))))


def _told(stage: str) -> Callable[[int, int], None]:
    return lambda done, total: logger.info("%s: %d of %d scenes", stage, done, total)


def main() -> int:
    """Run the command line."""
    import tyro

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    try:
        tyro.cli(Build).run()
    except MixoError as error:
        logger.error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
