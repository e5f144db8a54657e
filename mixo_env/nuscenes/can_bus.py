"""CAN bus messages of one scene, ``can_bus/<scene>_<message>.json``, in SI units.

The one place where km/h, deg/s and rpm are converted. The files hold (devkit, ``can_bus/README.md``) wheel speeds
in rpm, ``vehicle_monitor`` in km/h and deg/s, ``ms_imu`` and ``pose`` in rad/s and m/s.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.scene import CanBus, FloatArray, Signal

RADPS_PER_RPM = 2.0 * np.pi / 60.0
MPS_PER_KMPH = 1.0 / 3.6
RADPS_PER_DEGPS = np.pi / 180.0

Vector = tuple[float, float, float]


class _ZoeVehInfo(msgspec.Struct, gc=False):
    utime: int
    front_left_rpm: float = msgspec.field(name="FL_wheel_speed")
    front_right_rpm: float = msgspec.field(name="FR_wheel_speed")
    rear_left_rpm: float = msgspec.field(name="RL_wheel_speed")
    rear_right_rpm: float = msgspec.field(name="RR_wheel_speed")


class _MsImu(msgspec.Struct, gc=False):
    utime: int
    rotation_rate: Vector


class _Pose(msgspec.Struct, gc=False):
    utime: int
    vel: Vector
    rotation_rate: Vector


class _VehicleMonitor(msgspec.Struct, gc=False):
    utime: int
    vehicle_speed: float
    yaw_rate: float


class _SteeringAngleFeedback(msgspec.Struct, gc=False):
    utime: int
    value: float


class _ProductionGyro(msgspec.Struct, gc=False):
    utime: int
    yaw_rate: float


Message = _ZoeVehInfo | _MsImu | _Pose | _VehicleMonitor | _SteeringAngleFeedback | _ProductionGyro
MessageT = TypeVar("MessageT", bound=Message)

MESSAGES = (
    "zoe_veh_info",
    "ms_imu",
    "pose",
    "vehicle_monitor",
    "steeranglefeedback",
    "production_gyro",
)
"""Message files that are read; ``production_gyro`` exists in simulated folders only."""


def read_can_bus(folder: Path, scene: str) -> CanBus | None:
    """The CAN bus of ``scene``; ``None`` when ``folder`` holds none of its messages.

    Args:
        folder: the ``can_bus`` folder.
        scene: e.g. ``"scene-0061"``.

    Returns:
        Signals in SI units, sorted by time; a message whose file is missing or empty leaves its signals ``None``.

    Raises:
        DatasetError: a file is truncated, or lacks a field or holds a value that is not a number.
    """
    wheels = _read(folder, scene, "zoe_veh_info", _ZoeVehInfo)
    imu = _read(folder, scene, "ms_imu", _MsImu)
    pose = _read(folder, scene, "pose", _Pose)
    monitor = _read(folder, scene, "vehicle_monitor", _VehicleMonitor)
    steering = _read(folder, scene, "steeranglefeedback", _SteeringAngleFeedback)
    production = _read(folder, scene, "production_gyro", _ProductionGyro)
    if not any((wheels, imu, pose, monitor, steering, production)):
        return None
    return CanBus(
        wheel_speed_radps=_signal(
            wheels,
            lambda row: (row.front_left_rpm, row.front_right_rpm, row.rear_left_rpm, row.rear_right_rpm),
            RADPS_PER_RPM,
        ),
        imu_yaw_rate_radps=_signal(imu, lambda row: row.rotation_rate[2]),
        pose_speed_mps=_signal(pose, lambda row: row.vel[0]),
        pose_yaw_rate_radps=_signal(pose, lambda row: row.rotation_rate[2]),
        monitor_yaw_rate_radps=_signal(monitor, lambda row: row.yaw_rate, RADPS_PER_DEGPS),
        monitor_speed_mps=_signal(monitor, lambda row: row.vehicle_speed, MPS_PER_KMPH),
        steering_wheel_rad=_signal(steering, lambda row: row.value),
        consumer_yaw_rate_radps=_signal(production, lambda row: row.yaw_rate),
    )


def scenes_with_can_bus(folder: Path) -> frozenset[str]:
    """Names of the scenes that have at least one message file in ``folder``."""
    if not folder.is_dir():
        return frozenset()
    names = [path.name for path in folder.iterdir()]
    suffixes = [f"_{message}.json" for message in MESSAGES]
    return frozenset(name.removesuffix(suffix) for name in names for suffix in suffixes if name.endswith(suffix))


def _read(folder: Path, scene: str, message: str, row_type: type[MessageT]) -> list[MessageT]:
    """Rows of one message in time order (files are nearly always sorted already); empty when there is no file."""
    path = folder / f"{scene}_{message}.json"
    try:
        rows = msgspec.json.decode(path.read_bytes(), type=list[row_type])
    except FileNotFoundError:
        return []
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror}") from error
    except msgspec.MsgspecError as error:
        raise DatasetError(f"{path} is not a valid CAN bus file: {error}; unpack it again") from error
    return sorted(rows, key=lambda row: row.utime)


def _signal(
    rows: list[MessageT], value: Callable[[MessageT], float | tuple[float, ...]], si_per_unit: float = 1.0
) -> Signal | None:
    if not rows:
        return None
    values: FloatArray = np.array([value(row) for row in rows], dtype=np.float64) * si_per_unit
    return Signal(timestamp_us=np.array([row.utime for row in rows], dtype=np.int64), value=values)
