"""One scene through all experts: the rows of a recording, causal by construction.

Row k is made of images, match counts and CAN messages up to t_k and of nothing later: rounds close with their last
image, cameras see their images in time order, and inertial odometry at t uses messages up to t.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.experts.expert import CameraExpert, CameraStep, State
from mixo_env.experts.inertial import InertialEstimate
from mixo_env.experts.joint.config import JointConfig
from mixo_env.nuscenes.images import UNDECODABLE, describe_broken, image_fault, read_jpeg, too_many_broken
from mixo_env.nuscenes.scene import CameraCalibration, CameraReel, CanBus, Scene
from mixo_env.recordings.carry import carry_camera
from mixo_env.recordings.clock import NONE, Rounds, firing_rounds
from mixo_env.recordings.joint import JOINT, Watched, record_joint
from mixo_env.recordings.schema import INERTIAL_EXPERTS, empty_columns
from mixo_env.recordings.truth import exact_truth, own_window_truth, step_truth

logger = logging.getLogger(__name__)

Columns = dict[str, NDArray[Any]]

TIMING_COLUMNS = {
    "scene": "object",
    "camera": "object",
    "timestamp_us": "int64",
    "decode_ms": "float64",
    "expert_ms": "float64",
}
"""CPU time of every image: kept apart from the recording, never hashed."""


class InertialExpert(Protocol):
    """Causal inertial odometry of one scene."""

    def at(self, timestamps_us: NDArray[np.int64]) -> InertialEstimate:
        """Evaluate at increasing times; the value at t uses messages up to t only."""
        ...


@dataclass(frozen=True)
class Experts:
    """How the experts of a scene are made.

    Attributes:
        camera: odometry of one camera; ``None``: no image is looked at, and their times alone make the clock.
        inertial: one inertial grade from a CAN bus; raises :class:`DatasetError` when its messages are missing.
        variants: name -> camera, and other odometry that sees its images, too.
        joint: settings of JOINT, which all cameras' odometries then feed; ``None`` leaves it out.
    """

    camera: Callable[[CameraCalibration], CameraExpert] | None
    inertial: Callable[[CanBus, str], InertialExpert]
    variants: Mapping[str, tuple[str, Callable[[CameraCalibration], CameraExpert]]] = field(default_factory=dict)
    joint: JointConfig | None = None


def record_scene(scene: Scene, experts: Experts) -> tuple[Columns, Columns]:
    """Run every expert over one scene.

    Args:
        scene: its cameras become the recording's, in their order, if there is odometry for them.
        experts: makes them.

    Returns:
        All columns of the schema, ``(rows,)`` each, and the timings, ``(images,)`` each.

    Raises:
        DatasetError: without CAN bus, wheel speeds or IMU, or if they do not cover the images; for timing that is not
            that of the nuScenes rig; for more broken images than :func:`too_many_broken` allows.
    """
    if scene.can_bus is None:
        raise DatasetError("no CAN bus: distance and inertial odometry need wheel speeds and an IMU")
    rounds = firing_rounds({camera: reel.timestamp_us for camera, reel in scene.cameras.items()})
    if len(rounds) < 2:
        raise DatasetError("expected at least two firing rounds, got one: a step needs a start")
    cameras = rounds.cameras if experts.camera is not None else ()
    columns = empty_columns(
        len(rounds), cameras, INERTIAL_EXPERTS, (*experts.variants, *([JOINT] if experts.joint else []))
    )
    _record_steps(columns, scene, rounds)

    times = np.unique(rounds.image_time_us[rounds.fired])  # the closing times are among them
    inertial = _record_inertial(columns, scene, experts, times)
    timings: list[Columns] = [{name: np.zeros(0, dtype) for name, dtype in TIMING_COLUMNS.items()}]
    if experts.camera is None:
        return columns, timings[0]
    watched: dict[str, Watched] = {}
    for j, (camera, reel) in enumerate(scene.cameras.items()):
        rows = np.flatnonzero(rounds.fired[:, j])
        image = rounds.image[rows, j]
        at_image = np.searchsorted(times, reel.timestamp_us[image])
        made = {camera: experts.camera}
        made |= {name: make for name, (of, make) in experts.variants.items() if of == camera}
        for name, make in made.items():
            expert = make(reel.calibration)
            if experts.joint and name == camera:
                expert = watched[camera] = Watched(expert, experts.joint.camera_matches)
            steps, timing = _run_camera(name, expert, reel, image, inertial.distance_m[at_image])
            timings.append(timing | {"scene": np.full(len(image), scene.name, object)})
            sound = np.isfinite(timing["expert_ms"])  # the other images are as good as never taken
            rows, image, at_image = rows[sound], image[sound], at_image[sound]
            if name == camera:
                _record_images(columns, reel, rows, image)
            _record_camera(columns, name, camera, steps, rows)
    if experts.joint:
        timing = record_joint(columns, rounds, watched, experts.joint)
        timings.append(timing | {"scene": np.full(len(rounds), scene.name, object)})
    return columns, {name: np.concatenate([timing[name] for timing in timings]) for name in TIMING_COLUMNS}


def _record_steps(columns: Columns, scene: Scene, rounds: Rounds) -> None:
    """When each step ends, and where the car truly is then."""
    closing = rounds.closing_time_us
    columns["step"][:] = np.arange(len(rounds))
    columns["timestamp_us"][:] = closing
    columns["time_s"][:] = 1e-6 * (closing - closing[0])
    columns["dt_s"][:] = 1e-6 * np.diff(closing, prepend=closing[:1])
    truth = step_truth(scene.cameras, rounds) | (exact_truth(scene.exact, rounds) if scene.exact else {})
    for name, values in truth.items():
        columns[name][:] = values


def _record_inertial(columns: Columns, scene: Scene, experts: Experts, times: NDArray[np.int64]) -> InertialEstimate:
    """Distance, speed and every inertial grade of the steps; returns wheels and IMU at all ``times`` of images."""
    can_bus, closing = scene.can_bus, columns["timestamp_us"]
    assert can_bus is not None
    wheels_and_imu = experts.inertial(can_bus, "INERTIAL")
    inertial = wheels_and_imu.at(times)
    at_close = np.searchsorted(times, closing)
    columns["distance_m"][1:] = np.diff(inertial.distance_m[at_close])
    columns["speed_mps"][:] = inertial.speed_mps[at_close]
    _record_grade(columns, "INERTIAL", wheels_and_imu.at(closing))
    for grade in INERTIAL_EXPERTS[1:]:
        try:
            _record_grade(columns, grade, experts.inertial(can_bus, grade).at(closing))
        except DatasetError as error:  # its columns stay NaN: a message the scene lacks is no reason to drop it
            logger.info("%s: %s", scene.name, error)
    for name in ("truth.yaw_increment_rad", "truth.distance_m", "distance_m", "INERTIAL.yaw_increment_rad"):
        if not np.isfinite(columns[name][1:]).all():
            raise DatasetError(f"{name} is not finite in every step: the CAN bus or the poses do not cover the images")
    return inertial


def _record_grade(columns: Columns, grade: str, estimate: InertialEstimate) -> None:
    """Increments of one inertial grade over the steps, from its estimate at the closing times."""
    columns[f"{grade}.yaw_increment_rad"][1:] = np.diff(estimate.yaw_rad)
    columns[f"{grade}.yaw_std_rad"][1:] = np.sqrt(np.diff(estimate.yaw_variance_rad2))


def _run_camera(
    name: str, expert: CameraExpert, reel: CameraReel, image: NDArray[np.int64], distance_m: NDArray[np.float64]
) -> tuple[list[CameraStep], Columns]:
    """Show an expert its images in time order.

    Args:
        name: of the expert.
        expert: fresh.
        reel: the camera.
        image: ``(n,)`` the images to show.
        distance_m: ``(n,)`` inertial distance since the start of the scene at each of them.

    Returns:
        The expert's steps, one for each image that can be read, and the timings of all ``n`` but for the scene; an
        image that cannot be read has NaN for the expert's.

    Raises:
        DatasetError: if too many images cannot be read.
    """
    steps: list[CameraStep] = []
    decode_ms, expert_ms = np.full((2, len(image)), np.nan)
    faults: dict[int, str] = {}
    calibration, before = reel.calibration, distance_m[0]
    for n, i in enumerate(image):
        start = time.thread_time()
        grey = readable(reel.image_paths[i], calibration, expert.halvings)
        if isinstance(grey, str):
            faults[n] = grey
            if too_many_broken(faults, len(image)):
                paths = [reel.image_paths[k] for k in image]
                raise DatasetError("; ".join(describe_broken(calibration.channel, faults, paths)))
            continue
        decoded = time.thread_time()
        steps.append(expert.process(grey, int(reel.timestamp_us[i]), float(distance_m[n] - before)))
        before = distance_m[n]
        decode_ms[n] = 1e3 * (decoded - start)
        expert_ms[n] = 1e3 * (time.thread_time() - decoded)
    timing = {
        "camera": np.full(len(image), name, object),
        "timestamp_us": reel.timestamp_us[image],
        "decode_ms": decode_ms,
        "expert_ms": expert_ms,
    }
    return steps, timing


def readable(path: Path, calibration: CameraCalibration, halvings: int) -> NDArray[np.uint8] | str:
    """An image as :func:`read_grey`, or what is wrong with it."""
    fault = image_fault(path, calibration.width, calibration.height)
    if fault is not None:
        return fault
    try:
        return read_grey(path, halvings)
    except DatasetError:
        return UNDECODABLE


def broken_images(timings: Columns) -> dict[str, int]:
    """Camera -> number of its images that could not be read, for those that have any, from a scene's timings."""
    cameras = timings["camera"][np.isnan(timings["expert_ms"])]
    return {str(camera): int(np.sum(cameras == camera)) for camera in dict.fromkeys(cameras)}


