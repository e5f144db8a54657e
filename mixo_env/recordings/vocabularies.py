"""Vocabularies retrained for one camera: the rows "w/ retrained vocab." of the paper's Table I.

The paper retrains on a random 20 % of the images. Here they come from the training folds only: a scene is matched
with words that were learned without its own fold, a night scene (in no fold) with those of all folds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.nuscenes.tables import Dataset
from mixo_env.recordings.folds import FOLD_RULES, OUT_OF_DISTRIBUTION
from mixo_env.recordings.processes import processes
from mixo_env.recordings.provenance import configuration_hash
from mixo_env.recordings.schema import SceneEntry
from mixo_env.recordings.steps import readable

SHARE = 0.2
"""Of the images, as in the paper."""

Descriptors = NDArray[np.uint64]


@dataclass(frozen=True)
class Retrained:
    """One camera once more, with other words.

    Attributes:
        camera: channel.
        vocabulary: scene -> file, learned without the scene's fold.
    """

    camera: str
    vocabulary: Mapping[str, Path]


def retrain(
    dataset: Dataset,
    cameras: Sequence[str],
    config: MonocularConfig,
    folder: Path,
    *,
    scenes: Sequence[str] = (),
    folds: str = "log",
    workers: int = 1,
    seed: int = 0,
) -> dict[str, Retrained]:
    """Train what is missing of the vocabularies of every camera and fold held out.

    Args:
        dataset: whose images are learned from.
        cameras: channels.
        config: of the odometry that the words are for.
        folder: of the vocabularies; those of other settings, images or software never mix in.
        scenes: names; empty for all. Those without CAN bus cannot be recorded and are not learned from.
        folds: rule of ``FOLD_RULES``, as in the recording.
        workers: processes; the result does not depend on it.
        seed: of the choice of images and of the clustering.

    Returns:
        Name of the row -> what ``RecordConfig.variants`` needs.

    Raises:
        ConfigurationError: for too few images.
    """
    from joblib import Parallel, delayed

    from mixo_env.experts.monocular.vocabulary import train_vocabulary

    entries = [
        SceneEntry(info.name, info.log, info.vehicle, info.location, info.conditions, OUT_OF_DISTRIBUTION, 0)
        for info in dataset.scenes
        if info.has_can_bus and (not scenes or info.name in scenes)
    ]
    fold_of = {entry.name: fold for entry, fold in zip(entries, FOLD_RULES[folds](entries), strict=True)}
    made_by = {"monocular": asdict(config), "share": SHARE, "seed": seed, "folds": fold_of}
    home = folder / f"vocabularies-{configuration_hash(made_by)}"
    learned = [name for name, fold in fold_of.items() if fold != OUT_OF_DISTRIBUTION]
    made = {}
    for camera in cameras:
        path_of_fold = {fold: home / f"{camera}-without-fold-{fold}.npy" for fold in sorted(set(fold_of.values()))}
        path_of_fold[OUT_OF_DISTRIBUTION] = home / f"{camera}-all-folds.npy"
        if missing := [fold for fold, path in path_of_fold.items() if not path.exists()]:
            with processes(workers):
                tasks = (delayed(scene_descriptors)(dataset, name, camera, config, SHARE, seed) for name in learned)
                words = dict(zip(learned, cast("list[Descriptors]", Parallel()(tasks)), strict=True))
            home.mkdir(parents=True, exist_ok=True)
            for fold in missing:
                training = [words[name] for name in learned if fold_of[name] != fold]
                train_vocabulary(np.concatenate(training), seed=seed).save(path_of_fold[fold])
        vocabulary = {name: path_of_fold[fold_of.get(name, OUT_OF_DISTRIBUTION)] for name in dataset.scene_names}
        made[f"{camera} w/ retrained vocabulary"] = Retrained(camera, vocabulary)
    return made


def scene_descriptors(
    dataset: Dataset, scene: str, camera: str, config: MonocularConfig, share: float, seed: int
) -> Descriptors:
    """Descriptors ``(n, 4)`` of the corners in a random share of one camera's images of one scene; broken ones lack.

    Raises:
        DatasetError: when not one of them can be read.
    """
    import cv2

    from mixo_env.experts.monocular.camera import mount
    from mixo_env.experts.monocular.features import FeatureDetector

    cv2.setNumThreads(1)
    detector, track = FeatureDetector(config), dataset.reel(scene, camera)
    mounted = mount(track.calibration, config.max_pixels)
    rng = np.random.default_rng([seed, *scene.encode(), *camera.encode()])
    some = np.flatnonzero(rng.random(len(track.image_paths)) < share)
    words, faults = [], []
    for i in some:
        image = readable(track.image_paths[int(i)], track.calibration, mounted.halvings)
        if isinstance(image, str):
            faults.append(image)
        else:
            words.append(detector.detect(mounted.shrink(image)).descriptor)
    if faults and not words:
        raise DatasetError(f"{scene}: none of {len(faults)} images of {camera} can be used, the first {faults[0]}")
    return np.concatenate([np.empty((0, 4), np.uint64), *words])
