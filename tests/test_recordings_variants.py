"""Reference rows of Table I: retrained vocabularies and no inertial initialisation. They are scored and never vote."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.envs.replay import Replay
from mixo_env.errors import ConfigurationError
from mixo_env.experts.expert import State
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.leaderboard.board import build
from mixo_env.leaderboard.evaluation import instantly_tracking
from mixo_env.leaderboard.report import conventions
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.policies.registry import create, names
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.keyframes import at_keyframes
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.schema import HEADLINE_TRACKS, INERTIAL_EXPERTS, VARIANT_COLUMNS, VehicleConstants, columns
from mixo_env.recordings.steps import Experts, record_scene
from mixo_env.recordings.store import load_recordings, save_recordings
from mixo_env.recordings.variants import WITHOUT_INITIALISATION, as_variant, variants
from mixo_env.recordings.vehicles import travelled_m
from mixo_env.recordings.vocabularies import Retrained
from tests.corridor import calibration, picture
from tests.nuscenes_fixture import DRIVES, write_nuscenes
from tests.recording_fakes import FakeCamera, FakeDataset, FakeInertial, make_scene, write_sliding_texture
from tests.synthetic import synthetic_recordings

OTHER = "CAM_BACK_RIGHT w/ retrained vocabulary"


class Doubtful(FakeCamera):
    """Twice the turn of the other fake."""

    def process(self, image, timestamp_us, distance_m):
        step = super().process(image, timestamp_us, distance_m)
        return replace(step, yaw_increment_rad=2 * step.yaw_increment_rad, inliers=3)


EXPERTS = Experts(FakeCamera, FakeInertial, {OTHER: ("CAM_BACK_RIGHT", Doubtful)})


def with_variant(recordings: Recordings) -> Recordings:
    """A variant of CAM_BACK_RIGHT that says what CAM_FRONT says."""
    manifest = replace(recordings.manifest, variants={OTHER: "CAM_BACK_RIGHT"})
    same = {f"{OTHER}.{column}": recordings[f"CAM_FRONT.{column}"] for column in VARIANT_COLUMNS}
    return recordings.replace(manifest, same)


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return with_variant(synthetic_recordings(0))


def test_a_variant_sees_the_same_images_and_is_recorded_beside_its_camera(tmp_path):
    scene = make_scene(tmp_path)
    table, timings = record_scene(scene, EXPERTS)
    assert list(table) == list(columns(CAMERAS, INERTIAL_EXPERTS, variants=(OTHER,)))
    np.testing.assert_array_equal(table[f"{OTHER}.state"], table["CAM_BACK_RIGHT.state"])
    own = table["CAM_BACK_RIGHT.own_window_yaw_increment_rad"]
    np.testing.assert_allclose(table[f"{OTHER}.own_window_yaw_increment_rad"], 2 * own, rtol=1e-6)
    # It is carried by its own rate: twice the increment is twice the rate.
    np.testing.assert_allclose(
        table[f"{OTHER}.yaw_increment_rad"], 2 * table["CAM_BACK_RIGHT.yaw_increment_rad"], rtol=1e-5
    )
    alone, _ = record_scene(scene, replace(EXPERTS, variants={}))
    for name, values in alone.items():
        np.testing.assert_array_equal(table[name], values)
    assert set(timings["camera"]) == {*CAMERAS, OTHER}


def test_recorded_saved_loaded(tmp_path):
    dataset = FakeDataset({name: make_scene(tmp_path, name) for name in ("scene-2001", "scene-2002")})
    words = tmp_path / "words.npy"
    words.write_bytes(b"anything")
    config = RecordConfig(variants={OTHER: Retrained("CAM_BACK_RIGHT", dict.fromkeys(dataset.scenes, words))})
    made = record(dataset, config, tmp_path / "out", experts=EXPERTS)
    assert made.manifest.variants == {OTHER: "CAM_BACK_RIGHT"}
    assert str(tmp_path) not in (tmp_path / "out" / "manifest.json").read_text()
    assert set(made.manifest.parameters["variants"][OTHER]["vocabulary"]) == set(dataset.scenes)
    shown = as_variant(made, OTHER)
    np.testing.assert_array_equal(shown["CAM_BACK_RIGHT.yaw_increment_rad"], made[f"{OTHER}.yaw_increment_rad"])
    save_recordings(made, tmp_path / "again")
    assert load_recordings(tmp_path / "again").column_names == made.column_names
    words.write_bytes(b"other words")
    with pytest.raises(ConfigurationError, match="another configuration"):
        record(dataset, config, tmp_path / "out", experts=EXPERTS)
    with pytest.raises(ConfigurationError, match="unknown camera of a variant"):
        RecordConfig(cameras=("CAM_FRONT",), variants=config.variants)


def test_variants_have_no_vote_and_are_not_observed(recordings):
    bare = synthetic_recordings(0)
    assert recordings.experts == bare.experts
    for track in HEADLINE_TRACKS:
        assert recordings.voters(track) == bare.voters(track)
        one, other = (Replay(each, track=track) for each in (recordings, bare))
        assert one.layout.width == other.layout.width
        for replay in (one, other):
            replay.reset(np.arange(len(bare)))
        np.testing.assert_array_equal(one.observe_flat(), other.observe_flat())


def test_rows_follow_their_camera_and_are_scored_in_every_track(recordings):
    order = names(recordings)
    assert order[order.index("CAM_BACK_RIGHT") + 1] == OTHER
    assert order[order.index("CAM_FRONT") + 1] == WITHOUT_INITIALISATION
    assert create(OTHER, recordings).name == "CAM_BACK_RIGHT"
    cameras = ("CAM_FRONT", WITHOUT_INITIALISATION, "CAM_BACK_RIGHT", OTHER)
    board = build(recordings, policies=cameras)
    for table in board.standings:
        rows = {row.run.name: row for row in table.rows}
        assert tuple(rows) == cameras
        assert [row.votes for row in rows.values()] == [True, False, True, False]
        assert not any(row.fused for row in rows.values())
        assert rows[OTHER].scores == rows["CAM_FRONT"].scores  # it says the same
        assert repr(rows[OTHER].lost) == repr(rows["CAM_FRONT"].lost)
        assert rows[OTHER].scores != rows["CAM_BACK_RIGHT"].scores
    assert any(OTHER in line and "first good pair" in line for line in conventions(board))


def test_without_initialisation_nothing_moves_until_the_first_track(recordings):
    late = {"n099": VehicleConstants(can_latency_s=0.05)}
    recordings = recordings.replace(replace(recordings.manifest, vehicles=late))
    shown = as_variant(recordings, WITHOUT_INITIALISATION)
    for i in range(len(recordings)):
        rows, before = shown.rows(i), recordings.rows(i)
        first = int(np.argmax(before["CAM_FRONT.state"] == State.TRACKING))
        assert first > 1
        for column in ("CAM_FRONT.yaw_increment_rad", "distance_m"):
            assert np.isnan(rows[column][0])
            assert not rows[column][1:first].any()
            np.testing.assert_array_equal(rows[column][first:], before[column][first:])
        assert not travelled_m(shown)[shown.offsets[i] + 1 : shown.offsets[i] + first].any()  # whatever the latency
        assert before["distance_m"][1:first].all()  # the recordings themselves are as they were
    changed = {name for name in shown.column_names if shown[name] is not recordings[name]}
    assert changed == {"CAM_FRONT.yaw_increment_rad", "distance_m", "speed_mps"}
    table = build(recordings, policies=("CAM_FRONT", WITHOUT_INITIALISATION), tracks=("PAPER",)).standings[0]
    with_it, without = (row.scores["truth"].ate_m for row in table.rows)
    assert without > with_it


def test_without_a_front_camera_there_is_no_such_row(recordings):
    manifest = replace(recordings.manifest, cameras=("CAM_BACK_RIGHT",))
    assert variants(recordings.replace(manifest)) == {OTHER: "CAM_BACK_RIGHT"}


def test_key_frames_of_a_variant(recordings):
    slow = at_keyframes(recordings)
    np.testing.assert_array_equal(slow[f"{OTHER}.state"], slow["CAM_FRONT.state"])
    np.testing.assert_array_equal(slow[f"{OTHER}.yaw_increment_rad"], slow["CAM_FRONT.yaw_increment_rad"])


def test_instant_tracking_needs_no_second_run():
    """What the recorded states say about instant re-initialisation is what a run with it does."""
    camera = calibration()
    config = MonocularConfig(max_pixels=60_000, initial_matches=60)
    instant = replace(config, initial_pairs=1, initial_distance_m=0.0)
    runs = [MonocularOdometry(camera, settings) for settings in (config, instant)]
    dark = {4, 9, 10, 15, 17}
    states, matches = np.zeros((2, 22), np.int8), np.zeros(22)
    for k in range(22):
        image = picture(camera, 0.5 * k, 0.0, 0.01 * math.sin(k), noise_seed=k)
        image = np.zeros_like(image) if k in dark else image
        for which, odometry in enumerate(runs):
            step = odometry.process(image, 100_000 * k + 1, 0.5)
            states[which, k] = step.state
            matches[k] = step.matches
    assert (states[0] != states[1]).any()
    drawn = synthetic_recordings(0, scenes=1, steps=21)
    manifest = replace(drawn.manifest, parameters={"monocular": {"initial_matches": 60}})
    kept = {name: drawn[name][:22] for name in drawn.column_names}
    kept |= {"CAM_FRONT.state": states[0], "CAM_FRONT.matches": matches}
    manifest = replace(manifest, scenes=(replace(manifest.scenes[0], rows=22),))
    found = instantly_tracking(Recordings(manifest, kept), "CAM_FRONT")
    np.testing.assert_array_equal(found, states[1] == State.TRACKING)


def test_retraining_leaves_out_the_fold_of_each_scene(tmp_path, capsys, caplog):
    root, out = tmp_path / "nuscenes", tmp_path / "out"
    truth = write_nuscenes(root, DRIVES[:2], duration_s=2.0, images=False)
    write_sliding_texture(root, truth)
    command = ["record", str(root), "--out", str(out), "--cameras", "CAM_BACK"]
    assert main([*command, "--retrained", "CAM_FRONT"]) == 2
    assert not out.exists()
    assert main([*command, "--retrained", "CAM_BACK"]) == 0, caplog.text
    recordings = load_recordings(out)
    name = "CAM_BACK w/ retrained vocabulary"
    assert recordings.manifest.variants == {name: "CAM_BACK"}
    used = recordings.manifest.parameters["variants"][name]["vocabulary"]
    assert len(used) == 2
    files = sorted(path.name for path in out.glob("vocabularies-*/*"))
    assert files == ["CAM_BACK-all-folds.npy", "CAM_BACK-without-fold-0.npy", "CAM_BACK-without-fold-1.npy"]
    assert np.nanmedian(recordings[f"{name}.matches"]) > 50
    before = {path: path.stat().st_mtime_ns for path in out.glob("vocabularies-*/*")}
    assert main([*command, "--retrained", "CAM_BACK"]) == 0
    assert {path: path.stat().st_mtime_ns for path in out.glob("vocabularies-*/*")} == before
