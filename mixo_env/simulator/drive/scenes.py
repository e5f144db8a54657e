"""One simulated scene: the drive with its traffic, sensors and poses, and the pictures the cameras take of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import rotation_from_roll_pitch_yaw, wrap_angle_rad
from mixo_env.nuscenes.scene import CameraReel, ExactPoses, Scene
from mixo_env.nuscenes.selections import conditions_of
from mixo_env.nuscenes.writer import image_name
from mixo_env.simulator.city.land import land_of
from mixo_env.simulator.city.streets import BLOCK_M, SIDEWALK_M
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.drive.clock import CameraTimes, SceneTimes, scene_times
from mixo_env.simulator.drive.drive import DRIVE_RATE_HZ, Drive, plan_drive
from mixo_env.simulator.drive.localisation import localise
from mixo_env.simulator.drive.people import Person, stage_people
from mixo_env.simulator.drive.scenario import LOCATION, LogPlan, ScenePlan, generator
from mixo_env.simulator.drive.traffic import Vehicle, stage_traffic
from mixo_env.simulator.drive.vehicle_bus import bus_messages
from mixo_env.simulator.picture.faults import PASSING, PixelFault, Shot, dropped, glaring_sun, knock

if TYPE_CHECKING:
    from mixo_env.simulator.city.world import BlockSide
    from mixo_env.simulator.picture.render import CameraPose, Renderer

_LIGHT = {"day": "sunny", "rain": "rain", "night": "night"}  # the words that nuScenes uses, too
_WALL_SEEN_M = 60.0  # a blank wall reaches this far beyond the way


@dataclass(frozen=True)
class SimulatedScene:
    """Everything about one scene but its pixels.

    Attributes:
        scene: as it is written: poses and calibrations with their small errors, and the exact truth.
        times: when the sensors fire.
        drive: the true motion.
        vehicles: all others.
        people: on foot and on bicycles.
        messages: of the CAN bus, by name.
    """

    scene: Scene
    times: SceneTimes
    drive: Drive
    vehicles: tuple[Vehicle, ...]
    people: tuple[Person, ...]
    messages: dict[str, list[dict[str, Any]]]


def scene_drive(config: SimulationConfig, log: LogPlan, plan: ScenePlan) -> Drive:
    """The drive of one scene."""
    rng = generator(config, "drive", plan.number)
    return plan_drive(rng, plan.situation, config.seconds, log.course_offset_rad, plan.motion, land_of(log.world_seed))


def camera_fault(config: SimulationConfig, plan: ScenePlan) -> PixelFault | None:
    """The fault of one scene, ``None`` without; every kind meets the same camera, so that kinds can be compared."""
    if config.fault.kind == "none":
        return None
    rng = generator(config, "fault", plan.number)
    drawn = config.cameras[int(rng.integers(len(config.cameras)))]
    camera = config.fault.camera or drawn
    seed = int(generator(config, "fault", plan.number, *camera.encode()).integers(2**31))
    first, last = (0.25, 0.75) if config.fault.kind in PASSING else (0.0, 2.0)  # images go on a little after the end
    return PixelFault(config.fault.kind, camera, first * config.seconds, last * config.seconds, seed)


def simulate_scene(config: SimulationConfig, log: LogPlan, plan: ScenePlan, root: Path) -> SimulatedScene:
    """Drive one scene and let every sensor but the cameras record it."""
    drive = scene_drive(config, log, plan)
    times = scene_times(generator(config, "clock", plan.number), plan.start_us, config.seconds)
    land = land_of(log.world_seed)
    vehicles = stage_traffic(generator(config, "traffic", plan.number), drive, config.seconds, land)
    people = stage_people(generator(config, "people", plan.number), drive, land, config.seconds, vehicles, log.weather)
    localisation = localise(generator(config, "localisation", plan.number), drive, log.localisation_lag_s)
    first_us, last_us = int(times.sample_us[0]), int(times.sample_us[-1])
    bus_rng = generator(config, "bus", plan.number)
    messages = bus_messages(bus_rng, drive, localisation, log.sensors, first_us, last_us)

    reels = {}
    fault = camera_fault(config, plan)
    for channel in config.cameras:
        frames = times.cameras[channel]
        if fault is not None and fault.camera == channel:
            frames = _without_dropped(frames, fault, plan.start_us)
        x, y, yaw = localisation.pose((frames.timestamp_us - plan.start_us) / 1e6)
        names = zip(frames.timestamp_us.tolist(), frames.is_keyframe.tolist(), strict=True)
        paths = tuple(root / image_name(log.logfile, channel, time, key) for time, key in names)
        calibration = log.rig.written[channel]
        reels[channel] = CameraReel(
            calibration, frames.timestamp_us, paths, frames.is_keyframe, x, y, wrap_angle_rad(yaw)
        )
    description = ", ".join(
        [_LIGHT[log.weather], *(["low sun"] if log.low_sun else []), *_manoeuvre(drive, config.seconds)]
    )
    scene = Scene(
        name=plan.name,
        description=description,
        log=log.logfile,
        vehicle=log.vehicle,
        location=LOCATION,
        conditions=conditions_of(description),
        cameras=reels,
        can_bus=None,
        exact=_exact(drive, plan, config.seconds),
    )
    return SimulatedScene(scene, times, drive, vehicles, people, messages)


def pictures(
    config: SimulationConfig,
    log: LogPlan,
    plan: ScenePlan,
    simulated: SimulatedScene,
    renderer: Renderer,
    channels: Sequence[str] = (),
) -> Iterator[tuple[Path, NDArray[np.uint8]]]:
    """Every picture of the scene with its path, camera by camera in time order (the exposure control has a memory).

    A knocked camera looks where it does; all other faults come after the picture, see :func:`shots`.

    Args:
        config: of the data set.
        log: of the scene.
        plan: of the scene.
        simulated: the scene.
        renderer: of the log.
        channels: cameras; empty for all.
    """
    from mixo_env.simulator.picture.drops import drops_on, glass_of
    from mixo_env.simulator.picture.drops_seen import drops_veil

    shutter_s = renderer.weather.shutter_s
    fault = camera_fault(config, plan)
    for channel in channels or config.cameras:
        calibration = log.rig.true[channel]
        if fault is not None and fault.camera == channel:
            calibration = replace(
                calibration, rotation_ego_from_camera=knock(fault) @ calibration.rotation_ego_from_camera
            )
        gain = drops = None
        if log.weather == "rain":
            name = (config.seed, *b"drops", plan.number, *channel.encode())
            drops = drops_on(glass_of(channel), name, config.seconds, calibration.intrinsic[0, 0] / config.width)
        exposures_us = simulated.times.cameras[channel].exposure_us
        until_next_s = np.diff(exposures_us, append=exposures_us[-1]) / 1e6
        for number, (exposure_us, path) in enumerate(_exposed(simulated, channel)):
            open_s = (exposure_us - plan.start_us) / 1e6
            noise = generator(config, "noise", plan.number, *channel.encode(), number)
            picture = renderer.render(
                calibration,
                camera_pose(simulated.drive, calibration.rotation_ego_from_camera, calibration.translation_m, open_s),
                camera_pose(
                    simulated.drive,
                    calibration.rotation_ego_from_camera,
                    calibration.translation_m,
                    open_s + shutter_s,
                ),
                [vehicle.state(open_s + 0.5 * shutter_s) for vehicle in simulated.vehicles],
                people=[person.state(open_s + 0.5 * shutter_s) for person in simulated.people],
                gain=gain,
                noise_seed=int(noise.integers(2**31)),
                veil=drops_veil(drops, open_s, config.height, config.width) if drops else None,
                next_s=float(until_next_s[number]),
            )
            gain = picture.gain
            if path is not None:  # else dropped; but the exposure control has seen it
                yield path, picture.image


def _exposed(simulated: SimulatedScene, channel: str) -> Iterator[tuple[int, Path | None]]:
    """Time of exposure [us] and path of every picture a camera takes; ``None`` for those that it loses."""
    reel, times = simulated.scene.cameras[channel], simulated.times.cameras[channel]
    path_at = dict(zip(reel.timestamp_us.tolist(), reel.image_paths, strict=True))
    for time_us, exposure_us in zip(times.timestamp_us.tolist(), times.exposure_us.tolist(), strict=True):
        yield exposure_us, path_at.get(time_us)


def shots(log: LogPlan, plan: ScenePlan, simulated: SimulatedScene, fault: PixelFault) -> dict[Path, Shot]:
    """How every picture of the faulty camera was taken."""
    calibration, drive = log.rig.true[fault.camera], simulated.drive

    def view(time_s: float) -> NDArray[np.float64]:
        mounted = calibration.rotation_ego_from_camera, calibration.translation_m
        return camera_pose(drive, *mounted, time_s).rotation_map_from_camera

    sun = glaring_sun(fault, view(0.5 * (simulated.times.sample_us[-1] - plan.start_us) / 1e6))
    taken = {}
    for exposure_us, path in _exposed(simulated, fault.camera):
        if path is not None:
            open_s = (exposure_us - plan.start_us) / 1e6
            taken[path] = Shot(open_s, calibration.intrinsic, view(open_s).T @ sun)
    return taken


def _without_dropped(frames: CameraTimes, fault: PixelFault, start_us: int) -> CameraTimes:
    """The frames that a dropping camera hands over; its numbers count those it took."""
    table = zip(frames.exposure_us.tolist(), frames.is_keyframe.tolist(), strict=True)
    kept = [not dropped(fault, n, (time - start_us) / 1e6, key) for n, (time, key) in enumerate(table)]
    return CameraTimes(frames.timestamp_us[kept], frames.exposure_us[kept], frames.is_keyframe[kept])


def camera_pose(
    drive: Drive, rotation_ego_from_camera: NDArray[np.float64], translation_m: NDArray[np.float64], time_s: float
) -> CameraPose:
    """Where a camera of the pitching, rolling and heaving body really is."""
    from mixo_env.simulator.picture.render import CameraPose

    x, y, z, yaw, heave, roll, pitch = (
        float(drive.at(name, time_s)) for name in ("x_m", "y_m", "z_m", "yaw_rad", "heave_m", "roll_rad", "pitch_rad")
    )
    body = rotation_from_roll_pitch_yaw(roll, pitch, yaw)
    return CameraPose(body @ rotation_ego_from_camera, np.array([x, y, z + heave]) + body @ translation_m)


def blank_sides(config: SimulationConfig, log: LogPlan) -> tuple[BlockSide, ...]:
    """House fronts that the log's scenes with a blank wall need: one whole side of the way."""
    sides: dict[BlockSide, None] = {}
    for plan in log.scenes:
        if plan.situation != "blank_wall":
            continue
        drive = scene_drive(config, log, plan)
        s = np.arange(float(drive.at("s_m", 0.0)), float(drive.at("s_m", config.seconds)) + _WALL_SEEN_M, 1.0)
        x, y, course = drive.route.at(s)
        turned = course[-1] - course[0]
        # The wall stands on the outer side of a turn, so that the front view sweeps along it.
        outer = -np.sign(turned) if abs(turned) > 0.5 else generator(config, "wall", plan.number).choice([-1, 1])
        inside = (x - outer * 15.0 * np.sin(course), y + outer * 15.0 * np.cos(course))
        for u, v in zip(*land_of(log.world_seed).grid(*inside), strict=True):
            side = _nearest_side(u, v)
            if side:
                sides[side] = None
    return tuple(sides)


