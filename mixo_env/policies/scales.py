"""How far an expert is usually off, measured over seconds: one step tells mostly the noise of the true poses.

A camera's errors lean to one side for a while, and those of the poses cancel from step to step; both make single steps
the wrong place to look. Heading is made of sums, so a scale comes from sums over two seconds, per root of their length.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import MAD_TO_SIGMA
from mixo_env.policies.tokens import UNIT_RAD, Usual
from mixo_env.recordings.collection import Recordings

FloatArray = NDArray[np.float64]

WINDOW_S = 2.0
"""Long enough for the noise of poses to fade, short enough for many windows without a loss."""

FEWEST = 30
"""Windows that a scale needs; with fewer it is unknown."""

SMALLEST_RAD, SMALLEST_SHARE = 1e-3 * UNIT_RAD, 1e-3
"""Keep weights finite where an expert is exact."""


def usual(training: Recordings, experts: Sequence[str]) -> Usual:
    """Scales of experts, NaN where training scenes do not tell.

    Args:
        training: scenes with true increments.
        experts: in the order of the result.
    """
    truth = training["truth.yaw_increment_rad"].astype(np.float64)
    steps = max(1, round(WINDOW_S / float(np.nanmedian(training["dt_s"]))))
    starts = window_starts(training.offsets, steps)
    scale, share = np.full(len(experts), np.nan), np.full(len(experts), np.nan)
    for e, name in enumerate(experts):
        error = training[f"{name}.yaw_increment_rad"] - truth
        stated = training[f"{name}.yaw_std_rad"].astype(np.float64) if f"{name}.yaw_std_rad" in training else None
        scale[e] = max(_ratio(error, np.ones_like(error), starts, steps), SMALLEST_RAD)
        if stated is not None:
            share[e] = max(_ratio(error, np.where(stated > 0.0, stated, np.nan), starts, steps), SMALLEST_SHARE)
    return Usual(scale, share)


def window_starts(offsets: NDArray[np.integer], steps: int) -> NDArray[np.intp]:
    """Rows that open a window of ``steps`` steps inside a scene; row 0 of a scene is no step."""
    rows = [np.arange(first + 1, stop - steps + 1) for first, stop in zip(offsets[:-1], offsets[1:], strict=True)]
    return np.concatenate([np.zeros(0, np.intp), *rows])


def _ratio(error: FloatArray, std: FloatArray, starts: NDArray[np.intp], steps: int) -> float:
    """Robust standard deviation of summed errors over what independent ``std`` would give; NaN without windows."""
    good = np.isfinite(error) & np.isfinite(std)
    sums = [np.concatenate([[0.0], np.cumsum(np.where(good, x, 0.0))]) for x in (error, std**2, 1.0 * good)]
    total, variance, count = (x[starts + steps] - x[starts] for x in sums)
    full = count == steps
    if np.count_nonzero(full) < FEWEST:
        return np.nan
    return MAD_TO_SIGMA * float(np.median(np.abs(total[full]) / np.sqrt(variance[full])))
