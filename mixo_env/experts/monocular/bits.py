"""Counting bits with the processor's own instruction, for numba code."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic


def _count_bits(typing_context: Any, word: Any) -> Any:
    """Signature and code generator of :data:`population_count`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


population_count: Any = intrinsic(_count_bits)
"""Number of set bits of a uint64; only inside ``@njit`` functions."""
