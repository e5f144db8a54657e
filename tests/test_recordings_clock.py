"""Firing rounds."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.selections import ALL_CAMERAS, CAMERA_OFFSET_US, CAMERAS, LIDAR_PERIOD_US
from mixo_env.recordings.clock import NONE, firing_rounds

START_US = 1_533_151_603_547_590


def turns(count: int) -> np.ndarray:
    """Grid cells in which the rig fires: steps of 2, 2, 1 cells, the real 100/100/50 ms pattern."""
    return np.cumsum([0] + [(2, 2, 1)[i % 3] for i in range(count - 1)])


def stamps(cells: np.ndarray, cameras=CAMERAS, drop=(), jitter_us=0, seed=0) -> dict[str, np.ndarray]:
    """Image times of each camera; ``drop`` holds (camera, round) pairs that never reached the disk."""
    rng = np.random.default_rng(seed)
    table = {}
    for camera in cameras:
        times = (
            START_US
            + cells * LIDAR_PERIOD_US
            + CAMERA_OFFSET_US[camera]
            + rng.integers(-jitter_us, jitter_us + 1, len(cells))
        )
        table[camera] = np.delete(times, [k for name, k in drop if name == camera])
    return table


def test_rounds_of_three_turns_by_hand():
    rounds = firing_rounds({"CAM_FRONT": np.array([-35_500, 64_500]), "CAM_BACK": np.array([-10_400, 89_600, 139_600])})
    np.testing.assert_array_equal(rounds.image, [[0, 0], [1, 1], [NONE, 2]])
    np.testing.assert_array_equal(rounds.closing_time_us, [-10_400, 89_600, 139_600])
    np.testing.assert_array_equal(rounds.closing_camera, [1, 1, 1])
    np.testing.assert_array_equal(rounds.fired, [[True, True], [True, True], [False, True]])


def test_without_the_last_camera_the_round_closes_earlier():
    cells = turns(6)
    rounds = firing_rounds(stamps(cells, drop=[("CAM_BACK", 3)]))
    closes = START_US + cells * LIDAR_PERIOD_US + CAMERA_OFFSET_US["CAM_BACK"]
    closes[3] = START_US + cells[3] * LIDAR_PERIOD_US + CAMERA_OFFSET_US["CAM_BACK_RIGHT"]
    np.testing.assert_array_equal(rounds.closing_time_us, closes)
    assert CAMERAS[rounds.closing_camera[3]] == "CAM_BACK_RIGHT"
    assert rounds.image[3, CAMERAS.index("CAM_BACK")] == NONE
    assert rounds.image[4, CAMERAS.index("CAM_BACK")] == 3


def test_round_zero_is_the_first_complete_one():
    rounds = firing_rounds(stamps(turns(6), drop=[("CAM_FRONT", 0), ("CAM_BACK", 1)]))
    assert len(rounds) == 4
    np.testing.assert_array_equal(rounds.image[0], [1, 2, 1, 2])


@settings(max_examples=40, deadline=None)
@given(
    cameras=st.sampled_from([CAMERAS, ALL_CAMERAS, ("CAM_FRONT",)]),
    steps=st.lists(st.sampled_from([1, 2, 2, 3, 4]), min_size=5, max_size=60),
    dropped=st.sets(st.tuples(st.sampled_from(ALL_CAMERAS), st.integers(1, 50))),
    seed=st.integers(0, 99),
)
def test_jitter_and_dropped_frames_leave_rounds_exact(cameras, steps, dropped, seed):
    cells = np.cumsum([0, *steps])
    drop = [(camera, k) for camera, k in dropped if camera in cameras and k < len(cells)]
    rounds = firing_rounds(stamps(cells, cameras, drop, jitter_us=500, seed=seed))
    expected = np.array([[(camera, k) not in drop for camera in cameras] for k in range(len(cells))])
    expected = expected[expected.any(axis=1)]
    np.testing.assert_array_equal(rounds.fired, expected)
    assert np.all(np.diff(rounds.closing_time_us) > 0)
    later = rounds.closing_time_us[:, None] - rounds.image_time_us
    assert np.all((later[rounds.fired] >= 0) & (later[rounds.fired] <= 45_000))


@pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="needs real data")
@pytest.mark.parametrize("scene", ["0655", "0757"])
def test_real_stamps_of_the_front_camera(scene):
    path = Path(os.environ["MIXO_REAL_DATA"]) / "nuscenes_poses_12hz" / f"scene-{scene}_CAM_FRONT.json"
    content = json.loads(path.read_text())
    frames = content["frames"] if isinstance(content, dict) else content[0]["frames"]
    front = np.array([frame["timestamp"] for frame in frames])
    rng = np.random.default_rng(0)
    table = {
        c: front + CAMERA_OFFSET_US[c] - CAMERA_OFFSET_US["CAM_FRONT"] + rng.integers(-500, 501, len(front))
        for c in CAMERAS
    }
    missing = {c: np.sort(rng.choice(np.arange(1, len(front)), 7, replace=False)) for c in CAMERAS[1:]}
    rounds = firing_rounds({c: np.delete(times, missing.get(c, [])) for c, times in table.items()})
    assert len(rounds) == len(front) == 237
    for j, camera in enumerate(CAMERAS):
        np.testing.assert_array_equal(np.flatnonzero(~rounds.fired[:, j]), missing.get(camera, []))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"CAM_FRONT": np.array([], dtype=np.int64)}, "CAM_FRONT"),
        ({"CAM_FRONT": np.array([0, 0])}, "increase"),
        ({"CAM_FRONT": np.array([0, 20_000])}, "twice"),
        ({"CAM_FRONT": np.array([0]), "CAM_BACK": np.array([100_000])}, "no firing round"),
    ],
)
def test_impossible_timing_is_one_clear_error(table, message):
    with pytest.raises(DatasetError, match=message):
        firing_rounds(table)
