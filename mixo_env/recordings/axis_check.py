"""Wrong body axes are noticed: yaw that contradicts the truth by sign or scale, turn after turn.

The truth is used for nothing but this check. Where the car hardly turns nothing can be told, and an expert that is
merely bad passes: its ratios to the truth scatter, or it does not turn in any axes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import TrajectoryError
from mixo_env.trajectory.axes import BODY_AXES

FloatArray = NDArray[np.float64]

WINDOW_S = 1.0
"""Turns are compared over windows of this length."""
LEAST_TURN_RAD = np.deg2rad(2.0)
"""Smaller turns say nothing."""
LEAST_WINDOWS = 5
LEAST_RATIO, LARGEST_RATIO = 0.5, 1.6
"""Of an expert's turns to the true ones, the median; beyond these they contradict each other ..."""
FIT = 0.2
"""... and within this of 1 they fit."""
STEADY = 0.2
"""Median absolute deviation of the ratios up to which they are one and the same."""


@dataclass(frozen=True)
class Turns:
    """Steps of all sequences.

    Attributes:
        increments: axes -> one array ``(rows,)`` of yaw increments [rad] a sequence, NaN where nothing is known.
        axes: the name of those that were stated.
    """

    increments: Callable[[str], Sequence[FloatArray]]
    axes: str


@dataclass(frozen=True)
class Ratio:
    """Turns of one over those of another: median, median absolute deviation, number of windows."""

    median: float
    spread: float
    windows: int

    @property
    def contradicts(self) -> bool:
        """One steady ratio, and it is not 1."""
        known = self.windows >= LEAST_WINDOWS and self.spread <= STEADY
        return known and not LEAST_RATIO <= self.median <= LARGEST_RATIO

    @property
    def fits(self) -> bool:
        """One steady ratio, and it is 1."""
        return self.windows >= LEAST_WINDOWS and self.spread <= STEADY and abs(self.median - 1.0) <= FIT


def ratio(turns: Sequence[FloatArray], reference: Sequence[FloatArray], dt_s: Sequence[FloatArray]) -> Ratio:
    """How turns compare with those of a reference, over windows in which the reference turns."""
    found = []
    for own, other, dt in zip(turns, reference, dt_s, strict=True):
        window = np.floor(np.cumsum(dt[1:]) / WINDOW_S - 1e-9).astype(np.int64)
        count = int(window[-1]) + 1 if len(window) else 0
        sums = [np.bincount(window, weights=values[1:], minlength=count) for values in (own, other)]  # NaN spreads
        usable = np.isfinite(sums[0]) & (np.abs(np.nan_to_num(sums[1])) >= LEAST_TURN_RAD)
        found.append(sums[0][usable] / sums[1][usable])
    ratios = np.concatenate(found) if found else np.zeros(0)
    if not len(ratios):
        return Ratio(np.nan, np.inf, 0)
    median = float(np.median(ratios))
    return Ratio(median, float(np.median(np.abs(ratios - median))), len(ratios))


def check_axes(
    truth: Turns,
    experts: Mapping[str, Turns],
    dt_s: Sequence[FloatArray],
    sequences: Sequence[str],
    accepted: Sequence[str] = (),
) -> None:
    """Refuse experts whose yaw contradicts the truth, and a truth that contradicts the experts.

    Args:
        truth: of all sequences.
        experts: name -> turns.
        dt_s: ``(rows,)`` of every sequence.
        sequences: their names.
        accepted: experts that are let through.

    Raises:
        TrajectoryError: with the axes that would fit, if any do.
    """
    checked = {name: turns for name, turns in experts.items() if name not in accepted}
    own = {name: list(turns.increments(turns.axes)) for name, turns in checked.items()}
    true = list(truth.increments(truth.axes))
    if checked:
        _check_truth(truth, true, own, dt_s)
    for name, turns in checked.items():
        _check_expert(name, turns, own[name], true, dt_s, "all sequences")
        for i, sequence in enumerate(sequences):
            one = Turns(lambda axes, turns=turns, i=i: [turns.increments(axes)[i]], turns.axes)
            _check_expert(name, one, own[name][i : i + 1], true[i : i + 1], dt_s[i : i + 1], sequence)


def _check_expert(
    name: str,
    turns: Turns,
    own: Sequence[FloatArray],
    true: Sequence[FloatArray],
    dt_s: Sequence[FloatArray],
    where: str,
) -> None:
    found = ratio(own, true, dt_s)
    if not found.contradicts:
        return
    stuck = abs(found.median) < STEADY
    likely = [axes for axes in BODY_AXES if axes != turns.axes and ratio(turns.increments(axes), true, dt_s).fits]
    if stuck and not likely:
        return  # it hardly turns in any axes: broken, not misread
    cure = (
        f"--axes {name}={likely[0]} fits"
        + (" (or its poses take the world to the body: invert them)" if found.median < 0.0 else "")
        if likely
        else "no axes fit: check its times (--times, --rate) and whether its poses take the body to the world"
    )
    raise TrajectoryError(
        f"{name}, {where}: its yaw is {found.median:.2f} times that of the ground truth in {found.windows} turns (read "
        f"with axes {turns.axes}); {cure}; --despite {name} takes it as it is"
    )


def _check_truth(
    truth: Turns, true: Sequence[FloatArray], own: Mapping[str, Sequence[FloatArray]], dt_s: Sequence[FloatArray]
) -> None:
    """The truth's axes are wrong if most experts agree with each other, and with it only in other axes."""
    middle = [_median(np.stack([turns[i] for turns in own.values()])) for i in range(len(true))]
    found = ratio(true, middle, dt_s)
    turns_itself = ratio(true, true, dt_s).windows >= LEAST_WINDOWS
    if not found.contradicts or (len(own) < 2 and turns_itself):
        return
    agreeing = sum(ratio(turns, middle, dt_s).fits for turns in own.values())
    if 2 * agreeing <= len(own):
        return
    for axes in BODY_AXES:
        if axes != truth.axes and ratio(truth.increments(axes), middle, dt_s).fits:
            whose = "all experts" if agreeing == len(own) else f"{agreeing} of {len(own)} experts"
            raise TrajectoryError(
                f"ground truth: its yaw is {found.median:.2f} times that of {whose} in {found.windows} turns (read "
                f"with axes {truth.axes}); --axes groundtruth={axes} fits (or the axes of the experts are wrong)"
            )


def _median(turns: FloatArray) -> FloatArray:
    """Median ``(rows,)`` over experts ``(experts, rows)``; NaN where none delivers."""
    known = np.isfinite(turns).any(axis=0)
    middle = np.full(turns.shape[1], np.nan)
    middle[known] = np.nanmedian(turns[:, known], axis=0)
    return middle
