"""The track UNEQUAL: further experts vote in it, and the headline tracks do not notice that they are recorded."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.envs.replay import Replay
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.experts.expert import State
from mixo_env.experts.families import FAMILIES, family_expert, is_family_expert
from mixo_env.experts.imported import Quality
from mixo_env.leaderboard.board import build, requested
from mixo_env.leaderboard.exports import to_json
from mixo_env.leaderboard.sentences import title
from mixo_env.leaderboard.trajectories import ways
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.policies.registry import names
from mixo_env.policies.reinforcement import AGENTS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.importing import with_imported, without
from mixo_env.recordings.joint import JOINT
from mixo_env.recordings.keyframes import at_keyframes
from mixo_env.recordings.schema import HEADLINE_TRACKS, UNEQUAL, VARIANT_COLUMNS
from mixo_env.recordings.sequence_files import Source
from mixo_env.recordings.store import load_recordings, save_recordings
from mixo_env.recordings.variants import variants
from mixo_env.trajectory import Trajectory
from tests.synthetic import synthetic_recordings

TUTORIALS = tuple(family_expert("TUTORIAL", camera) for camera in CAMERAS)
ORB = "ORBSLAM3_FRONT"


def with_further(bare: Recordings, seed: int = 5) -> Recordings:
    """The same drives with JOINT, a poor TUTORIAL on every camera and an imported ORBSLAM3 that knows the truth."""
    rng = np.random.default_rng(seed)
    columns = {f"{JOINT}.{name}": bare[f"CAM_BACK.{name}"] for name in VARIANT_COLUMNS}
    truth = bare["truth.yaw_increment_rad"]
    for camera, expert in zip(CAMERAS, TUTORIALS, strict=True):
        columns |= {f"{expert}.{name}": bare[f"{camera}.{name}"].copy() for name in VARIANT_COLUMNS}
        noise = rng.normal(0.0, 0.01, len(truth)) + rng.choice([0.0, 0.2], len(truth), p=[0.98, 0.02])
        for name in ("yaw_increment_rad", "own_window_yaw_increment_rad", "two_frame_yaw_increment_rad"):
            columns[f"{expert}.{name}"] = (truth + noise).astype(np.float32)
        for name in ("yaw_std_rad", "own_window_yaw_std_rad"):
            columns[f"{expert}.{name}"] = np.full(len(truth), np.nan, np.float32)
        columns[f"{expert}.matches"] = rng.integers(100, 900, len(truth)).astype(np.float32)
    of = {JOINT: "CAM_BACK"} | dict(zip(TUTORIALS, CAMERAS, strict=True))
    recorded = bare.replace(replace(bare.manifest, variants=of), columns)
    return with_imported(recorded, ORB, {scene.name: orb_file(bare, scene.name) for scene in bare.scenes})


def orb_file(bare: Recordings, scene: str) -> Source:
    """The true way with match counts."""
    rows = bare.rows(scene)
    way = Trajectory.from_planar(
        rows["truth.x_m"], rows["truth.y_m"], rows["truth.yaw_rad"], 1e-6 * rows["timestamp_us"]
    )
    nothing = np.full(len(way), np.nan)
    return Source(
        Path("file.txt"), way, "vehicle", Quality(np.full(len(way), 700.0), nothing, nothing, np.zeros(len(way), bool))
    )


@pytest.fixture(scope="module")
def bare() -> Recordings:
    return with_fits(synthetic_recordings(0))


@pytest.fixture(scope="module")
def recordings(bare: Recordings) -> Recordings:
    return with_further(bare)


def test_names() -> None:
    assert family_expert("TUTORIAL", "CAM_FRONT_LEFT") == "TUTORIAL_FRONT_LEFT"
    assert all(is_family_expert(family_expert(family, camera)) for family in FAMILIES for camera in CAMERAS)
    assert not [name for name in (*CAMERAS, JOINT, "TUTORIAL", "LEARNEDLY_FRONT", "INERTIAL") if is_family_expert(name)]


def test_who_votes(bare: Recordings, recordings: Recordings) -> None:
    assert recordings.further == (*TUTORIALS, ORB)
    assert recordings.voters(UNEQUAL) == (*CAMERAS, *TUTORIALS, ORB)
    assert recordings.distinct_tracks == recordings.tracks == (*HEADLINE_TRACKS, UNEQUAL)
    assert bare.distinct_tracks == HEADLINE_TRACKS
    for track in HEADLINE_TRACKS:
        assert recordings.voters(track) == bare.voters(track)
    assert JOINT in variants(recordings)
    assert not set(TUTORIALS) & set(variants(recordings))


@pytest.mark.parametrize("track", HEADLINE_TRACKS)
def test_headline_tracks_keep_their_bits(bare: Recordings, recordings: Recordings, track: str) -> None:
    one, other = (Replay(each, track=track) for each in (recordings, bare))
    assert one.experts == other.experts
    assert one.counting == other.counting
    np.testing.assert_array_equal(one.context, other.context)
    np.testing.assert_array_equal(one.table, other.table)
    np.testing.assert_array_equal(one.votes.increments_rad, other.votes.increments_rad)
    assert recordings.manifest.reward_scale_rad[track] == bare.manifest.reward_scale_rad[track]
    assert recordings.manifest.linear_weights[track] == bare.manifest.linear_weights[track]


@pytest.mark.integration
def test_headline_tables_keep_their_bits(bare: Recordings, recordings: Recordings) -> None:
    """Every number of every row: policies, oracles, floors, comparisons, letters, conditions."""
    rows = [name for name in names(bare) if name not in ("MIXO", *AGENTS)] + ["PERFECT YAW", "NOISE FLOOR"]
    tables = [to_json(build(each, policies=rows, tracks=HEADLINE_TRACKS))["tracks"] for each in (recordings, bare)]
    assert json.dumps(tables[0]) == json.dumps(tables[1])  # NaN is NaN here


def test_gate_keeps_its_bits(bare: Recordings, recordings: Recordings) -> None:
    tables = [build(each, policies=["MIXO"], tracks=("VISION",), folds=(1,)) for each in (recordings, bare)]
    assert json.dumps(to_json(tables[0])["tracks"]) == json.dumps(to_json(tables[1])["tracks"])


def test_key_frames_keep_their_bits(bare: Recordings, recordings: Recordings) -> None:
    one, other = at_keyframes(recordings), at_keyframes(bare)
    for track in HEADLINE_TRACKS:
        np.testing.assert_array_equal(Replay(one, track=track).context, Replay(other, track=track).context)
        assert one.manifest.reward_scale_rad[track] == other.manifest.reward_scale_rad[track]


def test_its_own_table(recordings: Recordings) -> None:
    rows = ("CAM_BACK", JOINT, *TUTORIALS, ORB, "HIGHEST MATCH", "MEDIAN", "LINEAR", "HUBER", "ORACLE ALL")
    board = build(recordings, policies=rows)
    vision, unequal = (next(t for t in board.standings if t.track == track) for track in ("VISION", UNEQUAL))
    assert not {row.name for row in vision.rows} & {*TUTORIALS, ORB}
    assert {row.name for row in unequal.rows} == set(rows)
    by_name = {row.name: row for row in unequal.rows}
    assert [row.name for row in unequal.rows if not row.votes] == [JOINT]
    assert not by_name["TUTORIAL_BACK"].fused
    weights = unequal.linear_weights()[0]
    assert max(weights, key=lambda name: weights[name]) == ORB  # it knows the truth
    assert by_name["LINEAR"].headline.yaw_increment_rmse_deg < by_name["CAM_BACK"].headline.yaw_increment_rmse_deg
    lost = by_name["TUTORIAL_BACK"].lost
    assert lost is not None
    assert lost.counts.sum() > 0
    assert "the experts of other families vote" in title(unequal, recordings.manifest)
    assert "families" not in title(vision, recordings.manifest)


def test_a_single_expert_plays_its_own_columns(recordings: Recordings) -> None:
    """And not those of the camera whose images it saw."""
    (table,) = build(recordings, policies=["CAM_FRONT", "TUTORIAL_FRONT"], tracks=(UNEQUAL,)).standings
    camera, tutorial = ({row.name: row for row in table.rows}[name] for name in ("CAM_FRONT", "TUTORIAL_FRONT"))
    assert tutorial.headline.yaw_increment_rmse_deg > 3 * camera.headline.yaw_increment_rmse_deg


def test_signals_a_gate_can_use(recordings: Recordings) -> None:
    replay = Replay(recordings, track=UNEQUAL)
    assert replay.counting == (*CAMERAS, *TUTORIALS, ORB)
    replay.reset(np.arange(len(recordings)))
    replay.step(np.full((len(recordings), len(replay.experts)), 1.0 / len(replay.experts)))
    seen = replay.observe()
    place = replay.counting.index("TUTORIAL_FRONT")
    first = recordings.offsets[:-1] + 2
    tracking = recordings["TUTORIAL_FRONT.state"][first] == State.TRACKING
    expected = np.where(tracking, recordings["TUTORIAL_FRONT.matches"][first], 0.0)
    np.testing.assert_array_equal(seen["matches"][:, place], expected)
    np.testing.assert_array_equal(seen["state"][:, place], recordings["TUTORIAL_FRONT.state"][first])


def test_counts_of_a_further_expert_are_not_asked_of_others(bare: Recordings, recordings: Recordings) -> None:
    """An imported expert of no family, without match counts, stays uncounted when one with counts joins UNEQUAL."""
    rows = [orb_file(bare, scene.name) for scene in bare.scenes]
    mine = {s.name: replace(row, quality=None) for s, row in zip(bare.scenes, rows, strict=True)}
    alone, beside = (with_imported(each, "MINE", mine) for each in (bare, recordings))
    assert "MINE" in alone.voters("VISION")
    assert beside.voters("VISION") == alone.voters("VISION")
    assert Replay(beside, track="VISION").counting == Replay(alone, track="VISION").counting == CAMERAS
    assert beside.manifest.reward_scale_rad["VISION"] == alone.manifest.reward_scale_rad["VISION"]


def test_environment(recordings: Recordings, bare: Recordings) -> None:
    env = gym.make("MixoOdometry-v0", recordings=recordings, track=UNEQUAL)
    _, info = env.reset(seed=0)
    assert env.action_space.shape == (9,)
    assert info["scene"]
    with pytest.raises(ConfigurationError, match="mixo record --experts TUTORIAL"):
        gym.make("MixoOdometry-v0", recordings=bare, track=UNEQUAL)
    with pytest.raises(ConfigurationError, match="have no price"):
        gym.make("MixoOdometryBudget-v0", recordings=recordings, track=UNEQUAL)


def test_recordings_without_such_experts_say_so_in_one_line(tmp_path, capsys, bare: Recordings) -> None:
    save_recordings(bare, tmp_path / "bare")
    assert main(["benchmark", "--recordings", str(tmp_path / "bare"), "--tracks", UNEQUAL]) == 2
    error = capsys.readouterr().err
    assert "track UNEQUAL needs an expert of another family beside the cameras" in error
    assert len(error.strip().splitlines()) == 1


def test_a_row_of_another_track_is_refused(recordings: Recordings) -> None:
    with pytest.raises(ConfigurationError, match="TUTORIAL_FRONT: shown in track UNEQUAL alone"):
        requested(recordings, ("VISION",), ("TUTORIAL_FRONT",))
    assert requested(recordings, (), ("TUTORIAL_FRONT",)) == ("TUTORIAL_FRONT",)


def test_learned_policies_need_a_second_fold(recordings: Recordings) -> None:
    """The bundled recordings hold none of these experts, so there is nothing else to learn from."""
    one = recordings.select(folds=[0])
    with pytest.raises(PolicyError, match="no bundled recording has their experts"):
        build(one, policies=["LINEAR"], tracks=(UNEQUAL,))


def test_saved_loaded_and_left_out(tmp_path, bare: Recordings, recordings: Recordings) -> None:
    save_recordings(recordings, tmp_path / "all")
    loaded = load_recordings(tmp_path / "all")
    assert loaded.voters(UNEQUAL) == recordings.voters(UNEQUAL)
    left = without(loaded, [*TUTORIALS, ORB])
    assert left.tracks == HEADLINE_TRACKS
    assert left.manifest.variants == {JOINT: "CAM_BACK"}
    alone = without(loaded, CAMERAS)  # and with them what saw their images
    assert alone.voters("VISION") == (ORB,)
    assert alone.further == ()


def test_exported_where_it_votes(recordings: Recordings) -> None:
    assert "TUTORIAL_FRONT" in {way.row for way in ways(recordings, UNEQUAL)}
    assert "TUTORIAL_FRONT" not in {way.row for way in ways(recordings, "VISION")}
