"""JOINT in a recording: what the cameras' odometries compared is kept, and the rig is solved when all of them are done.

It is recorded as a variant: scored as a row of its own, but it never votes, is observed by no policy and enters no
oracle. The camera whose columns it takes the place of is the one that fires last, so that its windows are the steps.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.experts.expert import CameraExpert, CameraStep, State
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.joint.odometry import JointOdometry
from mixo_env.experts.joint.sight import Change, Sight, Told, sight
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.selections import CAMERA_OFFSET_US
from mixo_env.recordings.clock import Rounds

Columns = dict[str, NDArray[Any]]

JOINT = "JOINT"
"""Its row, and the prefix of its columns."""


def host(cameras: tuple[str, ...]) -> str:
    """The camera whose place JOINT takes: the one that fires last."""
    return max(cameras, key=lambda camera: CAMERA_OFFSET_US.get(camera, 0))


class Watched:
    """A camera's odometry that keeps what it compared; it says the same as unwatched.

    Args:
        odometry: of one camera, the project's own.
        most: matches to keep of every pair of images.

    Raises:
        ConfigurationError: for another odometry, which does not say what it compared.
    """

    def __init__(self, odometry: CameraExpert, most: int) -> None:
        if not isinstance(odometry, MonocularOdometry):
            raise ConfigurationError(
                f"{JOINT} needs the matches of MonocularOdometry, got {type(odometry).__name__}: leave {JOINT} out"
            )
        self.camera = odometry.camera
        self.sights: dict[int, Sight] = {}
        """By the time of the later image [us]."""
        self._odometry, self._most = odometry, most
        self._times_us = (0, 0)

    @property
    def halvings(self) -> int:
        """That of the odometry."""
        return self._odometry.halvings

    def process(self, image: NDArray[np.uint8], timestamp_us: int, distance_m: float) -> CameraStep:
        """As the odometry."""
        step = self._odometry.process(image, timestamp_us, distance_m)
        before_us, last_us = self._times_us
        if self._odometry.pair is not None:
            change = None if self._odometry.change is None else Change(before_us, *self._odometry.change)
            told = Told(step.yaw_increment_rad, step.yaw_std_rad) if step.state is State.TRACKING else None
            times_us = (last_us, timestamp_us)
            self.sights[timestamp_us] = sight(self._odometry.pair, times_us, self._most, change, told)
        self._times_us = (last_us, timestamp_us)
        return step


def record_joint(columns: Columns, rounds: Rounds, watched: Mapping[str, Watched], config: JointConfig) -> Columns:
    """Fill the columns of JOINT in place.

    Args:
        columns: of one scene.
        rounds: its clock.
        watched: by camera, after the last image.
        config: settings.

    Returns:
        Timings as those of a camera, but for the scene: ``(rows,)`` each; nothing is decoded.
    """
    odometry = JointOdometry({name: camera.camera for name, camera in watched.items()}, config)
    spent_ms = np.zeros(len(rounds))
    for k, time_us in enumerate(rounds.closing_time_us.tolist()):
        images = zip(rounds.cameras, rounds.image_time_us[k].tolist(), rounds.fired[k].tolist(), strict=True)
        sights = {name: watched[name].sights.get(at) for name, at, fired in images if fired}
        start = time.thread_time()
        step = odometry.process(time_us, {name: seen for name, seen in sights.items() if seen is not None})
        spent_ms[k] = 1e3 * (time.thread_time() - start)
        for name in ("state", "matches", "inliers", "residual_px", "two_frame_yaw_increment_rad"):
            columns[f"{JOINT}.{name}"][k] = getattr(step, name)
        for name in ("yaw_increment_rad", "yaw_std_rad"):
            columns[f"{JOINT}.own_window_{name}"][k] = columns[f"{JOINT}.{name}"][k] = getattr(step, name)
    return {
        "camera": np.full(len(rounds), JOINT, object),
        "timestamp_us": rounds.closing_time_us,
        "decode_ms": np.zeros(len(rounds)),
        "expert_ms": spent_ms,
    }
