"""The inner loop, compiled: one function per stage of a step, over a batch of scenes.

A step reads from top to bottom in :func:`step`: actions become scores, scores mix the experts (eq. 3), yaw (eq. 4) and
position (eq. 1) are integrated, errors become rewards, and the next observation is copied out. Powers of e and small
rotations are Taylor series: exact to the last bits, faster than the C library, and the same bits on every machine.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mixo_env.compiled import compiled

SUBSTITUTE, DT, DISTANCE, LINEAR_ERROR, TRUTH, TRUE_YAW, TRUE_X, TRUE_Y, FIRST_EXPERT = range(9)
"""Columns of the table of steps (float64, one row per recorded step):

* the increment standing in for experts that delivered nothing [rad];
* t_k - t_{k-1} [s]; s_k with the wheel scale applied [m];
* LINEAR's increment minus the true one, for reward "improvement" [rad]; the true increment [rad];
* the true pose at the end of the step, relative to the scene's start: yaw [rad], x and y along the map's axes [m];
* from ``FIRST_EXPERT`` on the experts' increments [rad]; NaN for those that do not vote.
"""

SCENE = np.dtype(
    [("first", np.int64), ("stop", np.int64), ("course_rad", np.float64), ("previous_yaw_rate", np.float64)]
)
"""Where a scene begins: its steps are rows ``first:stop``; direction of travel and previous yaw rate at its start."""

STATE = np.dtype(
    [
        ("scene", np.int64),
        ("row", np.int64),  # the step to be decided next; at the end of a scene its last step
        ("stop", np.int64),  # one past the scene's last step
        ("step", np.int64),  # steps done in this scene
        ("increment_rad", np.float64),  # fused, of the last step
        ("error_rad", np.float64),  # fused minus true, of the last step
        ("linear_error_rad", np.float64),  # of the last step
        ("previous_yaw_rate", np.float64),  # fused, of the last step [rad/s]
        ("yaw_rad", np.float64),  # fused pose relative to the scene's start, in the map's axes
        ("x_m", np.float64),
        ("y_m", np.float64),
        ("course_cos", np.float64),  # direction of travel: fused yaw plus course offset, in the map's axes
        ("course_sin", np.float64),
        ("position_error_m2", np.float64),  # squared distance from the true position
        ("sum_position_error_m2", np.float64),  # sums over the steps of the scene
        ("sum_yaw_error_rad2", np.float64),
        ("sum_error_rad2", np.float64),
        ("silent", np.int64),  # bit j: expert j delivers nothing at the coming step, whatever it recorded
        ("done", np.bool_),
        ("pause", np.bool_),  # just restarted: sit out the coming step
    ],
    align=True,
)
"""Where one scene of the batch stands."""

RULES = np.dtype(
    [
        ("scale", np.float64),  # of actions
        ("exponential", np.bool_),  # scores are e to the scaled actions
        ("shares", np.bool_),  # scores are normalised over the experts that vote
        ("mask", np.bool_),  # silenced experts do not vote
        ("fused", np.bool_),  # the observed previous yaw rate is the fused one
        ("rate_limit", np.float64),  # its bound [rad/s]
        ("reward", np.int64),
        ("sigma_rad", np.float64),  # sigma_0, the unit of errors in rewards
    ],
    align=True,
)
"""Options that the inner loop reads; an array of one."""

SQUARED, ABS, IMPROVEMENT, POSE = range(4)
"""Rewards, in the order of ``reward.TERMS``."""

REPORT = ("reward", "yaw_increment_rad", "yaw_error_rad")
"""First rows of the report of a step; the reward's terms follow."""

SCORES = ("ate_m", "ate_deg", "yaw_rmse_deg")
"""Of a scene, without alignment (docs/metrics.md): translation and rotation RMSE over all poses, the exact first one
included, and RMSE of the yaw increments."""

CAP = 10.0
"""Largest error that counts in a reward, in units of sigma_0 (yaw) or metres (position)."""


LARGEST_EXPONENT = 5.0
"""Up to here :func:`power_of_e` is exact; logits, LOGIT_SCALE times a number in [-1, 1], never go beyond."""


