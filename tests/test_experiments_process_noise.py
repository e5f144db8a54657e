"""The page about the process noise of inertial odometry: nothing is written about data that were not recorded."""

from __future__ import annotations

import numpy as np
import pytest

from docs._pages.process_noise_page import (
    FACTORS,
    PAPER_WEIGHT,
    Outcome,
    check,
    crossing,
    filtered,
    scaled,
    time_constant_s,
)
from mixo_env.errors import DatasetError
from mixo_env.experts.inertial import WHEEL_RADIUS_M, ProcessNoise
from mixo_env.experts.rate_filter import run_filter
from mixo_env.nuscenes.scene import CanBus, Signal
from mixo_env.recordings.collection import Recordings
from tests.synthetic import synthetic_recordings


def can_bus(recordings: Recordings, scene: int) -> CanBus:
    """A car that follows a circle at 6 m/s while the scene lasts."""
    times = recordings.rows(scene)["timestamp_us"]
    stamps = np.arange(times[0] - 50_000, times[-1] + 50_000, 10_000)
    wheels = Signal(stamps, np.full((len(stamps), 4), 6.0 / WHEEL_RADIUS_M))
    return CanBus(wheel_speed_radps=wheels, imu_yaw_rate_radps=Signal(stamps, np.full(len(stamps), 0.2)))


def test_steps_are_filtered_anew() -> None:
    recordings = synthetic_recordings(scenes=2)
    buses = [can_bus(recordings, scene) for scene in range(2)]
    yaw, distance = filtered(recordings, buses, "INERTIAL", 10.0)
    starts = recordings.offsets[:-1]
    assert np.isnan(yaw[starts]).all()
    steps = np.delete(np.arange(len(yaw)), starts)
    np.testing.assert_allclose(yaw[steps], 0.2 * recordings["dt_s"][steps], rtol=1e-4)
    np.testing.assert_allclose(distance[steps], 6.0 * recordings["dt_s"][steps], rtol=1e-4)
    missing, _ = filtered(recordings, buses, "INERTIAL_POSE", 1.0)
    assert np.isnan(missing).all()


def test_another_can_bus_is_refused() -> None:
    recordings = synthetic_recordings(scenes=2)
    column = "INERTIAL.yaw_increment_rad"
    check(recordings, column, recordings[column])
    other = recordings[column].copy()
    other[recordings.offsets[1] + 3] += 1e-4
    with pytest.raises(DatasetError, match=rf"^{recordings.scenes[1].name}: expected {column} .* as recorded"):
        check(recordings, column, other)


def test_time_constant_is_how_the_filter_answers_a_step() -> None:
    stamps = np.arange(0, 40_000_000, 20_000)
    rate = np.where(stamps < 20_000_000, 0.0, 1.0)
    states, *_ = run_filter(Signal(stamps, rate), 0.01, 1e-4)
    left = 1.0 - states[:, 1]
    after = 1e-6 * (stamps - 20_000_000)
    answered_s = float(np.interp(-np.exp(-1.0), -left[after >= 0], after[after >= 0]))
    assert time_constant_s([Signal(stamps, rate)], 0.01, 1e-4) == pytest.approx(answered_s, abs=0.02)


def test_scaled_noise() -> None:
    assert scaled(1.0) == ProcessNoise()
    assert scaled(100.0).acceleration == pytest.approx(100.0 * ProcessNoise().acceleration)


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ((0.05, 0.3, 0.4, 0.4, 0.4), "at Q x 0.019"),  # 29 % of the way from 0.01 to 0.1
        ((0.2, 0.2, 0.2, PAPER_WEIGHT - 0.05, 0.1), "at Q x 4.1"),  # 61 % of the way from 1 to 10
        ((0.2,) * 5, "above it everywhere"),
        ((0.1,) * 5, "below it everywhere"),
    ],
)
def test_where_the_weight_is_the_papers(weights: tuple[float, ...], words: str) -> None:
    outcomes = {
        ("INERTIAL", factor): Outcome(None, None, np.array([weight]))  # type: ignore[arg-type]
        for factor, weight in zip(FACTORS, weights, strict=True)
    }
    assert crossing(outcomes, "INERTIAL") == f"`INERTIAL`: {words}"
