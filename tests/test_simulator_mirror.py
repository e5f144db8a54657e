"""The mirror of the wet road against rays followed one by one through the same simple scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from mixo_env.geometry import rotation_from_yaw
from mixo_env.simulator.city.mesh import GROUND, SHADE, SOLID
from mixo_env.simulator.picture.mirror import mirror_road
from mixo_env.simulator.picture.views import Seen, View

pytestmark = pytest.mark.rendering

LENS = np.array([150.0, 150.0, 80.2, 45.3])
POSITION = np.array([3.0, -2.0, 1.5])
ROAD, PAVEMENT, WALL, POLE, UNDER = range(5)
MARK = np.zeros((5, 4), np.int32)
MARK[:, 1] = GROUND, GROUND, SOLID, SOLID, SHADE
WALL_M, POLE_M = 12.0, 7.0  # ahead of the camera
POLE_TOP_M = 1.2
FIELD = 0x1FFFFF
UNIT = 1000.0  # green radiance of everything that stands
PER_M = 200.0  # red radiance of what stands tells its height, blue how far aside it is


@dataclass(frozen=True)
class Scene:
    """What a camera sees of road, wall and pole; ``height_m`` and ``aside_m`` are those of the wall and the pole."""

    rotation: NDArray[np.float64]
    owner: NDArray[np.int32]
    depth: NDArray[np.float32]
    plane: NDArray[np.float64]
    radiance: NDArray[np.int64]
    rays: NDArray[np.float64]

    def mirrored(self, wetness: float = 1.0, clouds: int = 255) -> NDArray[np.int64]:
        radiance = self.radiance.copy()
        height, width = radiance.shape
        images = np.empty((height + 1) // 2 * ((width + 1) // 2) + 1, np.int64)
        noise = np.full((512, 512), clouds, np.uint8)
        seen = Seen(self.depth, self.owner, self.plane, np.zeros((5, 13), np.float32), MARK)
        view = View(self.rotation, POSITION, *LENS, far_m=100.0)
        mirror_road(radiance, seen, view, POSITION[2], noise, wetness, images)
        return radiance


def packed(red: NDArray[np.float64], green: NDArray[np.float64], blue: NDArray[np.float64]) -> NDArray[np.int64]:
    return red.astype(np.int64) | green.astype(np.int64) << 21 | blue.astype(np.int64) << 42


def hit(rays: NDArray[np.float64], start: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Way of rays (map frame) to the nearest of wall and pole, and which it is (-1 for none)."""
    with np.errstate(divide="ignore"):
        wall, pole = ((POSITION[0] + far - start[..., 0]) / rays[..., 0] for far in (WALL_M, POLE_M))
    at = start + pole[..., None] * rays
    on_pole = (
        (pole > 0.0) & (np.abs(at[..., 1] - POSITION[1] - 1.0) < 0.3) & (at[..., 2] > 0.0) & (at[..., 2] < POLE_TOP_M)
    )
    at = start + wall[..., None] * rays
    on_wall = (wall > 0.0) & (at[..., 2] > 0.0)
    return np.where(on_pole, pole, wall), np.where(on_pole, POLE, np.where(on_wall, WALL, -1)).astype(np.int32)


def scene(pitch_deg: float = 0.0, roll_deg: float = 0.0, height: int = 90, width: int = 160) -> Scene:
    """The view of a camera that looks along x, 1.5 m over a road."""
    level = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # camera from map
    about_z = rotation_from_yaw(np.radians(roll_deg))
    c, s = np.cos(np.radians(pitch_deg)), np.sin(np.radians(pitch_deg))
    rotation = about_z @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ level
    v, u = np.mgrid[0:height, 0:width].astype(float)
    rays = np.stack([(u - LENS[2]) / LENS[0], (v - LENS[3]) / LENS[1], np.ones_like(u)], axis=-1) @ rotation
    with np.errstate(divide="ignore"):
        ground = np.where(rays[..., 2] < 0.0, -POSITION[2] / rays[..., 2], np.inf)
    standing, which = hit(rays, np.broadcast_to(POSITION, rays.shape))
    near = np.where(which >= 0, standing, np.inf)
    owner = np.where(ground < near, ROAD, which).astype(np.int32)
    z = np.minimum(ground, near)
    at = POSITION + np.where(np.isfinite(z), z, 0.0)[..., None] * rays
    stands = (owner >= WALL).astype(np.float64)
    radiance = packed(stands * PER_M * at[..., 2], stands * UNIT, stands * PER_M * (at[..., 1] - POSITION[1] + 20.0))
    plane = np.zeros((5, 9))
    # 1/z of the ground is linear in column and row: - (ray . up) / height.
    up = rotation[:, 2]
    slope = -up[:2] / LENS[:2] / POSITION[2]
    plane[:2, 6:9] = (-up[2] / POSITION[2] - slope @ LENS[2:4], *slope)
    return Scene(rotation, owner, (1.0 / z).astype(np.float32), plane, radiance, rays)


