"""Body axes of other programs, and poses turned into the vehicle's: x forward, y left, z up, from the origin on."""

from __future__ import annotations

from typing import Literal

import numpy as np

from mixo_env.geometry import quaternion_wxyz_from_rotation
from mixo_env.trajectory.poses import Trajectory

Axes = Literal["file", "vehicle", "camera", "ned", "opengl"]
"""Body axes: as the format defines them (KITTI: camera, others: vehicle), or one of ``BODY_AXES``."""

BODY_AXES: dict[str, tuple[tuple[int, int, int], ...]] = {
    "vehicle": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "camera": ((0, 0, 1), (-1, 0, 0), (0, -1, 0)),
    "ned": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "opengl": ((0, 0, -1), (-1, 0, 0), (0, 1, 0)),
}
"""Name -> directions forward, left and up of the car in body axes.

``camera``: x right, y down, z forward; ``ned``: x forward, y right, z down; ``opengl``: x right, y up, z backward.
"""


def resolved(trajectory: Trajectory, axes: Axes) -> str:
    """The name in ``BODY_AXES`` of the axes of a trajectory."""
    return axes if axes != "file" else "camera" if trajectory.camera_axes else "vehicle"


def in_vehicle_axes(trajectory: Trajectory, axes: Axes = "file") -> Trajectory:
    """The same motion by poses of the vehicle relative to its first one.

    The frame of the file drops out, however it is placed and tilted; which way the body looks does not.

    Args:
        trajectory: as read.
        axes: of its body.
    """
    body = np.eye(4)
    body[:3, :3] = np.array(BODY_AXES[resolved(trajectory, axes)], dtype=np.float64).T
    poses = trajectory.matrices()
    rotation, position = poses[:, :3, :3], poses[:, :3, 3]
    relative = np.tile(np.eye(4), (len(poses), 1, 1))
    relative[:, :3, :3] = rotation[0].T @ rotation
    relative[:, :3, 3] = (position - position[0]) @ rotation[0]
    turned = body.T @ relative @ body
    return Trajectory(
        turned[:, :3, 3], quaternion_wxyz_from_rotation(turned[:, :3, :3]), trajectory.timestamps_s, camera_axes=False
    )
