from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.geometry import wrap_angle_rad, yaw_from_quaternion_wxyz
from mixo_env.nuscenes import cache
from mixo_env.nuscenes.json_rows import read_blocks
from mixo_env.nuscenes.selections import ALL_CAMERAS, CAMERAS
from mixo_env.nuscenes.tables import open_dataset
from tests.nuscenes_fixture import DRIVES, SceneTruth, token, write_nuscenes


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> tuple[Path, dict[str, SceneTruth]]:
    root = tmp_path_factory.mktemp("nuscenes")
    return root, write_nuscenes(root)


@pytest.fixture
def small(tmp_path) -> Path:
    """A folder of its own that a test may break."""
    write_nuscenes(tmp_path, drives=DRIVES[:1], duration_s=1.0)
    return tmp_path


def rewrite(table: Path, change) -> None:
    rows = json.loads(table.read_text())
    table.write_text(json.dumps(change(rows)))


def test_round_trip_gives_back_the_generators_truth(folder):
    root, truths = folder
    dataset = open_dataset(root)
    assert dataset.scene_names == tuple(sorted(truths))
    for name, truth in truths.items():
        scene = dataset.load(name, ALL_CAMERAS)
        assert tuple(scene.cameras) == ALL_CAMERAS
        assert (scene.log, scene.description) == (truth.drive.log, truth.drive.description)
        for channel, reel in scene.cameras.items():
            expected = truth.cameras[channel]
            assert reel.timestamp_us.dtype == np.int64
            assert reel.timestamp_us.tolist() == expected.timestamp_us
            assert reel.is_keyframe.tolist() == expected.is_keyframe
            assert [path.relative_to(root).as_posix() for path in reel.image_paths] == expected.filenames
            x, y, yaw = np.array(expected.pose).T
            np.testing.assert_allclose(reel.x_m, x, rtol=0, atol=1e-9)
            np.testing.assert_allclose(reel.y_m, y, rtol=0, atol=1e-9)
            np.testing.assert_allclose(wrap_angle_rad(reel.yaw_rad - yaw), 0.0, atol=1e-9)
            calibration = reel.calibration
            assert (calibration.channel, calibration.width, calibration.height) == (channel, 1600, 900)
            np.testing.assert_allclose(calibration.intrinsic, expected.intrinsic, atol=1e-9)
            np.testing.assert_allclose(calibration.translation_m, expected.translation_m, atol=1e-9)
            np.testing.assert_allclose(calibration.rotation_ego_from_camera, expected.rotation, atol=1e-9)


def test_irregularities_of_the_rig_survive(folder):
    root, _ = folder
    scene = open_dataset(root).load("scene-2061", ALL_CAMERAS)
    front, back = scene.cameras["CAM_FRONT"], scene.cameras["CAM_BACK"]
    assert len(back.timestamp_us) == len(front.timestamp_us) - 1  # the dropped frame
    assert set(np.diff(front.timestamp_us)) == {50_000, 100_000}
    assert back.timestamp_us[0] - front.timestamp_us[0] == 25_100  # the stagger
    other = open_dataset(root).load("scene-2103").cameras["CAM_FRONT"].calibration
    assert np.abs(other.intrinsic - front.calibration.intrinsic).max() > 0.1  # calibration is per scene


def test_conditions_log_and_missing_parts(folder):
    root, _ = folder
    dataset = open_dataset(root)
    assert {info.name: info.conditions for info in dataset.scenes} == {
        "scene-2061": ("day",),
        "scene-2103": ("day",),  # after rain: no drops fall
        "scene-2655": ("day", "rain"),
        "scene-2757": ("night",),
    }
    assert [info.has_can_bus for info in dataset.scenes] == [True, True, True, False]
    assert [info.vehicle for info in dataset.scenes] == ["n015", "n008", "n008", "n015"]
    assert dataset.load("scene-2757").can_bus is None
    without_monitor = dataset.load("scene-2655").can_bus
    assert without_monitor is not None
    assert without_monitor.monitor_yaw_rate_radps is None
    assert without_monitor.imu_yaw_rate_radps is not None


