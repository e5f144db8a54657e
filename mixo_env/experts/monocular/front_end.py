"""What sees corners in an image and finds them again in the next: replaceable, unlike the motion behind it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.features import FeatureDetector, Features
from mixo_env.experts.monocular.matching import MatchLimits, match_features
from mixo_env.experts.monocular.vocabulary import GENERAL_VOCABULARY, load_vocabulary


@dataclass(frozen=True)
class Frame:
    """One image and its corners.

    Attributes:
        image: ``(height, width)`` grey, working resolution.
        position_px: ``(n, 2)`` float32 corners, working pixels; the centre of the top left pixel is (0, 0).
        description: by which the front end that made the frame knows its corners again.
    """

    image: NDArray[np.uint8]
    position_px: NDArray[np.float32]
    description: Any


class FrontEnd(Protocol):
    """Corners and their matches; no memory."""

    def frame(self, image: NDArray[np.uint8], apart: bool = False) -> Frame:
        """Corners of an image ``(height, width)`` at working resolution; ``apart``: of a pair that is far apart."""
        ...

    def match(self, first: Frame, second: Frame, radius_px: float) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
        """Corners of two frames that are the same: indices ``(k,)`` into the first and ``(k,)`` into the second.

        Args:
            first: earlier.
            second: later.
            radius_px: half the side of the search window [working px].
        """
        ...


class OrbFrontEnd:
    """ORB features, matched within the words of a vocabulary (implements ``FrontEnd``)."""

    def __init__(self, config: MonocularConfig) -> None:
        self.config = config
        more = replace(config, features=max(config.features, config.features_apart))
        self._detectors = {False: FeatureDetector(config), True: FeatureDetector(more)}
        name = config.vocabulary
        self._vocabulary = load_vocabulary(GENERAL_VOCABULARY if name == "general" else Path(name))

    def frame(self, image: NDArray[np.uint8], apart: bool = False) -> Frame:
        """Features, and the ``match_words`` nearest words to each; more of them for images that are far apart."""
        features = self._detectors[apart].detect(image)
        words = self._vocabulary.nearest(features.descriptor, self.config.match_words)
        return Frame(image, features.position_px, (features, words))

    def match(self, first: Frame, second: Frame, radius_px: float) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
        """Mutual nearest neighbours, see :func:`~mixo_env.experts.monocular.matching.match_features`."""
        features1, words1 = _description(first)
        features2, words2 = _description(second)
        limits = MatchLimits(radius_px, self.config.match_max_bits, self.config.match_ratio)
        return match_features(features1, features2, words1, words2, len(self._vocabulary), limits)


def _description(frame: Frame) -> tuple[Features, NDArray[np.int32]]:
    return frame.description
