"""The trajectory itself: poses in space with or without times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixo_env.errors import TrajectoryError
from mixo_env.geometry import (
    FloatArray,
    quaternion_wxyz_from_rotation,
    quaternion_wxyz_from_yaw,
    rotation_from_quaternion_wxyz,
    yaw_from_quaternion_wxyz,
)


@dataclass(frozen=True)
class Trajectory:
    """N poses: each takes body coordinates to the world.

    Attributes:
        positions_m: ``(N, 3)``.
        quaternions_wxyz: ``(N, 4)``, of unit length; q and -q are the same rotation.
        timestamps_s: ``(N,)`` increasing, or ``None`` for a file without times.
        camera_axes: body and world axes are x right, y down, z forward, as the KITTI format defines them; otherwise z
            points up. Only what is seen *from above* (heading, top view) depends on it.
        counted: the times are whole numbers that may number the frames of a file without times.
    """

    positions_m: FloatArray
    quaternions_wxyz: FloatArray
    timestamps_s: FloatArray | None = None
    camera_axes: bool = False
    counted: bool = False

    def __post_init__(self) -> None:
        """Check the shapes; values are checked where files are read."""
        n = len(self.positions_m)
        if self.positions_m.shape != (n, 3) or self.quaternions_wxyz.shape != (n, 4):
            raise TrajectoryError(
                f"expected positions (N, 3) and quaternions (N, 4), got {self.positions_m.shape} and "
                f"{self.quaternions_wxyz.shape}; pass one row per pose"
            )
        if self.timestamps_s is not None and self.timestamps_s.shape != (n,):
            raise TrajectoryError(f"expected {n} timestamps, one per pose, got shape {self.timestamps_s.shape}")

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.positions_m)

    def __getitem__(self, rows: slice | NDArray[np.int64] | NDArray[np.bool_]) -> Trajectory:
        """The poses at ``rows``, in that order."""
        times = None if self.timestamps_s is None else self.timestamps_s[rows]
        return Trajectory(self.positions_m[rows], self.quaternions_wxyz[rows], times, self.camera_axes, self.counted)

    @classmethod
    def from_planar(
        cls, x_m: ArrayLike, y_m: ArrayLike, yaw_rad: ArrayLike, timestamps_s: FloatArray | None = None
    ) -> Self:
        """Poses in the plane z = 0 from arrays ``(N,)`` each."""
        x = np.asarray(x_m, dtype=np.float64)
        y = np.asarray(y_m, dtype=np.float64)
        return cls(np.stack([x, y, np.zeros_like(x)], axis=-1), quaternion_wxyz_from_yaw(yaw_rad), timestamps_s)

    @classmethod
    def from_matrices(
        cls, matrices: ArrayLike, timestamps_s: FloatArray | None = None, *, camera_axes: bool = False
    ) -> Self:
        """Poses from matrices ``(N, 3, 4)`` or ``(N, 4, 4)``; rounded rotations become the nearest true ones."""
        m = np.asarray(matrices, dtype=np.float64)
        return cls(m[:, :3, 3].copy(), quaternion_wxyz_from_rotation(m[:, :3, :3]), timestamps_s, camera_axes)

    def matrices(self) -> FloatArray:
        """Poses as ``(N, 4, 4)``."""
        m = np.tile(np.eye(4), (len(self), 1, 1))
        m[:, :3, :3] = rotation_from_quaternion_wxyz(self.quaternions_wxyz)
        m[:, :3, 3] = self.positions_m
        return m

    def planar(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What is seen from above: ``x_m``, ``y_m`` and ``yaw_rad`` (unwrapped), ``(N,)`` each, anticlockwise positive.

        With camera axes the plane is spanned by z (becomes x) and -x (becomes y).
        """
        if not self.camera_axes:
            x, y = self.positions_m[:, 0], self.positions_m[:, 1]
            yaw = yaw_from_quaternion_wxyz(self.quaternions_wxyz)
        else:
            x, y = self.positions_m[:, 2], -self.positions_m[:, 0]
            forward = rotation_from_quaternion_wxyz(self.quaternions_wxyz)[:, :, 2]
            yaw = np.arctan2(-forward[:, 0], forward[:, 2])
        return x, y, np.unwrap(yaw)