def test_can_bus_is_in_si_units(folder):
    root, truths = folder
    can_bus = open_dataset(root).load("scene-2061").can_bus
    drive = truths["scene-2061"].drive
    assert can_bus is not None
    for signal in (can_bus.imu_yaw_rate_radps, can_bus.pose_yaw_rate_radps, can_bus.monitor_yaw_rate_radps):
        expected = [drive.yaw_rate_radps((t - drive.start_us) * 1e-6) for t in signal.timestamp_us]
        np.testing.assert_allclose(signal.value, expected, atol=1e-12)
    assert can_bus.wheel_speed_radps.value.shape == (401, 4)
    np.testing.assert_allclose(can_bus.wheel_speed_radps.value * 0.305, 8.0)
    np.testing.assert_allclose(can_bus.pose_speed_mps.value, 8.0)
    np.testing.assert_allclose(can_bus.monitor_speed_mps.value, 8.0)
    assert can_bus.consumer_yaw_rate_radps is None


def test_exact_poses_are_read_where_they_exist(small):
    dataset = open_dataset(small)
    assert dataset.load("scene-2061").exact is None
    (small / "exact").mkdir()
    truth = {"timestamp_us": np.arange(3), "x_m": np.ones(3), "y_m": np.zeros(3), "yaw_rad": np.full(3, 0.5)}
    np.savez(small / "exact" / "scene-2061.npz", **truth)
    exact = dataset.load("scene-2061").exact
    assert exact is not None
    assert exact.timestamp_us.dtype == np.int64
    np.testing.assert_array_equal(exact.yaw_rad, 0.5)
    (small / "exact" / "scene-2061.npz").write_bytes(b"PK\x03\x04 cut")
    with pytest.raises(DatasetError, match="exact poses"):
        dataset.load("scene-2061")


def test_real_pose_of_scene_0061():
    """Published key-frame poses: the heading follows the path only when the quaternion is read as w, x, y, z."""
    positions = np.array([[411.304, 1180.890], [409.743, 1176.677], [408.102, 1172.152], [406.726, 1168.211]])
    yaw = yaw_from_quaternion_wxyz([0.5720, -0.0022, 0.0116, -0.8202])
    assert np.degrees(yaw) == pytest.approx(-110.2, abs=0.1)
    first = positions[1] - positions[0]
    assert np.degrees(np.arctan2(first[1], first[0])) == pytest.approx(-110.3, abs=0.1)


class TestCache:
    def test_second_opening_does_not_touch_the_tables(self, small, monkeypatch):
        first = open_dataset(small)
        monkeypatch.setattr(cache, "build_index", lambda folder: pytest.fail("read the tables again"))
        second = open_dataset(small)
        assert first.index.scenes == second.index.scenes
        assert first.index.calibrations == second.index.calibrations
        np.testing.assert_array_equal(first.index.yaw_rad, second.index.yaw_rad)
        assert first.load("scene-2061").cameras["CAM_BACK"].image_paths == (
            second.load("scene-2061").cameras["CAM_BACK"].image_paths
        )

    def test_changed_table_rebuilds(self, small):
        open_dataset(small)
        table = small / "v1.0-mini" / "scene.json"
        rewrite(table, lambda rows: [row | {"description": "Night"} for row in rows])
        assert open_dataset(small).scenes[0].conditions == ("night",)

    @pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"not a cache"])
    def test_damaged_cache_rebuilds(self, small, content):
        open_dataset(small)
        path = small / ".mixo-cache" / "v1.0-mini.npz"
        path.write_bytes(content)
        assert open_dataset(small).scene_names == ("scene-2061",)
        assert path.stat().st_size > len(content)

    def test_truncated_cache_rebuilds(self, small):
        open_dataset(small)
        path = small / ".mixo-cache" / "v1.0-mini.npz"
        path.write_bytes(path.read_bytes()[:-200])
        assert open_dataset(small).scene_names == ("scene-2061",)

    def test_other_schema_rebuilds(self, small, monkeypatch):
        open_dataset(small)
        monkeypatch.setattr(cache, "SCHEMA_VERSION", cache.SCHEMA_VERSION + 1)
        built = []
        original = cache.build_index
        monkeypatch.setattr(cache, "build_index", lambda folder: built.append(folder) or original(folder))
        open_dataset(small)
        assert len(built) == 1

    def test_read_only_root_uses_the_users_cache(self, small, tmp_path_factory, monkeypatch):
        home = tmp_path_factory.mktemp("home")
        monkeypatch.setenv("XDG_CACHE_HOME", str(home))
        (small / ".mixo-cache").write_text("a file in the way: nothing can be written below it")
        open_dataset(small)
        assert len(list((home / "mixo-env").glob("*-v1.0-mini.npz"))) == 1
        monkeypatch.setattr(cache, "build_index", lambda folder: pytest.fail("read the tables again"))
        open_dataset(small)

    def test_leaves_no_temporary_file(self, small):
        open_dataset(small)
        assert [path.name for path in (small / ".mixo-cache").iterdir()] == ["v1.0-mini.npz"]


