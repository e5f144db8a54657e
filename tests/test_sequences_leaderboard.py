"""Everything that plays recordings plays those made from trajectories alone."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.leaderboard.board import build
from mixo_env.leaderboard.report import to_markdown
from mixo_env.policies.gate import Mixo
from mixo_env.policies.registry import POLICIES
from mixo_env.policies.reinforcement import AGENTS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.sequence_files import Reading
from mixo_env.recordings.sequences import SequenceRules, recordings_from_trajectories
from mixo_env.recordings.store import save_recordings
from tests.odometry_files import RATE_HZ, write_set

REAL = Path(os.environ.get("MIXO_REAL_DATA", "/nonexistent"))
QUICK = [name for name in POLICIES if name not in (*AGENTS, "HIGHEST MATCH")]


def recorded(root: Path, experts: int, sequences: int = 3, counts: bool = False, **rules) -> Recordings:
    noise = {f"E{j}": 1e-3 * (j + 1) for j in range(experts)}
    folders = write_set(root, noise, sequences=sequences)
    if counts:
        for sequence in range(sequences):
            quality = folders["E0"] / f"drive{sequence:02d}.quality.csv"
            quality.write_text("\n".join(["matches", *(str(100 + k % 7) for k in range(160))]))
    truth = folders.pop("groundtruth")
    return recordings_from_trajectories(truth, folders, SequenceRules(Reading(rate_hz=RATE_HZ), **rules))


@pytest.mark.parametrize("experts", [1, 2, 9])
def test_any_number_of_experts_is_scored(tmp_path, experts):
    recordings = recorded(tmp_path, experts)
    board = build(recordings, policies=QUICK)
    (table,) = board.standings
    assert table.track == "VISION"
    scores = {row.name: row.headline.rotation_deg_per_m.mean for row in table.rows}
    assert all(np.isfinite(score) for score in scores.values())
    assert scores["MULTICAMERA GT"] <= scores["MEAN"]
    text = to_markdown(board)
    assert "Track VISION: the imported experts vote; distance from the ground truth (privileged)" in text
    assert "not in the confirmatory family because a row is missing: LINEAR - CAM_FRONT, MIXO - CAM_FRONT" in text
    assert "MIXO sees yaw rate and speed alone, HIGHEST MATCH has no row" in text
    with pytest.raises(PolicyError, match="HIGHEST MATCH needs match counts"):
        build(recordings, policies=["HIGHEST MATCH"])


def test_match_counts_give_highest_match_a_row(tmp_path, monkeypatch):
    monkeypatch.setattr(Mixo.__init__, "__kwdefaults__", Mixo.__init__.__kwdefaults__ | {"min_updates": 20})
    board = build(recorded(tmp_path, 2, counts=True), policies=["HIGHEST MATCH", "MIXO", "E0"])
    (table,) = board.standings
    scores = {row.name: row.headline.rotation_deg_per_m.mean for row in table.rows}
    assert scores["HIGHEST MATCH"] == scores["E0"]
    assert "no row" not in to_markdown(board)


def test_one_log_has_no_learned_rows_and_says_so(tmp_path):
    board = build(recorded(tmp_path, 2, sequences=2, logs={"*": "one"}))
    (table,) = board.standings
    assert {"LINEAR", "HUBER", "MIXO", "PPO"} <= set(table.left_out)
    assert {"E0", "E1", "MEDIAN", "PERFECT YAW"} <= {row.name for row in table.rows}
    assert "nothing to learn from that is not tested" in to_markdown(board)


def test_an_odometry_named_after_a_camera_takes_its_place_in_the_family(tmp_path):
    folders = write_set(tmp_path, {"CAM_FRONT": 1e-3, "CAM_BACK": 2e-3}, sequences=3)
    truth = folders.pop("groundtruth")
    recordings = recordings_from_trajectories(truth, folders, SequenceRules(Reading(rate_hz=RATE_HZ)))
    (table,) = build(recordings, policies=["CAM_FRONT", "LINEAR"]).standings
    assert [(c.first, c.second) for c in table.comparisons.confirmatory] == [("LINEAR", "CAM_FRONT")]


def test_lost_experts_are_bridged_by_the_others_and_counted(tmp_path):
    folders = write_set(tmp_path, {"A": 0.0, "B": 0.0}, sequences=2)
    state = ["tracking"] * 160
    state[40:60] = ["lost"] * 20
    (folders["A"] / "drive00.quality.csv").write_text("\n".join(["state", *state]))
    truth = folders.pop("groundtruth")
    recordings = recordings_from_trajectories(truth, folders, SequenceRules(Reading(rate_hz=RATE_HZ)))
    (table,) = build(recordings, policies=["A", "B", "MEDIAN"]).standings
    rows = {row.name: row for row in table.rows}
    assert rows["A"].headline.yaw_increment_rmse_deg < 1e-4  # B's turns stand in, and B is exact
    lost = [row.lost.counts.tolist() for row in rows.values() if row.lost is not None]
    assert (list(rows), lost) == (["A", "B", "MEDIAN"], [[1, 0], [0, 0], [0, 0]])


@pytest.mark.parametrize("experts", [1, 3])
@pytest.mark.parametrize("observation", ["paper", "rich", "dict"])
def test_the_environment_plays_them(tmp_path, experts, observation):
    save_recordings(recorded(tmp_path / "files", experts, leave_one_out=True), tmp_path / "out")
    for track in ("CONSUMER", "VISION"):
        env = gym.make(
            "mixo_env:MixoOdometry-v0", recordings=tmp_path / "out", observation=observation, track=track, split="all"
        )
        seen, _ = env.reset(seed=0)
        assert env.observation_space.contains(seen)
        assert env.action_space.shape == (experts,)
        ended, info = False, {}
        while not ended:
            seen, reward, _, ended, info = env.step(env.action_space.sample())
            assert np.isfinite(float(reward))
        assert np.isfinite(info["ate_m"])
    with pytest.raises(ConfigurationError, match="expected recordings with cameras to switch"):
        gym.make("mixo_env:MixoOdometryBudget-v0", recordings=tmp_path / "out")


def test_counts_are_observed_where_there_are_any(tmp_path):
    with_counts = gym.make("mixo_env:MixoOdometry-v0", recordings=recorded(tmp_path / "a", 2, counts=True))
    without_counts = gym.make("mixo_env:MixoOdometry-v0", recordings=recorded(tmp_path / "b", 2))
    widths = [env.observation_space.shape for env in (with_counts, without_counts)]
    assert widths == [(6,), (4,)]


@pytest.mark.integration
@pytest.mark.parametrize("form", ["tum", "kitti"])
def test_evaluate_finds_the_numbers_of_the_leaderboard_in_what_is_exported(tmp_path, capsys, form):
    save_recordings(recorded(tmp_path / "files", 3, sequences=4), tmp_path / "out")
    arguments = ["export", str(tmp_path / "out"), "--out", str(tmp_path / "ways"), "--policies", "LINEAR", "huber"]
    assert main([*arguments, "--format", form]) == 0
    assert "groundtruth (4), E0 (4), E1 (4), E2 (4), LINEAR (4), HUBER (4); track VISION" in capsys.readouterr().out
    assert main([*arguments, "--format", form]) == 2
    assert "is not empty" in capsys.readouterr().err
    names = ["E0", "E2", "LINEAR", "HUBER"]
    ways = [str(tmp_path / "ways" / name) for name in names]
    truth = str(tmp_path / "ways" / "groundtruth")
    assert main(["evaluate", "--groundtruth", truth, "--estimate", *ways, "--format", "csv"]) == 0
    evaluated = {row["Method"]: row for row in csv.DictReader(capsys.readouterr().out.splitlines())}
    command = ["benchmark", "--recordings", str(tmp_path / "out"), "--out", str(tmp_path / "b"), "--policies", *names]
    assert main(command) == 0
    board = json.loads((tmp_path / "b" / "leaderboard.json").read_text())
    assert board["distance"] == {"from": "truth", "privileged": True}
    for row in board["tracks"]["VISION"]["rows"]:
        score, found = row["scores"]["truth"], evaluated[row["policy"]]
        for ours, theirs in (
            (score["ate_m"], "ATE [m]"),
            (score["ate_deg"], "ATE [deg]"),
            (score["translation_percent"]["mean"], "RTE [%]"),
            (score["rotation_deg_per_m"]["mean"], "RTE [deg/m]"),
        ):
            assert float(found[theirs]) == pytest.approx(ours, rel=1e-5, abs=1e-7)


@pytest.mark.integration
@pytest.mark.skipif(not (REAL / "kitti_experts").is_dir(), reason="needs the real data")
def test_real_experts_of_kitti(tmp_path, capsys):
    folder = REAL / "kitti_experts"
    names = ("SfMLearner", "DF-VO", "KPDepth-VO", "ACVO", "TartanVO")
    experts = [f"{name}={folder}" for name in names]
    command = ["import", "--groundtruth", str(folder), "--expert", *experts, "--rate", "9.648", "--leave-one-out"]
    assert main([*command, "--out", str(tmp_path / "out")]) == 0
    policies = ["MEDIAN", "HUBER", "LINEAR", *names]
    command = [
        "benchmark",
        "--recordings",
        str(tmp_path / "out"),
        "--out",
        str(tmp_path / "b"),
        "--policies",
        *policies,
    ]
    assert main(command) == 0
    capsys.readouterr()
    board = json.loads((tmp_path / "b" / "leaderboard.json").read_text())
    rmse = {
        row["policy"]: row["scores"]["truth"]["yaw_increment_rmse_deg"] for row in board["tracks"]["VISION"]["rows"]
    }
    assert rmse["ACVO"] > 10.0  # it breaks on 06
    assert rmse["LINEAR"] > 1.0
    assert rmse["HUBER"] < 0.03
    assert rmse["MEDIAN"] < 0.03
    assert rmse["DF-VO"] == pytest.approx(0.019, abs=0.002)


@pytest.mark.integration
@pytest.mark.skipif(not (REAL / "vo_estimates").is_dir(), reason="needs the real data")
@pytest.mark.parametrize(("part", "rate"), [("nuscenes", "2"), ("kitti", "10")])
def test_real_estimates_at_two_and_ten_hertz(tmp_path, capsys, part, rate):
    folder = REAL / "vo_estimates" / part
    experts = [f"{name}={folder}" for name in ("ORB-SLAM", "DeepVO", "MDN-VO", "Ours")]
    command = ["import", "--groundtruth", str(folder), "--expert", *experts, "--rate", rate]
    assert main([*command, "--out", str(tmp_path / "out")]) == 0
    assert "Ours in" in capsys.readouterr().out
    command = ["benchmark", "--recordings", str(tmp_path / "out"), "--out", str(tmp_path / "b"), "--policies", "MEDIAN"]
    assert main(command) == 0


def test_a_title_names_those_who_vote():
    from types import SimpleNamespace
    from typing import Any, cast

    from mixo_env.leaderboard.sentences import title
    from mixo_env.recordings.schema import INERTIAL_EXPERTS, Manifest

    track = cast("Any", SimpleNamespace(track="CONSUMER"))
    said = [
        title(track, Manifest("v", cameras, INERTIAL_EXPERTS, imported, ()))
        for cameras, imported in ((("CAM_FRONT",), ()), ((), ("ORB",)), ((), ()))
    ]
    assert said == [
        "Track CONSUMER: the cameras and INERTIAL_CONSUMER vote",
        "Track CONSUMER: the imported experts and INERTIAL_CONSUMER vote",
        "Track CONSUMER: INERTIAL_CONSUMER votes alone",
    ]
