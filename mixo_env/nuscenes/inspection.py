"""Check a nuScenes folder scene by scene before hours of recording go into it.

A *problem* is something wrong with the data: the scene cannot be recorded, or would be recorded wrongly. A *note* is
worth knowing and does no harm.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mixo_env.errors import DatasetError
from mixo_env.geometry import FloatArray
from mixo_env.nuscenes.can_bus import read_can_bus
from mixo_env.nuscenes.scene import CameraCalibration, CameraTrack, CanBus, IntArray, Signal
from mixo_env.nuscenes.selections import (
    CAMERAS,
    FIRST_NIGHT_SCENE,
    FIRST_SIMULATED_SCENE,
    KNOWN_PROBLEMS,
    LIDAR_PERIOD_US,
    SCENES_WITHOUT_CAN_BUS,
    scene_number,
)
from mixo_env.nuscenes.tables import Dataset, SceneInfo

GRID_TOLERANCE_US = 5_000
"""Image intervals lie on the lidar's 50 ms grid within this."""

LONGEST_IMAGE_GAP_S = 1.0
LONGEST_CAN_BUS_GAP_S = {"zoe_veh_info": 0.5, "ms_imu": 0.5, "pose": 0.5, "vehicle_monitor": 1.6}
"""A lost 2 Hz message leaves a gap of 1 s."""

CAN_BUS_EDGE_S = {"zoe_veh_info": 0.2, "ms_imu": 0.2, "pose": 0.2, "vehicle_monitor": 1.1}
"""How far the messages may end short of the images, at either end."""

TURNING_RADPS = 0.05
"""The sign of a gyro can be told once the car turns faster than this for a second."""

GYRO_CORRELATION = 0.95
LOWEST_WHEEL_RATIO, HIGHEST_WHEEL_RATIO = 0.9, 1.1
WHEEL_CHECK_M = 10.0
NOMINAL_WHEEL_RADIUS_M = 0.305


@dataclass
class SceneReport:
    """What was found in one scene.

    Attributes:
        name: of the scene.
        conditions: as :func:`mixo_env.nuscenes.selections.conditions_of`.
        problems: one line each; the scene should not be recorded as it is.
        notes: one line each; harmless.
        images: by camera.
        keyframes: of the scene table.
        duration_s: from the first to the last image.
        distance_m: driven, from the poses of the first camera.
        turn_deg: net change of heading.
        gyro_correlation: of ``ms_imu`` with the poses' yaw rate; ``None`` when the car does not turn.
        wheel_ratio: distance from the wheels over distance from the poses; ``None`` when the car hardly moves.
    """

    name: str
    conditions: tuple[str, ...]
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    images: dict[str, int] = field(default_factory=dict)
    keyframes: int = 0
    duration_s: float = 0.0
    distance_m: float = 0.0
    turn_deg: float = 0.0
    gyro_correlation: float | None = None
    wheel_ratio: float | None = None


@dataclass
class Inspection:
    """Problems of the folder as a whole, and one report a scene."""

    root: str
    version: str
    problems: list[str]
    scenes: list[SceneReport]

    @property
    def is_sound(self) -> bool:
        """Whether there is no problem anywhere."""
        return not self.problems and not any(scene.problems for scene in self.scenes)


def problems_of_folder(dataset: Dataset) -> list[str]:
    """What is wrong with the folder as a whole."""
    can_bus = dataset.root / "can_bus"
    return [] if can_bus.is_dir() else [f"no folder {can_bus}: unpack the CAN bus expansion beside samples"]


def inspect_scene(dataset: Dataset, info: SceneInfo, cameras: tuple[str, ...] = CAMERAS) -> SceneReport:
    """Check one scene: images, calibration, times, poses, CAN bus; nothing but file names and tables is read."""
    report = SceneReport(info.name, info.conditions, keyframes=info.keyframes)
    _remarks(report, info)
    tracks = {}
    for camera in cameras:
        try:
            tracks[camera] = dataset.track(info.name, camera)
        except DatasetError as error:
            report.problems.append(str(error).removeprefix(f"{info.name} "))
    for camera, track in tracks.items():
        report.images[camera] = len(track.timestamp_us)
        problems, notes = _timing(track, info.keyframes)
        problems += _image_problems(track) + calibration_problems(track.calibration)
        report.problems += [f"{camera}: {text}" for text in problems]
        report.notes += [f"{camera}: {text}" for text in notes]
    path = _true_path(tracks) if tracks else None
    if path is not None:
        report.duration_s = 1e-6 * float(path.time_us[-1] - path.time_us[0])
        report.distance_m = float(path.distance_m[-1])
        report.turn_deg = float(np.degrees(path.yaw_rad[-1] - path.yaw_rad[0]))
    try:
        can_bus = read_can_bus(dataset.root / "can_bus", info.name)
    except DatasetError as error:
        report.problems.append(str(error))
        return report
    if can_bus is None:
        known = info.name in SCENES_WITHOUT_CAN_BUS or not (dataset.root / "can_bus").is_dir()
        (report.notes if known else report.problems).append("no CAN bus data: it cannot be recorded")
    elif path is not None:
        _check_can_bus(report, can_bus, path)
    return report