class TestRows:
    """The block-wise reader agrees with the standard library wherever blocks end."""

    @pytest.mark.parametrize("block_bytes", [3, 17, 64, 1000, 10**6])
    @pytest.mark.parametrize("layout", [{"indent": 0}, {"indent": None}, {"separators": (",", ":")}, {"indent": 4}])
    def test_same_as_json(self, tmp_path, block_bytes, layout):
        from mixo_env.nuscenes.index import _SampleRow

        rows = [{"token": token(i), "scene_token": f"}} , {{ {i}", "nested": {"a": [{"b": 1}]}} for i in range(9)]
        path = tmp_path / "sample.json"
        path.write_text("\n" + json.dumps(rows, **layout) + "\n")
        blocks = read_blocks(path, _SampleRow, block_bytes)
        read = [(row.token, row.scene_token) for row in itertools.chain.from_iterable(blocks)]
        assert read == [(row["token"], row["scene_token"]) for row in rows]

    @pytest.mark.parametrize("text", ["[]", " [ ] \n"])
    def test_empty_table(self, tmp_path, text):
        from mixo_env.nuscenes.index import _SampleRow

        path = tmp_path / "sample.json"
        path.write_text(text)
        assert list(itertools.chain.from_iterable(read_blocks(path, _SampleRow))) == []


