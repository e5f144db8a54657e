"""Counting bits with the processor's own instruction, for numba code."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _count_bits(typing_context: Any, word: Any) -> Any:
    """Signature and code generator of :data:`population_count`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


population_count: Any = intrinsic(_count_bits)
"""Number of set bits of a uint64; only inside compiled functions."""


def _count_trailing(typing_context: Any, word: Any) -> Any:
    """Signature and code generator of :data:`trailing_zeros`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.uint64(types.uint64), generate


trailing_zeros: Any = intrinsic(_count_trailing)
"""Number of zero bits below the lowest set one of a uint64 that is not 0; only inside compiled functions."""
