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

_INLIER_STD = 3.0
"""As in monocular/motion.py."""


class Views(NamedTuple):
    """What the cameras of a step see, one after another.

    Attributes:
        first, second: ``(n, 2)`` matches of all cameras.
        start: ``(m + 1,)`` int, where those of each camera begin.
        rotation: ``(m, 3, 3)`` ego from camera.
        position: ``(m, 3)`` of the camera [m].
        distance: ``(m,)`` travelled over its window [m], not 0.
        noise: ``(m,)`` expected position noise.
        local: ``(m, 6, BODY + OWN)`` its six unknowns from those of the body and its own.
        alone: ``(m, 6)`` information on each of the six when the camera is alone.
        doubt: ``(m,)`` the expected yaw error of its own is so many times as large as usual.
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
    doubt: FloatArray


class Solved(NamedTuple):
    """What solving gives.

    Attributes:
        unknowns: ``(N,)``.
        covariance: ``(N, N)``.
        noise: ``(m,)`` estimated.
        residual: ``(n,)`` across the epipolar lines, inf where a match is impossible.
        agree: ``(n,)`` matches that agree with the solution.
        support: ``(m,)`` share of each camera's matches that do.
        formal: ``(m,)`` standard deviation of the yaw of each camera alone [rad].
    """

    unknowns: FloatArray
    covariance: FloatArray
    noise: FloatArray
    residual: FloatArray
    agree: NDArray[np.bool_]
    support: FloatArray
    formal: FloatArray


@compiled
def _add(h: FloatArray, g: FloatArray, own: int, local: FloatArray, scale: float, equations: Equations) -> None:
    """Map the equations of a camera's six unknowns to those of the body and its own, which begin at ``own``."""
    mapped = np.zeros((6, BODY + OWN))
    for a in range(6):
        for b in range(6):
            for k in range(BODY + OWN):
                mapped[a, k] += equations.h[a, b] * local[b, k]
    for j in range(BODY + OWN):
        row = j if j < BODY else own + j - BODY
        for a in range(6):
            if local[a, j] == 0.0:
                continue
            factor = scale * local[a, j]
            g[row] += factor * equations.g[a]
            for k in range(BODY):
                h[row, k] += factor * mapped[a, k]
            for k in range(OWN):
                h[row, own + k] += factor * mapped[a, BODY + k]


@compiled
def _alone(h: FloatArray, scale: float, prior: FloatArray) -> float:
    """Standard deviation of the first of six unknowns, from their equations and independent priors."""
    a = scale * h
    for k in range(6):
        a[k, k] += prior[k]
    for k in range(5, 0, -1):  # eliminate the last unknown, one after another
        for i in range(k):
            factor = a[i, k] / a[k, k]
            for j in range(k):
                a[i, j] -= factor * a[k, j]
    return math.sqrt(1.0 / a[0, 0])


@compiled
def _agreeing(
    start: NDArray[np.int64], residual: FloatArray, sigma: FloatArray
) -> tuple[NDArray[np.bool_], FloatArray]:
    """``agree`` and ``support`` of :class:`Solved`."""
    agree, support = np.empty(len(residual), np.bool_), np.empty(len(sigma))
    for j in range(len(sigma)):
        a, b = start[j], start[j + 1]
        agree[a:b] = np.abs(residual[a:b]) < _INLIER_STD * sigma[j]
        support[j] = np.mean(agree[a:b])
    return agree, support


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
            at = BODY + OWN * j
            here = views.local[j] @ np.concatenate((x[:BODY], x[at : at + OWN]))
            match_equations(
                Matches(views.first[a:b], views.second[a:b]),
                least[a:b],
                mounting,
                here,
                views.distance[j],
                sigma[j],
                (residual[a:b], across[a:b]),
                equations,
            )
            scale = 1.0 / (OPTIMISM * sigma[j]) ** 2
            _add(h, g, at, views.local[j], scale, equations)
            if iteration >= _SETTLED:
                formal[j] = _alone(equations.h, scale, views.alone[j])
            std = views.doubt[j] * math.hypot(own[0], own[1] * formal[j])
            weight = (own[2] + 1.0) / (own[2] + (x[at] / std) ** 2) / std**2
            h[at, at] += weight
            g[at] += weight * x[at]
            sigma[j] = robust_noise(residual[a:b], across[a:b], sigma[j], views.noise[j])
        step = np.linalg.solve(h, g)
        largest = 0.0
        for j in range(cameras):
            at = BODY + OWN * j
            turned = views.local[j] @ np.concatenate((step[:BODY], step[at : at + OWN]))
            largest = max(largest, np.abs(turned[:3]).max() / _LARGEST_STEP_RAD)
        x -= step / max(largest, 1.0)
    agree, support = _agreeing(views.start, residual, sigma)
    return Solved(x, np.linalg.inv(h).astype(np.float64), sigma, residual, agree, support, formal)
