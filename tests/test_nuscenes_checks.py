from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixo_env.nuscenes.checks.judge import judge, problems_of_folder
from mixo_env.nuscenes.checks.motion import lag_of, window_rates
from mixo_env.nuscenes.checks.mounting import calibration_problems
from mixo_env.nuscenes.images import BROKEN_IN_A_ROW, too_many_broken
from mixo_env.nuscenes.scene import CameraCalibration
from mixo_env.nuscenes.tables import open_dataset
from tests.nuscenes_fixture import DRIVES, write_can_bus, write_nuscenes


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("sound")
    write_nuscenes(root)
    return root


@pytest.fixture
def folder(sound, tmp_path) -> Path:
    shutil.copytree(sound, tmp_path / "copy")
    return tmp_path / "copy"


def report(folder: Path, name: str = "scene-2061"):
    dataset = open_dataset(folder)
    return judge(dataset, name, dataset.channels)


def problems(folder: Path, name: str = "scene-2061") -> list[str]:
    return [str(finding) for finding in report(folder, name).problems]


def notes(folder: Path, name: str = "scene-2061") -> list[str]:
    return [str(finding) for finding in report(folder, name).notes]


def change_can_bus(folder: Path, message: str, change) -> None:
    path = folder / "can_bus" / f"scene-2061_{message}.json"
    path.write_text(json.dumps(change(json.loads(path.read_text()))))


def test_sound_scenes(sound):
    first = report(sound)
    assert first.problems == []
    assert first.notes == []
    assert first.rates_hz == pytest.approx(
        {"zoe_veh_info": 100, "ms_imu": 100, "pose": 50, "vehicle_monitor": 2, "steeranglefeedback": 100}, rel=1e-3
    )
    assert first.pose_lag_s == pytest.approx(0.0, abs=2e-3)
    assert first.imu_latency_s == pytest.approx(0.0, abs=2e-3)
    assert first.truth_noise_deg < 0.01
    assert first.gyro_correlation > 0.999
    assert first.wheel_ratio == pytest.approx(1.0, abs=2e-3)
    assert first.distance_m == pytest.approx(8.0 * first.duration_s, rel=1e-3)
    assert first.turn_deg == pytest.approx(np.degrees(1.5), abs=1.0)
    standing = report(sound, "scene-2103")
    assert standing.problems == []
    assert [finding.check for finding in standing.notes] == ["standing"]
    assert standing.gyro_correlation is None
    assert standing.wheel_ratio is None
    assert problems_of_folder(open_dataset(sound)) == []


def test_missing_messages(sound):
    assert notes(sound, "scene-2655") == ["can-bus: no vehicle_monitor messages"]
    assert problems(sound, "scene-2757") == ["can-bus: no CAN bus data: it cannot be recorded"]


def test_images(folder):
    reel = open_dataset(folder).reel("scene-2061", "CAM_BACK")
    reel.image_paths[2].unlink()
    reel.image_paths[5].write_bytes(b"")
    assert problems(folder) == []
    assert notes(folder) == [
        f"images: CAM_BACK: 1 of 48 images are missing, first {reel.image_paths[2]}: no image in these steps",
        f"images: CAM_BACK: 1 of 48 images are empty, first {reel.image_paths[5]}: no image in these steps",
    ]
    reel.image_paths[3].unlink()
    limit = "at most 5% (one in any case) and 10 in a row may be broken"
    assert notes(folder) == []
    assert problems(folder) == [
        f"images: CAM_BACK: 2 of 48 images are missing, first {reel.image_paths[2]}: {limit}",
        f"images: CAM_BACK: 1 of 48 images are empty, first {reel.image_paths[5]}: {limit}",
    ]


def test_how_many_images_may_be_broken():
    def broken(positions, images):
        return too_many_broken(dict.fromkeys(positions, "gone"), images)

    assert not broken(range(100, 100 + BROKEN_IN_A_ROW), 1000)
    assert broken(range(100, 101 + BROKEN_IN_A_ROW), 1000)
    assert not broken(range(0, 100, 2), 1000)
    assert broken(range(0, 102, 2), 1000)
    assert not broken([5], 12)
    assert broken([5, 9], 12)
    assert broken([0], 1)


def test_times_and_key_frames(folder):
    table = folder / "v1.0-mini" / "sample_data.json"
    rows = json.loads(table.read_text())
    cut = [r for r in rows if "CAM_FRONT__" not in r["filename"] or not 1 < 1e-6 * (r["timestamp"] % 10**8) - 27 < 3]
    assert len(cut) < len(rows)
    for row in cut:
        if "CAM_BACK__" in row["filename"] and row["is_key_frame"]:
            row["timestamp"] += 12_000
    table.write_text(json.dumps(cut))
    found = problems(folder)
    assert any(text.startswith("image-gap: CAM_FRONT: no image for ") for text in found)
    assert any("key frames; the scene table says 9" in text for text in found)
    assert any("CAM_BACK: " in text and "off the 50 ms grid" in text for text in notes(folder))


