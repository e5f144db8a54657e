"""Writes a tiny valid nuScenes folder with the irregularities of the real one; shares no code with the package.

Its truth is kept in :class:`SceneTruth`, so that a test can ask for a round trip. Irregular on purpose: cameras fire
one after another, intervals run 100/100/50 ms, one frame is dropped, calibration differs from scene to scene,
quaternion signs flip, chains end in empty strings, lidar rows stand between the camera rows, ``sample_data`` is not in
time order, one scene stands still, one crosses yaw +-pi, one is at night, one lacks CAN bus data, one lacks
``vehicle_monitor``.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

LOGS = {
    "n015-2018-07-24-11-22-45+0800": ("n015", "singapore-onenorth"),
    "n008-2018-08-27-11-48-51-0400": ("n008", "boston-seaport"),
}

# channel -> (x, y, z) m, mounting yaw deg, focal length px, principal point px, firing offset ms before the lidar
RIG = {
    "CAM_FRONT": ((1.701, 0.016, 1.511), 0.3, 1266.4, (816.3, 491.5), -35.5),
    "CAM_FRONT_LEFT": ((1.524, 0.495, 1.509), 55.2, 1272.6, (826.6, 479.8), -43.1),
    "CAM_FRONT_RIGHT": ((1.551, -0.493, 1.496), -56.4, 1260.8, (808.0, 495.3), -27.6),
    "CAM_BACK": ((0.028, 0.003, 1.579), 179.9, 809.2, (829.2, 481.8), -10.4),
    "CAM_BACK_LEFT": ((1.036, 0.485, 1.591), 108.6, 1256.7, (792.1, 492.8), -0.5),
    "CAM_BACK_RIGHT": ((1.015, -0.481, 1.562), -110.8, 1259.5, (807.3, 501.2), -20.1),
}


TABLES = (
    *("attribute", "calibrated_sensor", "category", "ego_pose", "instance", "log", "map", "sample"),
    *("sample_annotation", "sample_data", "scene", "sensor", "visibility"),
)


@dataclass(frozen=True)
class Drive:
    """Analytic motion: constant speed (0: standing), yaw = start + amplitude * (1 - cos(2 pi t / period)) / 2."""

    name: str
    description: str
    log: str
    start_us: int
    speed_mps: float = 8.0
    start_yaw_rad: float = 0.4
    turn_rad: float = 1.5
    turn_period_s: float = 8.0
    has_can_bus: bool = True
    has_vehicle_monitor: bool = True

    def yaw_rad(self, time_s: float) -> float:
        return self.start_yaw_rad + 0.5 * self.turn_rad * (1 - math.cos(2 * math.pi * time_s / self.turn_period_s))

    def yaw_rate_radps(self, time_s: float) -> float:
        return math.pi * self.turn_rad / self.turn_period_s * math.sin(2 * math.pi * time_s / self.turn_period_s)

    def position_m(self, time_s: float) -> tuple[float, float]:
        """Fine midpoint integration from t = 0 (in either direction)."""
        pieces = max(1, math.ceil(abs(time_s) / 0.005))
        step = time_s / pieces
        x, y = 600.0, 1647.0
        for piece in range(pieces):
            yaw = self.yaw_rad((piece + 0.5) * step)
            x += self.speed_mps * step * math.cos(yaw)
            y += self.speed_mps * step * math.sin(yaw)
        return x, y


DRIVES = (
    Drive("scene-2061", "Parked truck, turn left", "n015-2018-07-24-11-22-45+0800", 1532402927647951),
    Drive(
        "scene-2103",
        "Wait at intersection, after rain",
        "n008-2018-08-27-11-48-51-0400",
        1535385092150000,
        speed_mps=0.0,
        turn_rad=0.0,
    ),
    Drive(
        "scene-2655",
        "Rain, big street",
        "n008-2018-08-27-11-48-51-0400",
        1535385192150000,
        start_yaw_rad=math.pi - 0.2,
        has_vehicle_monitor=False,
    ),
    Drive(
        "scene-2757",
        "Night, difficult lighting",
        "n015-2018-07-24-11-22-45+0800",
        1532403927647951,
        turn_rad=-0.8,
        has_can_bus=False,
    ),
)


@dataclass
class CameraTruth:
    filenames: list[str] = field(default_factory=list)
    timestamp_us: list[int] = field(default_factory=list)
    is_keyframe: list[bool] = field(default_factory=list)
    pose: list[tuple[float, float, float]] = field(default_factory=list)
    intrinsic: list[list[float]] = field(default_factory=list)
    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))


@dataclass
class SceneTruth:
    drive: Drive
    cameras: dict[str, CameraTruth]


def token(*parts: object) -> str:
    return hashlib.md5("/".join(map(str, parts)).encode()).hexdigest()


@functools.cache
def grey_jpeg(width: int = 1600, height: int = 900) -> bytes:
    """A whole JPEG of one grey level: three kilobytes."""
    out = io.BytesIO()
    Image.new("L", (width, height), 90).save(out, "JPEG", progressive=True, optimize=True, quality=5)
    return out.getvalue()


def _quaternion(matrix: np.ndarray) -> list[float]:
    """w, x, y, z by the textbook case distinction (another way than the package's)."""
    m = matrix
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace > 0:
        s = 2 * math.sqrt(trace + 1)
        return [s / 4, (m[2, 1] - m[1, 2]) / s, (m[0, 2] - m[2, 0]) / s, (m[1, 0] - m[0, 1]) / s]
    i = int(np.argmax(np.diag(m)))
    j, k = (i + 1) % 3, (i + 2) % 3
    s = 2 * math.sqrt(1 + m[i, i] - m[j, j] - m[k, k])
    q = [(m[k, j] - m[j, k]) / s, 0.0, 0.0, 0.0]
    q[1 + i], q[1 + j], q[1 + k] = s / 4, (m[j, i] + m[i, j]) / s, (m[k, i] + m[i, k]) / s
    return q


def _camera_rotation(yaw_deg: float) -> np.ndarray:
    """Columns: the camera's right, down and forward axes in the ego frame."""
    yaw = math.radians(yaw_deg)
    forward = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    return np.column_stack([np.cross(down, forward), down, forward])


def _frame_times_us(duration_s: float) -> list[tuple[int, bool]]:
    """(time after the first lidar turn, is key frame): 100/100/50 ms; a key frame every 500 ms."""
    times, now, pattern = [], 0, 0
    while now <= duration_s * 1_000_000:
        times.append((now, now % 500_000 == 0))
        now += (100_000, 100_000, 50_000)[pattern % 3]
        pattern += 1
    return times


def write_nuscenes(
    root: Path,
    drives: tuple[Drive, ...] = DRIVES,
    version: str = "v1.0-mini",
    duration_s: float = 4.0,
    images: bool = True,
    seed: int = 0,
) -> dict[str, SceneTruth]:
    """Write tables, empty images and CAN bus files under ``root``; returns the truth by scene name."""
    rng = np.random.default_rng(seed)
    tables: dict[str, list[dict]] = {name: [] for name in TABLES}
    channels = [*RIG, "LIDAR_TOP"]
    for channel in channels:
        modality = "camera" if channel in RIG else "lidar"
        tables["sensor"].append({"token": token("sensor", channel), "channel": channel, "modality": modality})
    for log, (vehicle, location) in LOGS.items():
        row = {"token": token("log", log), "logfile": log, "vehicle": vehicle, "location": location}
        tables["log"].append(row | {"date_captured": log[5:15]})
    truths = {}
    for drive in drives:
        truths[drive.name] = _write_scene(root, tables, drive, duration_s, images, rng)
        if drive.has_can_bus:
            write_can_bus(root / "can_bus", drive, duration_s)
    (root / version).mkdir(parents=True, exist_ok=True)
    tables["sample_data"].reverse()  # file order means nothing
    for name, rows in tables.items():
        (root / version / f"{name}.json").write_text(json.dumps(rows, indent=0))
    return truths


def _write_scene(root, tables, drive: Drive, duration_s, images, rng) -> SceneTruth:
    frames = _frame_times_us(duration_s)
    keys = [time for time, is_key in frames if is_key]
    samples = [token(drive.name, "sample", time) for time in keys]
    for i, time in enumerate(keys):
        tables["sample"].append(
            {
                "token": samples[i],
                "timestamp": drive.start_us + time,
                "scene_token": token(drive.name),
                "prev": samples[i - 1] if i else "",
                "next": samples[i + 1] if i + 1 < len(samples) else "",
            }
        )
    tables["scene"].append(
        {
            "token": token(drive.name),
            "log_token": token("log", drive.log),
            "nbr_samples": len(samples),
            "first_sample_token": samples[0],
            "last_sample_token": samples[-1],
            "name": drive.name,
            "description": drive.description,
        }
    )
    cameras = {}
    for channel in [*RIG, "LIDAR_TOP"]:
        truth = CameraTruth()
        offset_ms = _write_calibration(tables, drive, channel, truth, rng)
        filenames = _write_images(tables, drive, channel, truth, (frames, samples, offset_ms))
        if channel in RIG:
            cameras[channel] = truth
            for filename in filenames if images else ():
                (root / filename).parent.mkdir(parents=True, exist_ok=True)
                (root / filename).write_bytes(grey_jpeg())
    return SceneTruth(drive, cameras)


def _write_calibration(tables, drive: Drive, channel: str, truth: CameraTruth, rng) -> float:
    """One row of ``calibrated_sensor``; returns how late the sensor fires [ms]."""
    row: dict = {"token": token(drive.name, "calibrated", channel), "sensor_token": token("sensor", channel)}
    offset_ms = 0.0
    if channel in RIG:
        mount, yaw_deg, focal, centre, offset_ms = RIG[channel]
        jitter = rng.normal(0.0, 0.01, 3)
        truth.translation_m = tuple(float(a + b) for a, b in zip(mount, jitter, strict=True))
        truth.rotation = _camera_rotation(yaw_deg + rng.normal(0.0, 0.5))
        focal *= 1 + rng.normal(0.0, 0.005)
        truth.intrinsic = [[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]]
        row |= {"translation": list(truth.translation_m), "rotation": _quaternion(truth.rotation)}
        row |= {"camera_intrinsic": truth.intrinsic}
    else:
        row |= {"translation": [0.94, 0.0, 1.84], "rotation": [0.7071068, 0, 0, -0.7071068], "camera_intrinsic": []}
    tables["calibrated_sensor"].append(row)
    return offset_ms


def _write_images(tables, drive: Drive, channel: str, truth: CameraTruth, timing) -> list[str]:
    """Rows of ``sample_data`` and ``ego_pose`` of one sensor; returns the names of its files."""
    frames, samples, offset_ms = timing
    keys = [time for time, is_key in frames if is_key]
    chosen = list(frames)
    if channel == "CAM_BACK":
        del chosen[4]  # a dropped sweep
    tokens = [token(drive.name, channel, time) for time, _ in chosen]
    extension = "jpg" if channel in RIG else "pcd.bin"
    width, height = (1600, 900) if channel in RIG else (0, 0)
    for i, (time, is_key) in enumerate(chosen):
        stamp = drive.start_us + time + round(offset_ms * 1000)
        seconds = (stamp - drive.start_us) * 1e-6
        x, y = drive.position_m(seconds)
        yaw = drive.yaw_rad(seconds)
        sign = -1.0 if i % 5 == 3 else 1.0
        rotation = [sign * math.cos(yaw / 2), 0.0, 0.0, sign * math.sin(yaw / 2)]
        filename = f"{'samples' if is_key else 'sweeps'}/{channel}/{drive.log}__{channel}__{stamp}.{extension}"
        tables["ego_pose"].append(
            {"token": tokens[i], "timestamp": stamp, "rotation": rotation, "translation": [x, y, 0.0]}
        )
        tables["sample_data"].append(
            {
                "token": tokens[i],
                "sample_token": samples[next(k for k, key in enumerate(keys) if key >= time)],
                "ego_pose_token": tokens[i],
                "calibrated_sensor_token": token(drive.name, "calibrated", channel),
                "timestamp": stamp,
                "fileformat": extension.split(".")[0],
                "is_key_frame": is_key,
                "height": height,
                "width": width,
                "filename": filename,
                "prev": tokens[i - 1] if i else "",
                "next": tokens[i + 1] if i + 1 < len(tokens) else "",
            }
        )
        truth.filenames.append(filename)
        truth.timestamp_us.append(stamp)
        truth.is_keyframe.append(is_key)
        truth.pose.append((x, y, yaw))
    return truth.filenames


def write_can_bus(folder: Path, drive: Drive, duration_s: float, gyro_bias_radps: float = 0.0) -> None:
    """Noise-free messages in the units of the real files, from the first lidar turn on."""
    folder.mkdir(parents=True, exist_ok=True)

    def stamps(rate_hz: float, first_us: int) -> list[tuple[int, float]]:
        count = int(duration_s * rate_hz)
        times = [first_us + round(i * 1e6 / rate_hz) for i in range(count + 1)]
        return [(drive.start_us + time, time * 1e-6) for time in times]

    def write(message: str, rows: list[dict]) -> None:
        (folder / f"{drive.name}_{message}.json").write_text(json.dumps(rows))

    def rate(time: float) -> float:
        return drive.yaw_rate_radps(time) + gyro_bias_radps

    rpm = drive.speed_mps / 0.305 * 60 / (2 * math.pi)
    wheels = ("FL_wheel_speed", "FR_wheel_speed", "RL_wheel_speed", "RR_wheel_speed")
    write("zoe_veh_info", [{"utime": u, "odom": 3.0} | dict.fromkeys(wheels, rpm) for u, _ in stamps(100, 1_000)])
    write(
        "ms_imu",
        [{"utime": u, "rotation_rate": [0.0, 0.0, rate(t)], "q": [1, 0, 0, 0]} for u, t in stamps(100, 3_000)],
    )
    poses = []
    for u, t in stamps(50, 0):
        x, y = drive.position_m(t)
        pose = {"utime": u, "pos": [x, y, 0.0], "vel": [drive.speed_mps, 0.0, 0.0]}
        poses.append(pose | {"rotation_rate": [0.0, 0.0, rate(t)]})
    write("pose", poses)
    write("steeranglefeedback", [{"utime": u, "value": 4.0 * rate(t)} for u, t in stamps(100, 2_000)])
    if drive.has_vehicle_monitor:
        write(
            "vehicle_monitor",
            [
                {"utime": u, "vehicle_speed": drive.speed_mps * 3.6, "yaw_rate": math.degrees(rate(t)), "brake": 0}
                for u, t in stamps(2, 30_000)
            ],
        )
    write("route", [[600.0, 1647.0], [601.0, 1647.0]])
