"""``mixo train-vocabulary``: retrain the words that matching is restricted to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from tyro.conf import Positional

from mixo_env.nuscenes.selections import CAMERAS


@dataclass(frozen=True)
class TrainVocabulary:
    """Train a vocabulary tree on a random share of a data set's images (rows "w/ retrained vocab." of the paper).

    Give the scenes of the training folds only; the file then goes into ``MonocularConfig.vocabulary``.

    Worked examples:

      mixo train-vocabulary city --out words.npy                                     all four cameras
      mixo train-vocabulary city --out right.npy --cameras CAM_BACK_RIGHT --scenes scene-2001 scene-2002
    """

    interrupted: ClassVar[str] = "nothing was written"

    root: Positional[Path]
    """Folder that holds v1.0-*, samples and sweeps."""
    out: Path
    """File to write (.npy, a few KiB)."""
    version: str | None = None
    """Tables to use, e.g. v1.0-trainval; needed only when the folder holds several."""
    scenes: tuple[str, ...] = ()
    """Scenes to learn from; all by default."""
    cameras: tuple[str, ...] = CAMERAS
    """Cameras to learn from."""
    share: float = 0.2
    """Share of their images that is used, picked at random."""
    preset: Literal["fast", "paper"] = "fast"
    """Settings of the monocular odometry the vocabulary is for."""
    seed: int = 0
    """Of that pick and of the clustering."""

    def run(self) -> int:
        """Train, save and say how even the words are."""
        import numpy as np

        from mixo_env.cli.progress import progress
        from mixo_env.errors import ConfigurationError
        from mixo_env.experts.monocular.config import MonocularConfig
        from mixo_env.experts.monocular.vocabulary import train_vocabulary
        from mixo_env.files import writable_folder
        from mixo_env.nuscenes.tables import open_dataset
        from mixo_env.recordings.vocabularies import scene_descriptors

        if not 0.0 < self.share <= 1.0:
            raise ConfigurationError(f"share must be above 0 and at most 1, got {self.share:g}: use e.g. 0.2")
        writable_folder(self.out.parent)  # now, not after minutes of work
        config = MonocularConfig.preset(self.preset)
        dataset = open_dataset(self.root, self.version)
        pieces = [(name, camera) for name in self.scenes or dataset.scene_names for camera in self.cameras]
        words = []
        with progress("looking at cameras of scenes") as report:
            for done, (name, camera) in enumerate(pieces, start=1):
                words.append(scene_descriptors(dataset, name, camera, config, self.share, self.seed))
                report(done, len(pieces))
        descriptor = np.concatenate([np.empty((0, 4), np.uint64), *words])
        vocabulary = train_vocabulary(descriptor, seed=self.seed)
        vocabulary.save(self.out)
        count = np.bincount(vocabulary.nearest(descriptor)[:, 0], minlength=len(vocabulary))
        share = count / count.sum()
        print(
            f"{self.out}: {vocabulary.branches} x {vocabulary.branches} words from {len(descriptor):,} corners in "
            f"{self.share:.0%} of the images; words hold {share.min():.2%} to {share.max():.2%}"
        )
        return 0
