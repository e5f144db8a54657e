"""A truth far denser than any expert: motion capture and navigation systems give 100 or 200 poses a second."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

DENSE_S = 0.03
"""A truth with a longer step is taken as it is: no camera is much faster."""

DENSER = 1.5
"""A truth that is less denser than the densest expert is taken as it is."""

LONGEST_STEP_S = 0.1
"""Steps to be had between poses of experts that are rarer still: those of nuScenes."""


def thinned(truth_s: FloatArray, experts_s: Sequence[FloatArray]) -> NDArray[np.int64] | None:
    """Which true poses end the steps of a sequence.

    They are the nearest to the poses of the densest expert, so its increments are hardly interpolated, and where that
    expert has none, others as far apart; 0.1 s where no expert has any.

    Args:
        truth_s: ``(n,)`` increasing times.
        experts_s: times of every expert's poses, increasing.

    Returns:
        ``(m,)`` increasing positions; ``None``: all, because the truth is no denser than it has to be.
    """
    spacings = {i: float(np.median(np.diff(times))) for i, times in enumerate(experts_s) if len(times) > 1}
    if len(truth_s) < 3:
        return None
    own_s = float(np.median(np.diff(truth_s)))
    step_s = min([*spacings.values(), LONGEST_STEP_S])
    if own_s > DENSE_S or step_s < DENSER * own_s:
        return None
    times = experts_s[min(spacings, key=spacings.__getitem__)] if spacings else np.zeros(0)
    near = np.clip(np.searchsorted(truth_s, times), 1, len(truth_s) - 1)
    near -= times - truth_s[near - 1] < truth_s[near] - times
    marks = np.unique(near[np.abs(truth_s[near] - times) <= own_s])
    # Counted in poses, not in seconds: a wrong stamp must not ask for millions of steps.
    stride = max(1, round(step_s / own_s))
    ends = [-stride, *marks.tolist(), len(truth_s) - 1 + stride]
    between = [
        np.arange(before + stride, min(after - stride // 2, len(truth_s)), stride)
        for before, after in pairwise(ends)
        if after - before > DENSER * stride
    ]
    return np.unique(np.concatenate([marks, *between]))
