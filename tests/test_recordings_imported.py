"""Trajectories of other programs as experts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.errors import ConfigurationError, TrajectoryError
from mixo_env.experts.imported import MAXIMUM_GAP_S, Quality, imported_columns, imported_increments
from mixo_env.fusion import least_squares_weights
from mixo_env.geometry import multiply_quaternions_wxyz, quaternion_wxyz_from_rotation
from mixo_env.leaderboard.evaluation import FLOORS
from mixo_env.policies.registry import POLICIES
from mixo_env.recordings.fitting import DEFAULT_REWARD_SCALE_RAD
from mixo_env.recordings.importing import with_imported, without
from mixo_env.recordings.names import ROWS, is_reserved
from mixo_env.recordings.sequence_files import Reading, Source, read_sources
from mixo_env.recordings.store import load_recordings, save_recordings
from mixo_env.recordings.substitutes import substituted_increments
from mixo_env.trajectory import Trajectory, write_kitti, write_tum
from tests.synthetic import synthetic_recordings
from tests.trajectories import random_rotation

START_US = 1_600_000_000_000_000


def turning(times_s: np.ndarray) -> Trajectory:
    """Constant yaw rate of 0.3 rad/s through +-pi, at 5 m/s."""
    yaw = 3.0 + 0.3 * times_s
    return Trajectory.from_planar(5 * times_s, 0 * times_s, yaw, 1e-6 * START_US + times_s)


def as_camera(trajectory: Trajectory, mounting_deg: float = 0.0) -> Trajectory:
    """The same motion as a camera program sees it: world and body x right, y down, z forward."""
    axes = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    mounting = Trajectory.from_planar([1.5], [0.4], [np.deg2rad(mounting_deg)]).matrices()[0] @ axes
    camera = trajectory.matrices() @ mounting
    return Trajectory.from_matrices(np.linalg.inv(camera[0]) @ camera, trajectory.timestamps_s, camera_axes=True)


def test_increments_of_a_steady_turn_are_exact():
    steps = START_US + np.array([0, 100_000, 150_000, 300_000, 400_000])
    increments = imported_increments(turning(np.arange(-1, 12) * 0.07), steps)
    assert np.isnan(increments[0])
    np.testing.assert_allclose(increments[1:], 0.3 * np.array([0.1, 0.05, 0.15, 0.1]), atol=1e-6)


def test_outside_the_trajectory_and_across_gaps_nothing_is_invented():
    steps = START_US + np.arange(0, 3_000_000, 100_000)
    times = np.concatenate([np.arange(0.55, 1.2, 0.1), np.arange(2.05, 2.6, 0.1)])
    assert times[7] - times[6] > MAXIMUM_GAP_S
    available = np.isfinite(imported_increments(turning(times), steps))
    # Poses from 0.55 to 1.15 s and from 2.05 to 2.55 s: yaw at 0.6 ... 1.1 and 2.1 ... 2.5 s.
    np.testing.assert_array_equal(np.flatnonzero(available), [7, 8, 9, 10, 11, 22, 23, 24, 25])


def test_a_closing_time_on_the_last_pose_counts():
    steps = START_US + np.array([0, 100_000, 200_000])
    exact = turning(np.array([0.0, 0.1, 0.2]))
    exact = replace(exact, timestamps_s=1e-6 * steps)
    np.testing.assert_allclose(imported_increments(exact, steps)[1:], 0.03, atol=1e-9)


def test_live_poses_are_carried_by_their_own_rate():
    steps = START_US + np.array([0, 100_000, 150_000, 300_000, 400_000])
    increments = imported_increments(turning(np.arange(-3, 12) * 0.07), steps, live=True)
    np.testing.assert_allclose(increments[1:], 0.3 * np.array([0.1, 0.05, 0.15, 0.1]), atol=1e-6)


def test_by_hand_what_a_live_rate_held_wrongly_is_made_up_for():
    steps = START_US + np.array([0, 100_000, 200_000, 300_000])
    times, yaw = np.array([-0.12, -0.02, 0.08, 0.18, 0.28]), np.array([0.0, 0.0, 0.1, 0.1, 0.1])
    poses = Trajectory.from_planar(times, 0 * times, yaw, 1e-6 * START_US + times)
    # at the ends of the steps: 0, 0.1 + 1 rad/s x 0.02 s, 0.1, 0.1
    np.testing.assert_allclose(imported_increments(poses, steps, live=True)[1:], [0.12, -0.02, 0.0], atol=1e-5)


def test_no_live_increment_rests_on_a_later_pose():
    rng = np.random.default_rng(3)
    steps = START_US + np.arange(0, 1_500_000, 83_000)
    times = np.sort(rng.uniform(-0.2, 1.6, 22))
    lost = rng.random(len(times)) < 0.15
    yaw = np.cumsum(rng.normal(0.0, 0.05, len(times)))
    quality = Quality(np.arange(22.0), np.full(22, np.nan), np.full(22, 0.01), lost)

    def columns(changed: np.ndarray) -> dict[str, np.ndarray]:
        poses = Trajectory.from_planar(times, 0 * times, changed, 1e-6 * START_US + times)
        return imported_columns(poses, steps, quality, 0.3, live=True)

    before = columns(yaw)
    assert np.isfinite(before["yaw_increment_rad"]).sum() > 5
    for k, close in enumerate(1e-6 * (steps - START_US)):
        after = columns(np.where(times > close, yaw + rng.normal(0.0, 0.3, len(times)), yaw))
        for name, values in before.items():
            np.testing.assert_array_equal(after[name][: k + 1], values[: k + 1])


def test_nothing_is_told_live_where_the_last_pose_is_lost_or_too_old():
    steps = START_US + np.arange(0, 1_000_000, 100_000)
    times = np.arange(-0.15, 0.9, 0.1)
    lost = np.arange(len(times)) == 5  # at 0.35 s
    told = np.isfinite(imported_increments(turning(times), steps, 0.25, lost, live=True))
    np.testing.assert_array_equal(np.flatnonzero(~told), [0, 4, 5])
    told = np.isfinite(imported_increments(turning(times[times < 0.5]), steps, 0.14, live=True))
    np.testing.assert_array_equal(np.flatnonzero(~told), [0, 6, 7, 8, 9])
    assert np.isnan(imported_increments(turning(times[2:3]), steps, live=True)).all()


@pytest.mark.parametrize("mounting_deg", [0.0, 55.0, 180.0])
def test_camera_poses_turn_like_the_car(mounting_deg):
    steps = START_US + np.arange(0, 1_000_000, 100_000)
    vehicle = turning(np.arange(-0.1, 1.1, 0.05))
    expected = imported_increments(vehicle, steps)
    np.testing.assert_allclose(imported_increments(as_camera(vehicle, mounting_deg), steps), expected, atol=1e-6)


@pytest.mark.parametrize("camera", [False, True], ids=["vehicle", "camera"])
def test_the_frame_of_the_file_may_be_tilted(camera):
    steps = START_US + np.arange(0, 1_000_000, 100_000)
    vehicle = turning(np.arange(-0.1, 1.1, 0.05))
    expected = imported_increments(vehicle, steps)
    for seed in range(5):
        tilt = quaternion_wxyz_from_rotation(random_rotation(np.random.default_rng(seed)))
        poses = as_camera(vehicle, 10.0) if camera else vehicle
        tilted = replace(poses, quaternions_wxyz=multiply_quaternions_wxyz(tilt, poses.quaternions_wxyz))
        np.testing.assert_allclose(imported_increments(tilted, steps), expected, atol=1e-6)


def test_times_that_do_not_fit_are_refused():
    steps = START_US + np.arange(0, 1_000_000, 100_000)
    with pytest.raises(TrajectoryError, match="no pose lies in the scene"):
        imported_increments(replace(turning(np.arange(10.0)), timestamps_s=np.arange(10.0)), steps)
    with pytest.raises(TrajectoryError, match="expected a time for each pose"):
        imported_increments(replace(turning(np.arange(10.0)), timestamps_s=None), steps)


def source(trajectory: Trajectory, axes: str = "vehicle") -> Source:
    return Source(Path("file.txt"), trajectory, axes, None)


def truth(recordings, scene: str) -> Trajectory:
    rows = recordings.rows(scene)
    return Trajectory.from_planar(
        rows["truth.x_m"], rows["truth.y_m"], rows["truth.yaw_rad"], 1e-6 * rows["timestamp_us"]
    )


def test_a_perfect_expert_gets_all_the_weight():
    recordings = synthetic_recordings(scenes=4)
    names = [scene.name for scene in recordings.scenes]
    extended = with_imported(recordings, "PERFECT", {name: source(truth(recordings, name)) for name in names})
    assert extended.manifest.imported == ("PERFECT",)
    assert extended.voters("CONSUMER")[-2:] == ("PERFECT", "INERTIAL_CONSUMER")
    np.testing.assert_allclose(extended["PERFECT.yaw_increment_rad"], recordings["truth.yaw_increment_rad"], atol=2e-6)
    weights = extended.manifest.linear_weights["CONSUMER"]["none"]
    assert weights["PERFECT"] == pytest.approx(1.0, abs=1e-3)
    assert extended.manifest.reward_scale_rad["PAPER"] == DEFAULT_REWARD_SCALE_RAD
    votes, target = substituted_increments(extended, "PAPER"), extended["truth.yaw_increment_rad"]
    used = np.isfinite(target)
    np.testing.assert_allclose(
        list(extended.manifest.linear_weights["PAPER"]["none"].values()),
        least_squares_weights(votes[used], target[used]),
    )


def test_scenes_without_a_trajectory_stay_empty():
    recordings = synthetic_recordings(scenes=3)
    extended = with_imported(
        recordings,
        "X",
        {"scene-2002": source(truth(recordings, "scene-2002")), "scene-1": source(turning(np.arange(3.0)))},
    )
    available = [np.isfinite(extended.rows(i)["X.yaw_increment_rad"]).sum() for i in range(3)]
    assert available == [0, extended.scenes[1].rows - 1, 0]


@pytest.mark.parametrize(
    "name",
    [
        "CAM_FRONT",
        "cam_front",
        "Cam-Front-Right",
        "INERTIAL_POSE",
        "a b",
        "x.y",
        "",
        "truth",
        "Exact",
        "linear",
        "MIXO",
        "step",
        "VISION",
        "groundtruth",
        "Constant_Rate",
    ],
)
def test_names_that_cannot_be_used(name):
    recordings = synthetic_recordings(scenes=1)
    with pytest.raises(ConfigurationError):
        with_imported(recordings, name, {"scene-2001": source(truth(recordings, "scene-2001"))})


def test_the_names_of_all_rows_are_reserved():
    rows = ("JOINT", *POLICIES, *FLOORS)
    assert [name for name in rows if not is_reserved(name)] == []
    assert set(ROWS) == set(rows)
    assert not is_reserved("ORB-SLAM3")


def test_another_recording_is_never_replaced(tmp_path, capsys):
    for seed, name in enumerate(("in", "other")):
        save_recordings(synthetic_recordings(seed=seed, scenes=2), tmp_path / name)
    recordings = load_recordings(tmp_path / "in")
    (tmp_path / "files").mkdir()
    write_tum(tmp_path / "files" / "scene-2001.txt", truth(recordings, "scene-2001"))
    before = (tmp_path / "other" / "recordings.parquet").read_bytes()
    arguments = ["import", str(tmp_path / "in"), "--expert", f"X={tmp_path / 'files'}", "--out"]
    assert main([*arguments, str(tmp_path / "other")]) == 2
    assert "other holds another recording: choose another --out" in capsys.readouterr().err
    assert (tmp_path / "other" / "recordings.parquet").read_bytes() == before
    assert main([*arguments, str(tmp_path / "in")]) == 0  # in place: nothing is lost
    assert load_recordings(tmp_path / "in").manifest.imported == ("X",)


def test_no_scene_at_all_is_an_error():
    with pytest.raises(TrajectoryError, match="named after scenes like scene-2001, got drive-7"):
        with_imported(synthetic_recordings(scenes=1), "X", {"drive-7": source(turning(np.arange(3.0)))})


@pytest.mark.parametrize("kind", ["tum", "kitti", "camera in tum"])
def test_mixo_import(tmp_path, capsys, kind):
    recordings = synthetic_recordings(scenes=2)
    save_recordings(recordings, tmp_path / "in")
    (tmp_path / "files").mkdir()
    for scene in recordings.scenes:
        path = tmp_path / "files" / f"{scene.name}.txt"
        trajectory = truth(recordings, scene.name)
        if kind == "tum":
            write_tum(path, trajectory)
        elif kind == "kitti":
            write_kitti(path, as_camera(trajectory))
            assert trajectory.timestamps_s is not None
            np.savetxt(path.with_suffix(".times"), trajectory.timestamps_s, fmt="%.6f")
        else:
            write_tum(path, as_camera(trajectory, mounting_deg=55.0))
    arguments = ["--expert", f"OTHER={tmp_path / 'files'}", "--out", str(tmp_path / "out")]
    axes = ["--axes", "camera"] if kind == "camera in tum" else []
    assert main(["import", str(tmp_path / "in"), *arguments, *axes]) == 0
    assert "OTHER in 2 of 2 scenes, 100.0% of the steps" in capsys.readouterr().out
    loaded = load_recordings(tmp_path / "out")
    np.testing.assert_allclose(loaded["OTHER.yaw_increment_rad"], loaded["truth.yaw_increment_rad"], atol=1e-5)
    assert main(["import", str(tmp_path / "out"), *arguments]) == 2
    assert "already there" in capsys.readouterr().err


def test_folders_that_hold_no_trajectories(tmp_path):
    with pytest.raises(TrajectoryError):
        read_sources("X", tmp_path, ("X",), Reading())


def test_an_expert_left_out_is_gone_and_its_name_is_free():
    recordings = synthetic_recordings(scenes=3)
    left = without(recordings, ["CAM_BACK", "INERTIAL_POSE"])
    assert not [name for name in left.column_names if name.startswith(("CAM_BACK.", "INERTIAL_POSE."))]
    assert (left.tracks, left.voters("CONSUMER")[-1]) == (("VISION", "CONSUMER"), "INERTIAL_CONSUMER")
    assert "CAM_BACK" not in left.manifest.linear_weights["VISION"]["none"]
    with pytest.raises(ConfigurationError, match="PAPER needs INERTIAL_POSE, which these recordings lack"):
        left.voters("PAPER")
    sources = {scene.name: source(truth(recordings, scene.name)) for scene in recordings.scenes}
    replaced = with_imported(left, "CAM_BACK", sources)
    assert replaced.voters("VISION") == ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK_RIGHT", "CAM_BACK")
    with pytest.raises(ConfigurationError, match="already there"):
        with_imported(recordings, "CAM_BACK", sources)


def test_inertial_experts_alone_can_be_kept():
    recordings = synthetic_recordings(scenes=2)
    alone = without(recordings, recordings.manifest.cameras)
    assert (alone.manifest.cameras, alone.tracks) == ((), ("PAPER", "CONSUMER"))
    assert alone.voters("CONSUMER") == ("INERTIAL_CONSUMER",)


def test_yaw_that_contradicts_the_recorded_truth_is_refused():
    recordings = synthetic_recordings(scenes=2)
    sources = {scene.name: source(as_camera(truth(recordings, scene.name))) for scene in recordings.scenes}
    with pytest.raises(TrajectoryError, match="--axes X=camera fits"):
        with_imported(recordings, "X", sources)
    assert with_imported(recordings, "X", sources, despite=True).manifest.imported == ("X",)
