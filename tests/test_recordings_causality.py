"""The project's own experts in a recording: nothing from the future, no gyro in a camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import simplejpeg

from mixo_env.nuscenes.scene import Signal
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.record import RecordConfig, default_experts
from mixo_env.recordings.steps import record_scene
from tests.nuscenes_fixture import DRIVES, write_nuscenes
from tests.recording_fakes import with_another_future, write_sliding_texture

CAMERAS = ("CAM_FRONT", "CAM_BACK_RIGHT")
EXPERTS = default_experts(RecordConfig(cameras=CAMERAS), "any scene")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("nuscenes")
    write_sliding_texture(folder, write_nuscenes(folder, DRIVES[:1], duration_s=1.0, images=False))
    return open_dataset(folder).load(DRIVES[0].name, CAMERAS)


@pytest.fixture(scope="module")
def recorded(scene):
    columns, _ = record_scene(scene, EXPERTS)
    return columns


@pytest.mark.parametrize("k", [6])
def test_nothing_later_than_t_k_enters_row_k(scene, recorded, k):
    other, _ = record_scene(with_another_future(scene, recorded["timestamp_us"][k]), EXPERTS)
    for name, values in recorded.items():
        assert values[: k + 1].tobytes() == other[name][: k + 1].tobytes(), name
    changed = {name for name in recorded if recorded[name][k + 1 :].tobytes() != other[name][k + 1 :].tobytes()}
    assert {
        "distance_m",
        "INERTIAL.yaw_increment_rad",
        "INERTIAL_POSE.yaw_increment_rad",
        "CAM_FRONT.matches",
    } <= changed


def test_a_camera_does_not_listen_to_the_gyro(scene, recorded):
    can_bus = scene.can_bus
    gyro = can_bus.imu_yaw_rate_radps
    wrong = replace(can_bus, imu_yaw_rate_radps=Signal(gyro.timestamp_us, -2.0 * gyro.value + 0.5))
    other, _ = record_scene(replace(scene, can_bus=wrong), EXPERTS)
    assert changed(recorded, other) == {"INERTIAL.yaw_increment_rad", "INERTIAL.yaw_std_rad"}
    assert np.isfinite(recorded["CAM_FRONT.yaw_increment_rad"]).any()


def test_a_camera_does_not_see_a_pose(scene, recorded):
    turned = {c: replace(t, yaw_rad=t.yaw_rad[::-1], x_m=t.x_m + 7.0) for c, t in scene.cameras.items()}
    pose = scene.can_bus.pose_yaw_rate_radps
    wrong = replace(scene.can_bus, pose_yaw_rate_radps=Signal(pose.timestamp_us, 3.0 * pose.value - 0.2))
    other, _ = record_scene(replace(scene, cameras=turned, can_bus=wrong), EXPERTS)
    names = changed(recorded, other)
    assert {"INERTIAL_POSE.yaw_increment_rad", "truth.x_m"} <= names
    own_truth = {f"{camera}.own_window_truth_yaw_increment_rad" for camera in CAMERAS}
    assert not {name for name in names if name.startswith("CAM_")} - own_truth


def test_wheels_are_the_scale_of_a_camera_and_move_no_clock(scene, recorded):
    wheels = scene.can_bus.wheel_speed_radps
    fast = replace(scene.can_bus, wheel_speed_radps=Signal(wheels.timestamp_us, 1.1 * wheels.value))
    names = changed(recorded, record_scene(replace(scene, can_bus=fast), EXPERTS)[0])
    assert {"distance_m", "CAM_FRONT.own_window_yaw_increment_rad", "CAM_FRONT.yaw_increment_rad"} <= names
    assert not {name for name in names if name.endswith("image_time_offset_s") or name.endswith("own_window_s")}


def changed(recorded, other):
    return {name for name in recorded if recorded[name].tobytes() != other[name].tobytes()}


@pytest.mark.parametrize("picture", ["blank", "identical"])
def test_pictures_that_say_nothing_never_let_the_gyro_into_a_camera(tmp_path, scene, picture):
    first = {camera: track.image_paths[0].read_bytes() for camera, track in scene.cameras.items()}
    height, width = (int(n) for n in simplejpeg.decode_jpeg_header(first["CAM_FRONT"])[:2])
    blank = np.full((height, width, 1), 128, np.uint8)
    cameras = {}
    for camera, track in scene.cameras.items():
        path = tmp_path / f"{camera}.jpg"
        path.write_bytes(first[camera] if picture == "identical" else simplejpeg.encode_jpeg(blank, colorspace="GRAY"))
        cameras[camera] = replace(track, image_paths=(path,) * len(track.image_paths))
    silent = replace(scene, cameras=cameras)
    can_bus = scene.can_bus
    gyro, pose = can_bus.imu_yaw_rate_radps, can_bus.pose_yaw_rate_radps
    wrong = replace(
        can_bus,
        imu_yaw_rate_radps=Signal(gyro.timestamp_us, gyro.value + 0.5),
        pose_yaw_rate_radps=Signal(pose.timestamp_us, pose.value + 0.5),
    )
    before, _ = record_scene(silent, EXPERTS)
    after, _ = record_scene(replace(silent, can_bus=wrong), EXPERTS)
    assert not {name for name in changed(before, after) if name.startswith("CAM_")}
    if picture == "blank":
        assert all(np.isnan(before[f"{camera}.yaw_increment_rad"]).all() for camera in CAMERAS)
