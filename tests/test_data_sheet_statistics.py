"""What the figures of the data sheet mean: hand-worked cases and signals with known faults."""

from __future__ import annotations

import itertools
import json
import os
from pathlib import Path

import numpy as np
import pytest

from docs._pages.data_sheet import comparison, real
from docs._pages.data_sheet.motion import (
    Path as Way,
)
from docs._pages.data_sheet.motion import (
    forward_speed_mps,
    interval_statistics,
    motion_statistics,
    recorded_intervals,
    recorded_paths,
)
from docs._pages.data_sheet.outcomes import (
    camera_lost_tracks,
    exact_step_errors,
    moving_steps,
    own_time_errors,
    turning_steps,
    yaw_errors,
)
from docs._pages.data_sheet.sensors import production_gyro_statistics, sensor_statistics
from experiments import stored_figures as stored
from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.geometry import quaternion_wxyz_from_yaw
from mixo_env.leaderboard.firing_order import best_shares
from tests.synthetic import synthetic_recordings

REAL = os.environ.get("MIXO_REAL_DATA")
needs_real_data = pytest.mark.skipif(not REAL, reason="set MIXO_REAL_DATA to a folder of real driving data")


def straight(frames: int, step_m: float, heading: float = 0.0) -> Way:
    along = step_m * np.arange(frames)
    return Way(along * np.cos(heading), along * np.sin(heading), np.full(frames, heading))


# --- motion


def test_twelve_frames_count_as_one_second():
    speed = forward_speed_mps(straight(25, 0.5, heading=2.0))
    assert speed == pytest.approx(np.full(13, 6.0))
    assert forward_speed_mps(straight(25, -0.25, heading=2.0)) == pytest.approx(np.full(13, -3.0))


def test_motion_of_a_fast_and_a_standing_scene():
    found = motion_statistics([straight(241, 0.5), straight(241, 0.0)])
    assert found["speed_1s_mps"]["n"] == 2 * 229
    assert found["speed_1s_mps"]["mean"] == pytest.approx(3.0)
    assert found["speed_1s_mps_while_moving"]["p1"] == pytest.approx(6.0)
    assert found["longitudinal_accel_1s_mps2"]["n"] == 2 * 217
    assert found["path_length_per_scene_m"]["max"] == pytest.approx(120.0)
    assert found["top_speed_per_scene_mps"]["max"] == pytest.approx(6.0)
    assert np.isnan(motion_statistics([straight(241, 0.0)])["speed_1s_mps_while_moving"]["p50"])
    shares = found["shares"]
    assert shares["time_below_0.2_mps"] == shares["scenes_under_5_m"] == 0.5
    assert shares["path_over_150_m"] == shares["heading_over_30"] == 0.0


def test_motion_of_a_turn():
    yaw = np.radians(0.5) * np.arange(121)  # 6 deg/s for 10 s
    found = motion_statistics([Way(20.0 * np.sin(yaw), 20.0 - 20.0 * np.cos(yaw), yaw)])
    assert found["abs_yaw_rate_1s_degps"]["p50"] == pytest.approx(6.0)
    assert found["abs_net_heading_change_deg"]["mean"] == pytest.approx(60.0)
    assert found["shares"]["heading_over_30"] == 1.0
    assert found["shares"]["heading_over_120"] == 0.0


def test_intervals_are_counted_by_the_nearest_multiple_of_50_ms():
    found = interval_statistics([np.array([0.0, 0.1, 0.2, 0.25]), np.array([5.0, 5.1502])])
    assert found["n"] == 4
    assert (found["share_0.05_s"], found["share_0.10_s"], found["share_0.15_s"]) == (0.25, 0.5, 0.25)
    assert found["max_s"] == pytest.approx(0.1502)


def test_recorded_images_and_key_frames():
    recordings = synthetic_recordings(0, steps=60)
    found = recorded_intervals(recordings)
    assert found["keyframes"]["n"] <= sum(np.ceil(entry.rows / 6) for entry in recordings.scenes)
    assert found["frames_per_scene"]["max"] <= max(entry.rows for entry in recordings.scenes)
    ways = recorded_paths(recordings)
    assert len(ways) == len(recordings)
    assert np.array_equal(ways[1].x_m, recordings.rows(1)["truth.x_m"])


