"""``mixo record``: run the experts over a nuScenes folder, once."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from tyro.conf import Positional

from mixo_env.nuscenes.selections import CAMERAS

if TYPE_CHECKING:
    from mixo_env.recordings.collection import Recordings


@dataclass(frozen=True)
class Record:
    """Run the experts over a nuScenes folder, real or simulated, and keep what they say.

    Images are read here and never again: environments, policies and scores work on the recording. An interrupted run
    continues where it stopped; scenes that cannot be recorded, or in which `mixo inspect` finds a problem, are skipped
    with the reason, and the exit code is 1 then.

    Worked examples:

      mixo record city --out recorded                                     a simulated folder
      mixo record /data/nuscenes --out trainval --workers 8               everything you have
      mixo record /data/nuscenes --out two --scenes scene-0655 scene-0757
      mixo record /data/nuscenes --out paper --selection paper736 --folds contiguous --preset paper
      mixo record city --out front --cameras CAM_FRONT CAM_FRONT_LEFT
      mixo record city --out recorded --despite gyro-size clock-offset
      mixo record city --out recorded --retrained CAM_BACK_RIGHT          rows "w/ retrained vocabulary" of the paper
      mixo record city --out recorded --experts JOINT                     and all cameras in one estimate
      mixo record /data/nuscenes --out steps --no-images                  inertial experts, from tables and CAN bus
      mixo record city --out recorded --experts TUTORIAL                  and experts for the track UNEQUAL
      mixo benchmark --recordings recorded                                what to do next
    """

    interrupted: ClassVar[str] = "recorded scenes are kept, and the same command continues"

    root: Positional[Path]
    """Folder that holds v1.0-*, samples, sweeps and can_bus."""
    out: Path
    """Folder of the recording."""
    workers: int = 1
    """Processes; each records one scene at a time. The result does not depend on it."""
    scheduler: str | None = None
    """Record on a Dask cluster instead, e.g. tcp://10.0.0.1:8786; its workers must see the folder under the same path
    (needs the extra "cluster")."""
    version: str | None = None
    """Tables to use, e.g. v1.0-trainval; needed only when the folder holds several."""
    scenes: tuple[str, ...] = ()
    """Scenes to record; those of the selection by default."""
    selection: str = "all"
    """Scenes by name: all, day, night, rain, moving (5 m or more), paper736, or an official split such as val, whose
    list is read from splits.json in the version folder or from an installed nuscenes-devkit."""
    key_frames: bool = False
    """Leave the images between key frames (sweeps) out: 2 Hz."""
    cameras: tuple[str, ...] = CAMERAS
    """Cameras to record; the paper's four by default."""
    images: bool = True
    """Without images the inertial experts are recorded alone, at the times that the tables tell of the cameras' images;
    `mixo import` adds odometry of yours."""
    preset: Literal["fast", "paper"] = "fast"
    """Settings of the monocular odometry; "paper": 8000 features, 19 levels, full resolution."""
    folds: Literal["log", "contiguous"] = "log"
    """Folds of the cross-validation: whole drives, or the paper's contiguous blocks of scenes."""
    retrained: tuple[str, ...] = ()
    """Cameras to record once more with a vocabulary retrained on 20 % of the images of the other folds."""
    experts: tuple[Literal["JOINT", "TUTORIAL", "LEARNED"], ...] = ()
    """Experts beside the single cameras; JOINT: all cameras in one estimate, a row of its own that never votes.
    TUTORIAL: the odometry everyone writes first, on every camera. LEARNED: ours with learned corners, on every camera
    (needs the extra "learned"). These two vote in track UNEQUAL alone."""
    despite: tuple[str, ...] = ()
    """Checks of `mixo inspect` whose problems are accepted, by the name that stands before the remark."""
    data_version: str | None = None
    """Name of the data in every result; the version of the tables by default."""

    def run(self) -> int:
        """Record and say what was recorded."""
        from mixo_env.cli.progress import progress
        from mixo_env.errors import ConfigurationError, unknown
        from mixo_env.experts.joint.config import JointConfig
        from mixo_env.experts.learned import LearnedConfig
        from mixo_env.experts.monocular.config import MonocularConfig
        from mixo_env.experts.tutorial import TutorialConfig
        from mixo_env.nuscenes.checks.judge import JudgedDataset
        from mixo_env.nuscenes.selecting import chosen
        from mixo_env.nuscenes.tables import open_dataset
        from mixo_env.recordings.camera_faults import told_faults
        from mixo_env.recordings.folder import claimed
        from mixo_env.recordings.record import RecordConfig, record
        from mixo_env.recordings.vocabularies import retrain

        if not self.images and (self.retrained or self.experts):
            raise ConfigurationError("--retrained and --experts need images: leave them out, or --no-images")
        for camera in self.retrained:
            if camera not in self.cameras:
                raise ConfigurationError(unknown("camera to retrain for", camera, self.cameras))
        monocular = MonocularConfig.preset(self.preset)
        dataset = open_dataset(self.root, self.version, self.key_frames)
        for camera in self.cameras:
            dataset.channel(camera)
        scenes = chosen(dataset, self.scenes, self.selection)
        judged = JudgedDataset(dataset, self.despite, self.images)
        with claimed(self.out) if self.retrained else nullcontext():
            variants = retrain(
                dataset,
                self.retrained,
                monocular,
                self.out,
                scenes=scenes,
                folds=self.folds,
                workers=self.workers,
            )
        config = RecordConfig(
            cameras=self.cameras,
            scenes=scenes,
            monocular=monocular,
            folds=self.folds,
            data_version=self.data_version,
            variants=variants,
            joint=JointConfig() if "JOINT" in self.experts else None,
            images=self.images,
            tutorial=TutorialConfig() if "TUTORIAL" in self.experts else None,
            learned=LearnedConfig() if "LEARNED" in self.experts else None,
            camera_faults=told_faults(dataset.root),
        )
        with progress("recording scenes") as report:
            recordings = record(
                judged, config, self.out, workers=self.workers, progress=report, scheduler=self.scheduler
            )
        return self._say(recordings)

    def _say(self, recordings: Recordings) -> int:
        """What was recorded, and the exit code."""
        from mixo_env.recordings.presets import data_label

        manifest = recordings.manifest
        skipped = len(manifest.parameters["skipped"])
        broken = sum(
            count
            for of_scene in manifest.parameters["broken_images"].values()
            for camera, count in of_scene.items()
            if camera in manifest.cameras
        )
        print(
            f"{self.out}: {len(recordings)} scenes, {len(recordings['step']):,} rows, "
            f"{len({scene.log for scene in recordings.scenes})} logs, {data_label(manifest)}"
            + (f"; no image in {broken} steps for the reasons above" if broken else "")
            + (f"; {skipped} skipped for the reasons above: the same command tries them again" if skipped else "")
        )
        return 1 if skipped else 0
