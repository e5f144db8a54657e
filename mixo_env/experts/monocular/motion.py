"""Motion of the car between two images of one camera, from matched points, known distance, mounting and lever arm.

Model (kinematics.py). A point seen at h2 = (x, y, 1) on the second image plane with inverse depth rho is seen on the
first one along M h2 + rho C^T t, with M = C^T R C, C the rotation ego from camera, R the rotation first from second ego
frame and t the displacement of the camera, both of yaw, tilt, slip, heave and the known distance and lever arm.

The two-dimensional transfer error of a match is split along and across its epipolar direction w = d(image 1)/d(rho).
Across, the error is position noise. Along, it is noise plus the unknown depth, rho ~ N(mean, spread^2): worthless when
the camera has moved far, as good as the other when it stands. One estimator so covers driving, creeping, pure rotation
and standstill without a switch; points behind the camera, absurdly near or under the road are outliers.

Search is exhaustive over the yaw increment (the one-point model of Scaramuzza, IJCV 2011, here with known scale and
lever arm for any mounting), then all six unknowns are refined by iteratively reweighted least squares with priors.
No measured yaw rate enters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.experts.monocular.kinematics import camera_displacement, never_zero, tilted_rotation

FloatArray = NDArray[np.float64]

_MEAN_INVERSE_DEPTH = 0.06  # [1/m] street scenes: ground and fronts at 5 to 50 m
_SPREAD_INVERSE_DEPTH = 0.06
_MAX_INVERSE_DEPTH = 0.7  # [1/m] nothing but the car itself is nearer than 1.4 m
_DEPTH_SAMPLES = 20.0  # depths of neighbouring points are alike: all matches together count as so many
_SLOPE = math.tan(math.radians(2.0))  # the road may fall away, and the car nod, by so much ...
_DIP_M = 0.3  # ... and by this: nothing is seen below that
_SLIP_FLOOR_M = 0.004
_OPTIMISM = 1.4  # real errors over those of independent noise: neighbouring matches err together (simulated drives)
_SEVERITY = 0.6  # of the redescending weights: matches of movers and along weak edges err little but all the same way


@dataclass(frozen=True)
class MotionPrior:
    """What is known before looking.

    Attributes:
        distance_m: travelled between the images; negative when reversing.
        max_yaw_rad: largest yaw increment searched for, either sign.
        noise: expected position noise on the image plane (unit focal length).
        tilt_std_rad: standard deviation of roll and pitch increments.
        slip_mean, slip_std: expected sideways motion and its standard deviation, as shares of the distance.
        heave_mean, heave_std: the same of vertical motion.
        yaw_mean_rad, yaw_std_rad: expected yaw increment and its standard deviation; infinite when nothing is known.
    """

    distance_m: float
    max_yaw_rad: float
    noise: float
    tilt_std_rad: float = 0.003
    slip_mean: float = 0.0
    slip_std: float = 0.05
    heave_mean: float = 0.0
    heave_std: float = 0.05
    yaw_mean_rad: float = 0.0
    yaw_std_rad: float = math.inf

    def offset(self) -> tuple[FloatArray, FloatArray]:
        """Mean [m] and standard deviation [m] of slip and heave, ``(2,)`` each, over this distance."""
        s = never_zero(self.distance_m)
        std = [math.hypot(share * s, _SLIP_FLOOR_M) for share in (self.slip_std, self.heave_std)]
        return np.array([self.slip_mean, self.heave_mean]) * s, np.array(std)


@dataclass(frozen=True)
class Motion:
    """Motion first from second image, ego frame.

    Attributes:
        yaw_rad: yaw increment, anticlockwise positive.
        yaw_std_rad: its standard deviation, from the residuals.
        pitch_rad, roll_rad: tilt increments.
        slip_m, heave_m: motion of the camera to the left and up, beyond the arc.
        slip_std_m, heave_std_m: their standard deviations, prior included.
        inlier: ``(n,)`` bool, matches that agree.
        residual: median distance of the inliers from their epipolar lines, on the image plane; NaN without inliers.
    """

    yaw_rad: float
    yaw_std_rad: float
    pitch_rad: float
    roll_rad: float
    slip_m: float
    heave_m: float
    slip_std_m: float
    heave_std_m: float
    inlier: NDArray[np.bool_]
    residual: float


@compiled
def _least_inverse_depth(u: float, v: float, rotation: FloatArray, height: float) -> float:
    """Inverse depth [1/m] of the road where the ray (u, v, 1) meets it, 0 above the horizon: nothing lies behind it.

    It unmasks vehicles that move along with the car: their lower half would have to be under the road.
    """
    x = rotation[0, 0] * u + rotation[0, 1] * v + rotation[0, 2]
    y = rotation[1, 0] * u + rotation[1, 1] * v + rotation[1, 2]
    z = rotation[2, 0] * u + rotation[2, 1] * v + rotation[2, 2]
    return max(0.0, -z - _SLOPE * math.sqrt(x * x + y * y)) / (height + _DIP_M)


@compiled
def vote_yaw(
    first: FloatArray,
    second: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    distance: float,
    max_yaw: float,
    step: float,
    tolerance: float,
) -> tuple[float, float]:
    """Exhaustive one-unknown search: the yaw increment on which most matches agree.

    Args:
        first: ``(n, 2)`` points on the first image plane (unit focal length).
        second: ``(n, 2)`` the same points on the second.
        rotation: ``(3, 3)`` ego from camera.
        position: ``(3,)`` camera in the ego frame [m].
        distance: travelled [m].
        max_yaw: search range, either sign [rad].
        step: grid step [rad].
        tolerance: error on the image plane at which a match stops supporting a yaw.

    Returns:
        The best yaw [rad] and its score, at most n.
    """
    half = math.ceil(max_yaw / step)
    count = 2 * half + 1
    scores = np.zeros(count)
    s = never_zero(distance)
    c_t = np.ascontiguousarray(rotation.T)
    inverse = 1.0 / (2.0 * tolerance * tolerance)
    least = np.empty(len(second))
    for i in range(len(second)):
        least[i] = _least_inverse_depth(second[i, 0], second[i, 1], rotation, position[2])
    for b in range(count):
        yaw = (b - half) * step
        tx, ty = camera_displacement(yaw, s, position[0], position[1])
        m = c_t @ tilted_rotation(yaw, 0.0, 0.0) @ rotation
        t0, t1, t2 = c_t @ np.array([tx, ty, 0.0])
        score = 0.0
        for i in range(first.shape[0]):
            u, v = second[i, 0], second[i, 1]
            z = m[2, 0] * u + m[2, 1] * v + m[2, 2]
            y0 = first[i, 0] - (m[0, 0] * u + m[0, 1] * v + m[0, 2]) / z
            y1 = first[i, 1] - (m[1, 0] * u + m[1, 1] * v + m[1, 2]) / z
            w0, w1 = t0 - first[i, 0] * t2, t1 - first[i, 1] * t2
            length = math.sqrt(w0 * w0 + w1 * w1) + 1e-12
            along = (y0 * w0 + y1 * w1) / length
            reach = length / z
            excess = max(least[i] * reach - along, along - _MAX_INVERSE_DEPTH * reach, 0.0)
            across = (y0 * w1 - y1 * w0) / length
            score += 1.0 / (1.0 + (across * across + excess * excess) * inverse)
        scores[b] = score
    k = int(np.argmax(scores))
    yaw = (k - half) * step
    if 0 < k < count - 1:
        bend = scores[k - 1] - 2.0 * scores[k] + scores[k + 1]
        if bend < 0.0:
            yaw += 0.5 * step * (scores[k - 1] - scores[k + 1]) / bend
    return yaw, scores[k]


@compiled
def refine_motion(
    first: FloatArray,
    second: FloatArray,
    rotation: FloatArray,
    position: FloatArray,
    distance: float,
    yaw: float,
    noise: float,
    yaw_mean: float,
    yaw_std: float,
    tilt_std: float,
    offset: FloatArray,
    offset_std: FloatArray,
    iterations: int,
) -> tuple[FloatArray, NDArray[np.floating], float, FloatArray]:
    """Refine yaw, pitch, roll, slip, heave and mean inverse depth together, robustly.

    Args:
        first: ``(n, 2)`` points on the first image plane (unit focal length).
        second: ``(n, 2)`` the same points on the second.
        rotation: ``(3, 3)`` ego from camera.
        position: ``(3,)`` camera in the ego frame [m].
        distance: travelled [m].
        yaw: start value [rad].
        noise: expected position noise on the image plane; the scale is then estimated from the residuals.
        yaw_mean: prior mean of the yaw increment [rad].
        yaw_std: prior standard deviation of it [rad], may be infinite.
        tilt_std: prior of pitch and roll [rad].
        offset: ``(2,)`` prior mean of slip and heave [m].
        offset_std: ``(2,)`` prior standard deviation of slip and heave [m].
        iterations: reweighting steps.

    Returns:
        The six unknowns, their covariance ``(6, 6)``, the estimated noise, and ``(n,)`` residuals across the epipolar
        lines (inf where the match contradicts the motion along its line: behind the camera, absurdly near or under the
        road).
    """
    n = first.shape[0]
    s = never_zero(distance)
    c_t = np.ascontiguousarray(rotation.T)
    x = np.array([yaw, 0.0, 0.0, 0.0, 0.0, _MEAN_INVERSE_DEPTH])
    least = np.empty(n)
    for i in range(n):
        least[i] = _least_inverse_depth(second[i, 0], second[i, 1], rotation, position[2])
    residual = np.empty(n)
    across_all = np.empty(n)
    sigma = 3.0 * noise  # wide at first, so that a coarse start finds its way
    h = np.zeros((6, 6))
    jac = np.zeros(6)
    jal = np.zeros(6)
    depth_variance = 0.5 * _SPREAD_INVERSE_DEPTH**2 * max(1.0, n / _DEPTH_SAMPLES)
    root = math.sqrt(0.5)
    eps = 1e-6
    for it in range(iterations + 1):
        last = it == iterations
        tx, ty = camera_displacement(x[0], s, position[0], position[1])
        qx, qy = camera_displacement(x[0] + eps, s, position[0], position[1])
        r0 = tilted_rotation(x[0], x[1], x[2])
        m = c_t @ r0 @ rotation
        d_yaw = c_t @ ((tilted_rotation(x[0] + eps, x[1], x[2]) - r0) / eps) @ rotation
        d_pitch = c_t @ ((tilted_rotation(x[0], x[1] + eps, x[2]) - r0) / eps) @ rotation
        d_roll = c_t @ ((tilted_rotation(x[0], x[1], x[2] + eps) - r0) / eps) @ rotation
        tc = c_t @ np.array([tx, ty + x[3], x[4]])
        tc_yaw = c_t @ np.array([(qx - tx) / eps, (qy - ty) / eps, 0.0])
        if not last:
            h[:] = 0.0
        g = np.zeros(6)
        for i in range(n):
            u, v = second[i, 0], second[i, 1]
            a, b = first[i, 0], first[i, 1]
            z = m[2, 0] * u + m[2, 1] * v + m[2, 2]
            iz = 1.0 / z
            y0 = a - (m[0, 0] * u + m[0, 1] * v + m[0, 2]) * iz
            y1 = b - (m[1, 0] * u + m[1, 1] * v + m[1, 2]) * iz
            w0, w1 = tc[0] - a * tc[2], tc[1] - b * tc[2]
            length = math.sqrt(w0 * w0 + w1 * w1) + 1e-12
            e0, e1 = w0 / length, w1 / length
            along = y0 * e0 + y1 * e1
            r = root * (y0 * e1 - y1 * e0)
            across_all[i] = r
            reach = length * iz
            excess = max(least[i] * reach - along, along - _MAX_INVERSE_DEPTH * reach) - 4.0 * sigma
            if z < 0.05 or excess > 0.0:
                residual[i] = np.inf
                continue
            residual[i] = r
            if last:
                continue
            q = r / sigma
            weight = 1.0 / (1.0 + _SEVERITY * q * q) ** 2
            rho = along / reach if reach > 1e-9 else 0.0
            rho = min(max(rho, 0.0), _MAX_INVERSE_DEPTH)
            variance = sigma * sigma + reach * reach * depth_variance
            ra = root * along - root * x[5] * reach
            p = ra * ra / variance
            weight_along = weight * sigma * sigma / variance / (1.0 + 0.25 * p) ** 2
            for k in range(3):
                d = d_yaw if k == 0 else (d_pitch if k == 1 else d_roll)
                dz = d[2, 0] * u + d[2, 1] * v + d[2, 2]
                dy0 = ((a - y0) * dz - (d[0, 0] * u + d[0, 1] * v + d[0, 2])) * iz
                dy1 = ((b - y1) * dz - (d[1, 0] * u + d[1, 1] * v + d[1, 2])) * iz
                jac[k] = root * (dy0 * e1 - dy1 * e0)
                jal[k] = root * (dy0 * e0 + dy1 * e1)
            # d(across)/dt = rho (e x dw): translation matters as much as the point is near
            scale = root * rho * iz
            dw0, dw1 = tc_yaw[0] - a * tc_yaw[2], tc_yaw[1] - b * tc_yaw[2]
            jac[0] += scale * (e0 * dw1 - e1 * dw0)
            for k in range(3, 5):
                dw0, dw1 = c_t[0, k - 2] - a * c_t[2, k - 2], c_t[1, k - 2] - b * c_t[2, k - 2]
                jac[k] = scale * (e0 * dw1 - e1 * dw0)
            jal[5] = -root * reach
            for k in range(6):
                g[k] += weight * jac[k] * r + weight_along * jal[k] * ra
                for j in range(k + 1):
                    h[k, j] += weight * jac[k] * jac[j] + weight_along * jal[k] * jal[j]
        if last:
            break
        for k in range(6):
            for j in range(k):
                h[j, k] = h[k, j]
        variance = sigma * sigma
        h[0, 0] += variance / yaw_std**2
        g[0] += variance / yaw_std**2 * (x[0] - yaw_mean)
        for k in range(1, 3):
            h[k, k] += variance / tilt_std**2
            g[k] += variance / tilt_std**2 * x[k]
        for k in range(3, 5):
            h[k, k] += variance / offset_std[k - 3] ** 2
            g[k] += variance / offset_std[k - 3] ** 2 * (x[k] - offset[k - 3])
        h[5, 5] += variance / _SPREAD_INVERSE_DEPTH**2
        g[5] += variance / _SPREAD_INVERSE_DEPTH**2 * (x[5] - _MEAN_INVERSE_DEPTH)
        h[0, 0] += 1e-12
        step = np.linalg.solve(h, g)
        largest = max(abs(step[0]), abs(step[1]), abs(step[2])) / 0.02
        if largest > 1.0:
            step /= largest
        x -= step
        # robust scale of the matches that are not plainly wrong
        near = np.abs(across_all[np.isfinite(residual) & (np.abs(across_all) < 5.0 * sigma)])
        if near.size > 10:
            robust = min(max(1.4826 * np.median(near), 0.1 * noise), 2.0 * noise)
            sigma = max(robust, 0.6 * sigma)
    covariance = np.linalg.inv(h) * sigma * sigma
    return x, covariance, sigma, residual


_MIN_MATCHES = 8


def estimate_motion(
    first: FloatArray,
    second: FloatArray,
    rotation: FloatArray,
    position_m: FloatArray,
    prior: MotionPrior,
    start_rad: float | None = None,
) -> Motion | None:
    """Motion of the car between two images of one camera.

    Args:
        first: ``(n, 2)`` matched points on the first image plane (x right, y down, unit focal length).
        second: ``(n, 2)`` the same on the second.
        rotation: ``(3, 3)`` ego from camera.
        position_m: ``(3,)`` camera in the ego frame; its height says where the road is.
        prior: distance, search range, noise and what the car is expected to do.
        start_rad: yaw increment to refine, for instance of an earlier solution; ``None`` searches for it.

    Returns:
        ``None`` when fewer than 8 matches are given or the solution leaves the search range or is not finite.
    """
    if len(first) < _MIN_MATCHES:
        return None
    first, second = np.ascontiguousarray(first, dtype=np.float64), np.ascontiguousarray(second, dtype=np.float64)
    distance = prior.distance_m
    if start_rad is None:
        tolerance = max(3.0 * prior.noise, 0.6 * prior.tilt_std_rad)
        some = slice(None, None, max(1, len(first) // 300))
        start_rad, _ = vote_yaw(
            first[some], second[some], rotation, position_m, distance, prior.max_yaw_rad, tolerance, tolerance
        )
    unknowns, covariance, sigma, residual = refine_motion(
        first,
        second,
        rotation,
        position_m,
        distance,
        start_rad,
        prior.noise,
        prior.yaw_mean_rad,
        prior.yaw_std_rad,
        prior.tilt_std_rad,
        *prior.offset(),
        10,
    )
    std = np.sqrt(np.diag(covariance))
    if not np.isfinite(unknowns).all() or not (std > 0.0).all() or abs(unknowns[0]) > 1.2 * prior.max_yaw_rad:
        return None
    inlier = np.abs(residual) < 3.0 * sigma
    return Motion(
        yaw_rad=float(unknowns[0]),
        yaw_std_rad=_OPTIMISM * float(std[0]),
        pitch_rad=float(unknowns[1]),
        roll_rad=float(unknowns[2]),
        slip_m=float(unknowns[3]),
        heave_m=float(unknowns[4]),
        slip_std_m=float(std[3]),
        heave_std_m=float(std[4]),
        inlier=inlier,
        residual=float(np.median(np.abs(residual[inlier]))) if inlier.any() else math.nan,
    )
