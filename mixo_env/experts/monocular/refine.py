"""Refinement of a motion: six unknowns by iteratively reweighted least squares with priors (model: motion.py).

Unknowns: yaw, pitch, roll [rad], slip, heave [m], mean inverse depth of the matches [1/m].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.experts.monocular.depths import MAX_INVERSE_DEPTH, FloatArray, Matches, Mounting, least_inverse_depths
from mixo_env.experts.monocular.kinematics import camera_displacement, never_zero, tilted_rotation
from mixo_env.geometry import MAD_TO_SIGMA

_MEAN_INVERSE_DEPTH = 0.06
"""[1/m] Of street scenes: ground and fronts at 5 to 50 m."""

_SPREAD_INVERSE_DEPTH = 0.06
"""[1/m] Standard deviation of it: anything from infinity to a few metres is common."""

_DEPTH_SAMPLES = 20.0
"""Depths of neighbouring points are alike: all matches together count as so many."""

_SEVERITY = 0.6
"""Of the redescending weights: matches of movers and along weak edges err little but all the same way."""

_SEVERITY_ALONG = 0.25
"""The same along the lines, where the depth may differ from the mean without the match being wrong."""

_ROOT = math.sqrt(0.5)
"""The transfer error from the second image to the first is the difference of two positions, each with the noise."""

_EPS = 1e-6
"""Step of numerical derivatives [rad]: half of a double's digits, and bends are far slower than this."""

_NO_LINE = 1e-12
"""Keeps a match at the epipole, which has no epipolar direction, from dividing by zero; far below any noise."""

_NEAREST_Z = 0.05
"""A ray this far off the other camera's axis is (nearly) behind it."""

_WIDE = 3.0
"""Noise assumed at first, over the expected: wide, so that a coarse start finds its way."""

_BEYOND = 4.0
"""Standard deviations by which a match may exceed the limits of its depth."""

_LEAST_REACH = 1e-9
"""Camera displacement below which a match says nothing about its depth."""

_LARGEST_STEP_RAD = 0.02
"""Angles change by no more in one iteration: beyond a degree the linearisation misleads."""

_WRONG = 5.0
"""Residuals of more standard deviations are plainly wrong and not part of the estimated noise."""

_LEAST_SCALED = 10
"""A median of no more residuals is no estimate: the noise stays as it was."""

_LEAST_NOISE, _MOST_NOISE = 0.1, 2.0
"""Bounds of the estimated noise over the expected: a vehicle's few points may agree too well, a blurred image not."""

_SHRINK = 0.6
"""The noise falls to no less than this share in one iteration, so that the weights follow the motion, not lead it."""

_RIDGE = 1e-12
"""Keeps the equations solvable where neither matches nor prior tell the yaw."""


class Expected(NamedTuple):
    """Prior of the kernel: ``MotionPrior`` with the sideways motions in metres.

    Attributes:
        distance: travelled [m].
        noise: position noise on the image plane; the scale is then estimated from the residuals.
        yaw: mean of the yaw increment [rad].
        yaw_std: its standard deviation [rad], may be infinite.
        tilt_std: of pitch and roll [rad].
        offset: ``(2,)`` mean of slip and heave [m].
        offset_std: ``(2,)`` their standard deviation [m].
    """

    distance: float
    noise: float
    yaw: float
    yaw_std: float
    tilt_std: float
    offset: FloatArray
    offset_std: FloatArray


class Refined(NamedTuple):
    """What refining gives.

    Attributes:
        unknowns: ``(6,)``.
        covariance: ``(6, 6)``.
        noise: estimated position noise on the image plane.
        residual: ``(n,)`` across the epipolar lines; inf where the match contradicts the motion along its line: behind
            the camera, absurdly near or under the road.
    """

    unknowns: FloatArray
    covariance: NDArray[np.floating]
    noise: float
    residual: FloatArray


