"""Moving vehicles in the pictures, where the simulator knows them, and how many inlier matches lie on them (Fig. 3)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from docs._pages.data_sheet.folder import City
from docs._pages.data_sheet.images import match_pair, scaled_intrinsic
from experiments.picture_statistics import read_gray
from mixo_env.geometry import FloatArray
from mixo_env.nuscenes.scene import CameraCalibration
from mixo_env.simulator.city.land import FLAT, Land, land_of
from mixo_env.simulator.city.streets import BLOCK_M, SIDEWALK_M
from mixo_env.simulator.city.vehicles import VEHICLE_KINDS, VehicleState
from mixo_env.simulator.drive.scenario import LogPlan, ScenePlan
from mixo_env.simulator.drive.scenes import SimulatedScene, camera_pose
from mixo_env.simulator.picture.render import CameraPose
from mixo_env.simulator.picture.weather import weather_named

MOVING_MPS = 0.5
"""Slower vehicles count as part of the street."""

NEAR_M = 0.1
FARTHEST_M = 120.0

FULL = 0.05
"""From this share of the picture on, movers can matter: pairs are taken from such pictures."""

EVERY = 10
"""Images between those that are looked at."""

_CORNERS = np.array(list(itertools.product((-0.5, 0.5), (-0.5, 0.5), (0.0, 1.0))))
_EDGES = [(a, b) for a, b in itertools.combinations(range(8), 2) if np.count_nonzero(_CORNERS[a] - _CORNERS[b]) == 1]


@dataclass(frozen=True)
class Sight:
    """One image of one camera, and the share of it that moving vehicles cover."""

    log: LogPlan
    plan: ScenePlan
    channel: str
    index: int
    covered: float


@dataclass(frozen=True)
class MoverShares:
    """Of one pair of consecutive pictures: how much of what lies on movers.

    Attributes:
        covered: share of the first picture.
        matches: share of the matched corners.
        inliers: share of those that agree with one essential matrix (plain five-point RANSAC).
        odometry: share of the inliers of the project's odometry, which knows scale, mounting and the ground; NaN if it
            found no motion.
    """

    covered: float
    matches: float
    inliers: float
    odometry: float


def outline(
    state: VehicleState, calibration: CameraCalibration, pose: CameraPose, land: Land = FLAT
) -> NDArray[np.int32] | None:
    """Convex outline ``(n, 2)`` of a vehicle's box in pixels; ``None`` when it is behind the camera."""
    kind = VEHICLE_KINDS[state.kind]
    body = _CORNERS * (kind.length_m, kind.width_m, kind.height_m)
    c, s = np.cos(state.yaw_rad), np.sin(state.yaw_rad)
    x, y = state.x_m + c * body[:, 0] - s * body[:, 1], state.y_m + s * body[:, 0] + c * body[:, 1]
    corners = np.stack([x, y, body[:, 2] + land.height(*land.grid(x, y))], axis=1)
    seen = (corners - pose.position_m) @ pose.rotation_map_from_camera
    points = [seen[k] for k in range(8) if seen[k, 2] >= NEAR_M]
    for a, b in _EDGES:
        if (seen[a, 2] < NEAR_M) != (seen[b, 2] < NEAR_M):
            part = (NEAR_M - seen[a, 2]) / (seen[b, 2] - seen[a, 2])
            points.append(seen[a] + part * (seen[b] - seen[a]))
    if len(points) < 3:
        return None
    flat = np.array(points) @ calibration.intrinsic.T
    pixels = np.clip(flat[:, :2] / flat[:, 2:], -1e5, 1e5)
    return np.asarray(cv2.convexHull(pixels.round().astype(np.int32))[:, 0], np.int32)


