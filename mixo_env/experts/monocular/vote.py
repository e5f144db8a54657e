"""Exhaustive search for the yaw increment on which most matches of a pair agree."""

from __future__ import annotations

import math

import numpy as np

from mixo_env.compiled import compiled
from mixo_env.experts.monocular.depths import MAX_INVERSE_DEPTH, FloatArray, Matches, Mounting, least_inverse_depths
from mixo_env.experts.monocular.kinematics import camera_displacement, never_zero, tilted_rotation

_NO_LINE = 1e-12
"""Keeps a match at the epipole, which has no epipolar direction, from dividing by zero; far below any noise."""


@compiled
def _support(matches: Matches, least: FloatArray, m: FloatArray, t: FloatArray, inverse: float) -> float:
    """How many matches agree with a motion (rotation ``m``, displacement ``t`` in first camera axes), softly counted.

    Args:
        matches: of the pair.
        least: ``(n,)`` least inverse depths.
        m: ``(3, 3)`` first from second camera.
        t: ``(3,)`` of the camera [m].
        inverse: 1 / (2 tolerance^2).
    """
    first, second = matches
    t0, t1, t2 = t
    score = 0.0
    for i in range(first.shape[0]):
        u, v = second[i, 0], second[i, 1]
        z = m[2, 0] * u + m[2, 1] * v + m[2, 2]
        y0 = first[i, 0] - (m[0, 0] * u + m[0, 1] * v + m[0, 2]) / z
        y1 = first[i, 1] - (m[1, 0] * u + m[1, 1] * v + m[1, 2]) / z
        w0, w1 = t0 - first[i, 0] * t2, t1 - first[i, 1] * t2
        length = math.sqrt(w0 * w0 + w1 * w1) + _NO_LINE
        along = (y0 * w0 + y1 * w1) / length
        reach = length / z
        excess = max(least[i] * reach - along, along - MAX_INVERSE_DEPTH * reach, 0.0)
        across = (y0 * w1 - y1 * w0) / length
        score += 1.0 / (1.0 + (across * across + excess * excess) * inverse)
    return score


@compiled
def vote_yaw(
    matches: Matches, mounting: Mounting, distance: float, max_yaw: float, step: float, tolerance: float
) -> tuple[float, float]:
    """Exhaustive one-unknown search: the yaw increment on which most matches agree.

    Args:
        matches: of the pair.
        mounting: of the camera.
        distance: travelled [m].
        max_yaw: search range, either sign [rad].
        step: grid step [rad].
        tolerance: error on the image plane at which a match stops supporting a yaw.

    Returns:
        The best yaw [rad], by a parabola through the best of the grid and its neighbours, and its score, at most n.
    """
    half = math.ceil(max_yaw / step)
    count = 2 * half + 1
    scores = np.zeros(count)
    s = never_zero(distance)
    rotation, position = mounting
    c_t = np.ascontiguousarray(rotation.T)
    inverse = 1.0 / (2.0 * tolerance * tolerance)
    least = least_inverse_depths(matches.second, mounting)
    for b in range(count):
        yaw = (b - half) * step
        tx, ty = camera_displacement(yaw, s, position[0], position[1])
        m = c_t @ tilted_rotation(yaw, 0.0, 0.0) @ rotation
        scores[b] = _support(matches, least, m, c_t @ np.array([tx, ty, 0.0]), inverse)
    k = int(np.argmax(scores))
    yaw = (k - half) * step
    if 0 < k < count - 1:
        bend = scores[k - 1] - 2.0 * scores[k] + scores[k + 1]
        if bend < 0.0:
            yaw += 0.5 * step * (scores[k - 1] - scores[k + 1]) / bend
    return yaw, scores[k]
