"""One step of all cameras: iteratively reweighted least squares over the motion of one body (compiled).

Unknowns: yaw rate at three knots [rad/s]; pitch and roll rate [rad/s], slip and heave share [rad] of the body; then for
every camera its own yaw error over its window [rad], slip and heave share of its mounting [rad], mean inverse depth
[1/m]. Each camera's six unknowns of ``monocular/refine.py`` are linear in them, so the normal equations of its matches
are those of the single camera, mapped.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.experts.monocular.depths import Matches, Mounting, least_inverse_depths
from mixo_env.experts.monocular.refine import Equations, match_equations, robust_noise

FloatArray = NDArray[np.float64]

BODY = 7
"""Unknowns of the body; four of every camera follow."""

OWN = 4

OPTIMISM = 1.4
"""Real errors over those of independent noise, as in ``monocular/motion.py``."""

_ITERATIONS = 8
_WIDE = 3.0
_SETTLED = 3
"""The first iteration whose noise is near enough to its end to tell how much a camera's matches know."""

_LARGEST_STEP_RAD = 0.02


class Views(NamedTuple):
    """What the cameras of a step see, one after another.

    Attributes:
        first, second: ``(n, 2)`` matches of all cameras.
        start: ``(m + 1,)`` int, where those of each camera begin.
        rotation: ``(m, 3, 3)`` ego from camera.
        position: ``(m, 3)`` of the camera [m].
        distance: ``(m,)`` travelled over its window [m], not 0.
        noise: ``(m,)`` expected position noise.
        local: ``(m, 6, N)`` its six unknowns from all.
        alone: ``(m, 6)`` information on each of the six when the camera is alone.
    """

    first: FloatArray
    second: FloatArray
    start: NDArray[np.int64]
    rotation: FloatArray
    position: FloatArray
    distance: FloatArray
    noise: FloatArray
    local: FloatArray
    alone: FloatArray


class Solved(NamedTuple):
    """What solving gives.

    Attributes:
        unknowns: ``(N,)``.
        covariance: ``(N, N)``.
        noise: ``(m,)`` estimated.
        residual: ``(n,)`` across the epipolar lines, inf where a match is impossible.
        formal: ``(m,)`` standard deviation of the yaw of each camera alone [rad].
    """

    unknowns: FloatArray
    covariance: FloatArray
    noise: FloatArray
    residual: FloatArray
    formal: FloatArray


@compiled
def solve_step(
    views: Views, start: FloatArray, mean: FloatArray, information: FloatArray, own: tuple[float, float, float]
) -> Solved:
    """Solve a step.

    Args:
        views: of the cameras.
        start: ``(N,)`` where to begin.
        mean: ``(N,)`` of the prior.
        information: ``(N, N)`` of the prior; that on the cameras' own yaw errors is added here.
        own: their least standard deviation [rad], the share of ``formal``, degrees of freedom.
    """
    cameras = len(views.distance)
    x, sigma = start.copy(), _WIDE * views.noise
    residual, across = np.empty(len(views.first)), np.empty(len(views.first))
    least = np.empty(len(views.first))
    for j in range(cameras):
        a, b = views.start[j], views.start[j + 1]
        least[a:b] = least_inverse_depths(views.second[a:b], Mounting(views.rotation[j], views.position[j]))
    equations = Equations(np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros(6))
    formal = np.zeros(cameras)
    h, g = information.copy(), np.zeros(len(x))
    for iteration in range(_ITERATIONS):
        h[:], g[:] = information, information @ (x - mean)
        for j in range(cameras):
            a, b = views.start[j], views.start[j + 1]
            mounting = Mounting(views.rotation[j], views.position[j])
            local = views.local[j]
            match_equations(
                Matches(views.first[a:b], views.second[a:b]),
                least[a:b],
                mounting,
                local @ x,
                views.distance[j],
                sigma[j],
                (residual[a:b], across[a:b]),
                equations,
            )
            scale = 1.0 / (OPTIMISM * sigma[j]) ** 2
            h += local.T @ (scale * (equations.h @ local))
            g += local.T @ (scale * equations.g)
            if iteration >= _SETTLED:
                formal[j] = math.sqrt(np.linalg.inv(scale * equations.h + np.diag(views.alone[j]))[0, 0])
            at = BODY + OWN * j
            std = math.hypot(own[0], own[1] * formal[j])
            weight = (own[2] + 1.0) / (own[2] + (x[at] / std) ** 2) / std**2
            h[at, at] += weight
            g[at] += weight * x[at]
            sigma[j] = robust_noise(residual[a:b], across[a:b], sigma[j], views.noise[j])
        step = np.linalg.solve(h, g)
        largest = 0.0
        for j in range(cameras):
            largest = max(largest, np.abs((views.local[j] @ step)[:3]).max() / _LARGEST_STEP_RAD)
        x -= step / max(largest, 1.0)
    return Solved(x, np.linalg.inv(h).astype(np.float64), sigma, residual, formal)
