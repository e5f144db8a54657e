"""How the bundled recordings are made: ``make mixocity``, or stage by stage with ``python -m experiments.mixocity``.

Images stay in a cache outside the repository, so that experts can be recorded anew without rendering. Every stage may
be interrupted: the same command continues.
"""

from __future__ import annotations

import logging
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import mixo_env
from mixo_env.errors import DatasetError, MixoError
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.leaderboard.conditions import SITUATIONS
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.folds import folds_by_log
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.schema import SceneEntry
from mixo_env.recordings.store import save_recordings
from mixo_env.recordings.vehicles import training_constants
from mixo_env.recordings.vocabularies import Retrained, retrain
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.dataset import simulate
from mixo_env.simulator.drive.scenario import LOCATION, plan_logs

logger = logging.getLogger(__name__)

CONFIG = SimulationConfig(scenes=104, scenes_per_log=4, seed=0, seconds=20, rain=0.2, night=2 / 26)
"""26 drives of 4 scenes, the paper's four cameras at 800 x 450: 19 by day, 5 in rain, 2 at night (``ood``)."""

FULL_SIZE = replace(CONFIG, width=1600, height=900)
"""The same drives at the size of nuScenes; only the scenes of :func:`full_size_scenes` are rendered."""

RETRAINED = ("CAM_BACK_RIGHT", "CAM_FRONT_LEFT")
"""Cameras that the paper gives a vocabulary of their own."""

DATA_VERSION = "0.6"

Stage = Literal["simulate", "vocabularies", "record", "simulate-paper", "record-paper"]


def full_size_scenes() -> tuple[str, ...]:
    """First scene of every third drive that is not at night: 8 scenes, two of every fold."""
    logs = [log for log in plan_logs(FULL_SIZE) if log.weather != "night"]
    return tuple(log.scenes[0].name for log in logs[::3])


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
    """Make the bundled recordings anew: a few hours on 2 cores.

    Worked examples:

      python -m experiments.mixocity                                   everything, or what is still missing
      python -m experiments.mixocity --stages simulate --workers 8     images only
      python -m experiments.mixocity --stages vocabularies record      other experts, the same images
    """

    cache: Path = Path.home() / ".cache" / "mixocity"
    """Where images, vocabularies and unfinished recordings are kept (about 20 GB)."""
    out: Path = Path(mixo_env.__file__).parent / "recordings" / "data"
    """Where finished recordings go: ``mixocity`` and ``mixocity-paper`` (8 scenes at 1600 x 900, preset "paper")."""
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
                case "vocabularies":
                    self._vocabularies(city)
                case "record":
                    self._record(city, "mixocity", "fast", self._vocabularies(city), progress)
                case "simulate-paper":
                    simulate(FULL_SIZE, full_size, self.workers, progress, only=full_size_scenes())
                case "record-paper":
                    self._record(full_size, "mixocity-paper", "paper", {}, progress)

    def _vocabularies(self, city: Path) -> dict[str, Retrained]:
        """Trained on a random 20 % of the images of the folds that a scene is not in."""
        return retrain(open_dataset(city), RETRAINED, MonocularConfig.preset("fast"), self.cache, workers=self.workers)

    def _record(
        self,
        root: Path,
        name: str,
        preset: str,
        variants: Mapping[str, Retrained],
        progress: Callable[[int, int], None],
    ) -> None:
        """Record into the cache, and put the finished recording in its place."""
        config = RecordConfig(
            monocular=MonocularConfig.preset(preset), data_version=f"{name}-{DATA_VERSION}", variants=variants
        )
        recordings = record(open_dataset(root), config, self.cache / name, self.workers, progress)
        if skipped := recordings.manifest.parameters["skipped"]:
            raise DatasetError(f"{name} is not whole: {len(skipped)} scenes could not be recorded, see above")
        shutil.rmtree(self.out / name, ignore_errors=True)  # of an older schema, perhaps, which is never overwritten
        save_recordings(with_planned_folds(recordings), self.out / name)
        logger.info("%s: %d scenes, %d rows in %s", name, len(recordings), len(recordings["step"]), self.out / name)


def with_planned_folds(recordings: Recordings) -> Recordings:
    """The recordings with the folds of all 104 scenes, even if they hold but some: nothing leaks between the two."""
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
