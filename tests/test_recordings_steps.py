"""Rows of one scene: what stands in which column, and that nothing later than t_k enters row k."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import simplejpeg

from mixo_env.errors import DatasetError
from mixo_env.experts.expert import State
from mixo_env.geometry import wrap_angle_rad
from mixo_env.nuscenes.scene import CanBus
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.recordings.clock import firing_rounds
from mixo_env.recordings.schema import INERTIAL_EXPERTS, columns
from mixo_env.recordings.steps import Experts, read_grey, record_scene
from tests.corridor import calibration, picture
from tests.recording_fakes import (
    CELLS,
    DROPPED,
    FAKES,
    SPEED_MPS,
    YAW_RATE_RADPS,
    drive,
    make_scene,
    with_another_future,
    write_picture,
)


@pytest.fixture
def scene(tmp_path):
    return make_scene(tmp_path)


def rounds_of(scene):
    return firing_rounds({camera: track.timestamp_us for camera, track in scene.cameras.items()})


def test_columns_are_those_of_the_schema(scene):
    table, timings = record_scene(scene, FAKES)
    expected = columns(CAMERAS, INERTIAL_EXPERTS)
    assert {name: values.dtype.name for name, values in table.items()} == expected
    assert list(table) == list(expected)
    assert {len(values) for values in table.values()} == {len(CELLS)}
    assert {len(values) for values in timings.values()} == {len(CELLS) * len(CAMERAS) - len(DROPPED)}


def test_truth_is_the_pose_of_the_closing_image(scene):
    table, _ = record_scene(scene, FAKES)
    x, y, yaw = drive(table["timestamp_us"])
    np.testing.assert_allclose(table["truth.x_m"], x, atol=1e-9)
    np.testing.assert_allclose(table["truth.y_m"], y, atol=1e-9)
    np.testing.assert_allclose(wrap_angle_rad(table["truth.yaw_rad"] - yaw), 0.0, atol=1e-9)
    dt = table["dt_s"][1:]
    np.testing.assert_allclose(dt, np.diff(table["time_s"]), atol=1e-9)
    np.testing.assert_allclose(table["truth.yaw_increment_rad"][1:], YAW_RATE_RADPS * dt, atol=1e-9)
    radius = SPEED_MPS / YAW_RATE_RADPS
    np.testing.assert_allclose(table["truth.distance_m"][1:], 2 * radius * np.sin(0.5 * YAW_RATE_RADPS * dt), atol=1e-9)
    np.testing.assert_allclose(table["exact.x_m"], x, atol=1e-5)
    np.testing.assert_allclose(table["exact.yaw_rad"], yaw, atol=1e-9)
    rounds = rounds_of(scene)
    assert CAMERAS[rounds.closing_camera[4]] == "CAM_BACK_RIGHT"  # CAM_BACK was dropped
    np.testing.assert_array_equal(table["is_keyframe"], np.arange(len(CELLS)) % 6 == 0)


def test_driving_backwards_is_a_negative_distance(scene):
    turned = {
        camera: replace(track, yaw_rad=wrap_angle_rad(track.yaw_rad + np.pi)) for camera, track in scene.cameras.items()
    }
    forwards, _ = record_scene(scene, FAKES)
    backwards, _ = record_scene(replace(scene, cameras=turned), FAKES)
    np.testing.assert_allclose(backwards["truth.distance_m"][1:], -forwards["truth.distance_m"][1:])


def test_camera_columns(scene):
    table, _ = record_scene(scene, FAKES)
    rounds = rounds_of(scene)
    for j, camera in enumerate(CAMERAS):
        track = scene.cameras[camera]
        state = table[f"{camera}.state"]
        np.testing.assert_array_equal(state == State.NO_IMAGE, ~rounds.fired[:, j])
        levels = [read_grey(path).mean() for path in track.image_paths]
        image_of = {int(k): int(rounds.image[k, j]) for k in np.flatnonzero(rounds.fired[:, j])}
        own, carried = (table[f"{camera}.{name}yaw_increment_rad"] for name in ("own_window_", ""))
        for k in range(len(CELLS)):
            if k not in image_of:
                for name in (
                    "own_window_s",
                    "matches",
                    "flow_px",
                    "image_time_offset_s",
                    "own_window_yaw_increment_rad",
                ):
                    assert np.isnan(table[f"{camera}.{name}"][k])
                continue
            i = image_of[k]
            offset = 1e-6 * (track.timestamp_us[i] - rounds.closing_time_us[k])
            assert table[f"{camera}.image_time_offset_s"][k] == pytest.approx(offset, abs=1e-7)
            if i == 0:
                assert state[k] == State.INITIALISING
                assert np.isnan(table[f"{camera}.own_window_s"][k])
                continue
            window = 1e-6 * (track.timestamp_us[i] - track.timestamp_us[i - 1])
            assert table[f"{camera}.own_window_s"][k] == pytest.approx(window, abs=1e-6)
            truth = table[f"{camera}.own_window_truth_yaw_increment_rad"][k]
            assert truth == pytest.approx(YAW_RATE_RADPS * window, abs=1e-9)
            assert np.isfinite(own[k]) == (levels[i] >= 30) == (state[k] == State.TRACKING)
            assert np.isfinite(carried[k]) == (np.isfinite(own[k]) and k - 1 in image_of)
            assert np.isfinite(table[f"{camera}.two_frame_yaw_increment_rad"][k]) == (k - 1 in image_of)
            if np.isfinite(own[k]):
                change = 1e-3 * (levels[i] - levels[i - 1])
                assert own[k] == pytest.approx(change + 1e-3 * SPEED_MPS * window, abs=2e-4)


def test_inertial_columns(scene):
    table, _ = record_scene(scene, FAKES)
    dt = table["dt_s"][1:]
    np.testing.assert_allclose(table["distance_m"][1:], SPEED_MPS * dt, atol=0.07)
    np.testing.assert_allclose(table["speed_mps"], SPEED_MPS, atol=0.05)
    np.testing.assert_allclose(table["INERTIAL.yaw_increment_rad"][1:], YAW_RATE_RADPS * dt, atol=4e-3)
    assert np.all(table["INERTIAL.yaw_std_rad"][1:] > 0)
    assert np.isnan(table["INERTIAL_POSE.yaw_increment_rad"]).all()  # the scene has no such message
    for name in ("distance_m", "INERTIAL.yaw_increment_rad", "truth.yaw_increment_rad", "CAM_FRONT.yaw_increment_rad"):
        assert np.isnan(table[name][0])


@pytest.mark.parametrize("k", range(1, 11))
def test_nothing_later_than_t_k_enters_row_k(scene, k):
    before, _ = record_scene(scene, FAKES)
    after, _ = record_scene(with_another_future(scene, before["timestamp_us"][k]), FAKES)
    for name, values in before.items():
        assert values[: k + 1].tobytes() == after[name][: k + 1].tobytes(), name
    changed = {name for name in before if before[name][k + 1 :].tobytes() != after[name][k + 1 :].tobytes()}
    assert {"distance_m", "INERTIAL.yaw_increment_rad", "CAM_FRONT.yaw_increment_rad", "CAM_BACK.matches"} <= changed


@pytest.mark.parametrize("k", [3, 6])
def test_a_scene_that_ends_earlier_has_the_same_first_rows(scene, k):
    whole, _ = record_scene(scene, FAKES)
    t_k = whole["timestamp_us"][k]
    tracks = {}
    for camera, track in scene.cameras.items():
        n = int(np.searchsorted(track.timestamp_us, t_k, side="right"))
        arrays = {name: getattr(track, name)[:n] for name in ("timestamp_us", "is_keyframe", "x_m", "y_m", "yaw_rad")}
        tracks[camera] = replace(track, image_paths=track.image_paths[:n], **arrays)
    shorter, _ = record_scene(replace(scene, cameras=tracks), FAKES)
    for name, values in shorter.items():
        assert values.tobytes() == whole[name][: k + 1].tobytes(), name


def test_what_cannot_be_recorded_is_refused(scene):
    with pytest.raises(DatasetError, match="no CAN bus"):
        record_scene(replace(scene, can_bus=None), FAKES)
    with pytest.raises(DatasetError, match="INERTIAL needs its messages"):
        record_scene(replace(scene, can_bus=CanBus()), FAKES)
    alone = {
        camera: replace(track, timestamp_us=track.timestamp_us[:1], image_paths=track.image_paths[:1])
        for camera, track in scene.cameras.items()
    }
    with pytest.raises(DatasetError, match="at least two firing rounds"):
        record_scene(replace(scene, cameras=alone), FAKES)

    class Blind:
        def __init__(self, can_bus, grade):
            self.expert = FAKES.inertial(can_bus, "INERTIAL")

        def at(self, timestamps_us):
            track = self.expert.at(timestamps_us)
            return replace(track, distance_m=np.where(track.distance_m > 3.0, np.nan, track.distance_m))

    with pytest.raises(DatasetError, match="distance_m is not finite in every step"):
        record_scene(scene, Experts(FAKES.camera, Blind))


def test_unreadable_images_are_named(tmp_path):
    path = tmp_path / "a.jpg"
    with pytest.raises(DatasetError, match=r"a\.jpg cannot be read"):
        read_grey(path)
    write_picture(path, 77)
    assert read_grey(path).shape == (9, 16)
    assert abs(read_grey(path).mean() - 77) < 2
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(DatasetError, match=r"a\.jpg cannot be read as JPEG"):
        read_grey(path)


@pytest.mark.parametrize(("height", "width"), [(360, 640), (361, 641)])
def test_halved_by_the_decoder_is_the_mean_of_four_pixels(tmp_path, height, width):
    street = cv2.resize(picture(calibration(), 0.0, 0.0, 0.1), (width, height))
    path = tmp_path / "a.jpg"
    path.write_bytes(simplejpeg.encode_jpeg(street[..., None], quality=90, colorspace="GRAY"))
    half, whole = read_grey(path, 1), read_grey(path)
    mean = whole[:360, :640].reshape(180, 2, 320, 2).mean((1, 3))
    assert half.shape == mean.shape
    assert np.abs(half - mean).mean() < 0.5
    assert np.abs(half - mean).max() < 6
    corners = np.asarray(cv2.goodFeaturesToTrack(half, 300, 0.01, 7), np.float32)
    moved = cv2.calcOpticalFlowPyrLK(
        np.rint(mean).astype(np.uint8), half, corners, corners.copy(), winSize=(15, 15), maxLevel=0
    )[0]
    assert np.abs(np.median(moved - corners, axis=0)).max() < 0.01
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(DatasetError, match="cannot be read as JPEG"):
        read_grey(path, 1)
