"""When the sensors fire: cameras on the lidar's 50 ms grid, staggered, with dropped frames; key frames at 2 Hz.

Source of every number: NUSCENES.md section 4 and the frame intervals of real scenes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.nuscenes.selections import CAMERA_OFFSET_US, LIDAR_PERIOD_US

IntArray = NDArray[np.int64]

ROUNDS_PER_KEYFRAME = 6

MAX_STAMP_ERROR_US = 500
_PATTERN_TURNS = (2, 2, 1)  # 100, 100, 50 ms: twelve exposures spread over twenty lidar turns
_KEYFRAME_SHIFT_PROBABILITY = 0.065  # a key frame one round early or late: 450 and 550 ms intervals
_DROP_PROBABILITY = 0.01  # of a sweep; key frames are complete by definition
_GRID_JITTER_US = 30.0
_CONSTANT_STAMP_ERROR_US = 400.0
_JITTER_STAMP_ERROR_US = 30.0


@dataclass(frozen=True)
class CameraTimes:
    """Frames of one camera in one scene, in time order.

    Attributes:
        timestamp_us: ``(n,)`` as written.
        exposure_us: ``(n,)`` when the shutter really opens, at most 0.5 ms from the written time.
        is_keyframe: ``(n,)`` bool; every camera has one key frame per sample.
    """

    timestamp_us: IntArray
    exposure_us: IntArray
    is_keyframe: NDArray[np.bool_]


@dataclass(frozen=True)
class SceneTimes:
    """All firing times of one scene: ``sample_us`` ``(K,)`` are the lidar times of the key frames."""

    sample_us: IntArray
    cameras: dict[str, CameraTimes]


def scene_times(rng: np.random.Generator, start_us: int, seconds: int) -> SceneTimes:
    """Fire all six cameras of one scene.

    Args:
        rng: all six cameras are drawn, so that the choice of channels does not change any of them.
        start_us: lidar time of the first key frame.
        seconds: length of the scene; it has two key frames per second.
    """
    keyframes = 2 * seconds
    shift_probability = _KEYFRAME_SHIFT_PROBABILITY / 2.0
    shift = rng.choice([-1, 0, 1], size=keyframes, p=[shift_probability, 1 - 2 * shift_probability, shift_probability])
    shift[1:][shift[:-1] != 0] = 0
    shift[[0, -1]] = 0
    key_rounds = ROUNDS_PER_KEYFRAME * np.arange(keyframes) + shift

    rounds = int(key_rounds[-1]) + 1
    phase = int(rng.integers(len(_PATTERN_TURNS)))
    steps = np.resize(np.roll(_PATTERN_TURNS, phase), rounds - 1)
    lidar_us = start_us + LIDAR_PERIOD_US * np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)
    is_keyframe = np.zeros(rounds, dtype=np.bool_)
    is_keyframe[key_rounds] = True

    cameras = {}
    for channel, offset_us in CAMERA_OFFSET_US.items():
        fired = is_keyframe | (rng.uniform(size=rounds) >= _DROP_PROBABILITY)
        timestamp = lidar_us + offset_us + _rounded(_GRID_JITTER_US * rng.standard_normal(rounds))
        error = rng.uniform(-1, 1) * _CONSTANT_STAMP_ERROR_US + _JITTER_STAMP_ERROR_US * rng.standard_normal(rounds)
        exposure = timestamp + _rounded(np.clip(error, -MAX_STAMP_ERROR_US, MAX_STAMP_ERROR_US))
        cameras[channel] = CameraTimes(timestamp[fired], exposure[fired], is_keyframe[fired])
    return SceneTimes(lidar_us[key_rounds], cameras)


def _rounded(value_us: NDArray[np.float64]) -> IntArray:
    return np.rint(value_us).astype(np.int64)
