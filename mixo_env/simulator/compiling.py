"""How the short loops of the renderer are compiled: ``@njit(**INLINED)``."""

from __future__ import annotations

from typing import Any

from numba.core.compiler import Compiler


class _Apart(Compiler):
    """Numba's usual compiler, told that the arrays passed to a function never overlap.

    A loop that gathers from a texture and writes a span runs in SIMD only with this promise.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.flags.noalias = True


INLINED: dict[str, Any] = {
    "cache": True,
    "error_model": "numpy",
    "forceinline": True,
    "_nrt": False,
    "pipeline_class": _Apart,
}
"""Compile into the caller, and do not count references to arrays: for a run of twenty pixels the counting cost as much
as the arithmetic. Such a function may cut arrays into views, but must neither make nor return one, and what it writes
must not overlap anything else that it is given."""
