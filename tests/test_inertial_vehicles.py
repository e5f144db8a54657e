from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixo_env.errors import RecordingError
from mixo_env.experts.inertial import grade_inputs
from mixo_env.fusion import dead_reckon
from mixo_env.nuscenes.scene import CanBus, Signal
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import VehicleConstants
from mixo_env.recordings.vehicles import fit_vehicle_constants, travelled_m
from tests.synthetic import synthetic_recordings

TRUE = {"n008": (1.006, -0.008, 0.04), "n015": (0.994, 0.005, -0.02)}
"""Vehicle -> wheel scale, course offset in rad, latency in s."""


def recordings_of_two_vehicles() -> Recordings:
    """Wheels and course follow TRUE, with the noise of the synthetic wheels."""
    plain = synthetic_recordings(scenes=8)
    scenes = tuple(replace(s, vehicle=("n008", "n015")[i % 2]) for i, s in enumerate(plain.scenes))
    columns = {name: plain[name].copy() for name in plain.column_names}
    for i, scene in enumerate(scenes):
        rows = slice(plain.offsets[i], plain.offsets[i + 1])
        scale, offset, latency_s = TRUE[scene.vehicle]
        gained = np.diff(columns["speed_mps"][rows], prepend=columns["speed_mps"][rows][0])
        columns["distance_m"][rows] = (columns["distance_m"][rows] - latency_s * gained) / scale
        steps = columns["truth.yaw_increment_rad"][rows][1:], columns["truth.distance_m"][rows][1:]
        x, y, _ = dead_reckon(*steps, start=(0, 0, columns["truth.yaw_rad"][rows][0]), course_offset_rad=offset)
        columns["truth.x_m"][rows], columns["truth.y_m"][rows] = x, y
    return Recordings(replace(plain.manifest, scenes=scenes), columns)


def test_recovers_the_constants():
    found = fit_vehicle_constants(recordings_of_two_vehicles(), TRUE)
    for vehicle, (scale, offset, latency_s) in TRUE.items():
        assert found[vehicle].wheel_scale == pytest.approx(scale, abs=1e-3)
        assert found[vehicle].course_offset_rad == pytest.approx(offset, abs=1e-4)
        assert found[vehicle].can_latency_s == pytest.approx(latency_s, abs=0.003)


def test_unknown_vehicle_gets_the_mean_of_all():
    found = fit_vehicle_constants(recordings_of_two_vehicles(), ["n999"])["n999"]
    assert found.wheel_scale == pytest.approx(1.0, abs=3e-3)
    assert abs(found.course_offset_rad) < 0.004


def test_fitted_constants_remove_the_error():
    recordings = recordings_of_two_vehicles()
    found = fit_vehicle_constants(recordings.select(folds=(0, 1)), TRUE)
    scene = recordings.rows(6)  # of a fold that was not fitted
    x, y, yaw = (float(scene[f"truth.{name}"][0]) for name in ("x_m", "y_m", "yaw_rad"))

    def error(vehicles: dict[str, VehicleConstants]) -> float:
        """Of the mean place."""
        known = recordings.replace(replace(recordings.manifest, vehicles=vehicles))
        distances = travelled_m(known)[recordings.offsets[6] : recordings.offsets[7]][1:]
        offset = vehicles[recordings.scenes[6].vehicle].course_offset_rad
        increments = scene["truth.yaw_increment_rad"][1:]
        found_x, found_y, _ = dead_reckon(increments, distances, start=(x, y, yaw), course_offset_rad=offset)
        return float(np.hypot(found_x - scene["truth.x_m"], found_y - scene["truth.y_m"]).mean())

    nominal = dict.fromkeys(TRUE, VehicleConstants())
    timeless = {name: replace(constants, can_latency_s=0.0) for name, constants in found.items()}
    assert error(found) < 0.25 * error(nominal)
    assert error(found) < error(timeless)


def test_distances_are_corrected_scene_by_scene():
    recordings = synthetic_recordings(scenes=2)
    vehicles = {"n099": VehicleConstants(wheel_scale=1.02, can_latency_s=0.1)}
    scenes = tuple(replace(scene, vehicle="n099") for scene in recordings.scenes)
    recordings = recordings.replace(replace(recordings.manifest, scenes=scenes, vehicles=vehicles))
    for i in range(2):
        scene = recordings.rows(i)
        metres = travelled_m(recordings)[recordings.offsets[i] : recordings.offsets[i + 1]]
        expected = 1.02 * scene["distance_m"][1:] + 0.1 * np.diff(scene["speed_mps"].astype(float))
        np.testing.assert_allclose(metres[1:], expected, atol=1e-6)
        assert np.isnan(metres[0])


def test_without_a_change_of_speed_there_is_no_latency():
    recordings = synthetic_recordings(scenes=2)
    columns = {name: recordings[name] for name in recordings.column_names}
    columns["speed_mps"] = np.full_like(columns["speed_mps"], 5.0)
    (found,) = fit_vehicle_constants(Recordings(recordings.manifest, columns), ["n099"]).values()
    assert found.can_latency_s == 0.0


def test_standing_scenes_are_refused():
    recordings = synthetic_recordings(scenes=2)
    columns = {name: recordings[name] for name in recordings.column_names}
    columns["truth.distance_m"] = np.zeros_like(columns["truth.distance_m"])
    with pytest.raises(RecordingError, match="vehicle constants need 50"):
        fit_vehicle_constants(Recordings(recordings.manifest, columns), ["n099"])


def test_the_speed_is_that_of_the_rear_axle() -> None:
    """In a turn the front wheels roll a longer way: the reference point is the middle of the rear axle."""
    time_us = np.arange(0, 1_000_000, 10_000)
    wheels = np.tile([21.0, 25.0, 18.0, 22.0], (len(time_us), 1))  # front left, front right, rear left, rear right
    gyro = Signal(time_us, np.full(len(time_us), 0.1))
    can_bus = CanBus(wheel_speed_radps=Signal(time_us, wheels), imu_yaw_rate_radps=gyro, monitor_yaw_rate_radps=gyro)
    speed, _ = grade_inputs(can_bus, "INERTIAL")
    np.testing.assert_allclose(speed.value, 0.305 * 20.0)
    consumer, _ = grade_inputs(can_bus, "INERTIAL_CONSUMER")
    np.testing.assert_allclose(consumer.value, 0.305 * 20.0)