def remarks_on_images(scene: Scene, timings: Columns) -> list[str]:
    """One line for every kind of broken image, as ``mixo inspect`` says it.

    Args:
        scene: that was recorded.
        timings: that came of it.
    """
    remarks = []
    for camera, reel in scene.cameras.items():
        broken = (timings["camera"] == camera) & np.isnan(timings["expert_ms"])
        positions = np.searchsorted(reel.timestamp_us, timings["timestamp_us"][broken]).tolist()
        width, height = reel.calibration.width, reel.calibration.height
        faults = {k: image_fault(reel.image_paths[k], width, height) or UNDECODABLE for k in positions}
        remarks += [f"images: {text}" for text in describe_broken(camera, faults, reel.image_paths)]
    return remarks


def _record_images(columns: Columns, reel: CameraReel, rows: NDArray[np.int64], image: NDArray[np.int64]) -> None:
    """When the images of one camera were taken: ``image`` are their numbers, one for each of ``rows``."""
    camera, times = reel.calibration.channel, reel.timestamp_us[image]
    taken = np.full(len(columns["step"]), NONE)
    taken[rows] = image
    columns[f"{camera}.image_time_offset_s"][rows] = 1e-6 * (times - columns["timestamp_us"][rows])
    columns[f"{camera}.own_window_s"][rows[1:]] = 1e-6 * np.diff(times)
    columns[f"{camera}.own_window_truth_yaw_increment_rad"][:] = own_window_truth(reel, taken)


