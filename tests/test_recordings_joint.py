"""JOINT in a recording: it changes nothing of the others, and nobody but its own row meets it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from experiments.joint_odometry import study
from mixo_env.envs.replay import Replay
from mixo_env.errors import ConfigurationError, RecordingError
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.leaderboard.board import build
from mixo_env.nuscenes.selections import ALL_CAMERAS, CAMERAS
from mixo_env.recordings.joint import JOINT, host
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.schema import HEADLINE_TRACKS, VARIANT_COLUMNS
from mixo_env.recordings.steps import Experts, record_scene
from mixo_env.recordings.store import load_recordings
from tests.recording_fakes import FakeCamera, FakeDataset, FakeInertial, make_scene
from tests.synthetic import synthetic_recordings

EXPERTS = Experts(partial(MonocularOdometry), FakeInertial)


def test_other_columns_keep_their_bits(tmp_path):
    scene = make_scene(tmp_path)
    alone, _ = record_scene(scene, EXPERTS)
    table, timings = record_scene(scene, replace(EXPERTS, joint=JointConfig()))
    assert set(table) - set(alone) == {f"{JOINT}.{name}" for name in VARIANT_COLUMNS}
    for name, values in alone.items():
        np.testing.assert_array_equal(table[name], values)
    assert set(timings["camera"]) == {*CAMERAS, JOINT}


def test_recorded_and_loaded_by_name_only(tmp_path):
    dataset = FakeDataset({"scene-2001": make_scene(tmp_path)})
    off, on = RecordConfig(), RecordConfig(joint=JointConfig())
    assert "joint" not in off.parameters()
    assert off.parameters().items() <= on.parameters().items()
    made = record(dataset, on, tmp_path / "out", experts=replace(EXPERTS, joint=on.joint))
    assert made.manifest.variants == {JOINT: "CAM_BACK"}
    assert load_recordings(tmp_path / "out").column_names == made.column_names


def test_it_needs_the_matches_of_the_own_odometry(tmp_path):
    with pytest.raises(ConfigurationError, match="FakeCamera"):
        record_scene(make_scene(tmp_path), Experts(FakeCamera, FakeInertial, joint=JointConfig()))


def test_it_takes_the_place_of_the_camera_that_fires_last():
    assert host(CAMERAS) == "CAM_BACK"
    assert host(ALL_CAMERAS) == "CAM_BACK_LEFT"
    assert host(("CAM_FRONT",)) == "CAM_FRONT"


def test_it_has_a_row_but_no_vote_and_enters_no_oracle():
    bare = synthetic_recordings(0)
    exact = {f"{JOINT}.{name}": bare[f"CAM_BACK.{name}"].copy() for name in VARIANT_COLUMNS}
    exact[f"{JOINT}.yaw_increment_rad"] = bare["truth.yaw_increment_rad"].astype(np.float32)
    recordings = bare.replace(replace(bare.manifest, variants={JOINT: "CAM_BACK"}), exact)
    for track in HEADLINE_TRACKS:
        assert recordings.voters(track) == bare.voters(track)
        one, other = (Replay(each, track=track) for each in (recordings, bare))
        for replay in (one, other):
            replay.reset(np.arange(len(bare)))
        np.testing.assert_array_equal(one.observe_flat(), other.observe_flat())
    rows = ("CAM_BACK", JOINT, "HUBER", "MULTICAMERA GT", "ORACLE ALL")
    with_it = build(recordings, policies=rows, tracks=("VISION",)).standings[0].rows
    without = build(bare, policies=[row for row in rows if row != JOINT], tracks=("VISION",)).standings[0].rows
    assert [row.name for row in with_it if not row.votes] == [JOINT]
    scores = {row.name: row.headline for row in with_it}
    assert all(scores[row.name] == row.headline for row in without)
    assert scores[JOINT].yaw_increment_rmse_deg < 0.1 * scores["CAM_BACK"].yaw_increment_rmse_deg


def test_the_study_prints_a_row_for_every_camera_joint_and_huber():
    bare = synthetic_recordings(0)
    same = {f"{JOINT}.{name}": bare[f"CAM_BACK.{name}"] for name in VARIANT_COLUMNS}
    table = study(bare.replace(replace(bare.manifest, variants={JOINT: "CAM_BACK"}), same), {JOINT: 1.5})
    rows = {row[0]: row[1:] for row in table.rows}
    assert set(rows) == {*CAMERAS, JOINT, "HUBER"}
    assert rows[JOINT][:-1] == pytest.approx(rows["CAM_BACK"][:-1], nan_ok=True)
    assert rows[JOINT][-1] == 1.5
    inside = rows["CAM_FRONT"][5]
    assert isinstance(inside, float)
    assert 55.0 < inside < 80.0  # its noise is normal with the recorded standard deviation
    with pytest.raises(RecordingError, match="--experts JOINT"):
        study(bare, {})
