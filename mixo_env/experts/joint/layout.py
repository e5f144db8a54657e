"""What stays the same however a step is solved: times, places, and how a camera's unknowns follow from the body's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.joint.knots import window_weights
from mixo_env.experts.joint.sight import Sight
from mixo_env.experts.joint.solve import BODY, OWN
from mixo_env.experts.monocular.camera import MountedCamera
from mixo_env.experts.monocular.kinematics import never_zero

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Moment:
    """When a step is, and what sees it.

    Attributes:
        knots_s: the beginning of the last step (negative), of this one (0) and its end [s].
        origin_us: the time of the middle one.
        used: the cameras that have a say.
    """

    knots_s: tuple[float, float, float]
    origin_us: int
    used: Mapping[str, Sight]

    def start_radps(self) -> float:
        """Median yaw rate of the pairs alone; 0 where none tells."""
        seen = [sight.yaw_rad / (1e-6 * (sight.end_us - sight.start_us)) for sight in self.used.values()]
        told = [rate for rate in seen if math.isfinite(rate)]
        return float(np.median(told)) if told else 0.0

    def since_s(self, time_us: int) -> float:
        """A time, counted from the middle knot."""
        return 1e-6 * (time_us - self.origin_us)


class Layout(NamedTuple):
    """Of ``m`` cameras in a step.

    Attributes:
        rotation: ``(m, 3, 3)`` ego from camera.
        position: ``(m, 3)`` of the camera [m].
        distance: ``(m,)`` travelled over its window [m], not 0.
        noise: ``(m,)`` expected position noise.
        local: ``(m, 6, BODY + OWN)`` a camera's six unknowns from those of the body and its own.
        gap_s: ``(m,)`` length of its window.
    """

    rotation: FloatArray
    position: FloatArray
    distance: FloatArray
    noise: FloatArray
    local: FloatArray
    gap_s: FloatArray

    def of(self, rows: list[int]) -> Layout:
        """That of some of the cameras."""
        return Layout(*(part[rows] for part in self))


def lay_out(cameras: Mapping[str, MountedCamera], moment: Moment) -> Layout:
    """The layout of a step.

    Args:
        cameras: of the rig.
        moment: the step.
    """
    local = np.zeros((len(moment.used), 6, BODY + OWN))
    gaps, distances = [], []
    for row, (name, seen) in zip(local, moment.used.items(), strict=True):
        gap_s, distance = 1e-6 * (seen.end_us - seen.start_us), never_zero(seen.distance_m)
        row[0, :3] = window_weights(moment.since_s(seen.start_us), moment.since_s(seen.end_us), moment.knots_s)
        row[0, BODY] = 1.0
        row[1, 3] = row[2, 4] = gap_s
        row[3, 5] = row[3, BODY + 1] = row[4, 6] = row[4, BODY + 2] = distance
        x, y, z = gap_s * cameras[name].position_m  # a tilt of the body also swings the camera
        row[3, 4], row[4, 4], row[4, 3] = -z, y, -x
        row[5, BODY + 3] = 1.0
        gaps.append(gap_s)
        distances.append(distance)
    return Layout(
        np.array([cameras[name].rotation for name in moment.used]),
        np.array([cameras[name].position_m for name in moment.used]),
        np.array(distances),
        np.array([seen.noise for seen in moment.used.values()]),
        local,
        np.array(gaps),
    )