def in_sight(position_m: FloatArray, state: VehicleState, land: Land = FLAT) -> bool:
    """Whether no block of houses stands between a camera and the middle or an end of a vehicle."""
    half_m = 0.5 * VEHICLE_KINDS[state.kind].length_m
    for along in (0.0, half_m, -half_m):
        x, y = state.x_m + along * np.cos(state.yaw_rad), state.y_m + along * np.sin(state.yaw_rad)
        part = np.linspace(0.0, 1.0, 2 + int(np.hypot(x - position_m[0], y - position_m[1])))
        way_x, way_y = position_m[0] + part * (x - position_m[0]), position_m[1] + part * (y - position_m[1])
        way = np.stack(land.grid(way_x, way_y))
        inside = np.abs(way - BLOCK_M * np.rint(way / BLOCK_M)) > SIDEWALK_M
        if not inside.all(axis=0).any():
            return True
    return False


def mover_mask(
    states: Sequence[VehicleState], calibration: CameraCalibration, pose: CameraPose, land: Land = FLAT
) -> NDArray[np.bool_]:
    """``(height, width)`` pixels inside the box of a vehicle that moves and is in sight."""
    mask = np.zeros((calibration.height, calibration.width), np.uint8)
    for state in states:
        distance_m = np.hypot(state.x_m - pose.position_m[0], state.y_m - pose.position_m[1])
        if abs(state.speed_mps) < MOVING_MPS or distance_m > FARTHEST_M:
            continue
        polygon = outline(state, calibration, pose, land)
        if polygon is not None and in_sight(pose.position_m, state, land):
            cv2.fillConvexPoly(mask, polygon, 1)
    return mask > 0


def image_mask(
    log: LogPlan, plan: ScenePlan, simulated: SimulatedScene, channel: str, index: int, kind: str | None = None
) -> NDArray[np.bool_]:
    """:func:`mover_mask` of one image, at the middle of its exposure, through the true (not the written) camera.

    Args:
        log: of the scene.
        plan: of the scene.
        simulated: the scene.
        channel: camera.
        index: of its images.
        kind: of the vehicles that count; ``None``: all.
    """
    calibration = log.rig.true[channel]
    exposure_us = int(simulated.times.cameras[channel].exposure_us[index])
    time_s = (exposure_us - plan.start_us) * 1e-6 + 0.5 * weather_named(log.weather).shutter_s
    pose = camera_pose(simulated.drive, calibration.rotation_ego_from_camera, calibration.translation_m, time_s)
    vehicles = [vehicle for vehicle in simulated.vehicles if kind in (None, vehicle.kind)]
    return mover_mask([vehicle.state(time_s) for vehicle in vehicles], calibration, pose, land_of(log.world_seed))


def sights(city: City) -> list[Sight]:
    """Every ``EVERY``-th image of every camera and scene, with what movers cover of it."""
    scenes = [(log, plan, city.drive_again(log, plan)) for log, plan in city.scenes()]
    return [
        sight
        for log, plan, simulated in scenes
        for channel in city.config.cameras
        for sight in scene_sights(log, plan, simulated, channel)
    ]


def scene_sights(
    log: LogPlan, plan: ScenePlan, simulated: SimulatedScene, channel: str, kind: str | None = None
) -> list[Sight]:
    """Those of one camera in one scene; ``kind`` of the vehicles that count, ``None``: all."""
    images = range(0, len(simulated.times.cameras[channel].exposure_us) - 1, EVERY)
    covered = [float(image_mask(log, plan, simulated, channel, index, kind).mean()) for index in images]
    return [Sight(log, plan, channel, index, share) for index, share in zip(images, covered, strict=True)]


def mover_shares(
    city: City, found: Sequence[Sight], per_camera: int = 40
) -> dict[str, list[tuple[Sight, MoverShares]]]:
    """Pairs of pictures full of movers by camera, day and rain, evenly spread over all there are."""
    result = {}
    for channel in city.config.cameras:
        full = [
            sight
            for sight in found
            if sight.channel == channel and sight.covered >= FULL and sight.log.weather != "night"
        ]
        chosen = np.unique(np.linspace(0, len(full) - 1, min(per_camera, len(full))).round().astype(int))
        result[channel] = [(full[k], pair_shares(city, full[k])) for k in chosen]
    return result


