"""What an odometry expert delivers, whatever is inside it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class State(IntEnum):
    """State of a monocular expert at a step."""

    INITIALISING = 0
    TRACKING = 1
    LOST = 2
    NO_IMAGE = 3
    """The camera delivered no image in this firing round."""


@dataclass(frozen=True)
class CameraStep:
    """Outcome of one image of one camera.

    Attributes:
        state: INITIALISING, TRACKING or LOST; never ``NO_IMAGE`` here.
        yaw_increment_rad: of the car since the previous image, anticlockwise positive, and what this image corrects of
            earlier increments: they add up to the best heading; NaN unless TRACKING.
        yaw_std_rad: standard deviation of that increment; NaN unless TRACKING.
        matches: features matched with the previous image.
        inliers: estimate of the matches that agree with the motion. At most ``solver_matches`` matches, evenly picked,
            are solved with; the share of these that agree is extrapolated to all ``matches`` (rounded).
        residual_px: median reprojection residual of the inliers; NaN without inliers.
        flow_px: median displacement of the matches; NaN without matches.
        two_frame_yaw_increment_rad: the same increment from the last two images alone, no memory; NaN when it fails.
    """

    state: State
    yaw_increment_rad: float
    yaw_std_rad: float
    matches: int
    inliers: int
    residual_px: float
    flow_px: float
    two_frame_yaw_increment_rad: float


class CameraExpert(Protocol):
    """Single-camera odometry of one camera over one scene: images go in, in time order, increments come out."""

    @property
    def halvings(self) -> int:
        """How often it halves images anyway: a decoder may do so."""
        ...

    def process(self, image: NDArray[np.uint8], timestamp_us: int, distance_m: float) -> CameraStep:
        """Take the next image.

        Args:
            image: ``(height, width)`` grey, of the calibrated size or already halved ``halvings`` times.
            timestamp_us: exposure time; must increase.
            distance_m: distance travelled since the previous image (the external scale s_k; 0 for the first image).
        """
        ...