def calibration_problems(calibration: CameraCalibration) -> list[str]:
    """What is wrong with a camera's intrinsic matrix and mounting."""
    problems = []
    k, rotation = calibration.intrinsic, calibration.rotation_ego_from_camera
    if not np.all(np.isfinite(k)) or k[0, 0] <= 0 or k[1, 1] <= 0:
        problems.append("the intrinsic matrix is not finite with focal lengths > 0")
    elif not (0 < k[0, 2] < calibration.width and 0 < k[1, 2] < calibration.height):
        problems.append(f"the principal point ({k[0, 2]:.0f}, {k[1, 2]:.0f}) lies outside the image")
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6):
        problems.append("the mounting is not a rotation")
    elif np.linalg.det(rotation) < 0:
        problems.append("the mounting is left-handed")
    elif rotation[2, 1] > -0.5:
        problems.append("the camera's y axis does not point down: quaternion not in the order w, x, y, z?")
    return problems


@dataclass(frozen=True)
class _Path:
    """Ego poses of all cameras' images in time order."""

    time_us: IntArray
    distance_m: FloatArray
    yaw_rad: FloatArray


def _true_path(tracks: dict[str, CameraTrack]) -> _Path:
    time_us, first = np.unique(np.concatenate([track.timestamp_us for track in tracks.values()]), return_index=True)
    x, y, yaw = (
        np.concatenate([getattr(track, name) for track in tracks.values()])[first] for name in ("x_m", "y_m", "yaw_rad")
    )
    steps = np.hypot(np.diff(x), np.diff(y))
    return _Path(time_us, np.concatenate([[0.0], np.cumsum(steps)]), np.unwrap(yaw))


def _remarks(report: SceneReport, info: SceneInfo) -> None:
    """What is known of the scene from its name alone."""
    if info.name in KNOWN_PROBLEMS:
        report.notes.append(KNOWN_PROBLEMS[info.name])
    number = scene_number(info.name)
    if number is not None and number < FIRST_SIMULATED_SCENE:
        by_number, by_text = number >= FIRST_NIGHT_SCENE, "night" in info.conditions
        if by_number != by_text:
            report.notes.append(f"described as {'night' if by_text else 'day'}, against what its number suggests")


def _image_problems(track: CameraTrack) -> list[str]:
    sizes = []
    for path in track.image_paths:
        try:
            sizes.append(path.stat().st_size)
        except OSError:
            sizes.append(-1)
    problems = []
    for size, what in ((-1, "missing"), (0, "empty")):
        if count := sizes.count(size):
            problems.append(f"{count} of {len(sizes)} images are {what}, first {track.image_paths[sizes.index(size)]}")
    return problems


def _timing(track: CameraTrack, keyframes: int) -> tuple[list[str], list[str]]:
    problems, notes = [], []
    interval_us = np.diff(track.timestamp_us)
    off_grid = np.abs(interval_us - LIDAR_PERIOD_US * np.round(interval_us / LIDAR_PERIOD_US)) > GRID_TOLERANCE_US
    if off_grid.any():
        notes.append(f"{np.count_nonzero(off_grid)} of {len(interval_us)} intervals are off the 50 ms grid")
    if len(interval_us) and interval_us.max() > 1e6 * LONGEST_IMAGE_GAP_S:
        problems.append(f"no image for {1e-6 * interval_us.max():.1f} s; at most {LONGEST_IMAGE_GAP_S:g} s is expected")
    if (count := int(track.is_keyframe.sum())) != keyframes:
        problems.append(f"{count} key frames; the scene table says {keyframes}")
    return problems, notes


