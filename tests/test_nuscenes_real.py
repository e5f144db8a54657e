"""The reader on real tables, where they are at hand."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from mixo_env.errors import DatasetError
from mixo_env.geometry import wrap_angle_rad
from mixo_env.nuscenes.tables import open_dataset
from tests.nuscenes_fixture import token


@pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="needs real data")
class TestRealData:
    def test_mini_descriptions(self):
        from mixo_env.nuscenes.selections import FIRST_NIGHT_SCENE, conditions_of, scene_number

        rows = json.loads((Path(os.environ["MIXO_REAL_DATA"]) / "nuscenes_mini_tables" / "scene.json").read_text())
        for row in rows:
            number = scene_number(row["name"])
            assert number is not None
            assert ("night" in conditions_of(row["description"])) == (number >= FIRST_NIGHT_SCENE)

    def test_real_can_bus_messages(self):
        from mixo_env.nuscenes.can_bus import read_can_bus, scenes_with_can_bus

        folder = Path(os.environ["MIXO_REAL_DATA"]) / "nuscenes_can_bus"
        names = scenes_with_can_bus(folder)
        assert names == {"scene-0061", "scene-0655", "scene-0757", "scene-0796"}
        for name in names:
            can_bus = read_can_bus(folder, name)
            assert can_bus is not None
            assert can_bus.consumer_yaw_rate_radps is None
            wheels = can_bus.wheel_speed_radps.value[:, 2:].mean(axis=1) * 0.305
            assert np.median(np.diff(can_bus.wheel_speed_radps.timestamp_us)) == pytest.approx(10_000, rel=0.02)
            assert wheels.mean() == pytest.approx(can_bus.pose_speed_mps.value.mean(), rel=0.03)
            assert wheels.mean() == pytest.approx(can_bus.monitor_speed_mps.value.mean(), rel=0.03)

    def test_tables_filled_up_with_real_poses(self, tmp_path):
        """The real small tables of the mini version, completed by sample_data and ego_pose rows from real poses."""
        root = Path(os.environ["MIXO_REAL_DATA"])
        version = tmp_path / "v1.0-mini"
        version.mkdir()
        for path in (root / "nuscenes_mini_tables").glob("*.json"):
            (version / path.name).write_bytes(path.read_bytes())
        calibration = json.loads((root / "nuscenes_poses_12hz" / "calibration.json").read_text())
        scenes = {row["name"]: row for row in json.loads((version / "scene.json").read_text())}
        data, poses, frames = [], [], {}
        for name in ("scene-0655", "scene-0757"):
            frames[name] = json.loads((root / "nuscenes_poses_12hz" / f"{name}_CAM_FRONT.json").read_text())["frames"]
            for frame in frames[name]:
                data.append(
                    {
                        "token": token(frame["filename"]),
                        "sample_token": scenes[name]["first_sample_token"],
                        "ego_pose_token": frame["sample_data_token"] if "sample_data_token" in frame else token(frame),
                        "calibrated_sensor_token": calibration[name]["calibrated_sensor_token"],
                        "filename": frame["filename"],
                        "timestamp": frame["timestamp"],
                        "is_key_frame": frame["filename"].startswith("samples"),
                        "width": 1600,
                        "height": 900,
                    }
                )
                poses.append(
                    {
                        "token": data[-1]["ego_pose_token"],
                        "timestamp": frame["timestamp"],
                        "translation": frame["egoTranslation"],
                        "rotation": frame["egoRotation_wxyz"],
                    }
                )
        (version / "sample_data.json").write_text(json.dumps(data))
        (version / "ego_pose.json").write_text(json.dumps(poses))
        dataset = open_dataset(tmp_path)
        assert len(dataset.scene_names) == 10
        for name, expected in frames.items():
            scene = dataset.load(name, ("CAM_FRONT",))
            reel = scene.cameras["CAM_FRONT"]
            assert len(reel.x_m) == 237
            assert reel.is_keyframe.sum() == 41 == next(s for s in dataset.scenes if s.name == name).keyframes
            assert reel.timestamp_us.tolist() == [frame["timestamp"] for frame in expected]
            np.testing.assert_allclose(reel.calibration.intrinsic, calibration[name]["cam_intrinsic"], atol=1e-9)
            step = np.hypot(np.diff(reel.x_m), np.diff(reel.y_m))
            moving = step > 0.2
            course = np.arctan2(np.diff(reel.y_m), np.diff(reel.x_m))[moving]
            middle = reel.yaw_rad[:-1][moving] + 0.5 * wrap_angle_rad(np.diff(reel.yaw_rad))[moving]
            assert np.degrees(np.abs(np.median(wrap_angle_rad(course - middle)))) < 1.0
        with pytest.raises(DatasetError, match="the tables list no images"):
            dataset.load("scene-0061")