class TestBadInput:
    @pytest.mark.parametrize(
        "table", ["scene", "log", "sample", "sensor", "calibrated_sensor", "sample_data", "ego_pose"]
    )
    def test_missing_table(self, small, table):
        (small / "v1.0-mini" / f"{table}.json").unlink()
        with pytest.raises(DatasetError, match=rf"{table}\.json is missing|not a nuScenes folder"):
            open_dataset(small, "v1.0-mini")

    @pytest.mark.parametrize("table", ["scene", "sample_data", "ego_pose"])
    @pytest.mark.parametrize("keep", [0.0, 0.5, 0.999])
    def test_truncated_table(self, small, table, keep):
        path = small / "v1.0-mini" / f"{table}.json"
        content = path.read_bytes()
        path.write_bytes(content[: int(len(content) * keep)])
        with pytest.raises(DatasetError, match=rf"{table}\.json is not a valid nuScenes file"):
            open_dataset(small)

    def test_missing_key(self, small):
        drop = lambda rows: [{k: v for k, v in row.items() if k != "ego_pose_token"} for row in rows]  # noqa: E731
        rewrite(small / "v1.0-mini" / "sample_data.json", drop)
        with pytest.raises(DatasetError, match=r"sample_data\.json.*missing required field `ego_pose_token`"):
            open_dataset(small)

    def test_wrong_type(self, small):
        rewrite(small / "v1.0-mini" / "ego_pose.json", lambda rows: [row | {"rotation": [1.0, 0.0]} for row in rows])
        with pytest.raises(DatasetError, match=r"ego_pose\.json"):
            open_dataset(small)

    def test_object_instead_of_array(self, small):
        (small / "v1.0-mini" / "log.json").write_text("{}")
        with pytest.raises(DatasetError, match="expected a JSON array"):
            open_dataset(small)

    @pytest.mark.parametrize(
        ("table", "key", "target"),
        [
            ("sample_data", "calibrated_sensor_token", "calibrated_sensor"),
            ("sample_data", "sample_token", "sample"),
            ("sample", "scene_token", "scene"),
            ("scene", "log_token", "log"),
            ("calibrated_sensor", "sensor_token", "sensor"),
        ],
    )
    def test_dangling_token(self, small, table, key, target):
        rewrite(small / "v1.0-mini" / f"{table}.json", lambda rows: [row | {key: "0" * 32} for row in rows])
        with pytest.raises(DatasetError, match=f"refers to {target} '0000"):
            open_dataset(small)

    def test_the_pose_key_is_followed(self, small):
        """Poses under other tokens than the images' own."""
        rewrite(small / "v1.0-mini" / "ego_pose.json", lambda rows: [r | {"token": "p" + r["token"]} for r in rows])
        with pytest.raises(DatasetError, match="images have no ego pose"):
            open_dataset(small).load("scene-2061")
        swap = lambda rows: [row | {"ego_pose_token": "p" + row["token"]} for row in rows]  # noqa: E731
        rewrite(small / "v1.0-mini" / "sample_data.json", swap)
        assert open_dataset(small).load("scene-2061").cameras["CAM_FRONT"].x_m[0] == pytest.approx(600, abs=1)

    def test_no_such_scene_camera_or_version(self, small):
        dataset = open_dataset(small)
        with pytest.raises(ConfigurationError, match="did you mean 'scene-2061'"):
            dataset.load("scene-2016")
        with pytest.raises(ConfigurationError, match="did you mean 'CAM_FRONT_LEFT'"):
            dataset.load("scene-2061", ("CAM_FRONT-LEFT",))
        with pytest.raises(ConfigurationError, match="unknown version"):
            open_dataset(small, "v1.0-test")

    def test_wrong_folder(self, small, tmp_path_factory):
        with pytest.raises(DatasetError, match="give the folder above it"):
            open_dataset(small / "v1.0-mini")
        with pytest.raises(DatasetError, match="not a nuScenes folder"):
            open_dataset(small / "samples")
        with pytest.raises(DatasetError, match="is not a folder"):
            open_dataset(small / "nowhere")

    def test_several_versions(self, small):
        write_nuscenes(small, DRIVES[1:2], version="v1.0-trainval", duration_s=0.5)
        with pytest.raises(ConfigurationError, match=r"v1\.0-mini, v1\.0-trainval: name one"):
            open_dataset(small)
        assert open_dataset(small, "v1.0-trainval").scene_names == ("scene-2103",)

    def test_repeated_time(self, small):
        rewrite(small / "v1.0-mini" / "sample_data.json", lambda rows: [row | {"timestamp": 10**15} for row in rows])
        with pytest.raises(DatasetError, match="repeat the time of the one before"):
            open_dataset(small).load("scene-2061")

    def test_changing_calibration(self, small):
        first = token("scene-2061", "calibrated", "CAM_FRONT")

        def second_row(rows):
            return [*rows, next(r for r in rows if r["token"] == first) | {"token": "f" * 32, "translation": [1, 0, 1]}]

        rewrite(small / "v1.0-mini" / "calibrated_sensor.json", second_row)
        half = lambda rows: [  # noqa: E731
            r | {"calibrated_sensor_token": "f" * 32} if r["calibrated_sensor_token"] == first and i % 2 else r
            for i, r in enumerate(rows)
        ]
        rewrite(small / "v1.0-mini" / "sample_data.json", half)
        with pytest.raises(DatasetError, match="calibration changes within the scene"):
            open_dataset(small).load("scene-2061")
        assert open_dataset(small).load("scene-2061", ("CAM_BACK",))

    def test_broken_calibration_and_quaternion(self, small):
        table = small / "v1.0-mini" / "calibrated_sensor.json"
        rewrite(table, lambda rows: [row | {"camera_intrinsic": []} for row in rows])
        with pytest.raises(DatasetError, match="camera_intrinsic must be"):
            open_dataset(small).load("scene-2061")
        rewrite(small / "v1.0-mini" / "ego_pose.json", lambda rows: [r | {"rotation": [2, 0, 0, 0]} for r in rows])
        rewrite(table, lambda rows: [row | {"camera_intrinsic": np.eye(3).tolist()} for row in rows])
        with pytest.raises(DatasetError, match="quaternion is not unit"):
            open_dataset(small).load("scene-2061")

    @pytest.mark.parametrize("content", ["", "[{]", '[{"utime": 1}]', '[{"utime": 1, "rotation_rate": [0, 0, NaN]}]'])
    def test_broken_can_bus_file(self, small, content):
        (small / "can_bus" / "scene-2061_ms_imu.json").write_text(content)
        with pytest.raises(DatasetError, match=r"scene-2061_ms_imu\.json is not a valid CAN bus file"):
            open_dataset(small).load("scene-2061")

    def test_empty_can_bus_file_is_a_missing_message(self, small):
        (small / "can_bus" / "scene-2061_ms_imu.json").write_text("[]")
        can_bus = open_dataset(small).load("scene-2061").can_bus
        assert can_bus is not None
        assert can_bus.imu_yaw_rate_radps is None

    def test_without_can_bus_folder(self, small):
        import shutil

        shutil.rmtree(small / "can_bus")
        dataset = open_dataset(small)
        assert dataset.load("scene-2061").can_bus is None
        assert not dataset.scenes[0].has_can_bus


def test_paper_cameras_come_first_by_default(folder):
    assert tuple(open_dataset(folder[0]).load("scene-2061").cameras) == CAMERAS
