"""The checks by name, the report of one scene, and a data set that gives out sound scenes only."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from mixo_env.errors import ConfigurationError, DatasetError, unknown
from mixo_env.nuscenes.can_bus import MESSAGES, Messages, can_bus_of, read_messages
from mixo_env.nuscenes.checks import gyro, messages, mounting, pictures, poses, wheels
from mixo_env.nuscenes.checks.evidence import Evidence, Finding, true_path
from mixo_env.nuscenes.scene import CameraReel, IntArray, Scene
from mixo_env.nuscenes.selections import (
    CAMERAS,
    FIRST_NIGHT_SCENE,
    FIRST_SIMULATED_SCENE,
    KNOWN_PROBLEMS,
    is_published,
    lacks_can_bus,
    scene_number,
)
from mixo_env.nuscenes.tables import Dataset

logger = logging.getLogger(__name__)

CHECKS: Mapping[str, str] = {
    "images": "but for a few, images are there, whole, JPEGs and of the size in the tables",
    "image-gap": "no camera pauses for more than a second",
    "image-time": "file names and tables give one time and one camera for an image",
    "key-frames": "every camera has the key frames of the scene table",
    "calibration": "cameras are upright pinholes that look where their name says",
    "pose-time": "an image's pose has the time of the image",
    "pose-tilt": "the car stands upright on the map",
    "pose-heading": "the car points where it goes",
    "pose-jump": "the car moves and turns as a car can",
    "can-bus": "there are wheel speeds and an IMU",
    "can-order": "messages stand in the order of time",
    "can-coverage": "messages cover the images without silence",
    "wrong-axis": "gyros turn with the poses",
    "gyro-size": "gyros turn as much as the poses",
    "clock-offset": "CAN bus and poses have one clock",
    "wheel-range": "wheels turn as wheels can",
    "wheel-unit": "wheels roll as far as the poses go",
}
"""What can be overridden, by name. What cannot even be read (``tables``, ``can-file``) is no matter of judgement."""

_FUNCTIONS: tuple[Callable[[Evidence], Iterator[Finding]], ...] = (
    pictures.image_gaps,
    pictures.keyframes,
    pictures.image_files,
    pictures.image_names,
    mounting.calibration,
    poses.pose_times,
    poses.pose_tilt,
    poses.pose_course,
    poses.pose_jumps,
    poses.standing,
    messages.can_bus_there,
    messages.coverage,
    gyro.gyro_sign,
    gyro.gyro_clock,
    gyro.gyro_size,
    wheels.wheel_range,
    wheels.wheel_unit,
    wheels.wheel_clock,
)


@dataclass
class SceneReport:
    """What was found in one scene.

    Attributes:
        name: of the scene.
        conditions: as :func:`mixo_env.nuscenes.selections.conditions_of`.
        problems: the scene should not be recorded as it is.
        notes: harmless.
        images: by camera.
        keyframes: of the scene table.
        duration_s: from the first to the last image.
        distance_m: driven, from the poses of all cameras.
        turn_deg: net change of heading.
        gyro_correlation: of ``ms_imu`` with the poses' yaw rate; ``None`` when the car does not turn.
        wheel_ratio: distance from the wheels over distance from the poses; ``None`` when the car hardly moves.
        rates_hz: of the messages that are there.
        imu_latency_s: how late ``pose``, whose rates are copies of ``ms_imu``'s, follows it; ``None`` if too even.
        pose_lag_s: how late the poses follow ``ms_imu``, crudely; ``None`` when the car turns too evenly to tell.
        course_offset_deg: direction of motion minus heading, on straight roads.
        truth_noise_deg: RMS difference of half-second yaw increments of poses and ``ms_imu``: the noise of both.
    """

    name: str
    conditions: tuple[str, ...]
    problems: list[Finding] = field(default_factory=list)
    notes: list[Finding] = field(default_factory=list)
    images: dict[str, int] = field(default_factory=dict)
    keyframes: int = 0
    duration_s: float = 0.0
    distance_m: float = 0.0
    turn_deg: float = 0.0
    gyro_correlation: float | None = None
    wheel_ratio: float | None = None
    rates_hz: dict[str, float] = field(default_factory=dict)
    imu_latency_s: float | None = None
    pose_lag_s: float | None = None
    course_offset_deg: float | None = None
    truth_noise_deg: float | None = None


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


def judge(dataset: Dataset, name: str, cameras: tuple[str, ...] = CAMERAS, *, images: bool = True) -> SceneReport:
    """Check one scene: images, calibration, times, poses, CAN bus.

    Of images a kilobyte is read, and nothing is decoded; without ``images`` their files are not looked at.

    Raises:
        ConfigurationError: no such scene or camera.
    """
    info = dataset.scenes[dataset.position(name)]
    report = SceneReport(info.name, info.conditions, keyframes=info.keyframes)
    report.notes += _known(dataset.version, info.name, info.conditions)
    evidence, unreadable = _read(dataset, name, cameras)
    report.problems += unreadable
    for check in _FUNCTIONS if images else [check for check in _FUNCTIONS if check is not pictures.image_files]:
        for finding in check(evidence):
            (report.problems if finding.is_problem else report.notes).append(finding)
    _measure(report, evidence)
    return report


@dataclass(frozen=True)
class JudgedDataset:
    """A data set whose scenes are checked before they are given out, in the words of ``mixo inspect``.

    Attributes:
        dataset: the folder.
        despite: checks whose problems are accepted.
        images: their files are looked at.
    """

    dataset: Dataset
    despite: tuple[str, ...] = ()
    images: bool = True

    def __post_init__(self) -> None:
        """Check the names.

        Raises:
            ConfigurationError: no such check.
        """
        for name in self.despite:
            if name not in CHECKS:
                raise ConfigurationError(unknown("check", name, CHECKS))

    @property
    def version(self) -> str:
        """Of the tables."""
        return self.dataset.version

    @property
    def scene_names(self) -> tuple[str, ...]:
        """All scenes, sound or not, in ascending order of name."""
        return self.dataset.scene_names

    def load(self, name: str, cameras: tuple[str, ...] = CAMERAS) -> Scene:
        """One scene.

        Raises:
            ConfigurationError: no such scene or camera.
            DatasetError: it has a problem that is not accepted, or cannot be read.
        """
        problems = judge(self.dataset, name, cameras, images=self.images).problems
        refusing = [finding for finding in problems if finding.check not in self.despite]
        if refusing:
            more = f" (and {len(refusing) - 1} more, see `mixo inspect`)" if len(refusing) > 1 else ""
            raise DatasetError(f"{refusing[0]}{more}")
        for finding in problems:
            logger.warning("%s: recorded despite %s", name, finding)
        return self.dataset.load(name, cameras)


def _read(dataset: Dataset, name: str, cameras: tuple[str, ...]) -> tuple[Evidence, list[Finding]]:
    """Everything the checks look at, and what cannot be read."""
    unreadable: list[Finding] = []
    reels: dict[str, CameraReel] = {}
    index, position = dataset.index, dataset.position(name)
    rows = {camera: dataset.rows(name, camera) for camera in cameras}
    for camera in cameras:
        try:
            reels[camera] = dataset.reel(name, camera)
        except DatasetError as error:
            unreadable.append(Finding("tables", str(error).removeprefix(f"{name} ")))
    folder = dataset.root / "can_bus"
    sent = Messages([], [], [], [], [], [])
    try:
        sent = read_messages(folder, name)
    except DatasetError as error:
        unreadable.append(Finding("can-file", str(error)))
    times: dict[str, IntArray] = {message: sent.times_us(message) for message in MESSAGES}
    evidence = Evidence(
        info=dataset.scenes[position],
        reels=reels,
        tilt_rad={camera: index.tilt_rad[rows[camera]].astype(np.float64) for camera in reels},
        pose_delay_s={camera: index.pose_delay_s[rows[camera]].astype(np.float64) for camera in reels},
        path=true_path(reels),
        can_bus=can_bus_of(sent),
        message_times_us=times,
        is_can_bus_readable=not any(finding.check == "can-file" for finding in unreadable),
        expects_can_bus=folder.is_dir() and not lacks_can_bus(dataset.version, name),
    )
    return evidence, unreadable


def _known(version: str, name: str, conditions: tuple[str, ...]) -> Iterator[Finding]:
    """What is known of a published scene from its name alone."""
    if not is_published(version):
        return
    if name in KNOWN_PROBLEMS:
        yield Finding("known", KNOWN_PROBLEMS[name], is_problem=False)
    number = scene_number(name)
    if number is not None and number < FIRST_SIMULATED_SCENE:
        by_number, by_text = number >= FIRST_NIGHT_SCENE, "night" in conditions
        if by_number != by_text:
            text = f"described as {'night' if by_text else 'day'}, against what its number suggests"
            yield Finding("known", text, is_problem=False)


def _measure(report: SceneReport, evidence: Evidence) -> None:
    """Numbers that are no judgement."""
    report.images = {camera: len(reel.timestamp_us) for camera, reel in evidence.reels.items()}
    rates = {message: messages.message_rate_hz(times) for message, times in evidence.message_times_us.items()}
    report.rates_hz = {message: rate for message, rate in rates.items() if rate is not None}
    path, can_bus = evidence.path, evidence.can_bus
    if path is None:
        return
    report.duration_s = 1e-6 * float(path.time_us[-1] - path.time_us[0])
    report.distance_m = float(path.distance_m[-1])
    report.turn_deg = float(np.degrees(path.yaw_rad[-1] - path.yaw_rad[0]))
    if (offset := poses.course_offset_rad(path, straight_only=True)) is not None:
        report.course_offset_deg = float(np.degrees(offset))
    if can_bus is None:
        return
    if (wheel := can_bus.wheel_speed_radps) is not None:
        report.wheel_ratio = wheels.wheel_ratio(wheel, path)
    if (imu := can_bus.imu_yaw_rate_radps) is not None and len(imu.timestamp_us) > 1:
        if (compared := evidence.yaw_rates.get("ms_imu")) is not None:
            report.truth_noise_deg = float(np.degrees(0.5 * np.std(compared.true - compared.sensed)))
            if compared.is_moving(gyro.TURNING_RADPS):
                report.gyro_correlation = compared.correlation
        if (lag := evidence.pose_lags.get("ms_imu")) is not None:
            report.pose_lag_s = lag.seconds
        report.imu_latency_s = gyro.latency_s(can_bus)
