"""How the short loops of the renderer are compiled: ``@njit(**INLINED)``."""

from __future__ import annotations

from typing import Any

INLINED: dict[str, Any] = {"cache": True, "error_model": "numpy", "forceinline": True, "_nrt": False}
"""Compile into the caller, and do not count references to arrays: for a run of twenty pixels the counting cost as much
as the arithmetic. Such a function may cut arrays into views, but must neither make nor return one."""