@compiled
def power_of_e(x: float) -> float:
    """e^x for abs(x) <= LARGEST_EXPONENT, relative error below 1e-14: e^(x/16) by series, squared four times."""
    t = 0.0625 * x
    e = 1 / 40320 + t * (1 / 362880 + t * (1 / 3628800 + t * (1 / 39916800 + t * (1 / 479001600))))
    e = 1 / 24 + t * (1 / 120 + t * (1 / 720 + t * (1 / 5040 + t * e)))
    e = 1 + t * (1 + t * (1 / 2 + t * (1 / 6 + t * e)))
    e *= e
    e *= e
    e *= e
    return e * e


@compiled
def half_turn(angle_rad: float) -> tuple[float, float]:
    """Cosine and sine of half an angle; beyond half a radian, which no step of a car reaches, by the C library."""
    h = 0.5 * angle_rad
    if abs(h) > 0.25:
        return math.cos(h), math.sin(h)
    q = h * h
    c = 1.0 + q * (-1 / 2 + q * (1 / 24 + q * (-1 / 720 + q * (1 / 40320 + q * (-1 / 3628800)))))
    n = 1.0 + q * (-1 / 6 + q * (1 / 120 + q * (-1 / 5040 + q * (1 / 362880 + q * (-1 / 39916800)))))
    return c, h * n


@compiled
def restart(state: Any, which: Any, scenes: Any, starts: Any, pause: bool) -> None:
    """Put batch entries ``which`` at the start of ``scenes``; ``starts`` ``(scenes,)`` is SCENE."""
    for i in range(which.size):
        s = state[which[i]]
        start = starts[scenes[i]]
        s.scene = scenes[i]
        s.row = start.first
        s.stop = start.stop
        s.step = 0
        s.increment_rad = s.error_rad = s.linear_error_rad = 0.0
        s.previous_yaw_rate = start.previous_yaw_rate
        s.yaw_rad = s.x_m = s.y_m = 0.0
        s.course_cos = math.cos(start.course_rad)
        s.course_sin = math.sin(start.course_rad)
        s.position_error_m2 = s.sum_position_error_m2 = s.sum_yaw_error_rad2 = s.sum_error_rad2 = 0.0
        s.silent = 0
        s.done = False
        s.pause = pause


@compiled
def score(actions: Any, scale: float, exponential: bool, scores: Any) -> bool:
    """Write ``scale`` x ``actions``, or e to that power, into ``scores``; False if one is no number in [-1, 1]."""
    wrong = 0
    for i in range(actions.size):
        a = np.float64(actions[i])
        wrong += not abs(a) <= 1.0  # NaN is wrong too
        scores[i] = scale * a
    if exponential and wrong == 0:
        for i in range(actions.size):
            scores[i] = power_of_e(scores[i])
    return wrong == 0


