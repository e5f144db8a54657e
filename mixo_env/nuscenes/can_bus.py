"""CAN bus messages of one scene, ``can_bus/<scene>_<message>.json``, in SI units.

The one place where km/h, deg/s and rpm are converted. The files hold (devkit, ``can_bus/README.md``) wheel speeds
in rpm, ``vehicle_monitor`` in km/h and deg/s, ``ms_imu`` and ``pose`` in rad/s and m/s.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.files import read_file
from mixo_env.nuscenes.limits import LONGEST_SCENE_S, Reading, TimeUs
from mixo_env.nuscenes.scene import CanBus, FloatArray, IntArray, Signal

RADPS_PER_RPM = 2.0 * np.pi / 60.0
MPS_PER_KMPH = 1.0 / 3.6
RADPS_PER_DEGPS = np.pi / 180.0

Vector = tuple[Reading, Reading, Reading]


class _ZoeVehInfo(msgspec.Struct, gc=False):
    utime: TimeUs
    front_left_rpm: Reading = msgspec.field(name="FL_wheel_speed")
    front_right_rpm: Reading = msgspec.field(name="FR_wheel_speed")
    rear_left_rpm: Reading = msgspec.field(name="RL_wheel_speed")
    rear_right_rpm: Reading = msgspec.field(name="RR_wheel_speed")


class _MsImu(msgspec.Struct, gc=False):
    utime: TimeUs
    rotation_rate: Vector


class _Pose(msgspec.Struct, gc=False):
    utime: TimeUs
    vel: Vector
    rotation_rate: Vector


class _VehicleMonitor(msgspec.Struct, gc=False):
    utime: TimeUs
    vehicle_speed: Reading
    yaw_rate: Reading


class _SteeringAngleFeedback(msgspec.Struct, gc=False):
    utime: TimeUs
    value: Reading


class _ProductionGyro(msgspec.Struct, gc=False):
    utime: TimeUs
    yaw_rate: Reading


Message = _ZoeVehInfo | _MsImu | _Pose | _VehicleMonitor | _SteeringAngleFeedback | _ProductionGyro
MessageT = TypeVar("MessageT", bound=Message)

_WHEELS = ("front_left_rpm", "front_right_rpm", "rear_left_rpm", "rear_right_rpm")

MESSAGES = (
    "zoe_veh_info",
    "ms_imu",
    "pose",
    "vehicle_monitor",
    "steeranglefeedback",
    "production_gyro",
)
"""Message files that are read; ``production_gyro`` exists in simulated folders only."""


@dataclass(frozen=True)
class Messages:
    """The rows of every message of one scene, as they stand in the files; an absent message is an empty list."""

    zoe_veh_info: list[_ZoeVehInfo]
    ms_imu: list[_MsImu]
    pose: list[_Pose]
    vehicle_monitor: list[_VehicleMonitor]
    steeranglefeedback: list[_SteeringAngleFeedback]
    production_gyro: list[_ProductionGyro]

    def times_us(self, message: str) -> IntArray:
        """``(n,)`` times of one message in the order of its file."""
        rows = getattr(self, message)
        return np.fromiter(map(attrgetter("utime"), rows), np.int64, len(rows))


def read_can_bus(folder: Path, scene: str) -> CanBus | None:
    """The CAN bus of ``scene``; ``None`` when ``folder`` holds none of its messages.

    Args:
        folder: the ``can_bus`` folder.
        scene: e.g. ``"scene-0061"``.

    Returns:
        Signals in SI units, sorted by time; a message whose file is missing or empty leaves its signals ``None``.

    Raises:
        DatasetError: as :func:`read_messages`.
    """
    return can_bus_of(read_messages(folder, scene))


def read_messages(folder: Path, scene: str) -> Messages:
    """All message files of ``scene``.

    Raises:
        DatasetError: a file is truncated, is no file, lacks a field, or holds a value that is not a number or beyond
            sense (``mixo_env.nuscenes.limits``).
    """
    return Messages(
        zoe_veh_info=_read(folder, scene, "zoe_veh_info", _ZoeVehInfo),
        ms_imu=_read(folder, scene, "ms_imu", _MsImu),
        pose=_read(folder, scene, "pose", _Pose),
        vehicle_monitor=_read(folder, scene, "vehicle_monitor", _VehicleMonitor),
        steeranglefeedback=_read(folder, scene, "steeranglefeedback", _SteeringAngleFeedback),
        production_gyro=_read(folder, scene, "production_gyro", _ProductionGyro),
    )


def can_bus_of(messages: Messages) -> CanBus | None:
    """Signals in SI units, sorted by time; ``None`` without a single message."""
    if not any(getattr(messages, name) for name in MESSAGES):
        return None
    pose, monitor = _sorted(messages.pose), _sorted(messages.vehicle_monitor)
    return CanBus(
        wheel_speed_radps=_signal(_sorted(messages.zoe_veh_info), *_WHEELS, si_per_unit=RADPS_PER_RPM),
        imu_yaw_rate_radps=_signal(_sorted(messages.ms_imu), "rotation_rate", axis=2),
        pose_speed_mps=_signal(pose, "vel", axis=0),
        pose_yaw_rate_radps=_signal(pose, "rotation_rate", axis=2),
        monitor_yaw_rate_radps=_signal(monitor, "yaw_rate", si_per_unit=RADPS_PER_DEGPS),
        monitor_speed_mps=_signal(monitor, "vehicle_speed", si_per_unit=MPS_PER_KMPH),
        steering_wheel_rad=_signal(_sorted(messages.steeranglefeedback), "value"),
        consumer_yaw_rate_radps=_signal(_sorted(messages.production_gyro), "yaw_rate"),
    )


def scenes_with_can_bus(folder: Path) -> frozenset[str]:
    """Names of the scenes that have at least one message file in ``folder``."""
    try:
        names = [path.name for path in folder.iterdir()]
    except OSError:  # not there, no folder, or closed to this user: said when a scene is read
        return frozenset()
    suffixes = [f"_{message}.json" for message in MESSAGES]
    return frozenset(name.removesuffix(suffix) for name in names for suffix in suffixes if name.endswith(suffix))


def _read(folder: Path, scene: str, message: str, row_type: type[MessageT]) -> list[MessageT]:
    """Rows of one message in file order; empty when there is no file."""
    path = folder / f"{scene}_{message}.json"
    try:
        rows = msgspec.json.decode(read_file(path), type=list[row_type])
    except FileNotFoundError:
        return []
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise _broken(path, str(error)) from None
    except RecursionError:
        raise _broken(path, "it is too deeply nested") from None
    times = list(map(attrgetter("utime"), rows))
    if rows and max(times) - min(times) > 1e6 * LONGEST_SCENE_S:
        raise _broken(path, f"its times span {1e-6 * (max(times) - min(times)):.0f} s; a scene lasts 20 s")
    return rows


def _broken(path: Path, reason: str) -> DatasetError:
    return DatasetError(f"{path} is not a valid CAN bus file: {reason}; unpack it again")


def _sorted(rows: list[MessageT]) -> list[MessageT]:
    """In time order; files nearly always are already."""
    return sorted(rows, key=attrgetter("utime"))


def _signal(rows: Sequence[Message], *names: str, axis: int | None = None, si_per_unit: float = 1.0) -> Signal | None:
    """One field of every row, one axis of a vector, or several fields side by side; ``None`` without rows."""
    if not rows:
        return None
    times = np.fromiter(map(attrgetter("utime"), rows), np.int64, len(rows))
    columns: list[FloatArray] = []
    for name in names:
        column: Iterable[float] = map(attrgetter(name), rows)
        if axis is not None:
            column = map(itemgetter(axis), column)  # type: ignore[arg-type]
        columns.append(np.fromiter(column, np.float64, len(rows)))
    value = columns[0] if len(columns) == 1 else np.column_stack(columns)
    return Signal(timestamp_us=times, value=value * si_per_unit)
