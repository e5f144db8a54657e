"""Moving vehicles as patches, put anew into every picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked
from mixo_env.simulator.mesh import CUT_OUT, SHADE, TWO_SIDED, PatchSet, packed
from mixo_env.simulator.vehicles import VEHICLE_KINDS, VehicleState
from mixo_env.simulator.world import World

_SWEEPS = 3
_SHADE, _BOTH = SHADE, TWO_SIDED | CUT_OUT


@compiled_unchecked
def _place(states, models, size, source, target, texels_per_m, sun, shadows):
    """Copy the models named in ``models`` to their ``states`` (x, y, yaw); see :class:`Fleet`."""
    start, geometry, texel, look, tag, spheres = source
    out_start, out_geometry, out_texel, out_look, out_tag, out_spheres = target
    q = under = 0
    for n in range(states.shape[0]):
        x, y, m = states[n, 0], states[n, 1], models[n]
        c, s = np.cos(states[n, 2]), np.sin(states[n, 2])
        out_start[n] = q
        out_spheres[n, 0] = x + c * spheres[m, 0] - s * spheres[m, 1]
        out_spheres[n, 1] = y + s * spheres[m, 0] + c * spheres[m, 1]
        out_spheres[n, 2] = spheres[m, 2]
        out_spheres[n, 3] = spheres[m, 3]
        for p in range(start[m], start[m + 1]):
            for e in range(0, 9, 3):
                gx, gy = geometry[p, e], geometry[p, e + 1]
                out_geometry[q, e], out_geometry[q, e + 1] = c * gx - s * gy, s * gx + c * gy
                out_geometry[q, e + 2] = geometry[p, e + 2]
            out_geometry[q, 0] += x
            out_geometry[q, 1] += y
            out_texel[q], out_look[q], out_tag[q] = texel[p], look[p], tag[p]
            nx, ny, nz = c * look[p, 10] - s * look[p, 11], s * look[p, 10] + c * look[p, 11], look[p, 12]
            facing = nx * sun[0] + ny * sun[1] + nz * sun[2]
            if facing < 0.0 and tag[p, 0] & _BOTH != 0:
                facing, nx, ny, nz = -facing, -nx, -ny, -nz
            out_look[q, 9], out_look[q, 10], out_look[q, 11], out_look[q, 12] = max(facing, 0.0), nx, ny, nz
            out_tag[q, 3] = n + 1
            if tag[p, 1] == _SHADE:
                _lay(out_geometry, out_texel, out_tag, q, texels_per_m)
                under = p
            q += 1
        if shadows:
            # The sun shadow of a box is its plan swept along the ground: the plan where it ends, two parallelograms.
            # A box a little smaller than the body's outer size, which rounded bodies do not fill.
            length, width, tall = 0.96 * size[m, 0], 0.96 * size[m, 1], 0.85 * size[m, 2]
            rx, ry = -tall * sun[0] / sun[2], -tall * sun[1] / sun[2]
            ux, uy, vx, vy = c * length, s * length, s * width, -c * width  # along the vehicle and to its right
            cx, cy = x - 0.5 * (ux + vx), y - 0.5 * (uy + vy)  # rear left corner
            ahead, aside = c * rx + s * ry > 0.0, s * rx - c * ry > 0.0
            for k in range(_SWEEPS):
                out_texel[q], out_look[q], out_tag[q] = texel[under], look[under], tag[under]
                for j in range(3):
                    out_look[q, j] = 1.0
                out_tag[q, 0] = TWO_SIDED
                g = out_geometry[q]
                g[2], g[5], g[8] = 0.01, 0.0, 0.0
                if k == 0:
                    g[0], g[1], g[3], g[4], g[6], g[7] = cx + rx, cy + ry, ux, uy, vx, vy
                elif k == 1:
                    g[0], g[1], g[3], g[4], g[6], g[7] = cx, cy, ux, uy, rx, ry
                    if aside:
                        g[0] += vx
                        g[1] += vy
                else:
                    g[0], g[1], g[3], g[4], g[6], g[7] = cx, cy, vx, vy, rx, ry
                    if ahead:
                        g[0] += ux
                        g[1] += uy
                _lay(out_geometry, out_texel, out_tag, q, texels_per_m)
                q += 1
            out_spheres[n, 3] += np.sqrt(rx * rx + ry * ry)
    out_start[states.shape[0]] = q


@compiled_unchecked
def _lay(geometry, texel, tag, q, texels_per_m):
    """Give patch ``q`` the texture of the ground below it; what lies on the ground does not move with the vehicle."""
    g = geometry[q]
    texel[q, 0], texel[q, 1], texel[q, 2] = texels_per_m * g[3], texels_per_m * g[6], texels_per_m * g[0]
    texel[q, 3], texel[q, 4], texel[q, 5] = texels_per_m * g[4], texels_per_m * g[7], texels_per_m * g[1]
    tag[q, 3] = 0


class Fleet:
    """All vehicle models of a world, ready to be placed.

    Args:
        world: whose models and sun are used.
        shadows: whether vehicles throw sun shadows.

    Attributes:
        size_m: ``(models, 3)`` length, width, height.
    """

    def __init__(self, world: World, shadows: bool) -> None:
        self._numbers = {name: number for number, name in enumerate(world.vehicles)}
        models = packed(list(world.vehicles.values()), world.sun)
        self._source = (models.group_start, models.geometry, models.texel, models.look, models.tag, models.groups)
        self._counts = np.diff(models.group_start) + _SWEEPS * shadows
        kinds = [VEHICLE_KINDS[kind] for kind, _ in world.vehicles]
        self.size_m = np.array([(k.length_m, k.width_m, k.height_m) for k in kinds]).reshape(-1, 3)
        self._world, self._shadows = world, shadows

    def models(self, vehicles: Sequence[VehicleState]) -> NDArray[np.int64]:
        """Number of each vehicle's model."""
        return np.array([self._numbers[v.kind, v.colour] for v in vehicles], np.int64)

    def placed(self, models: NDArray[np.int64], states: NDArray[np.float64]) -> PatchSet:
        """Patches of the vehicles, one group each; vehicle i is rigid body i + 1.

        Args:
            models: ``(n,)`` numbers.
            states: of ``moving_states``.
        """
        total = int(self._counts[models].sum())
        patches = PatchSet(
            geometry=np.empty((total, 9)),
            texel=np.empty((total, 6)),
            look=np.empty((total, 13), np.float32),
            tag=np.empty((total, 4), np.int32),
            groups=np.empty((len(states), 4)),
            group_start=np.empty(len(states) + 1, np.int64),
        )
        target = (patches.group_start, patches.geometry, patches.texel, patches.look, patches.tag, patches.groups)
        _place(
            states,
            models,
            self.size_m,
            self._source,
            target,
            self._world.ground_texels_per_m,
            self._world.sun,
            self._shadows,
        )
        return patches


