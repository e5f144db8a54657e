"""Poses seen from above."""

from __future__ import annotations

from dataclasses import dataclass

from mixo_env.geometry import FloatArray


@dataclass(frozen=True)
class PlanarPoses:
    """Planar poses ``(N,)`` each in the map frame, several scenes one after another; yaw need not be wrapped."""

    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.x_m)
