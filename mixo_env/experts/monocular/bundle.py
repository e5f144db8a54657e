"""Local bundle adjustment of three consecutive images: how much more or less the car turns from pair to pair.

Two images of a side view tell yaw only across their epipolar lines, since every shift along them may be depth. A third
image of the same points has no such freedom: once the motion between the first two gives each point its depth, where it
must appear next depends on the next motion alone. Along the epipolar lines the *change* of the yaw increment is so seen
several times better than either increment across them, even where traffic fills the view: what moves evenly past
changes its place evenly.

The points are eliminated rather than kept (light bundle adjustment: Indelman et al., BMVC 2012): of each, only the
error along the line remains, with the noise of both pairs. Jacobians are taken at the depth that suits both pairs
best; at the depth of the first pair alone, its noise would bias the turn (regression dilution). The first motion is
held: an error of its yaw is an error of the second yaw too, and cancels in the change.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.experts.monocular.camera import MountedCamera
from mixo_env.experts.monocular.depths import MAX_INVERSE_DEPTH, Mounting
from mixo_env.experts.monocular.kinematics import camera_motion, never_zero
from mixo_env.experts.monocular.motion import Motion, MotionPrior
from mixo_env.experts.monocular.pair import Pair
from mixo_env.geometry import MAD_TO_SIGMA

FloatArray = NDArray[np.float64]

_SHORTEST_M = 0.1  # a standing camera gives points no depth (and its turn is seen well by two images)
_LEAST_POINTS = 12  # six unknowns, five of them with priors; few points give a large standard deviation
_PACE = 0.01  # distances of two pairs relative to each other: exposure times and wheel speeds are not exact
_FARTHEST_STD = 4.0  # from the expected yaw: the points are those of a vehicle
_MIN_INVERSE_DEPTH = -0.03  # [1/m] far points may seem a little behind infinity
_SEVERITY = 0.6  # of the redescending weights, as in refine.py
_ITERATIONS = 6  # enough: the start is the expectation, and the noise is known after two
_WIDE = 3.0  # noise assumed at first, over the expected: a coarse start finds its way
_LEAST_NOISE = 0.2  # of the estimated noise, over the expected: few points may agree too well
_EPS = 1e-6  # of numerical derivatives [rad, m]: half of a double's digits
_NO_LINE = 1e-12  # keeps a point at the epipole from dividing by zero
_NEAREST_Z = 0.05  # a ray this far off the axis is (nearly) behind the camera
_UNKNOWNS = ("yaw_rad", "pitch_rad", "roll_rad", "slip_m", "heave_m")


@compiled
def _inverse_depths(
    first: FloatArray, second: FloatArray, m: FloatArray, t: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Depths of the points of a pair with known motion.

    Returns:
        Inverse depth [1/m] in the second image, and how far a unit of it moves the first point, ``(n,)`` each.
    """
    n = len(first)
    depth, reach = np.empty(n), np.empty(n)
    for i in range(n):
        u, v = second[i, 0], second[i, 1]
        z = m[2, 0] * u + m[2, 1] * v + m[2, 2]
        y0 = first[i, 0] - (m[0, 0] * u + m[0, 1] * v + m[0, 2]) / z
        y1 = first[i, 1] - (m[1, 0] * u + m[1, 1] * v + m[1, 2]) / z
        w0, w1 = t[0] - first[i, 0] * t[2], t[1] - first[i, 1] * t[2]
        length = math.sqrt(w0 * w0 + w1 * w1) + _NO_LINE
        reach[i] = length / z
        depth[i] = (y0 * w0 + y1 * w1) / length / reach[i]
    return depth, reach


