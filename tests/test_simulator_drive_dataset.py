"""Whole simulated folders: same files for any number of workers, resumable, honest about failure."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, DatasetError, OutputError
from mixo_env.files import atomic_path
from mixo_env.geometry import wrap_angle_rad
from mixo_env.nuscenes.scene import CameraCalibration
from mixo_env.nuscenes.selections import ALL_CAMERAS, CAMERAS
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.simulator import dataset
from mixo_env.simulator.city.streets import BLOCK_M
from mixo_env.simulator.config import SimulationConfig, SituationShares
from mixo_env.simulator.dataset import simulate
from mixo_env.simulator.drive.scenario import plan_logs
from mixo_env.simulator.drive.scenes import blank_sides, camera_pose, scene_drive, simulate_scene

TINY = SimulationConfig(scenes=5, scenes_per_log=2, seconds=4, images=False)


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and ".mixo-cache" not in path.parts  # the reader's
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("simulated") / "city"
    simulate(TINY, out)
    return out


def test_files_do_not_depend_on_the_number_of_workers(folder, tmp_path):
    simulate(TINY, tmp_path / "two", workers=2)
    assert digests(tmp_path / "two") == digests(folder)


def test_cameras_do_not_influence_each_other(folder, tmp_path):
    simulate(replace(TINY, cameras=ALL_CAMERAS), tmp_path / "six")
    four, six = open_dataset(folder), open_dataset(tmp_path / "six")
    assert set(six.channels) == set(ALL_CAMERAS)
    for name in four.scene_names:
        one, other = four.load(name, CAMERAS), six.load(name, CAMERAS)
        for channel in CAMERAS:
            assert np.array_equal(one.cameras[channel].timestamp_us, other.cameras[channel].timestamp_us)
            assert np.array_equal(one.cameras[channel].x_m, other.cameras[channel].x_m)


def test_the_reader_finds_what_was_simulated(folder):
    found = open_dataset(folder)
    assert found.version == "v1.0-mixo"
    assert found.scene_names == tuple(f"scene-{2001 + number}" for number in range(5))
    logs = plan_logs(TINY)
    assert len(logs) == 3
    for log in logs:
        for plan in log.scenes:
            simulated = simulate_scene(TINY, log, plan, folder)
            scene = found.load(plan.name)
            assert (scene.log, scene.vehicle, scene.description) == (
                log.logfile,
                log.vehicle,
                simulated.scene.description,
            )
            assert scene.conditions == (
                ("night",) if log.weather == "night" else ("day", "rain")[: 1 + (log.weather == "rain")]
            )
            for channel, reel in scene.cameras.items():
                mine = simulated.scene.cameras[channel]
                assert reel.timestamp_us.tolist() == mine.timestamp_us.tolist()
                assert reel.image_paths == mine.image_paths
                assert reel.x_m == pytest.approx(mine.x_m, abs=1e-9)
                assert np.abs(wrap_angle_rad(reel.yaw_rad - mine.yaw_rad)).max() < 1e-9
                written = log.rig.written[channel]
                assert reel.calibration.rotation_ego_from_camera == pytest.approx(
                    written.rotation_ego_from_camera, abs=1e-9
                )
            assert scene.can_bus is not None
            assert all(signal is not None for signal in vars(scene.can_bus).values())
            assert scene.exact is not None
            front = scene.cameras["CAM_FRONT"]
            exact_x = np.interp(front.timestamp_us, scene.exact.timestamp_us, scene.exact.x_m)
            assert np.abs(exact_x - front.x_m).max() < 0.8  # lag, wander


def test_an_interrupted_run_continues(folder, tmp_path, monkeypatch):
    real, calls = dataset._simulate_scene, []

    def stops_after_two(*arguments):
        if len(calls) == 2:
            raise KeyboardInterrupt
        calls.append(arguments[1][1].name)
        real(*arguments)

    out = tmp_path / "city"
    monkeypatch.setattr(dataset, "_simulate_scene", stops_after_two)
    with pytest.raises(KeyboardInterrupt):
        simulate(TINY, out)
    assert calls == ["scene-2001", "scene-2002"]
    assert not (out / "v1.0-mixo").exists()  # nothing that could be taken for a data set
    monkeypatch.setattr(
        dataset, "_simulate_scene", lambda *arguments: (calls.append(arguments[1][1].name), real(*arguments))
    )
    seen = []
    simulate(TINY, out, progress=lambda done, total: seen.append((done, total)))
    assert calls[2:] == ["scene-2003", "scene-2004", "scene-2005"]
    assert seen[-1] == (5, 5)
    assert digests(out) == digests(folder)


def test_some_scenes_now_and_the_others_later(folder, tmp_path):
    out = tmp_path / "city"
    seen = []
    simulate(TINY, out, only=("scene-2004", "scene-2002"), progress=lambda done, total: seen.append((done, total)))
    assert open_dataset(out).scene_names == ("scene-2002", "scene-2004")
    assert seen[-1] == (2, 2)
    whole = digests(folder)
    assert all(whole[name] == digest for name, digest in digests(out).items() if not name.startswith("v1.0-mixo"))
    simulate(TINY, out, only=("scene-2001",))
    assert open_dataset(out).scene_names == ("scene-2001", "scene-2002", "scene-2004")
    simulate(TINY, out)
    assert digests(out) == whole
    with pytest.raises(ConfigurationError, match="unknown scene 'scene-3000'"):
        simulate(TINY, out, only=("scene-3000",))


def test_a_finished_folder_is_left_alone(folder, monkeypatch):
    before = digests(folder)
    monkeypatch.setattr(dataset, "_simulate_scene", lambda *_: pytest.fail("simulated again"))
    simulate(TINY, folder)
    assert digests(folder) == before


def test_another_configuration_or_foreign_folder_is_refused(folder, tmp_path):
    with pytest.raises(ConfigurationError, match="different: seed"):
        simulate(replace(TINY, seed=1), folder)
    (tmp_path / "photo.jpg").write_bytes(b"")
    with pytest.raises(ConfigurationError, match="not an empty folder"):
        simulate(TINY, tmp_path)
    with pytest.raises(ConfigurationError, match="workers"):
        simulate(TINY, tmp_path / "new", workers=0)


def test_a_full_disk_gives_one_clear_line_and_no_half_file(tmp_path, monkeypatch):
    def write(path: Path, content: bytes) -> None:
        with atomic_path(path) as part:
            part.write_bytes(content)
            if "scene-2002_pose" in path.name:
                raise OSError(28, "No space left on device")

    out = tmp_path / "city"
    monkeypatch.setattr("mixo_env.nuscenes.writer.write_bytes", write)
    with pytest.raises(OutputError, match=r"cannot write .*scene-2002_pose\.json: No space left on device.*run again"):
        simulate(TINY, out)
    assert not list(out.rglob(".part-*"))
    assert not (out / "parts" / "scene-2002.json").exists()
    assert (out / "parts" / "scene-2001.json").exists()


def test_a_broken_part_is_named(folder, tmp_path):
    out = tmp_path / "city"
    simulate(replace(TINY, scenes=1), out)
    (out / "parts" / "scene-2001.json").write_text("{")
    with pytest.raises(DatasetError, match=r"scene-2001\.json"):
        simulate(replace(TINY, scenes=1), out)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenes": 0}, "scenes must lie between"),
        ({"scenes": 8000}, "scenes must lie between"),
        ({"seconds": 1}, "seconds"),
        ({"width": 640, "height": 480}, "16:9"),
        ({"cameras": ("CAM_FRNT",)}, "did you mean 'CAM_FRONT'"),
        ({"cameras": ()}, "none"),
        ({"cameras": ("CAM_FRONT", "CAM_FRONT")}, "once"),
        ({"rain": 0.7, "night": 0.7}, "add up"),
        ({"low_texture": -0.1}, "between 0 and 1"),
    ],
)
def test_impossible_configurations(change, message):
    with pytest.raises(ConfigurationError, match=message):
        replace(TINY, **change)


def test_impossible_situation_shares():
    with pytest.raises(ConfigurationError, match="add up"):
        SituationShares(standing=0.6, lead_truck=0.6)
    with pytest.raises(ConfigurationError, match="tight_turn"):
        SituationShares(tight_turn=2.0)


def test_shares_are_dealt_exactly():
    config = SimulationConfig(scenes=100, scenes_per_log=5)
    logs = plan_logs(config)
    assert len(logs) == 20
    situations = [plan.situation for log in logs for plan in log.scenes]
    for name, share in config.situations.by_name().items():
        assert situations.count(name) == pytest.approx(100 * share, abs=1)
    weathers = [log.weather for log in logs]
    assert (weathers.count("rain"), weathers.count("night")) == (4, 2)
    assert sum(log.low_texture for log in logs) == 2
    assert len({log.logfile for log in logs}) == 20
    assert len({log.world_seed for log in logs}) == 20
    assert len(plan_logs(SimulationConfig())) == 4
    times = [plan.start_us for log in logs for plan in log.scenes]
    assert times == sorted(times)


def test_a_blank_wall_stands_along_the_way():
    shares = SituationShares(**dict.fromkeys(SituationShares().by_name(), 0.0) | {"blank_wall": 1.0})
    config = SimulationConfig(scenes=2, scenes_per_log=2, situations=shares)
    (log,) = plan_logs(config)
    sides = blank_sides(config, log)
    assert sides
    middles = {"west": (0.0, 0.5), "east": (1.0, 0.5), "south": (0.5, 0.0), "north": (0.5, 1.0)}
    drives = [scene_drive(config, log, plan) for plan in log.scenes]
    for column, row, side in sides:
        x, y = (column + middles[side][0]) * BLOCK_M, (row + middles[side][1]) * BLOCK_M
        assert min(np.hypot(drive.x_m - x, drive.y_m - y).min() for drive in drives) < 150.0
    assert blank_sides(SimulationConfig(scenes=2), plan_logs(SimulationConfig(scenes=2))[0]) == ()


def test_cameras_ride_on_the_body():
    log = plan_logs(TINY)[0]
    drive = scene_drive(TINY, log, log.scenes[0])
    for channel in ALL_CAMERAS:
        calibration: CameraCalibration = log.rig.true[channel]
        pose = camera_pose(drive, calibration.rotation_ego_from_camera, calibration.translation_m, 1.0)
        yaw = float(drive.at("yaw_rad", 1.0))
        ego = np.array([float(drive.at("x_m", 1.0)), float(drive.at("y_m", 1.0)), float(drive.at("z_m", 1.0))])
        c, s = np.cos(yaw), np.sin(yaw)
        level = ego + np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ calibration.translation_m
        assert (
            np.linalg.norm(pose.position_m - level) < 0.2
        )  # pitch, roll and heave move it by centimetres, a slope of 6 % by a decimetre more
        assert pose.rotation_map_from_camera @ pose.rotation_map_from_camera.T == pytest.approx(np.eye(3), abs=1e-9)
        axis = pose.rotation_map_from_camera[:, 2]
        mounted = calibration.rotation_ego_from_camera[:, 2]
        turned = np.arctan2(axis[1], axis[0]) - np.arctan2(mounted[1], mounted[0]) - yaw
        assert abs(float(wrap_angle_rad(turned))) < 0.03


def test_notes_are_plain_json(folder):
    note = json.loads((folder / "simulation.json").read_text())
    assert note["scenes"] == 5
    assert note["format"] == dataset.FORMAT