@needs_real_data
def test_definitions_are_those_of_the_real_statistics():
    """On some of the trajectories behind them: within what leaving out the others changes."""
    folder = Path(REAL or "")
    known = json.loads((folder / "nuscenes_motion_statistics.json").read_text())["motion"]
    ways = []
    for path in sorted((folder / "nuscenes_val_poses").glob("*.txt")):
        camera = np.loadtxt(path).reshape(-1, 3, 4)
        forward, up = camera[:, :, 2], -camera[:, :, 1].mean(axis=0)
        up /= np.linalg.norm(up)
        position = camera[:, :, 3] - 1.70 * forward
        ahead = forward[0] - up * (forward[0] @ up)
        ahead /= np.linalg.norm(ahead)
        left = np.cross(up, ahead)
        yaw = np.unwrap(np.arctan2(forward @ left, forward @ ahead))
        ways.append(Way(position @ ahead, position @ left, yaw))
    found = motion_statistics(ways)
    assert found["speed_1s_mps"]["p50"] == pytest.approx(known["speed_1s_mps"]["p50"], abs=0.2)
    assert found["speed_1s_mps"]["p95"] == pytest.approx(known["speed_1s_mps"]["p95"], abs=0.2)
    acceleration, theirs = (part["longitudinal_accel_1s_mps2"] for part in (found, known))
    assert acceleration["p5"] == pytest.approx(theirs["p5"], abs=0.05)
    assert acceleration["p95"] == pytest.approx(theirs["p95"], abs=0.05)
    assert found["path_length_per_scene_m"]["mean"] == pytest.approx(known["path_length_per_scene_m"]["mean"], abs=3.0)
    shares = found["shares"]
    assert shares["time_below_0.2_mps"] == pytest.approx(
        known["share_of_time_below_0p2_mps"]["speed_over_1s"], abs=0.02
    )
    assert shares == pytest.approx(real.real_motion(folder)["shares"], abs=0.09)


# --- CAN bus