@compiled
def _errors(
    first: FloatArray, second: FloatArray, depth: FloatArray, m: FloatArray, t: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where points of known inverse depth in the first image are seen in the second, against where they should be.

    Returns:
        Error of the second point along its epipolar line, and how far a unit of inverse depth moves it, ``(n,)`` each;
        inf behind the camera.
    """
    n = len(first)
    along, reach = np.empty(n), np.empty(n)
    g = m.T @ t
    for i in range(n):
        x, y, z = first[i, 0] - depth[i] * t[0], first[i, 1] - depth[i] * t[1], 1.0 - depth[i] * t[2]
        q0 = m[0, 0] * x + m[1, 0] * y + m[2, 0] * z
        q1 = m[0, 1] * x + m[1, 1] * y + m[2, 1] * z
        q2 = m[0, 2] * x + m[1, 2] * y + m[2, 2] * z
        if q2 < _NEAREST_Z:
            along[i] = reach[i] = np.inf
            continue
        u, v = q0 / q2, q1 / q2
        w0, w1 = (u * g[2] - g[0]) / q2, (v * g[2] - g[1]) / q2
        reach[i] = math.sqrt(w0 * w0 + w1 * w1) + _NO_LINE
        along[i] = ((second[i, 0] - u) * w0 + (second[i, 1] - v) * w1) / reach[i]
    return along, reach


class _Points(NamedTuple):
    """The same points on the image planes of three images, ``(n, 2)`` each.

    Attributes:
        p0: in the first image ...
        p1: ... in the second, as matched with the first ...
        q1: ... in the second, as matched with the third (the same corner, less than a pixel away) ...
        q2: ... in the third.
    """

    p0: FloatArray
    p1: FloatArray
    q1: FloatArray
    q2: FloatArray


class _Expected(NamedTuple):
    """What is known before looking at the third image.

    Attributes:
        first_distance: travelled between first and second image [m].
        first_motion: ``(5,)`` yaw, pitch, roll, slip, heave between them.
        distance: travelled between second and third image [m].
        mean: ``(6,)`` expected second motion and 0, relative error of the distance; also the start.
        std: ``(6,)`` its standard deviation, infinite for the yaw.
        noise: expected position noise on the image plane.
    """

    first_distance: float
    first_motion: FloatArray
    distance: float
    mean: FloatArray
    std: FloatArray
    noise: float


class _Terms(NamedTuple):
    """What the points say about the second motion, ``(n,)`` each.

    Attributes:
        along: error along the epipolar line, at the depth of the first pair.
        ratio: noise that depth brings into it, over the noise of the second pair.
        told: the point has a depth, a plausible one.
        jacobian: ``(n, 6)`` of the error, at the depth that suits both pairs best.
    """

    along: FloatArray
    ratio: FloatArray
    told: NDArray[np.bool_]
    jacobian: FloatArray


@compiled
def _linearise(
    points: _Points, depths: tuple[FloatArray, FloatArray], x: FloatArray, mounting: Mounting, expected: _Expected
) -> _Terms:
    """About a second motion ``x (6,)``; ``depths`` as :func:`_inverse_depths` gives them."""
    depth, first_reach = depths
    noise, rotation, position = expected.noise, mounting.rotation, mounting.position
    m, t = camera_motion(x, never_zero(expected.distance * (1.0 + x[5])), rotation, position)
    along, reach = _errors(points.q1, points.q2, depth, m, t)
    ratio = reach / first_reach
    told = np.isfinite(along) & (first_reach > noise) & (reach > noise)
    told &= (depth > _MIN_INVERSE_DEPTH) & (depth < MAX_INVERSE_DEPTH)
    best = np.where(told, depth + along / reach * ratio**2 / (1.0 + ratio**2), 0.0)
    best = np.minimum(np.maximum(best, _MIN_INVERSE_DEPTH), MAX_INVERSE_DEPTH)
    base = _errors(points.q1, points.q2, best, m, t)[0]
    told &= np.isfinite(base)
    jacobian = np.empty((len(depth), 6))
    for k in range(6):
        y = x.copy()
        y[k] += _EPS
        m, t = camera_motion(y, never_zero(expected.distance * (1.0 + y[5])), rotation, position)
        jacobian[:, k] = (_errors(points.q1, points.q2, best, m, t)[0] - base) / _EPS
    return _Terms(along, ratio, told, jacobian)


@compiled
def _normal_equations(terms: _Terms, sigma: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Matrix ``(6, 6)`` and right side ``(6,)`` of the step, and the sizes ``(used,)`` of the errors that entered."""
    error, used = np.empty(len(terms.along)), 0
    h, g = np.zeros((6, 6)), np.zeros(6)
    jacobian = terms.jacobian
    for i in range(len(error)):
        if not terms.told[i]:
            continue
        variance = 1.0 + terms.ratio[i] ** 2
        error[used] = abs(terms.along[i]) / math.sqrt(variance)
        weight = 1.0 / (1.0 + _SEVERITY * (error[used] / sigma) ** 2) ** 2 / variance
        used += 1
        for k in range(6):
            g[k] += weight * jacobian[i, k] * terms.along[i]
            for j in range(6):
                h[k, j] += weight * jacobian[i, k] * jacobian[i, j]
    return h, g, error[:used]


@compiled
def _second_motion(points: _Points, mounting: Mounting, expected: _Expected) -> tuple[float, float]:
    """Yaw of the second motion and its standard deviation [rad], given the first motion; NaN with too few points."""
    mean, std, noise = expected.mean, expected.std, expected.noise
    first_distance = never_zero(expected.first_distance)
    m, t = camera_motion(expected.first_motion, first_distance, mounting.rotation, mounting.position)
    depths = _inverse_depths(points.p0, points.p1, m, t)
    x, sigma, h = mean.copy(), _WIDE * noise, np.eye(6)
    for iteration in range(_ITERATIONS):
        h, g, error = _normal_equations(_linearise(points, depths, x, mounting, expected), sigma)
        if len(error) < _LEAST_POINTS:
            return math.nan, math.nan
        for k in range(6):
            h[k, k] += (sigma / std[k]) ** 2
            g[k] += (sigma / std[k]) ** 2 * (x[k] - mean[k])
        x -= np.linalg.solve(h, g)
        if iteration > 0:
            sigma = max(MAD_TO_SIGMA * np.median(error), _LEAST_NOISE * noise)
    return x[0], sigma * math.sqrt(np.linalg.inv(h)[0, 0])


def turn_change(
    last: Pair, last_motion: Motion, pair: Pair, motion: Motion, prior: MotionPrior, camera: MountedCamera
) -> tuple[float, float] | None:
    """Yaw increment of the second of two consecutive pairs less that of the first, from points in all three images.

    Args:
        last: first and second image, compared.
        last_motion: between them.
        pair: second and third image, compared.
        motion: between them, of the pair alone; it only says which points agree with the epipolar geometry.
        prior: of the motion between them; its yaw is only where the search starts and how far it may lead.
        camera: calibration and mounting.

    Returns:
        The change and its standard deviation [rad]; ``None`` when fewer than 12 points are in all images, the car
        hardly moved, or the points contradict what the car can do.
    """
    if min(abs(last.prior.distance_m), abs(prior.distance_m)) < _SHORTEST_M:
        return None
    _, first, second = np.intersect1d(last.corner[:, 1], pair.corner[:, 0], assume_unique=True, return_indices=True)
    agree = last_motion.inlier[first] & motion.inlier[second]
    first, second = first[agree], second[agree]
    if len(first) < _LEAST_POINTS:
        return None
    offset, offset_std = prior.offset()
    expected = _Expected(
        last.prior.distance_m,
        np.array([getattr(last_motion, name) for name in _UNKNOWNS]),
        prior.distance_m,
        np.array([prior.yaw_mean_rad, 0.0, 0.0, *offset, 0.0]),
        np.array([math.inf, prior.tilt_std_rad, prior.tilt_std_rad, *offset_std, _PACE]),
        prior.noise,
    )
    points = _Points(last.first[first], last.second[first], pair.first[second], pair.second[second])
    yaw_rad, std_rad = _second_motion(points, Mounting(camera.rotation, camera.position_m), expected)
    if not abs(yaw_rad - prior.yaw_mean_rad) < _FARTHEST_STD * math.hypot(prior.yaw_std_rad, std_rad):
        return None
    return yaw_rad - last_motion.yaw_rad, std_rad