@compiled
def advance(scores: Any, shares: bool, mask: bool, state: Any, table: Any, history: Any) -> None:
    """One step of every scene that has not ended: mix the increments, integrate yaw and position, add up the errors.

    Args:
        scores: ``(batch, experts)``; weights, or with ``shares`` numbers >= 0 that become weights by normalisation.
        shares: whether to normalise ``scores`` over the experts that vote.
        mask: silenced experts do not vote (otherwise the substitute votes in their place).
        state: ``(batch,)`` STATE, changed in place.
        table: of steps.
        history: ``(longest scene, batch)``; receives the fused increments. Empty: they are not kept.
    """
    for b in range(state.size):
        s = state[b]
        if s.done or s.pause:
            s.pause = False
            continue
        row = s.row
        k = table[row]
        fused = total = plain = 0.0  # eq. 3
        votes = 0
        for j in range(table.shape[1] - FIRST_EXPERT):
            increment = k[FIRST_EXPERT + j]
            if (s.silent >> j) & 1:
                increment = np.nan if mask else k[SUBSTITUTE]
            if increment == increment:
                fused += scores[b, j] * increment
                total += scores[b, j]
                plain += increment
                votes += 1
        if votes == 0:
            fused = k[SUBSTITUTE]
        elif shares:
            fused = fused / total if total > 0.0 else plain / votes

        yaw = s.yaw_rad + fused  # eq. 4

        c, n = half_turn(fused)  # eq. 1: the chord points along the yaw in the middle of the step
        east = s.course_cos * c - s.course_sin * n
        north = s.course_sin * c + s.course_cos * n
        x, y = s.x_m + k[DISTANCE] * east, s.y_m + k[DISTANCE] * north

        # All of the table is read before the state is written: the compiler cannot know that they never overlap.
        error, yaw_error = fused - k[TRUTH], yaw - k[TRUE_YAW]
        position_error = (x - k[TRUE_X]) ** 2 + (y - k[TRUE_Y]) ** 2
        rate, linear_error = fused / k[DT], k[LINEAR_ERROR]

        s.yaw_rad, s.x_m, s.y_m = yaw, x, y
        s.course_cos, s.course_sin = east * c - north * n, north * c + east * n
        if history.size:
            history[s.step, b] = fused
        s.increment_rad, s.previous_yaw_rate = fused, rate
        s.error_rad, s.linear_error_rad, s.position_error_m2 = error, linear_error, position_error
        s.sum_error_rad2 += error * error
        s.sum_yaw_error_rad2 += yaw_error * yaw_error
        s.sum_position_error_m2 += position_error
        s.step += 1
        if row + 1 == s.stop:
            s.done = True
        else:
            s.row = row + 1


@compiled
def judge(state: Any, reward: int, sigma_rad: float, report: Any) -> int:
    """Write what the last step was into ``report`` ``(3 + terms, batch)``.

    All is 0 for a scene that sat the step out. Returns the number of scenes that have ended.
    """
    ended = 0
    for b in range(state.size):
        s = state[b]
        report[1, b] = s.increment_rad
        report[2, b] = s.error_rad
        error = min(abs(s.error_rad) / sigma_rad, CAP)
        if reward == POSE:
            total = report[3, b] = -min(s.position_error_m2, CAP * CAP)
        elif reward == ABS:
            total = report[3, b] = -error
        else:
            total = report[3, b] = -error * error
        if reward == IMPROVEMENT:
            linear_error = min(abs(s.linear_error_rad) / sigma_rad, CAP)
            report[4, b] = linear_error * linear_error
            total += report[4, b]
        report[0, b] = total
        ended += s.done
    return ended


@compiled
def tally(state: Any, scores: Any) -> None:
    """Write the SCORES ``(3, batch)`` of the scenes that have ended, 0 for the others."""
    for b in range(state.size):
        s = state[b]
        scores[0, b] = math.sqrt(s.sum_position_error_m2 / (s.step + 1)) if s.done else 0.0
        scores[1, b] = math.degrees(math.sqrt(s.sum_yaw_error_rad2 / (s.step + 1))) if s.done else 0.0
        scores[2, b] = math.degrees(math.sqrt(s.sum_error_rad2 / s.step)) if s.done else 0.0


@compiled
def look(out: Any, state: Any, context: Any, fused: bool, limit: float) -> None:
    """Copy each scene's recorded context into ``out`` ``(batch, width)`` and set the fused previous yaw rate.

    The rate is clipped to ``limit``, so that it stays in the observation space whatever the weights.
    """
    for b in range(state.size):
        row = state[b].row
        for c in range(out.shape[1]):
            out[b, c] = context[row, c]
        if fused:
            out[b, 0] = np.float32(min(max(state[b].previous_yaw_rate, -limit), limit))


@compiled
def step(
    actions: Any,
    report: Any,
    out: Any,
    rules: Any,
    state: Any,
    table: Any,
    history: Any,
    context: Any,
) -> int:
    """A whole step, in order.

    Returns:
        The number of scenes that have ended; -1, and nothing is changed, if an action is no number in [-1, 1].
    """
    r = rules[0]
    scores = np.empty(actions.shape)
    if not score(actions.ravel(), r.scale, r.exponential, scores.ravel()):
        return -1
    advance(scores, r.shares, r.mask, state, table, history)
    ended = judge(state, r.reward, r.sigma_rad, report)
    look(out, state, context, r.fused, r.rate_limit)
    return ended