def moving_states(vehicles: Sequence[VehicleState]) -> NDArray[np.float64]:
    """``(n, 5)`` x and y [m], yaw [rad], speed [m/s] and yaw rate [rad/s], one row a vehicle."""
    states = [(v.x_m, v.y_m, v.yaw_rad, v.speed_mps, v.yaw_rate_radps) for v in vehicles]
    return np.array(states, np.float64).reshape(-1, 5)


@compiled_unchecked
def body_motions(states, dt_s):
    """Motions of the map frame that carry the rigid bodies ``dt_s`` seconds on: the world, which stands, and vehicles.

    Args:
        states: of ``moving_states``.
        dt_s: seconds.

    Returns:
        Rotations ``(1 + n, 3, 3)`` and translations ``(1 + n, 3)``.
    """
    turns, shifts = np.zeros((1 + len(states), 3, 3)), np.zeros((1 + len(states), 3))
    turns[0, 0, 0] = turns[0, 1, 1] = turns[0, 2, 2] = 1.0
    for n, (x, y, yaw, speed, yaw_rate) in enumerate(states, 1):
        c, s = np.cos(yaw_rate * dt_s), np.sin(yaw_rate * dt_s)
        turns[n, 0, 0], turns[n, 0, 1], turns[n, 1, 0], turns[n, 1, 1], turns[n, 2, 2] = c, -s, s, c, 1.0
        shifts[n, 0] = x + speed * dt_s * np.cos(yaw) - (c * x - s * y)
        shifts[n, 1] = y + speed * dt_s * np.sin(yaw) - (s * x + c * y)
    return turns, shifts
