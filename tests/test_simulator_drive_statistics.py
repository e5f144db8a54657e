"""The drives of a whole data set against all 850 real ones: poses of 160 scenes at CAM_FRONT's times."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from docs._pages.data_sheet import motion
from docs._pages.data_sheet.real import load_real, real_motion
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.drive import targets
from mixo_env.simulator.drive.clock import scene_times
from mixo_env.simulator.drive.localisation import localise
from mixo_env.simulator.drive.scenario import generator, plan_logs
from mixo_env.simulator.drive.scenes import scene_drive

pytestmark = pytest.mark.rendering

# Largest Kolmogorov-Smirnov distance to the known quantiles of the real distribution.
LIMITS = {
    "speed_1s_mps": 0.05,
    "abs_yaw_rate_1s_degps": 0.05,
    "path_length_per_scene_m": 0.09,
    "abs_net_heading_change_deg": 0.09,
    # Nothing is dealt or promised here; far from the real drives is still wrong.
    "speed_1s_mps_while_moving": 0.08,
    "abs_yaw_rate_1s_degps_while_moving": 0.06,
    "longitudinal_accel_1s_mps2": 0.09,
    "top_speed_per_scene_mps": 0.13,
}
SHARE_BAND = 0.03
INTERVALS = {"mean_s": (0.084, 0.0005), "share_0.05_s": (0.3305, 0.01), "share_0.10_s": (0.661, 0.01)}


@pytest.fixture(scope="module")
def simulated() -> tuple[list[motion.Path], list[np.ndarray]]:
    """Written poses and image times of a data set of the default shares."""
    config = SimulationConfig(scenes=160, scenes_per_log=4, seed=0, night=0.0)
    paths, times = [], []
    for log in plan_logs(config):
        for plan in log.scenes:
            frames = scene_times(generator(config, "clock", plan.number), plan.start_us, 20).cameras["CAM_FRONT"]
            time_s = (frames.timestamp_us - plan.start_us) / 1e6
            drive = scene_drive(config, log, plan)
            poses = localise(generator(config, "localisation", plan.number), drive, log.localisation_lag_s)
            paths.append(motion.Path(*poses.pose(time_s)))
            times.append(time_s)
    return paths, times


def test_motion_is_distributed_as_in_real_drives(simulated):
    samples, real = motion.motion_samples(simulated[0]), load_real()["motion"]
    distances = {name: motion.distance(samples[name], real[name]) for name in LIMITS}
    assert {name: value for name, value in distances.items() if value > LIMITS[name]} == {}


def test_shares_are_the_real_ones(simulated):
    shares, real = motion.motion_statistics(simulated[0])["shares"], load_real()["motion"]["shares"]
    assert set(shares) == set(real)
    assert shares == pytest.approx(real, abs=SHARE_BAND)


def test_left_and_right_turns_are_balanced(simulated):
    heading = np.degrees([path.yaw_rad[-1] - path.yaw_rad[0] for path in simulated[0]])
    turned = np.abs(heading) > 30.0
    assert 0.3 < (heading[turned] > 0.0).mean() < 0.7


def test_intervals_between_images(simulated):
    found = motion.interval_statistics(simulated[1])
    assert all(found[name] == pytest.approx(real, abs=band) for name, (real, band) in INTERVALS.items())


def test_dealt_motions_are_stratified():
    situations = ["ordinary"] * 91 + ["standing"] * 9
    for seed in range(3):
        motions = targets.deal_motions(np.random.default_rng(seed), situations)
        path = np.sort([motion.mean_mps * targets.REAL_SECONDS for motion in motions])
        turned = np.sort(np.degrees([motion.turned_rad for motion in motions]))
        levels = np.arange(0.1, 1.0, 0.1)
        within = np.round(levels * 100).astype(int)
        assert (path[within - 3] <= targets.path_m(levels)).all()
        assert (targets.path_m(levels) <= path[within + 2]).all()
        assert (turned[within - 3] <= targets.turned_deg(levels)).all()
        assert (targets.turned_deg(levels) <= turned[within + 2]).all()


def test_situations_get_motions_that_they_can_do():
    for situation, check in (
        ("fast_straight", lambda m: m.mean_mps > 10.0 and m.turned_rad < 0.25),
        ("tight_turn", lambda m: 1.3 < m.turned_rad < 1.8),
        ("standing", lambda m: m.mean_mps * targets.REAL_SECONDS <= 5.0),
    ):
        assert all(check(m) for m in targets.deal_motions(np.random.default_rng(1), [situation] * 30)), situation


def test_distance_of_known_distributions():
    values = np.linspace(0.0, 1.0, 1001)
    real = {f"p{p}": p / 100.0 for p in (1, 25, 50, 75, 99)} | {"mean": 0.5}
    assert motion.distance(values, real) == pytest.approx(0.0, abs=2e-3)
    assert motion.distance(values + 0.1, real) == pytest.approx(0.1, abs=2e-3)
    assert motion.distance(np.zeros(4), real) == pytest.approx(0.99)


@pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="needs MIXO_REAL_DATA")
def test_targets_are_the_measured_ones():
    folder = Path(os.environ["MIXO_REAL_DATA"])
    measured = real_motion(folder)
    assert load_real()["motion"].keys() == measured.keys()
    for name, entry in load_real()["motion"].items():
        assert entry == pytest.approx(measured[name], rel=1e-4), name
    for name, quantile in (
        ("path_length_per_scene_m", targets.path_m),
        ("abs_net_heading_change_deg", targets.turned_deg),
    ):
        known = {int(key[1:]) / 100.0: value for key, value in measured[name].items() if key[1:].isdigit()}
        assert quantile(np.array(list(known))) == pytest.approx(np.array(list(known.values())))
    over = np.array([1.0 - measured["shares"][f"heading_over_{angle}"] for angle in (30, 60, 120)])
    assert targets.turned_deg(over) == pytest.approx([30.0, 60.0, 120.0], abs=0.3)
    front = json.loads((folder / "nuscenes_motion_statistics.json").read_text())["frame_intervals"][
        "both_scenes_CAM_FRONT"
    ]
    by_grid = front["share_by_nearest_0p05_s"]
    assert [front["mean_s"], by_grid["0.05"], by_grid["0.10"]] == [target for target, _ in INTERVALS.values()]