def test_broken_poses(folder):
    table = folder / "v1.0-mini" / "ego_pose.json"
    rows = json.loads(table.read_text())
    table.write_text(json.dumps([row | {"rotation": [v * 1.5 for v in row["rotation"]]} for row in rows]))
    found = problems(folder)
    assert len([text for text in found if text.startswith("tables: ") and "quaternion is not unit" in text]) == len(
        found
    )


class TestCalibration:
    good = CameraCalibration(
        "CAM_FRONT",
        np.array([[1266.0, 0, 816], [0, 1266, 491], [0, 0, 1]]),
        np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
        np.zeros(3),
        1600,
        900,
    )

    def test_good(self):
        assert calibration_problems(self.good) == []

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"intrinsic": np.full((3, 3), np.nan)}, "not finite"),
            ({"intrinsic": np.diag([-1.0, 1.0, 1.0])}, "focal lengths"),
            ({"intrinsic": np.array([[900.0, 0, 5000], [0, 900, 400], [0, 0, 1]])}, "principal point"),
            ({"rotation_ego_from_camera": 1.1 * good.rotation_ego_from_camera}, "not a rotation"),
            ({"rotation_ego_from_camera": good.rotation_ego_from_camera @ np.diag([-1, 1, 1])}, "left-handed"),
            ({"rotation_ego_from_camera": np.eye(3)}, "does not point down"),
        ],
    )
    def test_bad(self, change, message):
        found = calibration_problems(replace(self.good, **change))
        assert len(found) == 1
        assert message in found[0]


class TestCanBus:
    @pytest.mark.parametrize(
        ("message", "change", "expected"),
        [
            ("ms_imu", lambda rows: [r | {"rotation_rate": [0, 0, -r["rotation_rate"][2]]} for r in rows], "is -1.00"),
            ("ms_imu", lambda rows: [r | {"utime": r["utime"] + 600_000} for r in rows], "begins 0.65 s after"),
            ("ms_imu", lambda rows: rows[:200], "ends 2.0"),
            ("ms_imu", lambda rows: rows[:100] + rows[200:], "silent for 1.01 s"),
            ("zoe_veh_info", lambda rows: [r | {"RL_wheel_speed": 26.0, "RR_wheel_speed": 26.0} for r in rows], "roll"),
            ("zoe_veh_info", lambda rows: [], "no zoe_veh_info messages"),
        ],
    )
    def test_problems(self, folder, message, change, expected):
        change_can_bus(folder, message, change)
        assert any(message in text and expected in text for text in problems(folder)), problems(folder)

    def test_broken_file(self, folder):
        (folder / "can_bus" / "scene-2061_pose.json").write_text("[{")
        assert "is not a valid CAN bus file" in problems(folder)[0]

    def test_without_the_folder(self, folder):
        shutil.rmtree(folder / "can_bus")
        assert "unpack the CAN bus expansion" in problems_of_folder(open_dataset(folder))[0]
        assert report(folder).problems == []  # said once for the folder, not once a scene


def test_known_remarks_are_for_the_published_versions(tmp_path):
    drives = (
        replace(DRIVES[0], name="scene-0501", description="Day"),
        replace(DRIVES[0], name="scene-1002", description="Sunny street", start_us=DRIVES[0].start_us + 10**8),
        replace(DRIVES[3], name="scene-0161", description="Day"),
    )
    write_nuscenes(tmp_path, drives, duration_s=2.0)
    assert notes(tmp_path, "scene-0501") == ["known: outside the annotated map"]
    assert notes(tmp_path, "scene-1002") == ["known: described as day, against what its number suggests"]
    assert problems(tmp_path, "scene-0161") == []
    assert notes(tmp_path, "scene-0161") == ["can-bus: no CAN bus data: it cannot be recorded"]
    (tmp_path / "v1.0-mini").rename(tmp_path / "v1.0-mine")
    assert notes(tmp_path, "scene-0501") == []
    assert problems(tmp_path, "scene-0161") == ["can-bus: no CAN bus data: it cannot be recorded"]


TIMES = np.arange(0, 10_000_000, 100_000)
YAW = 0.5 * np.sin(1e-6 * TIMES)
RATE = 0.5 * np.cos(1e-6 * TIMES)


