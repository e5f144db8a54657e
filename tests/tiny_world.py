"""Worlds of a few plain patches, cameras of a car, and an independent ray caster, for the tests of the renderer."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import rotation_from_yaw
from mixo_env.nuscenes.scene import CameraCalibration
from mixo_env.simulator.city.mesh import Patch, Surface, mesh_of, packed
from mixo_env.simulator.city.textures import Atlas, Bytes, rgba
from mixo_env.simulator.city.world import World, grain_levels
from mixo_env.simulator.drive.rig import nominal_calibration
from mixo_env.simulator.picture.render import CameraPose
from mixo_env.simulator.picture.weather import Weather

SUN = np.array([0.6, 0.0, 0.8])

FLAT = Weather(
    "test",
    shutter_s=0.02,
    sun=0.0,
    ambient=1.0,
    colour=(1.0, 1.0, 1.0),
    haze_per_m=0.0,
    haze=(0.0, 0.0, 0.0),
    zenith=(0.0, 0.0, 0.0),
    sight_m=240.0,
    grain_levels=5,
    most_taps=3,
    clouds=0.0,
    lamps=0.0,
    wetness=0.0,
    exposure_target=0.2,
    largest_gain=1.0,
    shot_noise=0.0,
    read_noise=0.0,
)
"""Even light, black sky, no noise: a pixel is bright exactly where a white patch is."""

CHANNELS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK_RIGHT", "CAM_BACK")


def camera(channel: str, scale: float = 0.2) -> CameraCalibration:
    """A camera of the rig at ``scale`` of 1600 x 900."""
    return nominal_calibration(channel, round(1600 * scale), round(900 * scale))


def pose(calibration: CameraCalibration, x_m: float, y_m: float, yaw_rad: float) -> CameraPose:
    """Camera pose of a car that stands flat at (x, y, yaw)."""
    turn = rotation_from_yaw(yaw_rad)
    position = np.array([x_m, y_m, 0.0]) + turn @ calibration.translation_m
    return CameraPose(turn @ calibration.rotation_ego_from_camera, position)


@cache
def _open_ground() -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    return np.full((4096, 4096), 255, np.uint8), np.zeros((2048, 2048), np.float32)


def world_of(textures: Sequence[Bytes], patches: Sequence[Patch]) -> World:
    """A world of these textures (by number) and patches, without fine grain, vehicles or shadows."""
    atlas = Atlas()
    for texture in textures:
        atlas.add(texture)
    texels, table = atlas.packed()
    detail, detail_start = grain_levels(np.full((512, 512), 127, np.uint8))
    sunlight, field = _open_ground()
    return World(
        seed=0,
        sun=SUN,
        static=packed([mesh_of([patch]) for patch in patches], SUN),
        vehicles={},
        people={},
        texels=texels,
        table=table,
        detail=detail,
        detail_start=detail_start,
        sky=np.zeros((512, 512), np.uint8),
        sunlight=sunlight,
        shadow_height=field,
        lamp_light=np.zeros((1024, 1024), np.float32),
        ground_texels_per_m=16.0,
        underpasses=np.empty((0, 4)),
    )


def plain_texture(red: float, green: float, blue: float, fourth: float = 0.0) -> Bytes:
    """One colour, 16 x 16."""
    return rgba(np.full((16, 16, 3), (red, green, blue), np.float32), fourth)


def surface(texture: int, shape: int = 0) -> Surface:
    """A surface without grain, 16 texels a metre."""
    return Surface(texture, (16.0, 16.0), detail=0.0, shape=shape)


def cast(calibration: CameraCalibration, at: CameraPose, patch: Patch) -> tuple[NDArray[np.float64], ...]:
    """Independent oracle: s, t and distance along the optical axis of the patch's plane at every pixel; inf behind."""
    v, u = np.mgrid[0 : calibration.height, 0 : calibration.width].astype(np.float64)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(calibration.intrinsic).T
    rays = rays @ at.rotation_map_from_camera.T
    origin, edge_u, edge_v = (np.array(part) for part in patch[:3])
    normal = np.cross(edge_u, edge_v)
    with np.errstate(divide="ignore"):
        depth = ((origin - at.position_m) @ normal) / (rays @ normal)
    points = at.position_m + depth[..., None] * rays - origin
    s = points @ edge_u / (edge_u @ edge_u)  # edges at right angles
    t = points @ edge_v / (edge_v @ edge_v)
    return s, t, np.where(depth > 0.0, depth, np.inf)
