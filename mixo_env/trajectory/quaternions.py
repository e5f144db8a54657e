"""In which order a file writes its quaternions: from its heading, its format, or the motion itself.

The size of the turns from pose to pose does not tell (it is the same in either order). The direction of travel does:
seen from the body it hardly changes when the order is right, and wanders when it is wrong and the path turns.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mixo_env.geometry import FloatArray, rotation_from_quaternion_wxyz
from mixo_env.trajectory.text import NumberTable

Order = Literal["xyzw", "wxyz"]
QuaternionOrder = Literal["file", "xyzw", "wxyz"]
"""``"file"``: told from the file; else the order of files that do not name it."""

_OTHER: dict[Order, Order] = {"xyzw": "wxyz", "wxyz": "xyzw"}
_STEADY = 0.02
"""Below this the direction of travel counts as one (half angle 11 deg), see :func:`_wandering` ..."""
_WANDERING = 0.2
"""... and above this as several."""
_CLEARLY = 3.0
_LEAST_STEPS = 10
_IDENTITY = 1e-9


def quaternion_columns(table: NumberTable, asked: QuaternionOrder) -> tuple[FloatArray, str]:
    """Quaternions ``(N, 4)`` in the order w, x, y, z from columns 5 to 8, and why that order (empty: by definition).

    Raises:
        TrajectoryError: when heading, format and motion leave the order open, or contradict each other.
    """
    columns = table.values[:, 4:8]
    named = _named(table)
    if named:
        return _wxyz(columns, named), ""
    if asked != "file":
        return _wxyz(columns, asked), ""
    usual = _usual(table)
    if usual is None:
        order = _likely(table)
        return _wxyz(columns, order), f"quaternions read as {' '.join(order)}, which fits the motion"
    wander = _wandering(columns, table.values[:, 1:4])
    other = _OTHER[usual]
    if wander and wander[usual] > _WANDERING and wander[other] < _STEADY:
        raise table.error(
            0,
            f"expected quaternions as {' '.join(usual)}, but only {' '.join(other)} fits the motion; name the columns "
            f"in a first line, or give --quaternions {other} (or {usual})",
        )
    unusual = table.values.shape[1] == 8 and nanoseconds(table.values[:, 0])
    return _wxyz(columns, usual), f"nanoseconds, quaternions read as {' '.join(usual)}" if unusual else ""


def nanoseconds(times: FloatArray) -> bool:
    """Whether times are nanoseconds: Unix ones, or steps that would be eleven days or more in seconds."""
    return bool(np.abs(times[-1]) > 1e17 or (len(times) > 1 and np.median(np.abs(np.diff(times))) >= 1e6))


def _wxyz(columns: FloatArray, order: str) -> FloatArray:
    return columns.copy() if order == "wxyz" else np.roll(columns, 1, axis=1)


def _named(table: NumberTable) -> Order | None:
    """The order a heading names; one that names other columns than ``t x y z`` and a quaternion is an error."""
    names = table.names
    if not names:
        return None
    ends = "".join(name[-1:] for name in names[1:8])
    if ends in ("xyzxyzw", "xyzwxyz") and not names[1].startswith(("q", "quat", "ori", "rot")):
        return "xyzw" if ends.endswith("w") else "wxyz"
    if "w" in "".join(name[-1:] for name in names):
        raise table.error(0, f"expected the columns t x y z and a quaternion, the heading says {' '.join(names[:9])}")
    return None


def _usual(table: NumberTable) -> Order | None:
    """The order of the format that writes such lines, if it is one format only."""
    eight, fine = table.values.shape[1] == 8, nanoseconds(table.values[:, 0])
    if fine and (table.trailing or not eight):
        return "wxyz"  # EuRoC's states, VINS-Mono and VINS-Fusion
    if eight and (table.separator == " " or not fine):
        return "xyzw"  # TUM, whatever the separator; ORB-SLAM3 writes the same with nanoseconds
    return None


def _likely(table: NumberTable) -> Order:
    """The order that fits better where the format leaves it open."""
    columns = table.values[:, 4:8]
    wander = _wandering(columns, table.values[:, 1:4])
    for order, other in _OTHER.items():
        if wander and wander[order] < _STEADY and wander[other] > max(_STEADY, _CLEARLY * wander[order]):
            return order
    # Programs begin at the identity.
    start = np.abs(columns[0]) > 1.0 - _IDENTITY
    if start[0] != start[3]:
        return "wxyz" if start[0] else "xyzw"
    raise table.error(
        0,
        "expected to see whether quaternions begin or end with w: EuRoC writes w first, ORB-SLAM3 last; "
        "name the columns in a first line, or give --quaternions wxyz or xyzw",
    )


def _wandering(columns: FloatArray, positions_m: FloatArray) -> dict[Order, float] | None:
    """How much the direction of travel wanders as the body sees it, in either order: 0 (never) to 1.

    One less the mean resultant length of the directions; ``None`` for too few steps.
    """
    step = np.diff(positions_m, axis=0)
    length = np.sqrt(np.sum(step * step, axis=1))
    moving = np.flatnonzero(length > 0.1 * length.max(initial=0.0))
    if len(moving) < _LEAST_STEPS:
        return None
    direction = step[moving] / length[moving, None]
    wander: dict[Order, float] = {}
    for order in _OTHER:
        rotation = rotation_from_quaternion_wxyz(_wxyz(columns[moving], order))
        seen = np.einsum("nij,ni->nj", rotation, direction)
        wander[order] = 1.0 - float(np.linalg.norm(seen.mean(axis=0)))
    return wander