def write_can_bus(folder: Path, turning: bool = True) -> None:
    """A scene of 20 s: gyro 0.5 deg/s too high and 30 ms ahead of the pose, wheels of 0.3 m, monitor 0.2 deg/s low."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)

    def yaw(t: np.ndarray) -> np.ndarray:
        return 0.3 * np.sin(0.8 * t) * turning

    def speed(t: np.ndarray) -> np.ndarray:
        return 6.0 + 3.0 * np.sin(0.5 * t)

    def way(t: np.ndarray) -> np.ndarray:
        return 6.0 * t - 6.0 * np.cos(0.5 * t)

    def rate(t: np.ndarray) -> np.ndarray:
        return 0.24 * np.cos(0.8 * t) * turning

    def stamps(t: np.ndarray) -> list[int]:
        return (1_600_000_000_000_000 + np.round(t * 1e6)).astype(np.int64).tolist()

    pose_s, imu_s, slow_s = np.arange(0, 20, 0.02), np.arange(0, 20, 0.01), np.arange(0, 20, 0.5)
    distance = way(pose_s - 0.03)
    x, y = np.cumsum(np.diff(distance, prepend=distance[0]) * [np.cos(yaw(pose_s)), np.sin(yaw(pose_s))], axis=1)
    quaternions = quaternion_wxyz_from_yaw(yaw(pose_s - 0.03))
    gyro = rate(imu_s) + np.radians(0.5) + 0.002 * rng.standard_normal(len(imu_s))
    wheel = np.round(speed(imu_s - 0.03) / 0.3 * 60.0 / (2.0 * np.pi), 6)
    wheel[1::2] = wheel[::2]
    messages = {
        "pose": [
            {"utime": u, "pos": [a, b, 0.0], "orientation": list(q), "vel": [v, 0.0, 0.0]}
            for u, a, b, q, v in zip(stamps(pose_s), x, y, quaternions, speed(pose_s - 0.03), strict=True)
        ],
        "ms_imu": [
            {"utime": u, "rotation_rate": [0.0, 0.0, g], "linear_accel": [0.0, 0.0, 9.8]}
            for u, g in zip(stamps(imu_s), gyro, strict=True)
        ],
        "zoe_veh_info": [
            {"utime": u} | {f"{name}_wheel_speed": w for name in ("FL", "FR", "RL", "RR")}
            for u, w in zip(stamps(imu_s), wheel, strict=True)
        ],
        "vehicle_monitor": [
            {"utime": u, "yaw_rate": round(r, 1), "vehicle_speed": 3.6 * v}
            for u, r, v in zip(stamps(slow_s), np.degrees(rate(slow_s - 0.03)) - 0.2, speed(slow_s - 0.03), strict=True)
        ],
        "production_gyro": [
            {"utime": u, "yaw_rate": r}
            for u, r in zip(stamps(pose_s), rate(pose_s - 0.03) - np.radians(0.1), strict=True)
        ],
    }
    for name, rows in messages.items():
        (folder / f"scene-1_{name}.json").write_text(json.dumps(rows))


def test_known_faults_of_the_can_bus_are_found(tmp_path):
    write_can_bus(tmp_path)
    found = sensor_statistics(tmp_path, "scene-1")
    assert found["gyro_bias_degps"] == pytest.approx(0.5, abs=0.02)
    assert found["gyro_leads_pose_s"] == pytest.approx(0.03, abs=0.0051)
    assert found["gyro_noise_raw_radps"] == pytest.approx(0.002, rel=0.2)
    assert found["gyro_sample_to_sample_radps"] == pytest.approx(0.002, rel=0.2)
    assert found["gyro_noise_0p5_s_radps"] < 0.5 * found["gyro_noise_raw_radps"]
    assert found["wheel_radius_m"] == pytest.approx(0.3, rel=2e-3)
    assert found["wheel_radius_from_distance_m"] == pytest.approx(0.3, rel=2e-3)
    assert found["wheel_leads_pose_speed_s"] == pytest.approx(0.0, abs=0.0051)
    assert found["wheel_noise_mps"] < 0.02
    assert found["wheel_repeats"] == pytest.approx(0.5, abs=0.01)
    assert found["wheel_spread_of_radii"] == pytest.approx(0.0, abs=1e-9)
    assert found["monitor_yaw_bias_degps"] == pytest.approx(-0.2, abs=0.03)
    assert found["monitor_yaw_resolution_degps"] == pytest.approx(0.1)
    assert found["monitor_speed_scale"] == pytest.approx(1.0, abs=2e-3)
    assert (found["pose_rate_hz"], found["monitor_gaps"]) == (pytest.approx(50.0), 0.0)
    assert found["accel_z_mean_mps2"] == pytest.approx(9.8)
    production = production_gyro_statistics(tmp_path, "scene-1")
    assert production["production_gyro_bias_degps"] == pytest.approx(-0.1, abs=0.02)


def test_no_lead_where_there_is_no_bend(tmp_path):
    write_can_bus(tmp_path, turning=False)
    assert np.isnan(sensor_statistics(tmp_path, "scene-1")["gyro_leads_pose_s"])


def test_a_missing_message_is_one_clear_line(tmp_path):
    write_can_bus(tmp_path)
    (tmp_path / "scene-1_ms_imu.json").write_text("[{")
    with pytest.raises(DatasetError, match="ms_imu"):
        sensor_statistics(tmp_path, "scene-1")


@needs_real_data
def test_stored_figures_are_those_of_the_real_files():
    known, can_bus = real.load_real(), Path(REAL or "") / "nuscenes_can_bus"
    assert len(known["sensors"]) == 4
    for scene, figures in known["sensors"].items():
        again = sensor_statistics(can_bus, scene)
        assert figures == pytest.approx({name: again[name] for name in figures}, rel=1e-3, abs=1e-6, nan_ok=True)


def test_stored_figures_hold_all_that_is_compared():
    known = real.load_real()
    assert {quantity.key for quantity in comparison.MOTION} < set(known["motion"])
    for figures in known["sensors"].values():
        assert set(figures) == {name for name in comparison.SENSORS if not name.startswith("production")}
    assert {"KITTI 06", "nuScenes CAM_FRONT"} < set(known["pictures"])


# --- outcomes


def test_best_camera_splits_ties_and_leaves_out_the_lost():
    nan = np.nan
    errors = np.array(
        [
            [0.1, 0.2, 0.3],
            [0.2, 0.2, 0.3],  # a tie: half each
            [nan, 0.5, 0.4],  # the first is lost
            [nan, nan, nan],  # all are: no step
            [0.0, 0.9, 0.9],  # not among the steps
        ]
    )
    steps = np.array([True, True, True, True, False])
    assert best_shares(errors, steps) == pytest.approx([1.5 / 3, 0.5 / 3, 1 / 3])
    assert np.isnan(best_shares(errors, np.zeros(5, dtype=bool))).all()


def test_four_equal_cameras_share_evenly():
    errors = np.abs(np.random.default_rng(0).standard_normal((40000, 4)))
    assert best_shares(errors, np.ones(40000, dtype=bool)) == pytest.approx(np.full(4, 0.25), abs=0.01)


def test_steps_and_errors_of_a_recording():
    recordings = synthetic_recordings(0, steps=60)
    moving, turning = moving_steps(recordings), turning_steps(recordings)
    assert not moving[recordings.offsets[:-1]].any()
    with np.errstate(invalid="ignore", divide="ignore"):
        rate = recordings["truth.yaw_increment_rad"] / recordings["dt_s"]
    assert np.array_equal(turning, np.abs(np.nan_to_num(rate)) >= np.radians(5.0))
    errors, exact = own_time_errors(recordings), exact_step_errors(recordings)
    assert errors.shape == exact.shape == (recordings.offsets[-1], 4)
    assert np.isnan(exact[recordings.offsets[:-1]]).all()
    usable = np.isfinite(exact).all(axis=1)
    assert np.median(exact[usable, 0]) < np.median(exact[usable, 1])  # noise of the front camera is the smallest
    lost, instant = (camera_lost_tracks(recordings, "CAM_FRONT", instantly=instantly) for instantly in (False, True))
    assert lost.mean >= 1.0
    assert instant.mean >= lost.mean
    with pytest.raises(ConfigurationError, match="camera"):
        camera_lost_tracks(recordings, "INERTIAL")


def test_yaw_errors_add_up_scene_by_scene():
    recordings = synthetic_recordings(0, steps=60)
    camera, other = recordings.manifest.cameras[:2]
    one, two, both = (yaw_errors(recordings, group) for group in ((camera,), (other,), (camera, other)))
    sums, squares, windows = [], 0.0, 0
    for begin, end in itertools.pairwise(recordings.offsets):
        total, seen = 0.0, 0
        for row in range(begin, end):
            error = np.degrees(
                float(recordings[f"{camera}.own_window_yaw_increment_rad"][row])
                - recordings[f"{camera}.own_window_truth_yaw_increment_rad"][row]
            )
            if np.isfinite(error):
                total, seen, squares = total + error, seen + 1, squares + error**2
        if seen:
            sums.append(abs(total))
        windows += seen
    assert one.accumulated_deg == pytest.approx(sums)
    assert one.rms_deg == pytest.approx(np.sqrt(squares / windows))
    assert both.accumulated_deg == pytest.approx(np.concatenate([one.accumulated_deg, two.accumulated_deg]))
    assert min(one.rms_deg, two.rms_deg) < both.rms_deg < max(one.rms_deg, two.rms_deg)
    assert min(one.gain, two.gain) <= both.gain <= max(one.gain, two.gain)
    assert one.gain == pytest.approx(1.0, abs=0.05)


# --- pictures


def test_only_figures_outside_their_band_stand_out():
    differences = comparison.Differences()
    assert differences.judge("a", 1.0, 0.5, 1.5, 2, "1.2") == "1.00"
    assert differences.judge("b", 2.0, 0.5, 1.5, 2, "1.2") == "**2.00**"
    assert differences.judge("c", 2.0, np.nan, np.nan, 1, "-") == "2.0"
    assert (differences.found, differences.checked) == (["b: 2.00 against 1.2"], 2)


def test_numbers_and_ranges():
    assert [comparison.number(v, 1) for v in (-0.01, np.nan, 2.26)] == ["0.0", "-", "2.3"]
    assert comparison.widened([1.0, 3.0, np.nan]) == (0.0, 4.0)


def test_stored_numbers_keep_five_digits_and_nan(tmp_path):
    stored.save(tmp_path / "a.json", {"x": [1.2345678, np.nan], "n": 3, "text": "t"})
    again = stored.load(tmp_path / "a.json")
    assert again["x"][0] == 1.2346
    assert np.isnan(again["x"][1])
    assert (again["n"], again["text"]) == (3, "t")
    with pytest.raises(ConfigurationError, match="--images"):
        stored.load(tmp_path / "b.json")