def test_rates_need_overlap_and_tell_scale_sign_and_standstill():
    rates = window_rates(TIMES, YAW, TIMES, RATE)
    assert rates.correlation == pytest.approx(1.0, abs=1e-3)
    assert rates.slope == pytest.approx(1.0, abs=1e-2)
    assert window_rates(TIMES, YAW, TIMES, -2 * RATE).slope == pytest.approx(-2.0, abs=1e-2)
    assert window_rates(TIMES, YAW, TIMES + 9_500_000, RATE) is None
    assert window_rates(TIMES, YAW, TIMES, np.zeros(len(TIMES))).correlation == 0.0
    assert rates.is_moving(0.1)
    assert not window_rates(TIMES, 0.01 * YAW, TIMES, 0.01 * RATE).is_moving(0.1)
    assert window_rates(TIMES, 0.01 * YAW, TIMES, RATE).is_moving(0.1)  # either of the two


@pytest.mark.parametrize("late_s", [-0.25, -0.03, 0.0, 0.1, 0.31])
def test_lag_is_found_under_scale_offset_and_drift(late_s):
    fine = np.arange(0, 10_000_000, 10_000)
    seconds = 1e-6 * fine
    rate = 0.3 * np.cos(2.0 * seconds)
    yaw = 7.0 + 0.004 * seconds + 1.02 * 0.15 * np.sin(2.0 * (seconds - late_s))
    lag = lag_of(fine, yaw, fine, rate, (-0.065, 0.085), 0.01)
    assert lag is not None
    assert lag.seconds == pytest.approx(late_s, abs=2e-3)
    assert (lag.residual_allowed > 1.5 * lag.residual) == (not -0.065 < late_s < 0.085)


def test_residuals_of_a_lag_are_those_of_least_squares_over_the_shifted_integral():
    rng = np.random.default_rng(1)
    rate = np.convolve(rng.normal(size=1_100), np.ones(100) / 10, "valid")[:1_000]
    fine = np.arange(1_000) * 10_000
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * 0.01)])
    yaw = 3.0 + np.roll(turned, 10) + 0.01 * rng.normal(size=1_000)  # 0.1 s late; the ends are not looked at
    found = lag_of(fine, yaw, fine, rate, (-0.065, 0.085), 0.001)
    at = np.arange(fine[0] + 400_000, fine[-1] - 400_000, 20_000)
    residuals = {}
    for lag_us in range(-400_000, 400_001, 20_000):
        shifted = np.interp(at - lag_us, fine, turned)
        columns = np.column_stack([shifted, np.ones(len(at)), at - at.mean()])
        left = np.interp(at, fine, yaw) - columns @ np.linalg.lstsq(columns, np.interp(at, fine, yaw))[0]
        residuals[1e-6 * lag_us] = np.sqrt(np.mean(left**2))
    assert found is not None
    assert found.residual == pytest.approx(min(residuals.values()), rel=1e-6)
    allowed = {lag: value for lag, value in residuals.items() if -0.065 < lag < 0.085}
    assert found.residual_allowed == pytest.approx(min(allowed.values()), rel=1e-6)
    assert found.seconds == pytest.approx(0.1, abs=0.01)


def test_even_motion_tells_no_lag():
    assert lag_of(TIMES, 0.2 * 1e-6 * TIMES, TIMES, np.full(len(TIMES), 0.2), (-0.065, 0.085), 0.01) is None


@pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="needs real data")
def test_real_gyro_signs():
    from mixo_env.geometry import yaw_from_quaternion_wxyz
    from mixo_env.nuscenes.can_bus import read_can_bus

    folder = Path(os.environ["MIXO_REAL_DATA"]) / "nuscenes_can_bus"
    turning = {}
    for name in ("scene-0061", "scene-0655", "scene-0757", "scene-0796"):
        can_bus = read_can_bus(folder, name)
        poses = json.loads((folder / f"{name}_pose.json").read_text())
        times = np.array([row["utime"] for row in poses])
        yaw = np.unwrap(yaw_from_quaternion_wxyz([row["orientation"] for row in poses]))
        gyro = can_bus.imu_yaw_rate_radps
        rates = window_rates(times, yaw, gyro.timestamp_us, gyro.value)
        turning[name] = rates.correlation if rates.is_moving(0.05) else None
    assert turning["scene-0061"] > 0.99
    assert turning["scene-0796"] is None
    assert all(value is None or value > 0.95 for value in turning.values()), turning


def test_can_bus_of_the_fixture_has_a_bias_when_asked(tmp_path):
    write_can_bus(tmp_path, DRIVES[1], 1.0, gyro_bias_radps=0.01)
    rows = json.loads((tmp_path / f"{DRIVES[1].name}_ms_imu.json").read_text())
    assert rows[0]["rotation_rate"][2] == 0.01
