"""Inertial odometry on real CAN bus messages against the poses of the cameras' own times."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from mixo_env.experts.inertial import GRADES, STANDSTILL_SETTLE_S, InertialOdometry, grade_inputs, standstill_bias
from mixo_env.geometry import yaw_from_quaternion_wxyz
from mixo_env.nuscenes.can_bus import read_can_bus

pytestmark = pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="needs real data")


def can_bus_of(scene: str):
    can_bus = read_can_bus(Path(os.environ["MIXO_REAL_DATA"]) / "nuscenes_can_bus", scene)
    assert can_bus is not None
    return can_bus


def poses(scene: str):
    """Times, travelled distance and unwrapped yaw of all CAM_FRONT images."""
    path = Path(os.environ["MIXO_REAL_DATA"]) / "nuscenes_poses_12hz" / f"{scene}_CAM_FRONT.json"
    frames = json.loads(path.read_text())["frames"]
    time_us = np.array([frame["timestamp"] for frame in frames])
    x, y, _ = np.array([frame["egoTranslation"] for frame in frames]).T
    yaw = np.unwrap(yaw_from_quaternion_wxyz([frame["egoRotation_wxyz"] for frame in frames]))
    return time_us, np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))]), yaw


def drift_degps(time_us, error_rad) -> float:
    """Heading error gained over the time it took."""
    return float(np.degrees(error_rad[-1] - error_rad[0]) / (1e-6 * (time_us[-1] - time_us[0])))


@pytest.mark.parametrize("scene", ["scene-0655", "scene-0757"])
def test_distance_and_yaw(scene, capsys):
    can_bus = can_bus_of(scene)
    time_us, path_m, yaw = poses(scene)
    lines = {}
    for grade in GRADES:
        track = InertialOdometry(can_bus, grade).at(time_us)
        ratio = (track.distance_m[-1] - track.distance_m[0]) / path_m[-1]
        error = track.yaw_rad - yaw
        step_deg = np.degrees(np.sqrt(np.mean(np.diff(error) ** 2)))
        lines[grade] = (ratio, drift_degps(time_us, error), step_deg)
        figures = (
            f"distance {ratio:.4f} of true, yaw drift {lines[grade][1]:+.4f} deg/s, increment RMS {step_deg:.4f} deg"
        )
        with capsys.disabled():
            print(f"\n{scene} {grade:17} {figures}", end="")
    assert lines["INERTIAL"][0] == pytest.approx(1.0, abs=0.01)
    assert lines["INERTIAL_CONSUMER"][0] == lines["INERTIAL"][0]
    assert lines["INERTIAL_POSE"][0] == pytest.approx(1.0, abs=0.02)
    assert abs(lines["INERTIAL"][1]) < 0.05
    assert lines["INERTIAL"][2] < 0.035
    assert abs(lines["INERTIAL_CONSUMER"][1]) < 0.3


def test_drift_after_the_bias_is_known():
    """Scene 0757 stands for its last 10 s: from the moment the bias is known the yaw hardly drifts."""
    can_bus = can_bus_of("scene-0757")
    time_us, path_m, yaw = poses("scene-0757")
    stopped_us = time_us[np.argmax(path_m > path_m[-1] - 0.05)]
    known = time_us > stopped_us + round(1e6 * (STANDSTILL_SETTLE_S + 1.0))
    assert 1e-6 * np.ptp(time_us[known]) > 5.0
    for grade, limit in (("INERTIAL", 0.005), ("INERTIAL_CONSUMER", 0.03)):
        error = InertialOdometry(can_bus, grade).at(time_us).yaw_rad - yaw
        assert abs(drift_degps(time_us[known], error[known])) < limit, grade


def test_bias_of_scene_0757():
    can_bus = can_bus_of("scene-0757")
    gyro = standstill_bias(can_bus.imu_yaw_rate_radps, can_bus.wheel_speed_radps)[-1]
    monitor = standstill_bias(can_bus.monitor_yaw_rate_radps, can_bus.wheel_speed_radps)[-1]
    assert np.degrees(gyro) == pytest.approx(0.008, abs=0.003)
    assert np.degrees(monitor) == pytest.approx(-0.16, abs=0.02)


def test_moving_scenes_have_no_bias():
    for scene in ("scene-0061", "scene-0655", "scene-0796"):
        can_bus = can_bus_of(scene)
        _, rate = grade_inputs(can_bus, "INERTIAL")
        np.testing.assert_array_equal(rate.value, can_bus.imu_yaw_rate_radps.value)