def _check_can_bus(report: SceneReport, can_bus: CanBus, path: _Path) -> None:
    """Coverage of the messages, and the sign and size of what they say against the poses."""
    messages = {
        "zoe_veh_info": can_bus.wheel_speed_radps,
        "ms_imu": can_bus.imu_yaw_rate_radps,
        "pose": can_bus.pose_speed_mps,
        "vehicle_monitor": can_bus.monitor_yaw_rate_radps,
    }
    for message, sent in messages.items():
        needed = message in ("zoe_veh_info", "ms_imu")
        if sent is None:
            (report.problems if needed else report.notes).append(f"no {message} messages")
            continue
        found = _coverage(sent.timestamp_us, path.time_us, CAN_BUS_EDGE_S[message], LONGEST_CAN_BUS_GAP_S[message])
        (report.problems if needed else report.notes).extend(f"{message} {text}" for text in found)
    gyros = {
        "ms_imu": can_bus.imu_yaw_rate_radps,
        "pose": can_bus.pose_yaw_rate_radps,
        "production_gyro": can_bus.consumer_yaw_rate_radps,
    }
    for message, gyro in gyros.items():
        correlation = None if gyro is None else yaw_rate_correlation(gyro, path.time_us, path.yaw_rad)
        if message == "ms_imu":
            report.gyro_correlation = correlation
        if correlation is not None and correlation < GYRO_CORRELATION:
            report.problems.append(
                f"{message}: correlation of its yaw rate with the poses' is {correlation:.2f}; at least "
                f"{GYRO_CORRELATION} is expected: wrong axis, sign or clock"
            )
    if can_bus.wheel_speed_radps is not None:
        report.wheel_ratio = _wheel_ratio(can_bus.wheel_speed_radps, path)
    if report.wheel_ratio is not None and not LOWEST_WHEEL_RATIO < report.wheel_ratio < HIGHEST_WHEEL_RATIO:
        report.problems.append(
            f"zoe_veh_info: the rear wheels roll {report.wheel_ratio:.2f} of the poses' distance; "
            f"{LOWEST_WHEEL_RATIO} to {HIGHEST_WHEEL_RATIO} is expected: wrong unit?"
        )


def _wheel_ratio(wheels: Signal, path: _Path) -> float | None:
    """Distance rolled by the rear wheels over that of the poses, where both exist; ``None`` for a short way."""
    both = (path.time_us >= wheels.timestamp_us[0]) & (path.time_us <= wheels.timestamp_us[-1])
    if np.count_nonzero(both) < 2:
        return None
    true_m = np.ptp(path.distance_m[both])
    rolled_m = NOMINAL_WHEEL_RADIUS_M * np.ptp(
        _integral(wheels.timestamp_us, wheels.value[:, 2:].mean(axis=1), path.time_us[both])
    )
    return float(rolled_m / true_m) if true_m > WHEEL_CHECK_M else None


def _coverage(message_us: IntArray, image_us: IntArray, edge_s: float, gap_s: float) -> list[str]:
    found = []
    if (late := 1e-6 * (message_us[0] - image_us[0])) > edge_s:
        found.append(f"begins {late:.2f} s after the first image")
    if (early := 1e-6 * (image_us[-1] - message_us[-1])) > edge_s:
        found.append(f"ends {early:.2f} s before the last image")
    if len(message_us) > 1 and (gap := 1e-6 * np.diff(message_us).max()) > gap_s:
        found.append(f"is silent for {gap:.2f} s")
    return found


def yaw_rate_correlation(gyro: Signal, pose_us: IntArray, yaw_rad: FloatArray, window_s: float = 0.5) -> float | None:
    """Correlation of a gyro with the poses' yaw rate, both as means over windows of ``window_s``.

    Args:
        gyro: yaw rate, rad/s.
        pose_us: ``(n,)`` times of the poses.
        yaw_rad: ``(n,)`` unwrapped.
        window_s: 0.5 s averages the vibration away that both sensors see differently.

    Returns:
        ``None`` where the car hardly turns, and where the two overlap by less than 2 s.
    """
    begin = max(pose_us[0], gyro.timestamp_us[0])
    end = min(pose_us[-1], gyro.timestamp_us[-1])
    edges = np.arange(begin, end, int(1e6 * window_s))
    if len(edges) < 5:
        return None
    origin = pose_us[0]
    seconds = 1e-6 * (edges - origin)
    true_rate = np.diff(np.interp(seconds, 1e-6 * (pose_us - origin), yaw_rad)) / window_s
    gyro_rate = np.diff(_integral(gyro.timestamp_us, gyro.value, edges)) / window_s
    turning = np.convolve(np.abs(true_rate) > TURNING_RADPS, [1, 1], mode="valid").max() >= 2
    if not turning or np.std(gyro_rate) == 0.0:
        return None if not turning else 0.0
    return float(np.corrcoef(true_rate, gyro_rate)[0, 1])


def _integral(message_us: IntArray, rate: FloatArray, at_us: IntArray) -> FloatArray:
    """Trapezoid integral of a signal from its first message, at other times; flat outside."""
    seconds = 1e-6 * (message_us - message_us[0])
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(seconds)
    return np.interp(1e-6 * (at_us - message_us[0]), seconds, np.concatenate([[0.0], np.cumsum(steps)]))
