"""The writer: valid tables, chains and names, round trip through the reader, deterministic tokens."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mixo_env.errors import DatasetError, OutputError
from mixo_env.files import write_bytes
from mixo_env.geometry import rotation_from_quaternion_wxyz, wrap_angle_rad
from mixo_env.nuscenes.scene import CameraCalibration, CameraReel, Scene
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.nuscenes.writer import (
    EMPTY_TABLES,
    MAP_FILE,
    image_name,
    scene_tables,
    token,
    write_can_bus,
    write_tables,
)

LOG = "m001-2024-05-06-10-00-00+0000"
START_US = 1_715_000_000_000_000


def made_scene(
    root: Path, name: str, channels: tuple[str, ...] = ("CAM_FRONT", "CAM_BACK")
) -> tuple[Scene, np.ndarray]:
    """Three key frames with two sweeps between them, crossing yaw +-pi."""
    cameras = {}
    sample_us = START_US + int(name[-1]) * 60_000_000 + 500_000 * np.arange(3)
    for number, channel in enumerate(channels):
        time_us = np.concatenate([[k, k + 100_000, k + 250_000] for k in sample_us])[:7] - 10_000 * (number + 1)
        keyframe = np.array([True, False, False] * 3)[:7]
        paths = tuple(root / image_name(LOG, channel, int(t), bool(k)) for t, k in zip(time_us, keyframe, strict=True))
        quaternion = [0.5, -0.5, 0.5, -0.5] if number == 0 else [0.5, -0.5, -0.5, 0.5]
        calibration = CameraCalibration(
            channel,
            np.array([[630.5, 0.0, 400.25], [0.0, 630.5, 225.125], [0.0, 0.0, 1.0]]),
            rotation_from_quaternion_wxyz(quaternion),
            np.array([1.7 - number, 0.01, 1.5]),
            800,
            450,
        )
        drift = np.linspace(0.0, 0.3, 7)
        cameras[channel] = CameraReel(
            calibration, time_us, paths, keyframe, 100.0 + drift, -20.0 + drift, wrap_angle_rad(np.pi - 0.1 + drift)
        )
    return Scene(name, "sunny, straight", LOG, "m001", "mixocity", ("day",), cameras, None), sample_us


@pytest.fixture
def written(tmp_path) -> tuple[Path, list[Scene]]:
    scenes = [made_scene(tmp_path, name) for name in ("scene-2001", "scene-2002")]
    write_tables(tmp_path, "v1.0-mixo", [scene_tables(tmp_path, scene, times) for scene, times in scenes])
    return tmp_path, [scene for scene, _ in scenes]


def table(root: Path, name: str) -> list[dict]:
    return json.loads((root / "v1.0-mixo" / f"{name}.json").read_text())


def test_all_thirteen_tables_and_a_map(written):
    root, _ = written
    names = {path.stem for path in (root / "v1.0-mixo").iterdir()}
    assert len(names) == 13
    assert all(table(root, name) == [] for name in EMPTY_TABLES)
    image = cv2.imread(str(root / MAP_FILE), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.shape == (1, 1)
    (map_row,) = table(root, "map")
    assert map_row["log_tokens"] == [row["token"] for row in table(root, "log")]
    assert len(table(root, "log")) == 1  # two scenes of one log
    assert len(table(root, "sensor")) == 2
    assert len(table(root, "calibrated_sensor")) == 4  # per scene and sensor
    assert table(root, "log")[0]["date_captured"] == "2024-05-06"


def test_tokens_are_unique_hexadecimal_and_resolve(written):
    root, _ = written
    rows = {
        name: table(root, name)
        for name in ("scene", "sample", "sample_data", "ego_pose", "calibrated_sensor", "log", "sensor")
    }
    by_token = {name: {row["token"]: row for row in entries} for name, entries in rows.items()}
    for name, entries in rows.items():
        assert len(by_token[name]) == len(entries)
        assert all(re.fullmatch(r"[0-9a-f]{32}", row["token"]) for row in entries)
    for row in rows["sample_data"]:
        assert row["ego_pose_token"] == row["token"]
        assert by_token["ego_pose"][row["ego_pose_token"]]["timestamp"] == row["timestamp"]
        assert row["sample_token"] in by_token["sample"]
        sensor = by_token["sensor"][by_token["calibrated_sensor"][row["calibrated_sensor_token"]]["sensor_token"]]
        folder, channel, name = row["filename"].split("/")
        assert channel == sensor["channel"]
        assert folder == ("samples" if row["is_key_frame"] else "sweeps")
        assert name == f"{LOG}__{channel}__{row['timestamp']}.jpg"
        assert (row["width"], row["height"], row["fileformat"]) == (800, 450, "jpg")
    assert all(row["translation"][2] == 0.0 for row in rows["ego_pose"])
    assert np.linalg.norm([row["rotation"] for row in rows["ego_pose"]], axis=1) == pytest.approx(1.0)
    assert all(row["log_token"] in by_token["log"] for row in rows["scene"])


def test_chains_run_through_every_row(written):
    root, _ = written
    samples = {row["token"]: row for row in table(root, "sample")}
    frames = {row["token"]: row for row in table(root, "sample_data")}
    for row in table(root, "scene"):
        assert walk(samples, row["first_sample_token"]) == row["nbr_samples"] == 3
        assert samples[row["last_sample_token"]]["next"] == ""
        assert samples[row["first_sample_token"]]["prev"] == ""
    starts = [row for row in frames.values() if row["prev"] == ""]
    assert len(starts) == 4
    assert sum(walk(frames, row["token"]) for row in starts) == len(frames) == 28
    for row in frames.values():
        owner = samples[row["sample_token"]]
        if row["is_key_frame"]:
            assert abs(owner["timestamp"] - row["timestamp"]) < 50_000
        else:  # a sweep belongs to the key frame that follows it
            assert 0 < owner["timestamp"] - row["timestamp"] < 500_000


def walk(rows: dict[str, dict], first: str) -> int:
    count, here = 0, first
    while here:
        following = rows[here]["next"]
        if following:
            assert rows[following]["prev"] == here
            assert rows[following]["timestamp"] > rows[here]["timestamp"]
        count, here = count + 1, following
    return count


def test_round_trip_through_the_reader(written):
    root, scenes = written
    found = open_dataset(root)
    for scene in scenes:
        back = found.load(scene.name, ("CAM_FRONT", "CAM_BACK"))
        assert (back.description, back.log, back.vehicle, back.location) == (
            scene.description,
            scene.log,
            scene.vehicle,
            scene.location,
        )
        for channel, reel in scene.cameras.items():
            other = back.cameras[channel]
            assert np.array_equal(other.timestamp_us, reel.timestamp_us)
            assert np.array_equal(other.is_keyframe, reel.is_keyframe)
            assert other.image_paths == reel.image_paths
            assert other.x_m == pytest.approx(reel.x_m, abs=1e-9)
            assert other.y_m == pytest.approx(reel.y_m, abs=1e-9)
            assert np.abs(wrap_angle_rad(other.yaw_rad - reel.yaw_rad)).max() < 1e-9
            assert other.calibration.intrinsic == pytest.approx(reel.calibration.intrinsic)
            assert other.calibration.rotation_ego_from_camera == pytest.approx(
                reel.calibration.rotation_ego_from_camera, abs=1e-9
            )
            assert other.calibration.translation_m == pytest.approx(reel.calibration.translation_m)


def test_equal_input_gives_equal_files(written, tmp_path_factory):
    root, _ = written
    other = tmp_path_factory.mktemp("other")
    write_tables(
        other, "v1.0-mixo", [scene_tables(other, *made_scene(other, name)) for name in ("scene-2001", "scene-2002")]
    )
    for path in (root / "v1.0-mixo").iterdir():
        assert path.read_bytes() == (other / "v1.0-mixo" / path.name).read_bytes()
    assert token("a", 1) == token("a", 1) != token("a", 2)
    assert token("ab", "c") != token("a", "bc")


def test_can_bus_file_names(tmp_path):
    write_can_bus(tmp_path, "scene-2001", {"pose": [{"utime": 1, "vel": [1.0, 0.0, 0.0]}]})
    assert json.loads((tmp_path / "can_bus" / "scene-2001_pose.json").read_text())[0]["vel"] == [1.0, 0.0, 0.0]


def test_inconsistent_scenes_are_refused(tmp_path):
    scene, times = made_scene(tmp_path, "scene-2001")
    with pytest.raises(DatasetError, match="expected 2 key frames"):
        scene_tables(tmp_path, scene, times[:2])
    with pytest.raises(DatasetError, match="increase"):
        scene_tables(tmp_path, scene, times[::-1])
    with pytest.raises(DatasetError, match="at least one"):
        scene_tables(tmp_path, scene, [])
    reel = scene.cameras["CAM_FRONT"]
    twice = replace(reel, timestamp_us=np.repeat(reel.timestamp_us[:1], len(reel.timestamp_us)))
    with pytest.raises(DatasetError, match="increasing times"):
        scene_tables(tmp_path, replace(scene, cameras={"CAM_FRONT": twice}), times)


def test_unwritable_places_are_named(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match=r"cannot write .*file/inside"):
        write_bytes(tmp_path / "file" / "inside", b"1")
