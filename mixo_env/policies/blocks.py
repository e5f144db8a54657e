"""Scenes side by side: compiled loops take a block of them at once, and the scene is the last index of their arrays.

So vector units are full, and all that happens to a block fits into the first cache. The last block is filled up with
the last scene, again and again: what is computed twice is written twice.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import inlined

AT_ONCE = 32
"""Scenes in a block, at most: of fewer scenes there is one block of just these."""


def shape_of(batch: int) -> tuple[int, int]:
    """Number of blocks, and scenes in each, of ``batch`` scenes."""
    return -(-batch // AT_ONCE), min(batch, AT_ONCE)


def in_rows(blocks: NDArray[Any], batch: int) -> NDArray[Any]:
    """``(blocks, .., scenes)`` -> ``(batch, ..)``."""
    return np.moveaxis(blocks, -1, 1).reshape(-1, *blocks.shape[1:-1])[:batch]


@inlined
def gather(rows: NDArray[Any], first: int, block: NDArray[Any]) -> None:
    """Write ``rows`` ``(batch, n)`` of the scenes from ``first`` on to ``(n, scenes)``."""
    for s in range(block.shape[1]):
        row = rows[min(first + s, len(rows) - 1)]
        for i in range(len(block)):
            block[i, s] = row[i]


@inlined
def scatter(block: NDArray[Any], first: int, rows: NDArray[Any]) -> None:
    """Write a block ``(n, scenes)`` back to ``rows`` ``(batch, n)``."""
    for s in range(block.shape[1]):
        row = rows[min(first + s, len(rows) - 1)]
        for i in range(len(block)):
            row[i] = block[i, s]
