"""ORB-SLAM3 as an expert: run over a nuScenes folder, every scene and camera; its live poses as files for an import.

    python -m experiments.peers.orbslam3_expert --dataroot city --cameras CAM_FRONT CAM_BACK --out orbslam3
    mixo import recorded --expert ORBSLAM3_FRONT=orbslam3/ORBSLAM3_FRONT ... --live --max-gap-s 0.15 --out with-orbslam3

Of every scene and camera ``ORBSLAM3_FRONT/SCENE.txt`` (TUM, vehicle axes) and ``SCENE.quality.csv`` are written: a line
an image with state and map points tracked. A pose is the one given with its image, before any later one was seen; what
the map makes of it afterwards is not used. (With ``--live`` the import uses no pose after the end of a step either; a
longer gap would go on from poses before lost images.) What is there is not done again: a killed run loses the one that
it worked on.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from experiments.peers.orbslam3_client import OrbRun, OrbSettings, orbslam3_python, run_orbslam3
from experiments.peers.orbslam3_words import train_words
from mixo_env.cli.progress import progress
from mixo_env.errors import ConfigurationError, DatasetError, MixoError
from mixo_env.experts.families import family_expert
from mixo_env.experts.imported import MAXIMUM_GAP_S
from mixo_env.experts.monocular.camera import MountedCamera, mount
from mixo_env.experts.quality import quality_file
from mixo_env.files import write_text
from mixo_env.geometry import quaternion_wxyz_from_rotation
from mixo_env.nuscenes.scene import CameraReel
from mixo_env.nuscenes.selecting import chosen
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.nuscenes.tables import Dataset, open_dataset
from mixo_env.recordings.folder import claimed
from mixo_env.recordings.steps import readable

logger = logging.getLogger(__name__)

FAMILY = "ORBSLAM3"

SETTINGS = {"small": (OrbSettings(2000, 8), 800 * 450), "paper": (OrbSettings(8000, 19), 1600 * 900)}
"""Name -> extractor, and most pixels: larger images are halved."""

_WORDS, _SETTINGS = "words.txt", "settings.txt"
_VOCABULARY_IMAGES = 120
_STATES = {"OK": "tracking", "LOST": "lost", "RECENTLY_LOST": "lost"}
"""Its word -> that of quality files; any other is of a map that does not exist yet."""


@dataclass(frozen=True)
class Orbslam3Expert:
    """Run ORB-SLAM3 over a folder; the same command continues."""

    dataroot: Path
    """nuScenes folder, real or simulated."""
    out: Path
    """Folder of the files, a folder an expert in it."""
    cameras: tuple[str, ...] = CAMERAS
    """Channels."""
    scenes: tuple[str, ...] = ()
    """Names; all by default."""
    settings: Literal["small", "paper"] = "small"
    """small: 2000 corners, 8 levels, images halved to 800 x 450; paper: 8000 corners, 19 levels, 1600 x 900."""
    pace: float | None = None
    """Share of real time at which images are handed over. None: each when mapping is at rest, or has had the
    processor for as long as on a car: it does not starve on a machine that does other things."""

    def run(self) -> int:
        """Write the files; 1 if ORB-SLAM3 died somewhere.

        Raises:
            ConfigurationError: ORB-SLAM3 cannot be installed, other settings made what is in the folder.
            DatasetError: for the data.
        """
        if self.pace is not None and not self.pace > 0.0:
            raise ConfigurationError(f"expected a pace above 0, got {self.pace:g}")
        dataset = open_dataset(self.dataroot)
        scenes = chosen(dataset, self.scenes, "all")
        python = orbslam3_python()
        if python is None:
            raise ConfigurationError("ORB-SLAM3 cannot be installed here: it needs pip and the wheel pyorbslam3")
        todo = [(scene, camera) for scene in scenes for camera in self.cameras]
        faults = 0
        with claimed(self.out), progress("running ORB-SLAM3") as report:
            self._claim()
            words = self._words(dataset, scenes)
            for done, (name, camera) in enumerate(todo):
                report(done, len(todo))
                path = self.out / family_expert(FAMILY, camera) / f"{name}.txt"
                if path.exists():
                    continue
                try:
                    self._run_one(python, words, dataset.load(name, (camera,)).cameras[camera], path)
                except MixoError as error:
                    faults += 1
                    logger.warning("%s, %s: %s", name, camera, error)
            report(len(todo), len(todo))
        return 1 if faults else 0

    def _claim(self) -> None:
        """See that the folder's files were made with these settings: nothing mixes two programs under one name."""
        text = f"{self.settings} {asdict(SETTINGS[self.settings][0])} pace {self.pace}\n"
        path = self.out / _SETTINGS
        if path.exists() and path.read_text(encoding="utf-8") != text:
            raise ConfigurationError(f"{self.out} was made with other settings: choose another --out, or remove it")
        write_text(path, text)

    def _words(self, dataset: Dataset, scenes: tuple[str, ...]) -> Path:
        """A vocabulary of images of the folder, trained once."""
        path = self.out / _WORDS
        if not path.exists():
            each = -(-_VOCABULARY_IMAGES // (len(scenes) * len(self.cameras)))
            train_words(self._sample(dataset, scenes, each), path)
        return path

    def _sample(self, dataset: Dataset, scenes: tuple[str, ...], each: int) -> Iterator[NDArray[np.uint8]]:
        """At least ``_VOCABULARY_IMAGES`` images (if there are so many), evenly spread."""
        pairs = [(scene, camera) for scene in scenes for camera in self.cameras]
        for name, camera in pairs[:: max(1, len(pairs) // _VOCABULARY_IMAGES)]:
            reel = dataset.load(name, (camera,)).cameras[camera]
            mounted = mount(reel.calibration, SETTINGS[self.settings][1])
            for path in reel.image_paths[:: max(1, len(reel.image_paths) // each)]:
                image = readable(path, reel.calibration, mounted.halvings)
                if not isinstance(image, str):
                    yield image

    def _run_one(self, python: Path, words: Path, reel: CameraReel, path: Path) -> None:
        """One scene of one camera; images that cannot be read are left out."""
        settings, pixels = SETTINGS[self.settings]
        mounted = mount(reel.calibration, pixels)
        read = [readable(image, reel.calibration, mounted.halvings) for image in reel.image_paths]
        images = [image for image in read if not isinstance(image, str)]
        stamps = reel.timestamp_us[[not isinstance(image, str) for image in read]]
        if len(images) < 2:
            raise DatasetError(f"expected 2 images or more that can be read, got {len(images)}")
        fitting = settings.fitting(*images[0].shape)
        run = run_orbslam3(python, images, stamps, working_intrinsic(mounted), words, fitting, self.pace)
        trajectory, quality = files_of(run, stamps, mounted.rotation)
        write_text(quality_file(path), quality)  # first: the trajectory says that both are there
        write_text(path, trajectory)


def working_intrinsic(camera: MountedCamera) -> NDArray[np.float64]:
    """Pixel matrix ``(3, 3)`` of the halved image, without skew; the centre of its top left pixel is (0, 0)."""
    scale = 0.5**camera.halvings
    intrinsic = np.diag([*(scale * camera.focal_px), 1.0])
    intrinsic[:2, 2] = (camera.centre_px + 0.5) * scale - 0.5
    return intrinsic


def files_of(
    run: OrbRun, timestamp_us: NDArray[np.int64], rotation_ego_from_camera: NDArray[np.float64]
) -> tuple[str, str]:
    """Trajectory (TUM, vehicle axes, unknown scale) and quality of its poses, a line an image.

    An image without a pose has the last one, and a state that keeps it from being read. So have the first poses of a
    second map: it has a frame of its own, and what the car turned between two maps nobody knows. They are kept back
    until the pose before them is too old to be bridged by the import.

    Args:
        run: over ``n`` images.
        timestamp_us: ``(n,)`` of them.
        rotation_ego_from_camera: ``(3, 3)`` mounting.
    """
    poses, lines = [], ["matches,state"]
    pose: tuple[Any, Any] = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    last_us, new_map = -(10**18), True
    mounting = rotation_ego_from_camera
    for i, stamp in enumerate(timestamp_us.tolist()):
        state = _STATES.get(run.state[i], "initialising")
        if not np.isfinite(run.rotation[i]).all():
            # Either word means that a map begins anew before the next pose.
            new_map |= run.state[i] != "RECENTLY_LOST"
            state = "lost" if state == "tracking" else state
        elif new_map and stamp - last_us <= 1e6 * MAXIMUM_GAP_S:
            state = "initialising"
        else:
            last_us, new_map = stamp, False
            pose = quaternion_wxyz_from_rotation(mounting @ run.rotation[i] @ mounting.T), mounting @ run.position[i]
        (w, x, y, z), place = pose
        numbers = " ".join(f"{number:.9f}" for number in (*place, x, y, z, w))
        poses.append(f"{stamp // 10**6}.{stamp % 10**6:06d} {numbers}\n")
        lines.append(f"{run.matches[i]},{state}")
    return "".join(poses), "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    import tyro

    try:
        return tyro.cli(Orbslam3Expert, args=arguments).run()
    except MixoError as error:
        logger.error("%s", error)
        return 1


if __name__ == "__main__":
    sys.exit(main())
