"""Checks of the true poses: their times, their order of components, and whether a car can drive so."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mixo_env.geometry import FloatArray, wrap_angle_rad
from mixo_env.nuscenes.checks.evidence import Evidence, Finding, TruePath
from mixo_env.nuscenes.scene import CameraReel
from mixo_env.nuscenes.selections import STANDING_M

LATEST_POSE_S = 0.005
"""A pose is written for the time of its image."""

STEEPEST_DEG = 20.0
"""The steepest street in the world has 19 degrees; nuScenes stays below 4."""

FASTEST_MPS = 50.0
FASTEST_TURN_RADPS = 2.0
LONGEST_JUMP_M = 0.5
"""A pose off the path of its neighbours; 0.03 m in real data."""

COURSE_TOLERANCE_DEG = 20.0
COURSE_SPEED_MPS = 1.0
COURSE_WAY_M = 3.0


def pose_times(evidence: Evidence) -> Iterator[Finding]:
    """The pose of an image has the time of the image."""
    for camera, delay in evidence.pose_delay_s.items():
        late = np.abs(delay) > LATEST_POSE_S
        if late.any():
            yield Finding(
                "pose-time",
                f"{camera}: {np.count_nonzero(late)} of {len(delay)} images have a pose of another time, "
                f"by up to {np.abs(delay).max():.3g} s; one pose an image is expected",
            )


def pose_tilt(evidence: Evidence) -> Iterator[Finding]:
    """The car stands upright on the map."""
    for camera, tilt in evidence.tilt_rad.items():
        steep = np.degrees(tilt) > STEEPEST_DEG
        if steep.any():
            yield Finding(
                "pose-tilt",
                f"{camera}: {np.count_nonzero(steep)} of {len(tilt)} ego poses are tilted, by up to "
                f"{np.degrees(tilt).max():.0f} deg: quaternions not in the order w, x, y, z?",
            )


def pose_course(evidence: Evidence) -> Iterator[Finding]:
    """The car points where it goes."""
    if evidence.path is None:
        return
    offset = course_offset_rad(evidence.path)
    if offset is not None and abs(np.degrees(offset)) > COURSE_TOLERANCE_DEG:
        yield Finding(
            "pose-heading",
            f"the heading is {np.degrees(-offset):.0f} deg off the direction of motion: quaternions not in the order "
            "w, x, y, z, or from another frame? (a car that only reverses looks so, too)",
        )


def course_offset_rad(path: TruePath, straight_only: bool = False) -> float | None:
    """Median of the direction of motion minus the heading; ``None`` if the car moves less than 3 m.

    Args:
        path: of one scene.
        straight_only: leave out turns, in which the rear axle slips.
    """
    # Steps of 0.2 s: those between two cameras are too short against the rounding of positions.
    picks = np.searchsorted(path.time_us, np.arange(path.time_us[0], path.time_us[-1] + 1, 200_000))
    if len(picks) < 3:
        return None
    dt = 1e-6 * np.diff(path.time_us[picks])
    dx, dy, turn = np.diff(path.x_m[picks]), np.diff(path.y_m[picks]), np.diff(path.yaw_rad[picks])
    steps = np.hypot(dx, dy)
    moves = steps > COURSE_SPEED_MPS * dt
    if straight_only:
        moves &= (np.abs(turn) < 0.05 * dt) & (steps > 3.0 * dt)
    if steps[moves].sum() < COURSE_WAY_M:
        return None
    offset = wrap_angle_rad(np.arctan2(dy, dx) - (path.yaw_rad[picks][:-1] + 0.5 * turn))[moves]
    # A mean direction first, so that offsets around 180 deg do not fall into two halves.
    middle = np.arctan2(np.sin(offset).sum(), np.cos(offset).sum())
    return float(wrap_angle_rad(middle + np.median(wrap_angle_rad(offset - middle))))


def pose_jumps(evidence: Evidence) -> Iterator[Finding]:
    """From image to image the car moves and turns as a car can."""
    for camera, reel in evidence.reels.items():
        yield from (Finding("pose-jump", f"{camera}: {text}") for text in _jumps(reel))


def _jumps(reel: CameraReel) -> Iterator[str]:
    dt = 1e-6 * np.diff(reel.timestamp_us)
    if not len(dt):
        return
    steps = np.hypot(np.diff(reel.x_m), np.diff(reel.y_m))
    speed = steps / dt
    if speed.max() > FASTEST_MPS:
        yield f"the poses move at {speed.max():.0f} m/s, {_when(reel, speed)}; at most {FASTEST_MPS:g} is expected"
    elif (jump := np.abs(speed - _running_median(speed)) * dt).max() > LONGEST_JUMP_M:
        yield f"the poses jump by {jump.max():.1f} m, {_when(reel, jump)}; {LONGEST_JUMP_M:g} m is the most"
    turn = np.abs(wrap_angle_rad(np.diff(reel.yaw_rad))) / dt
    if turn.max() > FASTEST_TURN_RADPS:
        yield (
            f"the poses turn at {np.degrees(turn.max()):.0f} deg/s, {_when(reel, turn)}; at most "
            f"{np.degrees(FASTEST_TURN_RADPS):.0f} is expected"
        )


def _when(reel: CameraReel, values: FloatArray) -> str:
    return f"{1e-6 * (reel.timestamp_us[int(values.argmax())] - reel.timestamp_us[0]):.1f} s into the scene"


def _running_median(values: FloatArray) -> FloatArray:
    """Over five values, the ends repeated."""
    padded = np.concatenate([values[:1], values[:1], values, values[-1:], values[-1:]])
    return np.sort(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)[:, 2]


def standing(evidence: Evidence) -> Iterator[Finding]:
    """Whether the car moves at all."""
    path = evidence.path
    if path is not None and path.distance_m[-1] < STANDING_M:
        yield Finding(
            "standing",
            f"the car hardly moves ({path.distance_m[-1]:.1f} m): it tells little of odometry by distance",
            is_problem=False,
        )