class _Linearised(NamedTuple):
    """Camera motion in first camera axes and its rates: what all matches share in an iteration.

    Attributes:
        rotation: ``(3, 3)`` first from second camera.
        rates: ``(3, 3, 3)`` of the rotation with yaw, pitch, roll.
        displacement: ``(3,)`` of the camera [m].
        yaw_rate: ``(3,)`` of the displacement with yaw.
        axes: ``(3, 3)`` camera from ego: columns 1 and 2 are the rates of the displacement with slip and heave.
    """

    rotation: FloatArray
    rates: FloatArray
    displacement: FloatArray
    yaw_rate: FloatArray
    axes: FloatArray


class _Transfer(NamedTuple):
    """One match: error y of the transfer at infinity, direction e of its epipolar line, and y split along e.

    Attributes:
        z: depth of the second ray in the first camera, over its depth in the second.
        iz: 1 / z.
        y0, y1: position in the first image less where a point at infinity would be.
        e0, e1: unit vector of d(image 1)/d(inverse depth).
        along: y along e.
        across: y across e, over sqrt(2): one position's noise.
        reach: how far a unit of inverse depth moves the point.
    """

    z: float
    iz: float
    y0: float
    y1: float
    e0: float
    e1: float
    along: float
    across: float
    reach: float


class Equations(NamedTuple):
    """Normal equations ``h (6, 6) step = g (6,)``, and rows of the Jacobian ``(6,)`` of one match to work in."""

    h: FloatArray
    g: FloatArray
    across: FloatArray
    along: FloatArray


@compiled
def _linearise(x: FloatArray, s: float, mounting: Mounting) -> _Linearised:
    """About unknowns ``x``, with distance ``s`` [m], not 0."""
    rotation, position = mounting
    c_t = np.ascontiguousarray(rotation.T)
    tx, ty = camera_displacement(x[0], s, position[0], position[1])
    qx, qy = camera_displacement(x[0] + _EPS, s, position[0], position[1])
    r0 = tilted_rotation(x[0], x[1], x[2])
    rates = np.empty((3, 3, 3))
    rates[0] = c_t @ ((tilted_rotation(x[0] + _EPS, x[1], x[2]) - r0) / _EPS) @ rotation
    rates[1] = c_t @ ((tilted_rotation(x[0], x[1] + _EPS, x[2]) - r0) / _EPS) @ rotation
    rates[2] = c_t @ ((tilted_rotation(x[0], x[1], x[2] + _EPS) - r0) / _EPS) @ rotation
    return _Linearised(
        c_t @ r0 @ rotation,
        rates,
        c_t @ np.array([tx, ty + x[3], x[4]]),
        c_t @ np.array([(qx - tx) / _EPS, (qy - ty) / _EPS, 0.0]),
        c_t,
    )


@compiled
def _transfer(a: float, b: float, u: float, v: float, m: FloatArray, t: FloatArray) -> _Transfer:
    """Of the match (a, b) - (u, v) under rotation ``m`` and displacement ``t``."""
    z = m[2, 0] * u + m[2, 1] * v + m[2, 2]
    iz = 1.0 / z
    y0 = a - (m[0, 0] * u + m[0, 1] * v + m[0, 2]) * iz
    y1 = b - (m[1, 0] * u + m[1, 1] * v + m[1, 2]) * iz
    w0, w1 = t[0] - a * t[2], t[1] - b * t[2]
    length = math.sqrt(w0 * w0 + w1 * w1) + _NO_LINE
    e0, e1 = w0 / length, w1 / length
    return _Transfer(z, iz, y0, y1, e0, e1, y0 * e0 + y1 * e1, _ROOT * (y0 * e1 - y1 * e0), length * iz)


@compiled
def _impossible(seen: _Transfer, least: float, sigma: float) -> bool:
    """The match contradicts the motion along its line."""
    along, reach = seen.along, seen.reach
    excess = max(least * reach - along, along - MAX_INVERSE_DEPTH * reach) - _BEYOND * sigma
    return seen.z < _NEAREST_Z or excess > 0.0


