"""Sub-pixel alignment of matches: descriptors say which corner, grey values say where."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_WINDOW_PX = 9  # wider windows reach over edges to things at other depths, narrower ones hold too little texture
_STEPS = 8  # the start is right to about a pixel: a few Newton steps suffice, and more mean that it diverges
_LAST_STEP_PX = 0.02  # far below the noise of a match: going on would change nothing
_FARTHEST_PX = 2.5  # a corner of the coarsest level in use is known this well


def align_matches(
    first: NDArray[np.uint8], second: NDArray[np.uint8], p1: NDArray[np.float32], p2: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Move matched points of the second image to where the patch of the first fits best (Lucas and Kanade, 1981).

    Args:
        first: ``(height, width)`` grey image of the first points.
        second: the same of the second.
        p1: ``(n, 2)`` points in the first image [working px].
        p2: ``(n, 2)`` matched points in the second, right to about a pixel.

    Returns:
        ``(n, 2)`` refined points of the second image, and ``(n,)`` bool: the alignment converged near its start.
    """
    refined, status, _ = cv2.calcOpticalFlowPyrLK(
        first,
        second,
        p1,
        p2.copy(),
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _STEPS, _LAST_STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    near = np.abs(refined - p2).max(axis=1) < _FARTHEST_PX
    return np.asarray(refined, np.float32), (status[:, 0] > 0) & near
