"""The lag of written poses: found from cameras, never from the log that is scored, and only where they turn."""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.pose_lag import can_lag, exact_turns, lags_by_source, moved
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.keyframes import at_keyframes
from mixo_env.recordings.pose_lag_fit import LARGEST_STD_S, PoseLag, fit_pose_lag, fit_pose_lags, step_turns
from mixo_env.recordings.vehicles import fit_vehicle_constants, training_constants, with_held_out_constants
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.drive.localisation import LAG_RANGE_S
from mixo_env.simulator.drive.scenario import plan_logs
from tests.bundle import few_drives
from tests.late_poses import CAMERAS, late_recordings

OWN = tuple(f"{camera}.own_window_yaw_increment_rad" for camera in CAMERAS)
needs_real = pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="needs real data")


def wandering(recordings: Recordings, std_rad: float, correlation_s: float = 0.2) -> Recordings:
    """Written yaw with smooth noise of its own, as a localisation has it."""
    rng = np.random.default_rng(5)
    time = np.arange(0.0, 40.0, 0.01)
    kernel = np.exp(-0.5 * (np.arange(-1.0, 1.0, 0.01) / (0.5 * correlation_s)) ** 2)
    yaw = recordings["truth.yaw_rad"].copy()
    for i in range(len(recordings)):
        noise = np.convolve(rng.standard_normal(len(time)), kernel, "same")
        rows = slice(*recordings.offsets[i : i + 2])
        yaw[rows] += std_rad * np.interp(recordings["time_s"][rows], time, noise / noise.std())
    return recordings.replace(columns={"truth.yaw_rad": yaw})


@pytest.mark.parametrize("lag_s", [-0.02, 0.0, 0.015, 0.03, 0.1])
@pytest.mark.parametrize(("spacing_s", "tolerance_s"), [(0.1, 0.001), (0.5, 0.002)])
def test_the_lag_is_recovered(lag_s, spacing_s, tolerance_s):
    found = fit_pose_lag(late_recordings(lag_s, spacing_s=spacing_s))
    assert found.known
    assert found.lag_s == pytest.approx(lag_s, abs=tolerance_s)


def test_standard_error_is_that_of_repeated_drives():
    found = [fit_pose_lag(late_recordings(0.03, scenes=1, noise_rad=1e-3, seed=seed)) for seed in range(20)]
    z = np.array([(lag.lag_s - 0.03) / lag.std_s for lag in found])
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.7