def expected(view: Scene) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Point where each road pixel's mirrored ray ends, and on what; rays that leave the picture end nowhere."""
    on_road = view.owner == ROAD
    start = POSITION + np.where(on_road, 1.0 / view.depth, 0.0)[..., None] * view.rays
    reversed_rays = view.rays * (1.0, 1.0, -1.0)
    way, which = hit(reversed_rays, start)
    at = start + np.where(which >= 0, way, 0.0)[..., None] * reversed_rays
    seen = (at - POSITION) @ view.rotation.T
    with np.errstate(divide="ignore", invalid="ignore"):
        row = seen[..., 1] / seen[..., 2] * LENS[1] + LENS[3]
    inside = on_road & (which >= 0) & (row > 40.0 - 4.0)  # well below the rows that fade
    return at, np.where(inside, which, -1).astype(np.int32)


@pytest.mark.parametrize(("pitch_deg", "roll_deg"), [(0.0, 0.0), (1.5, 0.0), (0.0, 2.0), (-1.0, -1.5)])
def test_the_road_shows_what_mirrored_rays_meet(pitch_deg: float, roll_deg: float) -> None:
    view = scene(pitch_deg, roll_deg)
    result = view.mirrored()
    red, green, blue = (result >> shift & FIELD for shift in (0, 21, 42))
    at, which = expected(view)
    # Away from the pole's edges, where a pixel more or less shows something else.
    inner = (which == WALL) & (np.abs(at[..., 1] - POSITION[1] - 1.0 * WALL_M / POLE_M) > 1.2)
    inner &= green > 100  # dividing whole numbers
    inner[:, :10] = inner[:, -10:] = False  # comes from beside the picture
    assert inner.sum() > 400
    height, aside = red[inner] / green[inner] * UNIT / PER_M, blue[inner] / green[inner] * UNIT / PER_M - 20.0
    pixel = WALL_M / LENS[0]
    ripple = 1.5 * pixel  # the mean of two places three rows apart
    for error in (height - ripple - at[inner][:, 2], aside - (at[inner][:, 1] - POSITION[1])):
        assert np.abs(error).max() < 1.5 * pixel
        assert np.abs(error).mean() < 0.45 * pixel


def test_what_is_near_hides_what_is_far_in_the_mirror_too() -> None:
    view = scene()
    result = view.mirrored()
    green, blue = result >> 21 & FIELD, result >> 42 & FIELD
    at, which = expected(view)
    middle = (which == POLE) & (np.abs(at[..., 1] - POSITION[1] - 1.0) < 0.15) & (at[..., 2] > 0.2)
    middle &= (at[..., 2] < POLE_TOP_M - 0.2) & (green > 100)
    assert middle.sum() > 20
    aside = blue[middle] / green[middle] * UNIT / PER_M - 20.0
    assert np.abs(aside - 1.0).max() < 0.35  # the wall behind it would be seen 1.7 m aside


def test_only_the_road_changes_and_only_when_it_is_wet() -> None:
    view = scene(1.0, 1.0)
    assert np.array_equal(view.mirrored(wetness=0.0), view.radiance)
    assert np.array_equal(view.mirrored()[view.owner != ROAD], view.radiance[view.owner != ROAD])


def test_neither_ground_nor_what_lies_under_a_vehicle_is_mirrored() -> None:
    view = scene()
    for under, mark in ((PAVEMENT, ROAD), (UNDER, UNDER)):
        owner = view.owner.copy()
        owner[np.isin(owner, (WALL, POLE))] = under  # everything that stands becomes a bright piece of ground
        result = Scene(view.rotation, owner, view.depth, view.plane, view.radiance, view.rays).mirrored()
        assert np.array_equal(result[owner == mark], view.radiance[owner == mark])


def test_all_patches_of_the_ground_mirror_alike() -> None:
    """A border between two patches runs through cells; only pixels of the second patch in such cells may stay dry."""
    view = scene()
    owner = view.owner.copy()
    u = np.arange(owner.shape[1])
    owner[(owner == ROAD) & (u >= 71)] = PAVEMENT
    parted = Scene(view.rotation, owner, view.depth, view.plane, view.radiance, view.rays).mirrored()
    difference = np.abs((parted >> 21 & FIELD) - (view.mirrored() >> 21 & FIELD))
    assert set(np.flatnonzero((difference > 0.06 * UNIT).any(axis=0))) <= {71}


def test_the_mirror_fades_where_it_leaves_the_picture() -> None:
    view = scene(pitch_deg=8.0)
    green = (view.mirrored() >> 21 & FIELD)[:, 40]
    road = np.flatnonzero(view.owner[:, 40] == ROAD)
    assert green[road[4]] > 200
    assert green[road[-1]] == 0
    assert np.abs(np.diff(green[road[2:]])).max() < 60  # no edge


def test_pictures_of_odd_size() -> None:
    view = scene(height=75, width=121)
    result = view.mirrored()
    last_column = (view.owner[:, -1] == ROAD) & (result[:, -2] != view.radiance[:, -2])
    assert last_column.any()
    assert (result[last_column, -1] != view.radiance[last_column, -1]).all()
