"""Ground truth of a recording: ego poses at the images' own times, never at anything else."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import wrap_angle_rad
from mixo_env.nuscenes.scene import CameraTrack, ExactPoses
from mixo_env.recordings.clock import Rounds

FloatArray = NDArray[np.float64]


def step_truth(tracks: Mapping[str, CameraTrack], rounds: Rounds) -> dict[str, NDArray[np.generic]]:
    """``truth.*`` and ``is_keyframe`` columns: the ego pose of the image that closes each step.

    The distance is the chord between consecutive poses, negative when the car moves against its mean heading.
    """
    rows = np.arange(len(rounds))
    image = np.maximum(rounds.image, 0)

    def at_close(field: str) -> NDArray[np.generic]:
        values = [getattr(tracks[c], field)[image[:, j]] for j, c in enumerate(rounds.cameras)]
        return np.stack(values, axis=1)[rows, rounds.closing_camera]

    x, y, yaw = (at_close(name).astype(np.float64) for name in ("x_m", "y_m", "yaw_rad"))
    increment = wrap_angle_rad(np.diff(yaw))
    yaw = yaw[0] + np.concatenate([[0.0], np.cumsum(increment)])
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    dx, dy = np.diff(x), np.diff(y)
    chord = np.copysign(np.hypot(dx, dy), dx * np.cos(middle) + dy * np.sin(middle))
    return {
        "is_keyframe": at_close("is_keyframe"),
        "truth.x_m": x,
        "truth.y_m": y,
        "truth.yaw_rad": yaw,
        "truth.yaw_increment_rad": np.concatenate([[np.nan], increment]),
        "truth.distance_m": np.concatenate([[np.nan], chord]),
    }


def exact_truth(exact: ExactPoses, rounds: Rounds) -> dict[str, FloatArray]:
    """``exact.*`` columns: the simulator's noise-free poses at t_k; NaN outside the span they cover."""
    origin = exact.timestamp_us[0]
    # Seconds from the first pose: microseconds since 1970 would leave no digits for the interpolation weights.
    at, known = (1e-6 * (times - origin) for times in (rounds.closing_time_us, exact.timestamp_us))
    poses = {"exact.x_m": exact.x_m, "exact.y_m": exact.y_m, "exact.yaw_rad": np.unwrap(exact.yaw_rad)}
    return {name: np.interp(at, known, values, left=np.nan, right=np.nan) for name, values in poses.items()}


def own_window_truth(track: CameraTrack, image: NDArray[np.int64]) -> FloatArray:
    """True yaw increment of one camera since its previous image, from its own poses.

    Args:
        track: the camera.
        image: ``(rounds,)`` its image in each round, negative where it did not fire.

    Returns:
        ``(rounds,)`` rad; NaN without an image and at the camera's first one.
    """
    increment = np.full(len(image), np.nan)
    fired = np.flatnonzero(image >= 0)
    increment[fired[1:]] = wrap_angle_rad(np.diff(track.yaw_rad[image[fired]]))
    return increment
