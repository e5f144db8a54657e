"""A rig of cameras on a known drive, as matched points: noise, outliers, movers, tilt, staggered image times."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mixo_env.experts.joint.odometry import JointOdometry
from mixo_env.experts.joint.sight import JointStep, Sight
from mixo_env.experts.monocular.camera import MountedCamera
from mixo_env.geometry import rotation_from_yaw
from tests.rigid_body import camera_displacement

AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # ego from camera, looking forward
STEP_US, STAGGER_US = 83_000, 7_000
# mounting yaw [deg], focal length [px], width [px], lever x, y [m]
PLACES = {
    "front": (0.0, 1266.0, 1600, 1.70, 0.0),
    "front_left": (55.0, 1272.0, 1600, 1.57, 0.5),
    "back": (180.0, 809.0, 1600, 0.03, 0.0),
    "back_right": (250.0, 1259.0, 1600, 1.02, -0.48),
    "front_right": (-55.0, 600.0, 800, 1.6, -0.5),
    "back_left": (110.0, 1256.0, 1600, 1.03, 0.48),
}
RIGS = {
    "front and back": ("front", "back"),
    "front and sides": ("front", "front_left", "front_right"),
    "the paper's": ("front", "front_left", "back", "back_right"),
    "sides and back": ("front_left", "front_right", "back_left", "back_right", "back"),
    "all around": tuple(PLACES),
}


def mounted(name: str, written_yaw_deg: float = 0.0) -> MountedCamera:
    """A camera of the rig, its mounting written wrong by an angle."""
    yaw, focal, width, x, y = PLACES[name]
    shape = (width * 9 // 16, width)
    return MountedCamera(
        name,
        shape,
        shape,
        0,
        np.array([focal, focal]),
        0.0,
        np.array([width / 2, shape[0] / 2]),
        rotation_from_yaw(math.radians(yaw + written_yaw_deg)) @ AXES,
        np.array([x, y, 1.5]),
    )


def street(rng: np.random.Generator, camera: MountedCamera, count: int) -> np.ndarray:
    """Points ``(count, 3)`` in ego axes relative to the camera: ground, house fronts, far things."""
    pixel = rng.uniform([0, 0], camera.full_shape[::-1], (2 * count, 2))
    ray = np.column_stack([(pixel - camera.centre_px) / camera.focal_px, np.ones(len(pixel))])
    ray = (ray / np.linalg.norm(ray, axis=1, keepdims=True)) @ camera.rotation.T
    depth = np.exp(rng.uniform(math.log(6), math.log(100), len(ray)))
    depth = np.where(ray[:, 2] < -0.02, np.minimum(depth, 1.5 / np.maximum(-ray[:, 2], 0.02)), depth)
    return (ray * depth[:, None])[:count]


def tilt(pitch: float, roll: float) -> np.ndarray:
    """R_y(pitch) R_x(roll)."""
    c, s, a, b = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    return np.array([[a, 0, b], [0, 1, 0], [-b, 0, a]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def look(
    rng: np.random.Generator,
    name: str,
    times_us: tuple[int, int],
    motion: tuple[float, float, float, float],
    *,
    points: int = 150,
    outliers: float = 0.2,
    movers: bool = True,
) -> Sight:
    """Two images of one camera.

    Args:
        rng: draws.
        name: of the camera.
        times_us: of the images.
        motion: yaw [rad], distance [m], pitch, roll [rad] between them.
        points: matches.
        outliers: share that are wrong.
        movers: vehicles hold a part of the points.
    """
    camera, (yaw, distance, pitch, roll) = mounted(name), motion
    before = street(rng, camera, points)
    after = before.copy()
    if movers:
        after[: points // 8] += [rng.uniform(-1.0, 1.0), rng.normal(0, 0.05), 0.0]
    displacement = np.array([*camera_displacement(yaw, distance, *PLACES[name][3:]), 0.0])
    after = (after - displacement) @ (rotation_from_yaw(yaw) @ tilt(pitch, roll))
    noise = 0.5 / camera.focal_px[0]
    planes = []
    for seen in (before @ camera.rotation, after @ camera.rotation):
        planes.append((seen[:, :2] / seen[:, 2:] + rng.normal(0, noise, (points, 2)), seen[:, 2] > 0.5))
    keep = planes[0][1] & planes[1][1]
    first, second = planes[0][0][keep], planes[1][0][keep]
    wrong = rng.random(len(first)) < outliers
    second[wrong] += rng.normal(0, 0.03, (int(wrong.sum()), 2))
    return Sight(*times_us, distance, noise, len(first) * 4, first, second, yaw + rng.normal(0, 1e-3))


def drive(
    seed: int, names: tuple[str, ...], steps: int, *, speed: float = 8.0, rate_deg: float = 10.0, **options: Any
) -> Iterator[tuple[int, dict[str, Sight], float]]:
    """Closing time, sights and true yaw increment [rad] of every step; the yaw rate swings, cameras fire in turn."""
    rng = np.random.default_rng(seed)

    def yaw(time_us: float) -> float:
        return math.radians(rate_deg) / 0.8 * (1.0 - math.cos(0.8e-6 * time_us))

    for k in range(steps + 1):
        close = k * STEP_US
        pitch, roll = rng.normal(0, 0.001, 2)
        sights = {}
        for j, name in enumerate(names):
            end = close - STAGGER_US * (len(names) - 1 - j)
            start = end - STEP_US
            motion = (yaw(end) - yaw(start), speed * 1e-6 * STEP_US, pitch, roll)
            if k:
                sights[name] = look(rng, name, (start, end), motion, **options)
        yield close, sights, yaw(close) - yaw(close - STEP_US)


def play(
    cameras: Mapping[str, MountedCamera], steps: Iterator[tuple[int, dict[str, Sight], float]]
) -> tuple[list[JointStep], np.ndarray]:
    """Steps of a fresh odometry, and their errors [rad]."""
    odometry = JointOdometry(cameras)
    said, truth = [], []
    for time_us, sights, yaw in steps:
        said.append(odometry.process(time_us, sights))
        truth.append(yaw)
    return said, np.array([step.yaw_increment_rad for step in said]) - truth


def rig(names: tuple[str, ...]) -> dict[str, MountedCamera]:
    """The cameras, mounted as written."""
    return {name: mounted(name) for name in names}
