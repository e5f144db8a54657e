"""Inner loops written once in plain Python: interpreted for one pair of files, compiled by numba for large batches.

Importing numba and loading cached machine code costs half a second, more than scoring one pair; both speeds run the
same source and give the same numbers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any


@functools.cache
def compiled(loop: Callable[..., Any]) -> Callable[..., Any]:
    """``loop`` compiled, once per process; numba keeps the machine code on disk for the next."""
    import numba

    return numba.njit(cache=True)(loop)
