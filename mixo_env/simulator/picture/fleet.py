"""Moving vehicles and people as patches, put anew into every picture.

A vehicle stands on the plane that touches the ground below its middle: what is beside the middle is as much higher as
that plane is there. Slopes are small enough for this to be a rotation.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked, inlined
from mixo_env.simulator.city.land import FLAT, Land
from mixo_env.simulator.city.mesh import CUT_OUT, SHADE, TWO_SIDED, PatchSet, packed
from mixo_env.simulator.city.people import PEOPLE_KINDS, PHASES, PersonState
from mixo_env.simulator.city.underpass import light_at
from mixo_env.simulator.city.vehicles import VEHICLE_KINDS, VehicleState
from mixo_env.simulator.city.world import World
from mixo_env.simulator.picture.culling import spheres_in_view
from mixo_env.simulator.picture.views import (
    BODY,
    FACING,
    MATERIAL,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    SIDES,
    Bools,
    Float64s,
    Int64s,
    View,
)

X, Y, YAW, SPEED, YAW_RATE, HEIGHT, RISE_X, RISE_Y, GRID_U, GRID_V, DX_DV, DY_DU, SKYLIGHT = range(13)
"""Columns of ``moving_states``."""

_SWEEPS = 3  # patches of a sun shadow
_SHADE, _BOTH = SHADE, TWO_SIDED | CUT_OUT
_ROOMY = 1.1  # spheres leave room for the slope
_SHADOW_M = 0.01  # above the road, or the two would flicker

# A box a little smaller than the body's outer size, which rounded bodies do not fill, throws the shadow.
_SHADOW_PLAN = 0.96  # share of length and width
_SHADOW_HEIGHT = 0.85  # share of height


class Pose(NamedTuple):
    """Where a vehicle stands: position, cosine and sine of the yaw, slope, its place on the grid and how that bends."""

    x: float
    y: float
    z: float
    c: float
    s: float
    rise_x: float
    rise_y: float
    u: float
    v: float
    dx_dv: float
    dy_du: float


class Models(NamedTuple):
    """All that is copied when vehicles and people are placed.

    Attributes:
        patches: of the models, one group each.
        size_m: ``(models, 3)`` length, width, height.
        sun: ``(3,)`` unit vector towards the sun.
        texels_per_m: of the ground, which shadows show.
        shadows: whether they throw sun shadows.
    """

    patches: PatchSet
    size_m: Float64s
    sun: Float64s
    texels_per_m: float
    shadows: bool


@inlined
def _pose(state: Float64s) -> Pose:
    """A row of ``moving_states``."""
    return Pose(
        state[X], state[Y], state[HEIGHT], np.cos(state[YAW]), np.sin(state[YAW]), state[RISE_X], state[RISE_Y],
        state[GRID_U], state[GRID_V], state[DX_DV], state[DY_DU],
    )  # fmt: skip


@compiled_unchecked
def _bounds(states: Float64s, numbers: Int64s, models: Models) -> Float64s:
    """Bounding spheres of the models ``numbers`` in their ``states``, with their sun shadows: ``(n, 4)``."""
    spheres, out = models.patches.groups, np.empty((len(states), 4))
    for n in range(len(states)):
        pose, m = _pose(states[n]), numbers[n]
        out[n, 0] = pose.x + pose.c * spheres[m, 0] - pose.s * spheres[m, 1]
        out[n, 1] = pose.y + pose.s * spheres[m, 0] + pose.c * spheres[m, 1]
        out[n, 2] = pose.z + spheres[m, 2]
        out[n, 3] = _ROOMY * spheres[m, 3]
        if models.shadows:
            rx, ry = _throw(models, m, pose)
            out[n, 3] += np.sqrt(rx * rx + ry * ry)
    return out


@compiled_unchecked
def _place(states: Float64s, numbers: Int64s, wanted: Bools, models: Models, out: PatchSet) -> None:
    """Copy the models ``numbers`` to their ``states``, but only those that are wanted; see :class:`Fleet`."""
    patches = models.patches
    q = under = 0
    for n in range(states.shape[0]):
        out.group_start[n] = q
        if not wanted[n]:
            continue
        pose, m, light = _pose(states[n]), numbers[n], states[n, SKYLIGHT]
        # The body, in what light there is.
        for p in range(patches.group_start[m], patches.group_start[m + 1]):
            _move(patches, p, pose, out, q)
            _face(patches, p, (pose.c, pose.s), models.sun, out, q)
            for j in range(3):
                out.look[q, j] *= light
            out.tag[q, BODY] = n + 1
            if patches.tag[p, MATERIAL] == _SHADE:
                _lay(out, q, models.texels_per_m, pose)
                under = p
            q += 1
        # Its shadow, which looks like the ground under it.
        if models.shadows:
            q = _throw_shadow(models, m, pose, under, out, q)
    out.group_start[states.shape[0]] = q


@inlined
def _copy(patches: PatchSet, p: int, out: PatchSet, q: int) -> None:
    """How patch ``p`` looks, to ``q``; single numbers, since Numba copies a row more slowly."""
    for j in range(6):
        out.texel[q, j] = patches.texel[p, j]
    for j in range(13):
        out.look[q, j] = patches.look[p, j]
    for j in range(4):
        out.tag[q, j] = patches.tag[p, j]


@inlined
def _move(patches: PatchSet, p: int, pose: Pose, out: PatchSet, q: int) -> None:
    """Copy patch ``p`` to ``q``, turned and moved to ``pose``."""
    for e in range(0, 9, 3):
        gx, gy = patches.geometry[p, e], patches.geometry[p, e + 1]
        dx, dy = pose.c * gx - pose.s * gy, pose.s * gx + pose.c * gy
        out.geometry[q, e], out.geometry[q, e + 1] = dx, dy
        out.geometry[q, e + 2] = patches.geometry[p, e + 2] + pose.rise_x * dx + pose.rise_y * dy
    out.geometry[q, 0] += pose.x
    out.geometry[q, 1] += pose.y
    out.geometry[q, 2] += pose.z
    _copy(patches, p, out, q)


@inlined
def _face(patches: PatchSet, p: int, turn: tuple[float, float], sun: Float64s, out: PatchSet, q: int) -> None:
    """Turn the normal of patch ``p`` and look how it faces the sun; what is seen from both sides is lit on both."""
    c, s = turn
    look = patches.look[p]
    nx, ny, nz = c * look[NORMAL_X] - s * look[NORMAL_Y], s * look[NORMAL_X] + c * look[NORMAL_Y], look[NORMAL_Z]
    facing = nx * sun[0] + ny * sun[1] + nz * sun[2]
    if facing < 0.0 and patches.tag[p, SIDES] & _BOTH != 0:
        facing, nx, ny, nz = -facing, -nx, -ny, -nz
    lit = out.look[q]
    lit[FACING], lit[NORMAL_X], lit[NORMAL_Y], lit[NORMAL_Z] = max(facing, 0.0), nx, ny, nz


@compiled_unchecked
def _throw(models: Models, m: int, pose: Pose) -> tuple[float, float]:
    """Where the shadow of the roof of model ``m`` lies, from below it, in metres."""
    tall, sun = _SHADOW_HEIGHT * models.size_m[m, 2], models.sun
    way = tall / (sun[2] - pose.rise_x * sun[0] - pose.rise_y * sun[1])
    return -way * sun[0], -way * sun[1]


@compiled_unchecked
def _throw_shadow(models: Models, m: int, pose: Pose, under: int, out: PatchSet, q: int) -> int:
    """Put the sun shadow of a box from ``q`` on; the next free patch.

    It is the plan of the box swept along the ground: the plan where that ends, and two parallelograms.
    """
    x, y, c, s = pose.x, pose.y, pose.c, pose.s
    length, width = _SHADOW_PLAN * models.size_m[m, 0], _SHADOW_PLAN * models.size_m[m, 1]
    rx, ry = _throw(models, m, pose)
    ux, uy, vx, vy = c * length, s * length, s * width, -c * width  # along the vehicle and to its right
    cx, cy = x - 0.5 * (ux + vx), y - 0.5 * (uy + vy)  # rear left corner
    ahead, aside = c * rx + s * ry > 0.0, s * rx - c * ry > 0.0
    patches = models.patches
    for k in range(_SWEEPS):
        _copy(patches, under, out, q)
        for j in range(3):
            out.look[q, j] = 1.0  # the tint
        out.tag[q, SIDES] = TWO_SIDED
        g = out.geometry[q]
        if k == 0:
            g[0], g[1], g[3], g[4], g[6], g[7] = cx + rx, cy + ry, ux, uy, vx, vy
        elif k == 1:  # the sweep of the side that is turned from the sun
            g[0], g[1], g[3], g[4], g[6], g[7] = cx, cy, ux, uy, rx, ry
            if aside:
                g[0] += vx
                g[1] += vy
        else:  # of the front or the rear
            g[0], g[1], g[3], g[4], g[6], g[7] = cx, cy, vx, vy, rx, ry
            if ahead:
                g[0] += ux
                g[1] += uy
        g[2] = pose.z + _SHADOW_M + pose.rise_x * (g[0] - x) + pose.rise_y * (g[1] - y)
        g[5], g[8] = pose.rise_x * g[3] + pose.rise_y * g[4], pose.rise_x * g[6] + pose.rise_y * g[7]
        _lay(out, q, models.texels_per_m, pose)
        q += 1
    return q


@compiled_unchecked
def _lay(out: PatchSet, q: int, texels_per_m: float, pose: Pose) -> None:
    """Give patch ``q`` the texture of the ground below it; what lies on the ground does not move with the vehicle."""
    g, texel = out.geometry[q], out.texel[q]
    a, b = pose.dx_dv, pose.dy_du
    scale = texels_per_m / (1.0 - a * b)  # the map back to the grid
    dx, dy = g[0] - pose.x, g[1] - pose.y
    texel[0], texel[1] = scale * (g[3] - a * g[4]), scale * (g[6] - a * g[7])
    texel[2] = texels_per_m * pose.u + scale * (dx - a * dy)
    texel[3], texel[4] = scale * (g[4] - b * g[3]), scale * (g[7] - b * g[6])
    texel[5] = texels_per_m * pose.v + scale * (dy - b * dx)
    out.tag[q, BODY] = 0


class Fleet:
    """All models of vehicles and people of a world, ready to be placed.

    Args:
        world: whose models and sun are used.
        shadows: whether they throw sun shadows.

    Attributes:
        size_m: ``(models, 3)`` length, width, height.
    """

    def __init__(self, world: World, shadows: bool) -> None:
        self._numbers = {name: number for number, name in enumerate(world.vehicles)}
        self._people = {name: len(world.vehicles) + (PHASES + 1) * n for n, name in enumerate(world.people)}
        poses = [mesh for meshes in world.people.values() for mesh in meshes]
        patches = packed([*world.vehicles.values(), *poses], world.sun)
        self._counts = np.diff(patches.group_start) + _SWEEPS * shadows
        kinds = [VEHICLE_KINDS[kind] for kind, _ in world.vehicles]
        sizes = [(k.length_m, k.width_m, k.height_m) for k in kinds]
        sizes += [PEOPLE_KINDS[kind] for kind, _ in world.people for _ in range(PHASES + 1)]
        self.size_m = np.array(sizes).reshape(-1, 3)
        self._models = Models(patches, self.size_m, world.sun, float(world.ground_texels_per_m), bool(shadows))

    def models(self, vehicles: Sequence[VehicleState], people: Sequence[PersonState] = ()) -> NDArray[np.int64]:
        """Number of each vehicle's model, then of each person's."""
        numbers = [self._numbers[v.kind, v.colour] for v in vehicles]
        return np.array(numbers + [self._people[p.kind, p.look] + p.pose for p in people], np.int64)

    def placed(
        self,
        models: NDArray[np.int64],
        states: NDArray[np.float64],
        seen_by: tuple[View, tuple[int, int]] | None = None,
    ) -> PatchSet:
        """Patches of vehicles and people, one group each; number i is rigid body i + 1.

        Args:
            models: ``(n,)`` numbers.
            states: of ``moving_states``.
            seen_by: camera, and height and width of its picture; groups that it cannot show stay empty.
        """
        groups = _bounds(states, models, self._models)
        wanted = np.ones(len(states), np.bool_) if seen_by is None else spheres_in_view(groups, *seen_by)
        total = int(self._counts[models[wanted]].sum())
        patches = PatchSet(
            geometry=np.empty((total, 9)),
            texel=np.empty((total, 6)),
            look=np.empty((total, 13), np.float32),
            tag=np.empty((total, 4), np.int32),
            groups=groups,
            group_start=np.empty(len(states) + 1, np.int64),
        )
        _place(states, models, wanted, self._models, patches)
        return patches


def moving_states(
    vehicles: Sequence[VehicleState],
    people: Sequence[PersonState] = (),
    underpasses: Float64s | None = None,
    land: Land = FLAT,
) -> NDArray[np.float64]:
    """Where everybody is, vehicles first, and the ground below.

    Returns:
        ``(n, 13)``, columns as named above: x and y [m], yaw [rad], speed [m/s], yaw rate [rad/s], height of what they
        stand on [m], slope of the ground along x and y, place on the street grid [m], the grid's dx/dv and dy/du there,
        and the share of the sky's light, which is less than 1 in ``underpasses``.
    """
    states = [(v.x_m, v.y_m, v.yaw_rad, v.speed_mps, v.yaw_rate_radps, 0.0) for v in vehicles]
    states += [(p.x_m, p.y_m, p.yaw_rad, p.speed_mps, 0.0, p.z_m) for p in people]
    known = np.array(states, np.float64).reshape(-1, 6)
    ground = land.below(known)
    known[:, HEIGHT] += ground[:, 0]
    light = np.ones(len(known)) if underpasses is None else light_at(underpasses, ground[:, 3], ground[:, 4])
    return np.column_stack([known, ground[:, 1:], light])


@compiled_unchecked
def body_motions(states: Float64s, dt_s: float) -> tuple[Float64s, Float64s]:
    """Motions of the map frame that carry the rigid bodies ``dt_s`` seconds on: the world, which stands, and vehicles.

    Args:
        states: of ``moving_states``.
        dt_s: seconds.

    Returns:
        Rotations ``(1 + n, 3, 3)`` and translations ``(1 + n, 3)``.
    """
    turns, shifts = np.zeros((1 + len(states), 3, 3)), np.zeros((1 + len(states), 3))
    turns[0, 0, 0] = turns[0, 1, 1] = turns[0, 2, 2] = 1.0
    for n in range(1, 1 + len(states)):
        state = states[n - 1]
        x, y, yaw, speed, yaw_rate = state[X], state[Y], state[YAW], state[SPEED], state[YAW_RATE]
        c, s = np.cos(yaw_rate * dt_s), np.sin(yaw_rate * dt_s)
        turns[n, 0, 0], turns[n, 0, 1], turns[n, 1, 0], turns[n, 1, 1], turns[n, 2, 2] = c, -s, s, c, 1.0
        shifts[n, 0] = x + speed * dt_s * np.cos(yaw) - (c * x - s * y)
        shifts[n, 1] = y + speed * dt_s * np.sin(yaw) - (s * x + c * y)
        shifts[n, 2] = speed * dt_s * (state[RISE_X] * np.cos(yaw) + state[RISE_Y] * np.sin(yaw))
    return turns, shifts