def _record_camera(
    columns: Columns, expert: str, camera: str, steps: list[CameraStep], rows: NDArray[np.int64]
) -> None:
    """Columns of one camera from what its expert said; rows without an image stay NaN.

    Args:
        columns: filled in place; the columns of the camera's images are there.
        expert: the camera or a variant of it.
        camera: whose images it saw.
        steps: one for each of ``rows``.
        rows: rounds in which the camera fired.
    """
    columns[f"{expert}.state"][:] = State.NO_IMAGE
    for name in ("state", "matches", "inliers", "residual_px", "flow_px"):
        columns[f"{expert}.{name}"][rows] = [getattr(step, name) for step in steps]
    for name in ("yaw_increment_rad", "yaw_std_rad"):
        columns[f"{expert}.own_window_{name}"][rows] = [getattr(step, name) for step in steps]
    two_frame = np.full(len(columns["step"]), np.nan)
    two_frame[rows] = [step.two_frame_yaw_increment_rad for step in steps]
    carry_camera(columns, expert, camera, two_frame)


def read_grey(path: Path, halvings: int = 0) -> NDArray[np.uint8]:
    """A JPEG as ``(height, width)`` grey.

    Args:
        path: file.
        halvings: how often to halve the image. The decoder does so on the way, which saves time; the result is the mean
            of 2 x 2 pixels but for rounding (mean difference 0.1 grey levels, shift below 0.01 px). An odd last row or
            column is left out.

    Raises:
        DatasetError: if it is missing, truncated, no JPEG, or of a size that no camera has.
    """
    import simplejpeg

    jpeg = read_jpeg(path)
    try:
        height, width = (int(side) >> halvings for side in simplejpeg.decode_jpeg_header(jpeg)[:2])
        grey = simplejpeg.decode_jpeg(
            jpeg, colorspace="GRAY", min_height=height, min_width=width, min_factor=2**halvings
        )
        return grey[:height, :width, 0]
    except ValueError as error:
        raise DatasetError(f"{path} cannot be read as JPEG ({error}): unpack or simulate it again") from None
