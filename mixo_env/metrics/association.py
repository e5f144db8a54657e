"""Which poses of two files belong together (docs/metrics.md, "Association")."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mixo_env.errors import TrajectoryError
from mixo_env.geometry import FloatArray
from mixo_env.metrics.pairs import IntArray
from mixo_env.trajectory import Trajectory

MAX_DIFFERENCE_S = 0.02
_LEAST_PAIRS = 3
_MOST_CANDIDATES = 20_000_000
_UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}


def associate(
    first_s: FloatArray, second_s: FloatArray, max_difference_s: float = MAX_DIFFERENCE_S
) -> tuple[IntArray, IntArray]:
    """Greedy one-to-one association of timestamps, the closest pair first.

    Equally close pairs are taken in the order of their rows.

    Args:
        first_s: ``(N,)`` increasing.
        second_s: ``(M,)`` increasing.
        max_difference_s: only pairs with ``|dt|`` below this.

    Returns:
        Rows of the first and of the second, increasing, of equal length.

    Raises:
        TrajectoryError: when the limit lets so many pairs through that memory would not hold them.
    """
    low = np.searchsorted(second_s, first_s - 2.0 * max_difference_s)
    high = np.searchsorted(second_s, first_s + 2.0 * max_difference_s, side="right")
    candidates = int(np.sum(high - low))
    if candidates > _MOST_CANDIDATES:
        raise TrajectoryError(
            f"expected a time difference that leaves few choices, {max_difference_s:g} s leaves {candidates} pairs of "
            f"{len(first_s)} and {len(second_s)} poses; give less than the time from pose to pose"
        )
    rows = np.repeat(np.arange(len(first_s)), high - low)
    columns = np.arange(len(rows)) - np.repeat(np.cumsum(high - low) - (high - low), high - low) + low[rows]
    difference = np.abs(first_s[rows] - second_s[columns])
    near = difference < max_difference_s
    rows, columns, difference = rows[near], columns[near], difference[near]
    if len(np.unique(rows)) < len(rows) or len(np.unique(columns)) < len(columns):
        taken = _take_closest_first(rows, columns, difference)
        rows, columns = rows[taken], columns[taken]
    order = np.argsort(rows)
    return rows[order], columns[order]


def match(
    truth: Trajectory,
    estimate: Trajectory,
    max_difference_s: float = MAX_DIFFERENCE_S,
    names: tuple[str, str] = ("the ground truth", "the estimate"),
) -> tuple[Trajectory, Trajectory]:
    """The poses of both that belong together, in time order; trajectories without times match by index.

    Where one has no times and the first column of the other holds whole numbers, these are frames of the first.

    Args:
        truth: ``N`` poses.
        estimate: ``M`` poses.
        max_difference_s: largest time difference of a pair.
        names: of the two in messages, e.g. their files.

    Raises:
        TrajectoryError: for fewer than 3 pairs, for times on one side only, or for different lengths without times.
    """
    if truth.timestamps_s is None or estimate.timestamps_s is None:
        if estimate.timestamps_s is not None and estimate.counted:
            rows = _frames(estimate.timestamps_s, len(truth), (names[1], names[0]))
            return truth[rows], replace(estimate, timestamps_s=None)
        if truth.timestamps_s is not None and truth.counted:
            rows = _frames(truth.timestamps_s, len(estimate), names)
            return replace(truth, timestamps_s=None), estimate[rows]
        if truth.timestamps_s is not None or estimate.timestamps_s is not None:
            timed, untimed = names if estimate.timestamps_s is None else names[::-1]
            raise TrajectoryError(
                f"{timed} has times, {untimed} has none, so their poses cannot be matched; give times for both"
            )
        if len(truth) != len(estimate):
            raise TrajectoryError(
                f"without times poses match by index: expected {len(truth)} poses as in {names[0]}, "
                f"got {len(estimate)} in {names[1]}; give times for both or equal lengths"
            )
        if len(truth) < _LEAST_PAIRS:
            raise TrajectoryError(f"expected at least {_LEAST_PAIRS} poses, got {len(truth)} in {names[0]}")
        return truth, estimate
    rows, columns = associate(truth.timestamps_s, estimate.timestamps_s, max_difference_s)
    if len(rows) < _LEAST_PAIRS:
        first, second = truth.timestamps_s, estimate.timestamps_s
        raise TrajectoryError(
            f"expected at least {_LEAST_PAIRS} pairs closer than {max_difference_s} s, got {len(rows)}: "
            f"{names[0]} covers {_range(first)}, {names[1]} covers {_range(second)}; {_advice(first, second)}"
        )
    return truth[rows], estimate[columns]


def _frames(numbers: FloatArray, count: int, names: tuple[str, str]) -> IntArray:
    """Rows of an untimed trajectory of ``count`` poses that ``numbers`` of another name."""
    if len(numbers) < _LEAST_PAIRS:
        raise TrajectoryError(f"expected at least {_LEAST_PAIRS} poses, got {len(numbers)} in {names[0]}")
    if numbers[-1] >= count:
        raise TrajectoryError(
            f"{names[0]} numbers frames up to {numbers[-1]:.0f}, {names[1]} holds {count} without times; "
            "frames count from 0: subtract 1, or give times for both"
        )
    return numbers.astype(np.int64)


def _take_closest_first(rows: IntArray, columns: IntArray, difference: FloatArray) -> IntArray:
    """Positions of the pairs that remain when each row and column may be used once, closest pairs first."""
    used_rows: set[int] = set()
    used_columns: set[int] = set()
    taken = []
    order = np.lexsort((columns, rows, difference))
    for position, row, column in zip(order.tolist(), rows[order].tolist(), columns[order].tolist(), strict=True):
        if row not in used_rows and column not in used_columns:
            used_rows.add(row)
            used_columns.add(column)
            taken.append(position)
    return np.array(taken, dtype=np.int64)


def _range(times: FloatArray) -> str:
    return f"{times[0]:.3f} to {times[-1]:.3f} s ({len(times)} poses)"


def _advice(first: FloatArray, second: FloatArray) -> str:
    """What is most likely wrong with the times."""
    spans = first[-1] - first[0], second[-1] - second[0]
    ratio = max(spans) / max(min(spans), 1e-9)
    for factor, unit in _UNITS.items():
        if 0.5 < ratio / factor < 2.0:
            return f"one of them seems to be in {unit}: divide it by {factor:.0e}"
    if first[-1] < second[0] or second[-1] < first[0]:
        return "they do not overlap in time: check clock and file"
    return "shift one clock or allow a larger time difference"
