from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixo_env.errors import RecordingError
from mixo_env.fusion import dead_reckon
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.vehicles import fit_vehicle_constants
from tests.synthetic import synthetic_recordings

TRUE = {"n008": (1.006, -0.008), "n015": (0.994, 0.005)}
"""Vehicle -> wheel scale, course offset in rad."""


def recordings_of_two_vehicles() -> Recordings:
    """Wheels and course follow TRUE, with the noise of the synthetic wheels."""
    plain = synthetic_recordings(scenes=8)
    scenes = tuple(replace(s, vehicle=("n008", "n015")[i % 2]) for i, s in enumerate(plain.scenes))
    columns = {name: plain[name].copy() for name in plain.column_names}
    for i, scene in enumerate(scenes):
        rows = slice(plain.offsets[i], plain.offsets[i + 1])
        scale, offset = TRUE[scene.vehicle]
        columns["distance_m"][rows] /= scale
        steps = columns["truth.yaw_increment_rad"][rows][1:], columns["truth.distance_m"][rows][1:]
        x, y, _ = dead_reckon(*steps, start=(0, 0, columns["truth.yaw_rad"][rows][0]), course_offset_rad=offset)
        columns["truth.x_m"][rows], columns["truth.y_m"][rows] = x, y
    return Recordings(replace(plain.manifest, scenes=scenes), columns)


def test_recovers_both_constants():
    found = fit_vehicle_constants(recordings_of_two_vehicles(), TRUE)
    for vehicle, (scale, offset) in TRUE.items():
        assert found[vehicle].wheel_scale == pytest.approx(scale, abs=1e-3)
        assert found[vehicle].course_offset_rad == pytest.approx(offset, abs=1e-4)
        assert found[vehicle].can_latency_s == 0.0


def test_unknown_vehicle_gets_the_mean_of_all():
    found = fit_vehicle_constants(recordings_of_two_vehicles(), ["n999"])["n999"]
    assert found.wheel_scale == pytest.approx(1.0, abs=3e-3)
    assert abs(found.course_offset_rad) < 0.004


def test_fitted_constants_remove_the_error():
    recordings = recordings_of_two_vehicles()
    found = fit_vehicle_constants(recordings.select(folds=(0, 1)), TRUE)
    scene = recordings.rows(6)  # of a fold that was not fitted
    constants = found[recordings.scenes[6].vehicle]
    start = tuple(float(scene[f"truth.{name}"][0]) for name in ("x_m", "y_m", "yaw_rad"))

    def end_error(scale: float, offset: float) -> float:
        increments, distances = scene["truth.yaw_increment_rad"][1:], scale * scene["distance_m"][1:]
        x, y, _ = dead_reckon(increments, distances, start=start, course_offset_rad=offset)
        return float(np.hypot(x[-1] - scene["truth.x_m"][-1], y[-1] - scene["truth.y_m"][-1]))

    assert end_error(constants.wheel_scale, constants.course_offset_rad) < 0.25 * end_error(1.0, 0.0)


def test_standing_scenes_are_refused():
    recordings = synthetic_recordings(scenes=2)
    columns = {name: recordings[name] for name in recordings.column_names}
    columns["truth.distance_m"] = np.zeros_like(columns["truth.distance_m"])
    with pytest.raises(RecordingError, match="vehicle constants need 50"):
        fit_vehicle_constants(Recordings(recordings.manifest, columns), ["n099"])