@pytest.mark.parametrize("spacing_s", [0.1, 0.5])
def test_outliers_and_lost_cameras_do_little(spacing_s):
    recordings = late_recordings(0.03, spacing_s=spacing_s)
    rng = np.random.default_rng(1)
    columns = {name: recordings[name].copy() for name in OWN}
    for name, values in columns.items():
        wild = rng.random(len(values)) < 0.2
        values[wild] += np.radians(rng.uniform(-5, 5, wild.sum()))
        values[: len(values) // 2 * (name == OWN[1])] = np.nan
    columns[OWN[0]][:] = np.nan  # a column that is missing throughout
    found = fit_pose_lag(recordings.replace(columns=columns))
    assert found.known
    assert found.lag_s == pytest.approx(0.03, abs=0.002 if spacing_s < 0.5 else 0.005)


def test_a_regression_on_finite_differences_is_short_and_the_moved_curve_is_not():
    quiet = late_recordings(0.03, scenes=8, turning=0.7)
    noisy = wandering(quiet, np.radians(0.03))
    assert 0.028 < regressed_lag_s(quiet) < 0.0295  # flattened
    assert regressed_lag_s(noisy) < 0.027  # and attenuated
    for recordings in (quiet, noisy):
        assert fit_pose_lag(recordings).lag_s == pytest.approx(0.03, abs=0.001)


def regressed_lag_s(recordings: Recordings) -> float:
    """Residuals of the camera that closes the steps over the change of the poses' rate, by least squares."""
    yaw, time, starts = recordings["truth.yaw_rad"], recordings["time_s"], recordings.offsets[:-1]
    rate = np.full(len(yaw), np.nan)
    rate[1:-1] = (yaw[2:] - yaw[:-2]) / (time[2:] - time[:-2])
    rate[starts] = rate[starts - 1] = np.nan
    gain, turned = (np.diff(values, prepend=np.nan) for values in (rate, yaw))
    residual = recordings["CAM_BACK.own_window_yaw_increment_rad"] - turned
    usable = np.isfinite(gain + residual)
    return float(residual[usable] @ gain[usable] / (gain[usable] @ gain[usable]))


def unknown(found: PoseLag) -> bool:
    return not found.known and found.std_s > LARGEST_STD_S


def test_too_little_to_tell_is_unknown(caplog):
    recordings = late_recordings(0.03)
    straight = wandering(late_recordings(0.03, turning=0.001), np.radians(0.03))
    still = {"truth.distance_m": np.zeros_like(recordings["truth.distance_m"])}
    nothing = {name: np.full_like(recordings[name], np.nan) for name in OWN}
    blind = recordings.replace(replace(recordings.manifest, cameras=(), imported=("OTHER",)))
    cases = [straight, recordings.replace(columns=still), recordings.replace(columns=nothing), blind]
    few = replace(recordings.scenes[0], rows=12)
    first = {name: recordings[name][:12] for name in recordings.column_names}
    cases.append(Recordings(replace(recordings.manifest, scenes=(few,)), first))
    for case in cases:
        assert unknown(fit_pose_lag(case))
        caplog.clear()
        with caplog.at_level(logging.INFO):
            assert fit_pose_lags(case, ["n099", "n100"]) == {"n099": 0.0, "n100": 0.0}
        told = [record.getMessage() for record in caplog.records]
        assert told == [
            "pose lag of vehicle n099 stays 0: it shows its cameras too little turning to tell",
            "pose lag of vehicle n100 stays 0: it drives in no training scene",
        ]


def test_a_lag_beyond_the_range_is_unknown():
    assert all(unknown(fit_pose_lag(late_recordings(lag_s))) for lag_s in (-0.06, 0.16, 0.3))


def test_vehicles_keep_their_own_lag_and_the_wheels_theirs():
    true = {"a": 0.02, "b": 0.04}
    recordings = late_recordings(true, scenes=8, wheels_s=0.025)
    found = fit_vehicle_constants(recordings, true)
    for name, lag_s in true.items():
        assert found[name].pose_lag_s == pytest.approx(lag_s, abs=0.001)
        assert found[name].can_latency_s == pytest.approx(0.025, abs=0.003)
    assert fit_vehicle_constants(recordings, ["c"])["c"].pose_lag_s == 0.0


def shaken(recordings: Recordings, fold: int) -> Recordings:
    """Other poses in one fold."""
    columns = {name: recordings[name].copy() for name in ("truth.x_m", "truth.y_m", "truth.yaw_rad")}
    rng = np.random.default_rng(2)
    for i, scene in enumerate(recordings.scenes):
        if scene.fold == fold:
            for values in columns.values():
                rows = slice(*recordings.offsets[i : i + 2])
                values[rows] += 0.1 * rng.standard_normal(scene.rows)
    return recordings.replace(columns=columns)


def test_the_scored_fold_has_no_part_in_its_constants_nor_in_its_training_targets():
    recordings = late_recordings({"a": 0.02, "b": 0.04}, scenes=8)
    changed = shaken(recordings, 2)
    before, after = (with_held_out_constants(r).manifest.vehicles for r in (recordings, changed))
    for vehicle in "ab":
        assert before[f"{vehicle} in fold 2"] == after[f"{vehicle} in fold 2"]
        assert before[f"{vehicle} in fold 1"] != after[f"{vehicle} in fold 1"]
    targets, again = (CrossValidation(r).training(2)["truth.yaw_increment_rad"] for r in (recordings, changed))
    assert targets.tobytes() == again.tobytes()
    other, again = (CrossValidation(r).training(1)["truth.yaw_increment_rad"] for r in (recordings, changed))
    assert other.tobytes() != again.tobytes()


def test_scores_and_training_of_a_fold_share_one_lag():
    protocol = CrossValidation(late_recordings({"a": 0.02, "b": 0.04}, scenes=8))
    for scene in protocol.recordings.scenes:
        vehicle = scene.vehicle.split(" in fold ")[0]
        tested = protocol.recordings.manifest.vehicles[scene.vehicle].pose_lag_s
        assert tested == protocol.training(scene.fold).manifest.vehicles[vehicle].pose_lag_s
        assert tested == pytest.approx({"a": 0.02, "b": 0.04}[vehicle], abs=0.001)


def without_folds(recordings: Recordings) -> Recordings:
    scenes = tuple(replace(scene, fold=0) for scene in recordings.scenes)
    return recordings.replace(replace(recordings.manifest, scenes=scenes))


def test_without_folds_the_lag_comes_from_the_other_logs():
    recordings = without_folds(late_recordings(0.03, scenes=3))
    found = with_held_out_constants(recordings)
    for scene in found.scenes:
        assert found.manifest.vehicles[scene.vehicle].pose_lag_s == pytest.approx(0.03, abs=0.001)
    yaw = recordings["truth.yaw_rad"].copy()
    yaw[recordings.offsets[1] : recordings.offsets[2]] *= 1.5
    changed = with_held_out_constants(recordings.replace(columns={"truth.yaw_rad": yaw})).manifest.vehicles
    assert changed["n099 but log-1"] == found.manifest.vehicles["n099 but log-1"]
    assert changed["n099 but log-0"] != found.manifest.vehicles["n099 but log-0"]


def test_a_vehicle_with_one_log_keeps_lag_zero_and_it_is_said(caplog):
    with caplog.at_level(logging.INFO):
        found = with_held_out_constants(without_folds(late_recordings(0.03, scenes=1)))
    assert [vehicle.pose_lag_s for vehicle in found.manifest.vehicles.values()] == [0.0]
    assert "pose lag of vehicle n099 stays 0: it drives in no other log than log-0" in caplog.text
    folds = late_recordings({"a": 0.02, "b": 0.04}, scenes=8).select(scenes=["scene-2001", "scene-2002", "scene-2003"])
    assert with_held_out_constants(folds).manifest.vehicles["b in fold 0"].pose_lag_s == 0.0  # b drives in fold 0 alone


def test_bundled_cameras_find_the_lag_of_the_exact_truth():
    for found in lags_by_source(few_drives(12)).values():
        assert abs(found["cameras"].lag_s - found["exact"].lag_s) < 0.002
        assert abs(found["cameras, 2 Hz"].lag_s - found["exact, 2 Hz"].lag_s) < 0.005
        assert abs(found["cameras, 2 Hz"].lag_s - found["exact"].lag_s) < 0.005


def test_sources_of_the_study_agree_on_an_exact_drive():
    recordings = late_recordings(0.03)
    for source in (exact_turns(recordings), step_turns(recordings, recordings["INERTIAL.yaw_increment_rad"])):
        assert fit_pose_lag(recordings, source).lag_s == pytest.approx(0.03, abs=0.001)
    protocol = CrossValidation(recordings)
    again = moved(moved(protocol.recordings, 0.01), -0.01)
    np.testing.assert_allclose(again["truth.yaw_rad"], protocol.recordings["truth.yaw_rad"], atol=1e-12)


def test_key_frames_of_a_recording_keep_the_lag():
    slow = at_keyframes(training_known(late_recordings(0.03)))
    assert fit_pose_lag(slow).lag_s == pytest.approx(0.03, abs=0.003)


def training_known(recordings: Recordings) -> Recordings:
    return recordings.replace(replace(recordings.manifest, vehicles=training_constants(recordings)))


def test_a_simulated_car_has_one_lag_in_all_its_logs():
    by_seed = []
    for seed in range(3):
        logs = plan_logs(SimulationConfig(scenes=12, scenes_per_log=2, seed=seed))
        lags = {car: {log.localisation_lag_s for log in logs if log.vehicle == car} for car in ("m001", "m002")}
        assert all(len(values) == 1 for values in lags.values())
        assert lags["m001"] != lags["m002"]
        by_seed += [next(iter(values)) for values in lags.values()]
    assert len(set(by_seed)) == 6
    assert min(by_seed) >= LAG_RANGE_S[0]
    assert max(by_seed) <= LAG_RANGE_S[1]


@needs_real
@pytest.mark.parametrize(("scene", "known"), [("0061", True), ("0655", True), ("0757", True), ("0796", False)])
def test_real_poses_are_late(scene, known):
    found = can_lag(Path(os.environ["MIXO_REAL_DATA"]) / "nuscenes_can_bus", f"scene-{scene}")
    assert found.known == known
    assert 0.015 < found.lag_s < 0.05
