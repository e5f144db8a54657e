"""Ground truth of a recording: ego poses at the images' own times, and a simulator's noise-free ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixo_env.errors import RecordingError
from mixo_env.geometry import wrap_angle_rad
from mixo_env.nuscenes.scene import CameraReel, ExactPoses
from mixo_env.recordings.clock import Rounds

FloatArray = NDArray[np.float64]


def step_truth(reels: Mapping[str, CameraReel], rounds: Rounds) -> dict[str, NDArray[np.generic]]:
    """``truth.*`` and ``is_keyframe`` columns: the ego pose of the image that closes each step.

    The distance is the chord between consecutive poses, negative when the car moves against its mean heading.
    """
    rows = np.arange(len(rounds))
    image = np.maximum(rounds.image, 0)

    def at_close(field: str) -> NDArray[np.generic]:
        values = [getattr(reels[c], field)[image[:, j]] for j, c in enumerate(rounds.cameras)]
        return np.stack(values, axis=1)[rows, rounds.closing_camera]

    x, y, yaw = (at_close(name).astype(np.float64) for name in ("x_m", "y_m", "yaw_rad"))
    increment = wrap_angle_rad(np.diff(yaw))
    yaw = yaw[0] + np.concatenate([[0.0], np.cumsum(increment)])
    return {
        "is_keyframe": at_close("is_keyframe"),
        "truth.x_m": x,
        "truth.y_m": y,
        "truth.yaw_rad": yaw,
        "truth.yaw_increment_rad": np.concatenate([[np.nan], increment]),
        "truth.distance_m": np.concatenate([[np.nan], signed_chords(x, y, yaw)]),
    }


def signed_chords(x_m: FloatArray, y_m: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Distances ``(n - 1,)`` [m] between ``(n,)`` poses, negative against the mean heading [rad, unwrapped]."""
    middle = 0.5 * (yaw_rad[1:] + yaw_rad[:-1])
    dx, dy = np.diff(x_m), np.diff(y_m)
    return np.copysign(np.hypot(dx, dy), dx * np.cos(middle) + dy * np.sin(middle))


def exact_truth(exact: ExactPoses, rounds: Rounds) -> dict[str, FloatArray]:
    """``exact.*`` columns: the simulator's noise-free poses at t_k; NaN outside the span they cover."""
    origin = exact.timestamp_us[0]
    # Seconds from the first pose: microseconds since 1970 would leave no digits for the interpolation weights.
    at, known = (1e-6 * (times - origin) for times in (rounds.closing_time_us, exact.timestamp_us))
    poses = {"exact.x_m": exact.x_m, "exact.y_m": exact.y_m, "exact.yaw_rad": np.unwrap(exact.yaw_rad)}
    return {name: np.interp(at, known, values, left=np.nan, right=np.nan) for name, values in poses.items()}


def own_window_truth(reel: CameraReel, image: NDArray[np.int64]) -> FloatArray:
    """True yaw increment of one camera since its previous image, from its own poses.

    Args:
        reel: the camera.
        image: ``(rounds,)`` its image in each round, negative where it did not fire.

    Returns:
        ``(rounds,)`` rad; NaN without an image and at the camera's first one.
    """
    increment = np.full(len(image), np.nan)
    fired = np.flatnonzero(image >= 0)
    increment[fired[1:]] = wrap_angle_rad(np.diff(reel.yaw_rad[image[fired]]))
    return increment


def exact_own_window_increments(columns: Mapping[str, NDArray[Any]], camera: str) -> FloatArray:
    """Noise-free yaw increment of one camera since its previous image, from a simulator's truth.

    ``exact.yaw_rad`` is known at the closing times; between them a cubic through the four nearest says where the car
    headed at each image.

    Args:
        columns: of one scene, ``(rows,)`` each.
        camera: whose image times.

    Returns:
        ``(rows,)`` rad, beside ``own_window_truth_yaw_increment_rad``; NaN without an image, at the camera's first one,
        where the one before was taken before t_0, and on real data.

    Raises:
        RecordingError: for recordings without own-window columns.
    """
    name = f"{camera}.image_time_offset_s"
    if name not in columns:
        raise RecordingError(f"recordings without own-window columns ({name}): record anew")
    offset = 1e-6 * np.rint(1e6 * columns[name].astype(np.float64))
    fired = np.flatnonzero(np.isfinite(offset))
    increment = np.full(len(offset), np.nan)
    yaw = _cubic(columns["time_s"][fired] + offset[fired], columns["time_s"], columns["exact.yaw_rad"])
    increment[fired[1:]] = np.diff(yaw)
    return increment


def _cubic(at: ArrayLike, known: FloatArray, values: FloatArray) -> FloatArray:
    """Cubic through the four samples nearest to each time (fewer if there are fewer); NaN outside their span."""
    at = np.asarray(at, dtype=np.float64)
    count = min(4, len(known))
    first = np.clip(np.searchsorted(known, at, side="right") - 2, 0, len(known) - count)
    result = np.zeros(at.shape)
    for i in range(count):
        weight = np.ones(at.shape)
        for j in range(count):
            if j != i:
                weight *= (at - known[first + j]) / (known[first + i] - known[first + j])
        result += weight * values[first + i]
    return np.where((at >= known[0]) & (at <= known[-1]), result, np.nan)
