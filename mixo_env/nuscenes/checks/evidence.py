"""What the checks of a scene look at, read once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixo_env.nuscenes.checks.motion import Lag, Rates, lag_of, window_rates
from mixo_env.nuscenes.limits import LONGEST_SCENE_S
from mixo_env.nuscenes.scene import CameraReel, CanBus, FloatArray, IntArray, Signal
from mixo_env.nuscenes.tables import SceneInfo

LAG_S = (-0.065, 0.085)
"""How late poses may follow a gyro: -0.02 to 0 s on real scenes, up to 0.035 s on simulated ones."""

DETECTABLE_RAD = 0.01


@dataclass(frozen=True)
class Finding:
    """One remark on a scene.

    Attributes:
        check: short name of the check, as ``mixo record --despite`` takes it.
        text: one line.
        is_problem: the scene should not be recorded as it is; else worth knowing, and harmless.
    """

    check: str
    text: str
    is_problem: bool = True

    def __str__(self) -> str:
        """The line with the name in front."""
        return f"{self.check}: {self.text}"


@dataclass(frozen=True)
class TruePath:
    """Ego poses of all cameras' images in time order, as if one sensor had delivered them.

    Attributes:
        time_us: ``(n,)`` increasing.
        x_m, y_m: ``(n,)`` map frame.
        yaw_rad: ``(n,)`` unwrapped.
        distance_m: ``(n,)`` driven since the first, never decreasing.
    """

    time_us: IntArray
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray
    distance_m: FloatArray


@dataclass(frozen=True)
class Evidence:
    """One scene as it was read.

    Attributes:
        info: the scene's row.
        reels: by camera; those that could be read.
        tilt_rad: by camera, ``(n,)`` as in :class:`mixo_env.nuscenes.index.ImageIndex`.
        pose_delay_s: by camera, ``(n,)`` likewise.
        path: ``None`` without a single reel.
        can_bus: ``None`` without a single message.
        message_times_us: by message, ``(n,)`` in the order of the file.
        is_can_bus_readable: else a message file is broken, which has been said.
        expects_can_bus: whether CAN bus data should be there: not where the folder has none at all, or its publishers
            had none of this scene.
    """

    info: SceneInfo
    reels: Mapping[str, CameraReel]
    tilt_rad: Mapping[str, FloatArray]
    pose_delay_s: Mapping[str, FloatArray]
    path: TruePath | None
    can_bus: CanBus | None
    message_times_us: Mapping[str, IntArray]
    is_can_bus_readable: bool
    expects_can_bus: bool

    @cached_property
    def gyros(self) -> dict[str, Signal]:
        """Yaw rates by message; those that come often enough to be compared in half-second windows."""
        can_bus = self.can_bus
        if can_bus is None:
            return {}
        gyros = {
            "ms_imu": can_bus.imu_yaw_rate_radps,
            "pose": can_bus.pose_yaw_rate_radps,
            "production_gyro": can_bus.consumer_yaw_rate_radps,
        }
        return {message: gyro for message, gyro in gyros.items() if gyro is not None and len(gyro.timestamp_us) > 1}

    @cached_property
    def yaw_rates(self) -> dict[str, Rates]:
        """Yaw rates of the poses and of a gyro over common windows, by message, where there are enough."""
        rates = {} if self.path is None else {name: yaw_rates(self.path, gyro) for name, gyro in self.gyros.items()}
        return {message: compared for message, compared in rates.items() if compared is not None}

    @cached_property
    def pose_lags(self) -> dict[str, Lag]:
        """How late the true yaw follows a gyro, by message, where the car turns unevenly enough to tell."""
        path = self.path
        if path is None:
            return {}
        lags = {
            message: lag_of(path.time_us, path.yaw_rad, gyro.timestamp_us, gyro.value, LAG_S, DETECTABLE_RAD)
            for message, gyro in self.gyros.items()
        }
        return {message: lag for message, lag in lags.items() if lag is not None}


def yaw_rates(path: TruePath, gyro: Signal) -> Rates | None:
    """Yaw rates of the poses and of a gyro over common windows."""
    return window_rates(path.time_us, path.yaw_rad, gyro.timestamp_us, gyro.value)


def true_path(reels: Mapping[str, CameraReel]) -> TruePath | None:
    """The poses of all reels as one path; ``None`` without reels, or if they lie hours apart."""
    if not reels:
        return None
    ends = [time for reel in reels.values() for time in (reel.timestamp_us[0], reel.timestamp_us[-1])]
    if max(ends) - min(ends) > 1e6 * LONGEST_SCENE_S:
        return None
    time_us, first = np.unique(np.concatenate([reel.timestamp_us for reel in reels.values()]), return_index=True)
    x, y, yaw = (
        np.concatenate([getattr(reel, name) for reel in reels.values()])[first] for name in ("x_m", "y_m", "yaw_rad")
    )
    steps = np.hypot(np.diff(x), np.diff(y))
    return TruePath(time_us, x, y, np.unwrap(yaw), np.concatenate([[0.0], np.cumsum(steps)]))
