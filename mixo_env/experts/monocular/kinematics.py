"""How a camera moves with its car: from the motion of the rear axle to that of a camera mounted somewhere on it.

Ego axes x forward, y left, z up at the rear axle; camera axes x right, y down, z forward. A motion is yaw, pitch, roll
[rad] and slip, heave [m]: the rotation first from second ego frame is R_z(yaw) R_y(pitch) R_x(roll), and the camera is
displaced by

    t = arc(yaw, distance) + (R_z(yaw) - I) lever + (0, slip, heave).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled

FloatArray = NDArray[np.float64]

_STILL_M = 1e-4  # stands for zero distance, keeps epipolar directions defined; below 0.1 px everywhere


@compiled
def never_zero(distance: float) -> float:
    """Distance [m], kept off zero so that epipolar directions stay defined."""
    if abs(distance) < _STILL_M:
        return -_STILL_M if distance < 0.0 else _STILL_M
    return distance


@compiled
def camera_displacement(yaw: float, distance: float, lever_x: float, lever_y: float) -> tuple[float, float]:
    """Displacement x, y [m] of a camera at the lever arm while the rear axle follows an arc, in first ego axes."""
    half = 0.5 * yaw
    chord = distance * (1.0 - half * half / 6.0) if abs(half) < 1e-4 else distance * math.sin(half) / half
    c, s = math.cos(yaw), math.sin(yaw)
    x = chord * math.cos(half) + (c - 1.0) * lever_x - s * lever_y
    y = chord * math.sin(half) + s * lever_x + (c - 1.0) * lever_y
    return x, y


@compiled
def tilted_rotation(yaw: float, pitch: float, roll: float) -> FloatArray:
    """R_z(yaw) R_y(pitch) R_x(roll), ``(3, 3)``."""
    # Compiled, in the innermost loop of the solver: geometry.rotation_from_roll_pitch_yaw is the one for all else.
    cz, sz, cy, sy, cx, sx = (
        math.cos(yaw),
        math.sin(yaw),
        math.cos(pitch),
        math.sin(pitch),
        math.cos(roll),
        math.sin(roll),
    )
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


@compiled
def camera_motion(
    motion: FloatArray, distance: float, rotation: FloatArray, position: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Pose of the second camera in the axes of the first.

    Args:
        motion: yaw, pitch, roll [rad], slip, heave [m]; more is ignored.
        distance: travelled by the rear axle [m], not zero.
        rotation: ``(3, 3)`` ego from camera.
        position: ``(3,)`` camera in the ego frame [m].

    Returns:
        The rotation first from second camera ``(3, 3)`` and the displacement ``(3,)`` [m]: a point seen at
        h2 = (x, y, 1) with inverse depth rho in the second is seen along rotation h2 + rho displacement in the first.
    """
    c_t = np.ascontiguousarray(rotation.T)
    x, y = camera_displacement(motion[0], distance, position[0], position[1])
    m = c_t @ tilted_rotation(motion[0], motion[1], motion[2]) @ rotation
    return m, c_t @ np.array([x, y + motion[3], motion[4]])
