"""The noise of the truth, told by three instruments: by hand, against noise that was put in, against exact truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixo_env.leaderboard.board import build
from mixo_env.leaderboard.crossvalidation import CrossValidation, GroundTruth, Trial
from mixo_env.leaderboard.evaluation import Truth, noisy_truth, with_wheels
from mixo_env.leaderboard.noise import TIMES_S, YawNoise, hat, white_noise_rad, yaw_noise
from mixo_env.leaderboard.report import to_markdown
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import with_truth
from tests.bundle import few_drives
from tests.synthetic import synthetic_recordings

STD_RAD, TIME_S = 2e-3, 1.0


@pytest.fixture(scope="module")
def quiet() -> Recordings:
    """Sixteen scenes; written poses are exact."""
    drawn = synthetic_recordings(0, scenes=16, logs=8, steps=200)
    return with_truth(drawn, "exact")


def wander(recordings: Recordings, std_rad: float, time_s: float, seed: int) -> np.ndarray:
    """An Ornstein-Uhlenbeck error by its textbook recursion, every scene starting anew."""
    rng = np.random.default_rng(seed)
    error, dt = rng.normal(0.0, std_rad, recordings.offsets[-1]), recordings["dt_s"]
    firsts = set(recordings.offsets[:-1].tolist())
    for k in range(len(error)):
        if k not in firsts:
            keep = np.exp(-dt[k] / time_s)
            error[k] = keep * error[k - 1] + np.sqrt(1.0 - keep**2) * error[k]
    return error


def with_errors(recordings: Recordings, yaw_error_rad: np.ndarray) -> Recordings:
    """Poses with an error, and no exact truth."""
    yaw = recordings["truth.yaw_rad"] + yaw_error_rad
    turn = np.diff(yaw, prepend=np.nan)
    turn[recordings.offsets[:-1]] = np.nan
    nothing = np.full(recordings.offsets[-1], np.nan)
    hidden = {f"exact.{name}": nothing for name in ("x_m", "y_m", "yaw_rad")}
    return recordings.replace(columns={"truth.yaw_rad": yaw, "truth.yaw_increment_rad": turn, **hidden})


def without_cameras(recordings: Recordings) -> Recordings:
    return Recordings(
        replace(recordings.manifest, cameras=(), variants={}),
        {name: recordings[name] for name in recordings.column_names if not name.startswith("CAM_")},
    )


def test_lasting_noise_is_found_again_at_every_length(quiet: Recordings) -> None:
    found = yaw_noise(with_errors(quiet, wander(quiet, STD_RAD, TIME_S, 5)))
    assert found.source == "cameras and gyro"
    window_s = np.array([0.1, 0.5, 1.0, 2.0])
    expected = 2.0 * STD_RAD**2 * (1.0 - np.exp(-window_s / TIME_S))
    np.testing.assert_allclose(np.sqrt(found.variance_rad2(window_s)), np.sqrt(expected), rtol=0.15)


def test_white_noise_is_told_from_lasting_noise(quiet: Recordings) -> None:
    found = yaw_noise(with_errors(quiet, np.random.default_rng(1).normal(0.0, STD_RAD, quiet.offsets[-1])))
    assert np.hypot(found.white_rad, found.lasting_rad[0]) == pytest.approx(STD_RAD, rel=0.1)
    assert np.linalg.norm(found.lasting_rad[1:]) < 0.35 * STD_RAD


def test_errors_of_cameras_and_gyro_are_no_noise_of_the_poses(quiet: Recordings) -> None:
    """Twice the pose noise in all cameras alike, and a bias in the gyro: one of three instruments each."""
    written = with_errors(quiet, wander(quiet, STD_RAD, TIME_S, 5))
    drift = np.diff(wander(quiet, 2.0 * STD_RAD, 0.3, 6), prepend=0.0)
    columns = {f"{c}.yaw_increment_rad": written[f"{c}.yaw_increment_rad"] + drift for c in written.manifest.cameras}
    columns["INERTIAL.yaw_increment_rad"] = written["INERTIAL.yaw_increment_rad"] + 1e-4
    worse = yaw_noise(written.replace(columns=columns))
    window_s = np.array([0.1, 0.5, 1.0])
    expected = yaw_noise(written).variance_rad2(window_s)
    np.testing.assert_allclose(np.sqrt(worse.variance_rad2(window_s)), np.sqrt(expected), rtol=0.25)


def test_exact_poses_have_next_to_no_noise(quiet: Recordings) -> None:
    noisy = yaw_noise(with_errors(quiet, wander(quiet, STD_RAD, TIME_S, 5)))
    none = yaw_noise(with_errors(quiet, np.zeros(quiet.offsets[-1])))
    one = np.ones(1)
    assert none.variance_rad2(one)[0] < 0.05 * noisy.variance_rad2(one)[0]


def test_variance_by_hand() -> None:
    """White noise of 3 and a wandering of 4 that lasts 1 s, over 1 s: 2 x 9 + 2 x 16 x (1 - 1 / e)."""
    lasting = tuple(4.0 if time_s == 1.0 else 0.0 for time_s in TIMES_S)
    noise = YawNoise(3.0, lasting, "cameras and gyro")
    assert noise.variance_rad2(np.ones(1))[0] == pytest.approx(18.0 + 32.0 * (1.0 - 1.0 / np.e))


def test_drawn_noise_has_the_variance_it_states(quiet: Recordings) -> None:
    noise = YawNoise(1e-3, tuple(STD_RAD if time_s == 0.5 else 0.0 for time_s in TIMES_S), "cameras and gyro")
    moving = quiet.replace(columns={"distance_m": np.where(quiet["step"] > 0, quiet["dt_s"] * 5.0, np.nan)})
    error = noise.draw(moving)
    np.testing.assert_array_equal(error, noise.draw(moving))
    steps = 4
    later = np.arange(steps, len(error))[quiet["step"][steps:] >= steps]
    window_s = quiet["time_s"][later] - quiet["time_s"][later - steps]
    ratio = np.mean((error[later] - error[later - steps]) ** 2) / np.mean(noise.variance_rad2(window_s))
    assert ratio == pytest.approx(1.0, rel=0.1)
    standing = noise.draw(quiet.replace(columns={"distance_m": np.zeros(len(error))}))
    assert np.ptp(standing[: quiet.offsets[1]]) == 0.0


def test_without_cameras_a_gyro_tells_white_noise_only_and_the_table_says_so(quiet: Recordings) -> None:
    error = np.random.default_rng(1).normal(0.0, STD_RAD, quiet.offsets[-1])
    exact_gyro = {"INERTIAL.yaw_increment_rad": quiet["truth.yaw_increment_rad"] + 1e-4}
    alone = without_cameras(with_errors(quiet, error).replace(columns=exact_gyro))
    assert len(hat(alone)[0]) == 0
    found = yaw_noise(alone)
    assert (found.source, found.lasting_rad) == ("gyro", (0.0,) * len(TIMES_S))
    assert found.white_rad == white_noise_rad(alone) == pytest.approx(STD_RAD, rel=0.08)
    board = build(alone, tracks=("PAPER",), policies=("INERTIAL", "NOISE FLOOR"))
    assert "white noise only, a weak lower bound" in to_markdown(board)


@pytest.mark.parametrize("clock", ["poses", "keyframes"])
def test_the_floor_of_the_bundled_city_is_what_exact_yaw_scores(clock: GroundTruth) -> None:
    """The oracle: against the very poses whose noise is told without it."""
    recordings = CrossValidation(few_drives(12), Trial(ground_truth=clock)).recordings
    truth = Truth(recordings, "truth")
    exact = with_wheels(recordings, with_truth(recordings, "exact")["truth.yaw_increment_rad"])
    told, true = (truth.measure(m).relative.rotation_deg_per_m.mean() for m in (noisy_truth(recordings), exact))
    assert told == pytest.approx(true, rel=0.15)