@compiled
def _differentiate(
    point: tuple[float, float, float, float], seen: _Transfer, rho: float, about: _Linearised, rows: Equations
) -> None:
    """Overwrite both Jacobian rows of a match ``point`` (a, b, u, v) with inverse depth ``rho``."""
    a, b, u, v = point
    iz, e0, e1 = seen.iz, seen.e0, seen.e1
    d = about.rates
    for k in range(3):
        dz = d[k, 2, 0] * u + d[k, 2, 1] * v + d[k, 2, 2]
        dy0 = ((a - seen.y0) * dz - (d[k, 0, 0] * u + d[k, 0, 1] * v + d[k, 0, 2])) * iz
        dy1 = ((b - seen.y1) * dz - (d[k, 1, 0] * u + d[k, 1, 1] * v + d[k, 1, 2])) * iz
        rows.across[k] = _ROOT * (dy0 * e1 - dy1 * e0)
        rows.along[k] = _ROOT * (dy0 * e0 + dy1 * e1)
    # d(across)/dt = rho (e x dw): translation matters as much as the point is near
    scale = _ROOT * rho * iz
    dw0, dw1 = about.yaw_rate[0] - a * about.yaw_rate[2], about.yaw_rate[1] - b * about.yaw_rate[2]
    rows.across[0] += scale * (e0 * dw1 - e1 * dw0)
    c_t = about.axes
    for k in range(3, 5):
        dw0, dw1 = c_t[0, k - 2] - a * c_t[2, k - 2], c_t[1, k - 2] - b * c_t[2, k - 2]
        rows.across[k] = scale * (e0 * dw1 - e1 * dw0)
    rows.along[5] = -_ROOT * seen.reach


@compiled
def _add_matches(
    matches: Matches,
    least: FloatArray,
    about: _Linearised,
    mean: float,
    sigma: float,
    residual: tuple[FloatArray, FloatArray],
    equations: Equations,
) -> None:
    """Overwrite the normal equations (lower half) with those of all matches that are possible.

    Args:
        matches: of the pair.
        least: ``(n,)`` least inverse depths.
        about: the motion so far.
        mean: inverse depth of the matches so far.
        sigma: position noise so far.
        residual: ``(n,)`` as in ``Refined``, and ``(n,)`` across the lines for all matches; both overwritten.
        equations: overwritten.
    """
    first, second = matches
    h, g, jac, jal = equations
    h[:], g[:] = 0.0, 0.0
    n = len(first)
    depth_variance = 0.5 * _SPREAD_INVERSE_DEPTH**2 * max(1.0, n / _DEPTH_SAMPLES)
    for i in range(n):
        point = first[i, 0], first[i, 1], second[i, 0], second[i, 1]
        seen = _transfer(point[0], point[1], point[2], point[3], about.rotation, about.displacement)
        r, reach = seen.across, seen.reach
        residual[1][i] = r
        if _impossible(seen, least[i], sigma):
            residual[0][i] = np.inf
            continue
        residual[0][i] = r
        q = r / sigma
        weight = 1.0 / (1.0 + _SEVERITY * q * q) ** 2
        rho = seen.along / reach if reach > _LEAST_REACH else 0.0
        variance = sigma * sigma + reach * reach * depth_variance
        ra = _ROOT * seen.along - _ROOT * mean * reach
        weight_along = weight * sigma * sigma / variance / (1.0 + _SEVERITY_ALONG * (ra * ra / variance)) ** 2
        _differentiate(point, seen, min(max(rho, 0.0), MAX_INVERSE_DEPTH), about, equations)
        for k in range(6):
            g[k] += weight * jac[k] * r + weight_along * jal[k] * ra
            for j in range(k + 1):
                h[k, j] += weight * jac[k] * jac[j] + weight_along * jal[k] * jal[j]