def _nearest_side(u: float, v: float) -> BlockSide | None:
    """The house front next to a point of the grid behind it, ``None`` on a street."""
    column, row = int(np.floor(u / BLOCK_M)), int(np.floor(v / BLOCK_M))
    u, v = u - column * BLOCK_M, v - row * BLOCK_M
    if min(u, v, BLOCK_M - u, BLOCK_M - v) < SIDEWALK_M:
        return None
    distances = {"west": u, "east": BLOCK_M - u, "south": v, "north": BLOCK_M - v}
    return column, row, min(distances, key=lambda side: distances[side])


def _exact(drive: Drive, plan: ScenePlan, seconds: float) -> ExactPoses:
    """The noise-free truth from shortly before the first image until shortly after the last."""
    inside = (drive.time_s >= -0.2) & (drive.time_s <= seconds + 0.2)
    time_us = plan.start_us + np.rint(drive.time_s[inside] * 1e6).astype(np.int64)
    return ExactPoses(time_us, drive.x_m[inside], drive.y_m[inside], wrap_angle_rad(drive.yaw_rad[inside]))


def _manoeuvre(drive: Drive, seconds: float) -> list[str]:
    """What the car does, in the words of the scene table."""
    inside = slice(*np.searchsorted(drive.time_s, (0.0, seconds)))
    yaw, speed = drive.yaw_rad[inside], drive.speed_mps[inside]
    turned = yaw - yaw[0]
    words = []
    if drive.s_m[inside][-1] - drive.s_m[inside][0] < 0.25 * seconds:
        words.append("wait")
    elif (speed < 0.1).sum() > 0.5 * DRIVE_RATE_HZ:
        words.append("stop and go")
    if turned.max() > 0.7:
        words.append("turn left")
    if turned.min() < -0.7:
        words.append("turn right")
    staged = [] if drive.situation == "ordinary" else [drive.situation.replace("_", " ")]
    return (words or ["straight"]) + staged
