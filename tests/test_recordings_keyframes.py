"""Recordings at key frames only."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.errors import RecordingError
from mixo_env.experts.expert import State
from mixo_env.geometry import wrap_angle_rad
from mixo_env.recordings.keyframes import at_keyframes
from mixo_env.recordings.store import load_recordings, save_recordings
from tests.synthetic import synthetic_recordings


def test_steps_between_key_frames_add_up(tmp_path):
    recordings = synthetic_recordings(scenes=3, steps=40)
    sparse = at_keyframes(recordings)
    for i, scene in enumerate(sparse.scenes):
        dense, rows = recordings.rows(i), sparse.rows(i)
        keys = np.flatnonzero(dense["is_keyframe"])
        assert scene.rows == len(keys)
        np.testing.assert_array_equal(rows["timestamp_us"], dense["timestamp_us"][keys])
        np.testing.assert_array_equal(rows["step"], np.arange(len(keys)))
        assert rows["time_s"][0] == rows["dt_s"][0] == 0.0
        np.testing.assert_allclose(np.diff(rows["time_s"]), rows["dt_s"][1:], atol=1e-9)
        turned = wrap_angle_rad(np.diff(dense["truth.yaw_rad"][keys]))
        np.testing.assert_allclose(rows["truth.yaw_increment_rad"][1:], turned, atol=1e-9)
        for a, b, k in zip(keys, keys[1:], range(1, len(keys)), strict=False):
            part = slice(a + 1, b + 1)
            for name in ("CAM_FRONT.yaw_increment_rad", "INERTIAL.yaw_increment_rad", "distance_m"):
                np.testing.assert_allclose(rows[name][k], dense[name][part].sum(dtype=np.float64), rtol=1e-5, atol=1e-7)
            spread = np.sqrt(np.sum(dense["INERTIAL.yaw_std_rad"][part].astype(np.float64) ** 2))
            assert rows["INERTIAL.yaw_std_rad"][k] == pytest.approx(spread, rel=1e-4)
            assert rows["CAM_BACK.matches"][k] == pytest.approx(dense["CAM_BACK.matches"][part].mean(), rel=1e-4)
            tracking = np.isfinite(dense["CAM_FRONT.yaw_increment_rad"][part]).all()
            between = dense["CAM_FRONT.state"][part].tolist()
            broken = next((s for s in (State.LOST, State.INITIALISING) if s in between), State.NO_IMAGE)
            assert rows["CAM_FRONT.state"][k] == (State.TRACKING if tracking else broken)
        assert np.isnan(rows["truth.yaw_increment_rad"][0])
    assert set(sparse.manifest.linear_weights["PAPER"]) == {"none", "0", "1", "2"}
    save_recordings(sparse, tmp_path)
    assert len(load_recordings(tmp_path)) == 3


def test_a_missed_image_is_no_lost_track_and_a_loss_is_not_forgotten():
    """Steps of ten rows: one misses an image, one is lost for a row and back, the rest tracks."""
    recordings = synthetic_recordings(scenes=1, steps=30)
    rows = recordings.offsets[-1]
    state, turn = np.full(rows, State.TRACKING, np.int8), np.full(rows, 0.01, np.float32)
    state[[5, 15]] = State.NO_IMAGE, State.LOST
    turn[[0, 5, 6, 15]] = np.nan
    marks = np.arange(rows) % 10 == 0
    columns = {"is_keyframe": marks, "CAM_FRONT.state": state, "CAM_FRONT.yaw_increment_rad": turn}
    sparse = at_keyframes(recordings.replace(columns=columns))
    assert sparse["CAM_FRONT.state"][1:].tolist() == [State.NO_IMAGE, State.LOST, State.TRACKING]


def test_what_lies_before_the_first_key_frame_is_left_out():
    recordings = synthetic_recordings(scenes=1, steps=30)
    marks = np.zeros(len(recordings["step"]), dtype=bool)
    marks[[4, 10]] = True
    sparse = at_keyframes(recordings.replace(columns={"is_keyframe": marks}))
    assert len(sparse["step"]) == 2
    assert sparse["dt_s"][1] == pytest.approx(recordings["dt_s"][5:11].sum())


def test_a_scene_needs_two_key_frames():
    recordings = synthetic_recordings(scenes=1)
    with pytest.raises(RecordingError, match="expected at least 2 key frames, got 0"):
        at_keyframes(recordings.replace(columns={"is_keyframe": np.zeros(len(recordings["step"]), dtype=bool)}))
