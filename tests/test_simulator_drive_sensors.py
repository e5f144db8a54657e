"""Clock, rig and CAN bus: grid and stagger, bounded errors, noise as measured."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.geometry import yaw_from_quaternion_wxyz
from mixo_env.nuscenes.selections import ALL_CAMERAS, CAMERA_OFFSET_US
from mixo_env.simulator.city.land import land_of
from mixo_env.simulator.drive import rig as rigs
from mixo_env.simulator.drive.clock import MAX_STAMP_ERROR_US, scene_times
from mixo_env.simulator.drive.drive import plan_drive
from mixo_env.simulator.drive.localisation import localise
from mixo_env.simulator.drive.targets import deal_motions
from mixo_env.simulator.drive.vehicle_bus import RPM_RESOLUTION, bus_messages, draw_sensors

START_US = 1_715_000_000_000_000


def many_times(count: int = 30):
    rng = np.random.default_rng(0)
    return [scene_times(rng, START_US, 20) for _ in range(count)]


def test_frames_lie_on_the_lidar_grid_with_the_known_stagger():
    for times in many_times(5):
        for channel, frames in times.cameras.items():
            assert frames.timestamp_us.dtype == np.int64
            away = (frames.timestamp_us - START_US - CAMERA_OFFSET_US[channel] + 25_000) % 50_000 - 25_000
            assert np.abs(away).max() < 200
            assert np.all(np.diff(frames.timestamp_us) > 0)
            assert np.abs(frames.exposure_us - frames.timestamp_us).max() <= MAX_STAMP_ERROR_US
            assert frames.is_keyframe[0]
            assert frames.is_keyframe[-1]
            key_us = frames.timestamp_us[frames.is_keyframe]
            assert np.abs(key_us - times.sample_us - CAMERA_OFFSET_US[channel]).max() < 200


def test_intervals_are_distributed_as_in_real_scenes():
    steps, keys, counts = [], [], []
    for times in many_times():
        keys.append(np.diff(times.sample_us) / 50_000)
        for channel in ("CAM_FRONT", "CAM_BACK"):
            frames = times.cameras[channel]
            steps.append(np.rint(np.diff(frames.timestamp_us) / 50_000))
            counts.append(len(frames.timestamp_us))
    turns, key_turns = np.concatenate(steps), np.concatenate(keys)
    assert np.mean(turns == 1) == pytest.approx(0.33, abs=0.02)
    assert np.mean(turns == 2) == pytest.approx(0.655, abs=0.02)
    assert 0.002 < np.mean(turns > 2) < 0.03
    assert np.mean(key_turns == 10) == pytest.approx(0.88, abs=0.05)
    assert set(np.unique(key_turns)) <= {8, 9, 10, 11, 12}
    assert 228 < np.mean(counts) <= 235
    assert len(set(counts)) > 1  # cameras of one scene differ in length


def test_nominal_calibration_looks_where_the_real_cameras_look():
    yaw_deg = {"CAM_FRONT": 0.3, "CAM_FRONT_LEFT": 55.2, "CAM_FRONT_RIGHT": -56.4, "CAM_BACK_LEFT": 108.6}
    yaw_deg |= {"CAM_BACK_RIGHT": -110.8, "CAM_BACK": 179.9}
    for channel in ALL_CAMERAS:
        camera = rigs.nominal_calibration(channel, 800, 450)
        axis = camera.rotation_ego_from_camera[:, 2]
        assert np.degrees(np.arctan2(axis[1], axis[0])) == pytest.approx(yaw_deg[channel], abs=0.1)
        assert camera.rotation_ego_from_camera @ camera.rotation_ego_from_camera.T == pytest.approx(np.eye(3), abs=1e-9)
    full, half = (rigs.nominal_calibration("CAM_FRONT", width, width * 9 // 16) for width in (1600, 800))
    ray_full = np.linalg.solve(full.intrinsic, [1600 - 0.5, 900 - 0.5, 1.0])  # the image's lower right edge
    ray_half = np.linalg.solve(half.intrinsic, [800 - 0.5, 450 - 0.5, 1.0])
    assert ray_half == pytest.approx(ray_full)


def test_written_calibration_is_close_to_the_true_one_but_not_equal():
    for seed in range(20):
        rig = rigs.draw_rig(np.random.default_rng(seed), 800, 450)
        for channel in ALL_CAMERAS:
            true, written = rig.true[channel], rig.written[channel]
            turn = written.rotation_ego_from_camera @ true.rotation_ego_from_camera.T
            angle = np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))
            assert 0.0 < angle <= rigs.MAX_ROTATION_ERROR_RAD * 1.001
            assert 0.0 < np.linalg.norm(written.translation_m - true.translation_m) <= rigs.MAX_TRANSLATION_ERROR_M
            ratio = written.intrinsic[0, 0] / true.intrinsic[0, 0]
            assert 0.0 < abs(ratio - 1.0) <= rigs.MAX_FOCAL_ERROR
            assert np.linalg.det(written.rotation_ego_from_camera) == pytest.approx(1.0)
            nominal = rigs.nominal_calibration(channel, 800, 450)
            assert np.linalg.norm(true.translation_m - nominal.translation_m) < 0.06


@pytest.fixture(scope="module")
def recorded():
    """A moving and a standing scene with their messages."""
    scenes = []
    for seed, situation in ((1, "tight_turn"), (2, "standing")):
        rng = np.random.default_rng(seed)
        drive = plan_drive(rng, situation, 20.0, -0.008, deal_motions(rng, [situation])[0], land_of(seed))
        localisation = localise(rng, drive, 0.03)
        sensors = draw_sensors(rng, 0.305)
        messages = bus_messages(rng, drive, localisation, sensors, START_US, START_US + 19_500_000)
        scenes.append((drive, localisation, sensors, messages))
    return scenes


def column(rows, *keys):
    values = []
    for row in rows:
        value = row
        for key in keys:
            value = value[key]
        values.append(value)
    return np.array(values)


def test_messages_have_the_official_fields_times_and_rates(recorded):
    fields = {
        "ms_imu": ("linear_accel", "q", "rotation_rate"),
        "pose": ("accel", "orientation", "pos", "rotation_rate", "vel"),
        "zoe_veh_info": ("FL_wheel_speed", "FR_wheel_speed", "RL_wheel_speed", "RR_wheel_speed", "odom", "odom_speed"),
        "vehicle_monitor": ("vehicle_speed", "yaw_rate", "steering", "rear_left_rpm", "gear_position", "brake"),
        "steeranglefeedback": ("value",),
        "production_gyro": ("yaw_rate",),
    }
    rates = {"ms_imu": 100, "pose": 50, "zoe_veh_info": 100, "vehicle_monitor": 2, "steeranglefeedback": 100}
    for _, _, _, messages in recorded:
        assert set(messages) == set(fields)
        for name, rows in messages.items():
            assert all(isinstance(row["utime"], int) and set(fields[name]) <= set(row) for row in rows)
            utime = column(rows, "utime")
            assert np.all(np.diff(utime) >= 0)
            if name in rates:
                assert len(rows) / 19.5 == pytest.approx(rates[name], rel=0.08)
        assert np.linalg.norm(column(messages["ms_imu"], "q"), axis=1) == pytest.approx(1.0)
        assert np.linalg.norm(column(messages["pose"], "orientation"), axis=1) == pytest.approx(1.0)


def test_gyros_follow_the_true_yaw_rate(recorded):
    drive, _, sensors, messages = recorded[0]
    for name, keys, noise in (
        ("ms_imu", ("rotation_rate", 2), 0.008),
        ("production_gyro", ("yaw_rate",), 0.012),
    ):
        t = (column(messages[name], "utime") - START_US) / 1e6
        error = column(messages[name], *keys) - drive.at("yaw_rate_radps", t)
        assert np.corrcoef(column(messages[name], *keys), drive.at("yaw_rate_radps", t))[0, 1] > 0.95
        assert error.std() < noise
        assert error.std() > 0.001
    t = (column(messages["vehicle_monitor"], "utime") - START_US) / 1e6
    monitor = column(messages["vehicle_monitor"], "yaw_rate")
    smoothed = np.degrees(drive.at("yaw_rad", t) - drive.at("yaw_rad", t - 0.2)) / 0.2
    assert (monitor - smoothed).std() < 0.6
    assert (monitor - smoothed).mean() == pytest.approx(np.degrees(sensors.monitor_bias_radps), abs=0.2)
    assert np.abs(monitor * 10 - np.rint(monitor * 10)).max() < 1e-9


def test_wheels_measure_the_distance_and_repeat_themselves(recorded):
    drive, _, sensors, messages = recorded[0]
    rows = messages["zoe_veh_info"]
    t = (column(rows, "utime") - START_US) / 1e6
    rpm = np.stack([column(rows, f"{wheel}_wheel_speed") for wheel in ("RL", "RR")], axis=1)
    speed = (rpm * sensors.wheel_radius_m[2:]).mean(axis=1) * 2.0 * np.pi / 60.0
    rolled = np.sum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t))
    true = drive.at("s_m", t[-1] - sensors.wheel_latency_s) - drive.at("s_m", t[0] - sensors.wheel_latency_s)
    assert rolled == pytest.approx(true, rel=0.005)
    assert sensors.wheel_radius_m[2:].mean() == pytest.approx(0.305, abs=0.0041)
    assert np.abs(rpm / RPM_RESOLUTION - np.rint(rpm / RPM_RESOLUTION)).max() < 1e-4
    assert 0.5 < np.mean(np.diff(rpm[:, 0]) == 0) < 0.75
    assert (speed - drive.at("speed_mps", t)).std() < 0.1


def test_wheels_and_poses_stand_with_the_car(recorded):
    drive, _, _, messages = recorded[1]
    rows = messages["zoe_veh_info"]
    t = (column(rows, "utime") - START_US) / 1e6
    still = (drive.at("speed_mps", t - 0.1) == 0) & (drive.at("speed_mps", t) == 0)
    assert still.sum() > 100
    assert column(rows, "RL_wheel_speed")[still].max() == 0.0
    imu = messages["ms_imu"]
    t = (column(imu, "utime") - START_US) / 1e6
    still = (drive.at("speed_mps", t - 0.1) == 0) & (drive.at("speed_mps", t + 0.1) == 0)
    assert column(imu, "rotation_rate", 2)[still].std() == pytest.approx(0.0008, rel=0.3)


def test_can_pose_is_the_written_localisation(recorded):
    _, localisation, _, messages = recorded[0]
    rows = messages["pose"]
    t = (column(rows, "utime") - START_US) / 1e6
    x, y, yaw = localisation.pose(t)
    assert column(rows, "pos", 0) == pytest.approx(x, abs=1e-9)
    assert column(rows, "pos", 1) == pytest.approx(y, abs=1e-9)
    assert np.exp(1j * yaw_from_quaternion_wxyz(column(rows, "orientation"))) == pytest.approx(
        np.exp(1j * yaw), abs=1e-6
    )


def test_wheel_radii_lie_in_the_real_range():
    radii = [
        draw_sensors(np.random.default_rng(seed), mean).wheel_radius_m[2:].mean()
        for seed in range(50)
        for mean in (0.3035, 0.3065)
    ]
    assert min(radii) >= 0.301 - 1e-9
    assert max(radii) <= 0.309 + 1e-9
