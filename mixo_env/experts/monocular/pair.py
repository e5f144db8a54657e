"""Two images of one camera: match, align, solve. No memory beyond the pair."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.monocular.alignment import align_matches
from mixo_env.experts.monocular.camera import MountedCamera
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.front_end import Frame, FrontEnd, OrbFrontEnd
from mixo_env.experts.monocular.motion import Motion, MotionPrior, estimate_motion

_NEAREST_M = 4.0  # search windows allow for points this near


@dataclass(frozen=True)
class Pair:
    """Outcome of comparing two images.

    Attributes:
        matches: number of matched features.
        flow_px: their median displacement [px of the full image]; NaN without matches.
        first, second: ``(k, 2)`` aligned matches on the image planes, at most ``solver_matches``.
        corner: ``(k, 2)`` int, which corner of the first and of the second image each of them is.
        prior: what was known before.
        motion: ``None`` when none was found.
        apart: the images are far apart, and corners are counted among more of them.
    """

    matches: int
    flow_px: float
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    corner: NDArray[np.integer]
    prior: MotionPrior
    motion: Motion | None
    apart: bool = False


class PairSolver:
    """Compares images of one camera; corners are ORB features unless another front end is given."""

    def __init__(self, camera: MountedCamera, config: MonocularConfig, front_end: FrontEnd | None = None) -> None:
        self.camera, self.config = camera, config
        self._front_end = front_end or OrbFrontEnd(config)

    def frame(self, image: NDArray[np.uint8]) -> Frame:
        """Corners of an image ``(height, width)`` at working resolution."""
        return self._front_end.frame(image)

    def compare(self, first: Frame, second: Frame, gap_s: float, distance_m: float) -> Pair:
        """Motion of the car from the first to the second image.

        Args:
            first: earlier image.
            second: later image.
            gap_s: time between them.
            distance_m: travelled between them, negative in reverse.
        """
        camera, config = self.camera, self.config
        prior = MotionPrior(
            distance_m,
            min(
                config.max_yaw_rate_radps * gap_s,
                config.max_curvature_radpm * abs(distance_m) + config.standing_yaw_rad,
            ),
            config.noise_px * camera.pixel_size,
            config.tilt_std_rad,
            slip_std=config.slip_std,
            heave_std=config.slip_std,
        )
        apart = gap_s > config.apart_s
        if apart:  # in both, so that a pair depends on its two images alone, not on those before
            first, second = (self._front_end.frame(frame.image, True) for frame in (first, second))
        radius = (prior.max_yaw_rad + abs(distance_m) / _NEAREST_M) / camera.pixel_size + 8.0
        i, j = self._front_end.match(first, second, radius)
        p1, p2 = first.position_px[i], second.position_px[j]
        flow = float(np.median(np.hypot(*(p2 - p1).T))) * 2**camera.halvings if len(i) else math.nan
        corner = np.stack([i, j], axis=1)
        if len(i) < config.min_matches:
            return Pair(len(i), flow, camera.plane(p1), camera.plane(p2), corner, prior, None, apart)
        picked = np.arange(0, len(i), -(-len(i) // config.solver_matches))
        p1, p2, corner = p1[picked], p2[picked], corner[picked]
        p2, aligned = align_matches(first.image, second.image, p1, p2)
        f1, f2 = camera.plane(p1[aligned]), camera.plane(p2[aligned])
        motion = estimate_motion(f1, f2, camera.rotation, camera.position_m, prior)
        return Pair(len(i), flow, f1, f2, corner[aligned], prior, motion, apart)