@dataclass(frozen=True)
class MatchedSight:
    """An image and the next one, matched twice.

    Attributes:
        masks: ``(h, w)`` of movers in both.
        first, second: ``(n, 2)`` pixels of matched corners in both.
        inlier: ``(n,)`` in agreement with one essential matrix.
        odometry_first, odometry_second: ``(m, 2)`` pixels of the matches that agree with the odometry's motion.
    """

    masks: tuple[NDArray[np.bool_], NDArray[np.bool_]]
    first: FloatArray
    second: FloatArray
    inlier: NDArray[np.bool_]
    odometry_first: FloatArray
    odometry_second: FloatArray

    def on_movers(self, first: FloatArray, second: FloatArray) -> NDArray[np.bool_]:
        """``(n,)`` which matches lie on movers in both pictures."""
        return _on(self.masks[0], first) & _on(self.masks[1], second)


def pair_shares(city: City, sight: Sight) -> MoverShares:
    """Of the image and the next one."""
    pair = matched_sight(city, sight)
    on = pair.on_movers(pair.first, pair.second)
    odometry = pair.on_movers(pair.odometry_first, pair.odometry_second)
    return MoverShares(
        covered=float(pair.masks[0].mean()),
        matches=float(on.mean()) if len(on) else np.nan,
        inliers=float(on[pair.inlier].mean()) if pair.inlier.any() else np.nan,
        odometry=float(odometry.mean()) if len(odometry) else np.nan,
    )


def matched_sight(city: City, sight: Sight) -> MatchedSight:
    """Match an image with the next one, by OpenCV alone and by the project's odometry."""
    simulated = city.drive_again(sight.log, sight.plan)
    reel = city.dataset.reel(sight.plan.name, sight.channel)
    first, second = (read_gray(reel.image_paths[sight.index + k]) for k in (0, 1))
    size = first.shape[1], first.shape[0]  # large pictures are read at half size
    masks = [
        image_mask(sight.log, sight.plan, simulated, sight.channel, sight.index + k).astype(np.uint8) for k in (0, 1)
    ]
    before, after = (cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST) > 0 for mask in masks)
    calibration = reel.calibration
    intrinsic = scaled_intrinsic(calibration.intrinsic, calibration.width, first)
    pair = match_pair(first, second, intrinsic)
    gap_s, dx, dy = (
        float(np.diff(values[sight.index : sight.index + 2])[0])
        for values in (reel.timestamp_us * 1e-6, reel.x_m, reel.y_m)
    )
    odometry = _odometry_inliers(calibration, intrinsic, (first, second), gap_s, float(np.hypot(dx, dy)))
    return MatchedSight((before, after), pair.first, pair.second, pair.inlier, *odometry)


def _odometry_inliers(
    calibration: CameraCalibration,
    intrinsic: FloatArray,
    grays: Sequence[NDArray[np.uint8]],
    gap_s: float,
    way_m: float,
) -> tuple[FloatArray, FloatArray]:
    """Pixels of the matches on which the project's odometry bases its motion, in both pictures."""
    from mixo_env.experts.monocular.camera import mount
    from mixo_env.experts.monocular.config import MonocularConfig
    from mixo_env.experts.monocular.pair import PairSolver

    height, width = grays[0].shape
    seen = CameraCalibration(
        calibration.channel, intrinsic, calibration.rotation_ego_from_camera, calibration.translation_m, width, height
    )
    config = MonocularConfig()
    solver = PairSolver(mount(seen, config.max_pixels), config)
    frames = [solver.frame(solver.camera.shrink(gray)) for gray in grays]
    pair = solver.compare(frames[0], frames[1], gap_s, way_m)
    if pair.motion is None:
        return np.empty((0, 2)), np.empty((0, 2))
    focal, centre = intrinsic[[0, 1], [0, 1]], intrinsic[:2, 2]
    agreed = pair.motion.inlier
    return pair.first[agreed] * focal + centre, pair.second[agreed] * focal + centre


def _on(mask: NDArray[np.bool_], pixels: FloatArray) -> NDArray[np.bool_]:
    """Which of ``(n, 2)`` pixels the mask covers."""
    x, y = pixels.round().astype(int).T
    return mask[np.clip(y, 0, mask.shape[0] - 1), np.clip(x, 0, mask.shape[1] - 1)]
