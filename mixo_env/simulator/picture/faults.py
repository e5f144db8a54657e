"""Faults of one camera at the pixels: frozen and black, applied to the finished picture before it becomes a JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, unknown

KINDS = ("frozen", "black")


@dataclass(frozen=True)
class PixelFault:
    """One fault of one camera over ``start_s`` <= t < ``end_s`` [s since the scene began]."""

    kind: str
    camera: str
    start_s: float
    end_s: float

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ConfigurationError(unknown("camera fault", self.kind, KINDS))
        if not 0.0 <= self.start_s < self.end_s:
            raise ConfigurationError(
                f"a fault must end after it starts, got {self.start_s:g} to {self.end_s:g} s: change the seconds"
            )


def spoil(
    image: NDArray[np.uint8], last: NDArray[np.uint8] | None, fault: PixelFault, time_s: float
) -> NDArray[np.uint8]:
    """Picture (h, w, 3) as written; ``last`` is the picture written before it, which a frozen camera repeats."""
    if not fault.start_s <= time_s < fault.end_s:
        return image
    if fault.kind == "black":
        return np.zeros_like(image)
    return image if last is None else last