@compiled
def match_equations(
    matches: Matches,
    least: FloatArray,
    mounting: Mounting,
    x: FloatArray,
    distance: float,
    sigma: float,
    residual: tuple[FloatArray, FloatArray],
    equations: Equations,
) -> None:
    """Overwrite the normal equations, both halves, with those of one pair without any prior, for a sum over cameras.

    Args:
        matches: of the pair.
        least: ``(n,)`` least inverse depths.
        mounting: of the camera.
        x: ``(6,)`` unknowns so far.
        distance: travelled [m], not 0.
        sigma: position noise so far.
        residual: ``(n,)`` as in ``Refined``, and ``(n,)`` across the lines for all matches; both overwritten.
        equations: overwritten.
    """
    _add_matches(matches, least, _linearise(x, distance, mounting), x[5], sigma, residual, equations)
    for k in range(6):
        for j in range(k):
            equations.h[j, k] = equations.h[k, j]


@compiled
def _add_priors(h: FloatArray, g: FloatArray, x: FloatArray, variance: float, expected: Expected) -> None:
    """Complete the normal equations: their upper half, and the priors against noise of this ``variance``."""
    for k in range(6):
        for j in range(k):
            h[j, k] = h[k, j]
    h[0, 0] += variance / expected.yaw_std**2
    g[0] += variance / expected.yaw_std**2 * (x[0] - expected.yaw)
    for k in range(1, 3):
        h[k, k] += variance / expected.tilt_std**2
        g[k] += variance / expected.tilt_std**2 * x[k]
    for k in range(3, 5):
        h[k, k] += variance / expected.offset_std[k - 3] ** 2
        g[k] += variance / expected.offset_std[k - 3] ** 2 * (x[k] - expected.offset[k - 3])
    h[5, 5] += variance / _SPREAD_INVERSE_DEPTH**2
    g[5] += variance / _SPREAD_INVERSE_DEPTH**2 * (x[5] - _MEAN_INVERSE_DEPTH)
    h[0, 0] += _RIDGE


@compiled
def robust_noise(residual: FloatArray, across: FloatArray, sigma: float, noise: float) -> float:
    """Robust noise of the matches that are not plainly wrong, given the last one and the one expected."""
    near = np.abs(across[np.isfinite(residual) & (np.abs(across) < _WRONG * sigma)])
    if near.size > _LEAST_SCALED:
        robust = min(max(MAD_TO_SIGMA * np.median(near), _LEAST_NOISE * noise), _MOST_NOISE * noise)
        return max(robust, _SHRINK * sigma)
    return sigma


@compiled
def refine_motion(matches: Matches, mounting: Mounting, expected: Expected, yaw: float, iterations: int) -> Refined:
    """Refine yaw, pitch, roll, slip, heave and mean inverse depth together, robustly.

    Args:
        matches: of the pair.
        mounting: of the camera.
        expected: what was known before.
        yaw: start value [rad].
        iterations: reweighting steps, at least one.
    """
    n = len(matches.first)
    s = never_zero(expected.distance)
    x = np.array([yaw, 0.0, 0.0, 0.0, 0.0, _MEAN_INVERSE_DEPTH])
    least = least_inverse_depths(matches.second, mounting)
    residual, across = np.empty(n), np.empty(n)
    sigma = _WIDE * expected.noise
    equations = Equations(np.zeros((6, 6)), np.zeros(6), np.zeros(6), np.zeros(6))
    for _ in range(iterations):
        about = _linearise(x, s, mounting)
        _add_matches(matches, least, about, x[5], sigma, (residual, across), equations)
        _add_priors(equations.h, equations.g, x, sigma * sigma, expected)
        step = np.linalg.solve(equations.h, equations.g)
        largest = max(abs(step[0]), abs(step[1]), abs(step[2])) / _LARGEST_STEP_RAD
        if largest > 1.0:
            step /= largest
        x -= step
        sigma = robust_noise(residual, across, sigma, expected.noise)
    about = _linearise(x, s, mounting)
    first, second = matches
    for i in range(n):
        seen = _transfer(first[i, 0], first[i, 1], second[i, 0], second[i, 1], about.rotation, about.displacement)
        residual[i] = np.inf if _impossible(seen, least[i], sigma) else seen.across
    return Refined(x, np.linalg.inv(equations.h) * sigma * sigma, sigma, residual)
