"""Standard deviations of fused turns."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from experiments.deviations import (
    NORMAL,
    Fold,
    Windows,
    as_stated,
    conformal,
    conformal_factor,
    covered,
    likelihood,
    main,
    mixed_std,
    study,
    windows,
)
from mixo_env.fusion import mix
from mixo_env.recordings.store import save_recordings
from mixo_env.recordings.substitutes import substituted_increments
from tests.synthetic import synthetic_recordings


def some(error: np.ndarray, std: float = 1.0) -> Windows:
    return Windows(error, np.full(len(error), std), np.arange(len(error), dtype=np.float64))


def test_deviation_of_a_mixture_by_hand() -> None:
    """Halves of 1 and 3, usual 1 and 2, mix to 2: variance (1 + 1 + 4 + 1) / 4; a stranger shows only what it does."""
    half = np.array([[0.5, 0.5]])
    assert mixed_std(half, np.array([[1.0, 3.0]]), np.array([[1.0, 2.0]]))[0] ** 2 == pytest.approx(7 / 4)
    assert mixed_std(half, np.array([[1.0, 3.0]]), np.array([[1.0, np.inf]]))[0] ** 2 == pytest.approx(3 / 4)


def test_deviation_of_independent_experts_is_that_of_the_mixture() -> None:
    """Where all agree, the sum of the variances is left."""
    weights, std = np.array([[0.7, 0.2, 0.1]]), np.array([[1.0, 2.0, 3.0]])
    errors = np.random.default_rng(0).normal(size=(100_000, 3)) * std
    assert mixed_std(weights, np.ones((1, 3)), std)[0] == pytest.approx(np.std(errors @ weights[0]), rel=0.01)


def test_half_width_is_that_of_a_normal_interval() -> None:
    assert norm.cdf(NORMAL) - norm.cdf(-NORMAL) == pytest.approx(0.9, abs=1e-4)


def test_likelihood_is_scipys() -> None:
    error, std = np.radians([0.1, -0.3, 0.0]), np.radians([0.2, 0.1, 0.5])
    expected = -norm.logpdf(np.degrees(error), scale=np.degrees(std)).mean()
    assert likelihood(error, std) == pytest.approx(expected)


def test_conformal_factor_by_hand() -> None:
    """Of 19 the smallest with 18 = ceil(20 x .9) at or below; of 5 the largest, since 90 % of 6 is more than 5."""
    assert conformal_factor(some(np.arange(19.0) + 1.0)) == pytest.approx(18.0 / NORMAL)
    assert conformal_factor(some(np.arange(5.0) + 1.0)) == pytest.approx(5.0 / NORMAL)


def test_conformal_intervals_hold_on_new_windows_however_wrong_the_deviations() -> None:
    rng = np.random.default_rng(1)
    heavy = rng.standard_t(2, size=40_000)
    factor = conformal_factor(some(heavy[:20_000], 0.3))
    fold = Fold(some(heavy[20_000:], 0.3), some(heavy[20_000:], 0.3), factor)
    assert covered(fold.told) < 60.0
    mean, overall, _ = conformal([fold])
    assert mean == factor
    assert overall == pytest.approx(90.0, abs=1.0)


def test_coverage_over_all_in_the_worst_fold_and_in_the_hardest_quarter() -> None:
    """Spreads are 0 to 7 and 0 to 3, so the hardest quarter of twelve are 5, 6 and 7, all in the good fold."""
    good, bad = some(np.zeros(8)), some(np.array([0.0, 0.0, 0.0, 9.0]))
    _, overall, worst, hardest, width = as_stated([good, bad])
    assert overall == pytest.approx(100 * 11 / 12)
    assert worst == 75.0
    assert hardest == 100.0
    assert covered(bad.hardest()) == 0.0
    assert width == pytest.approx(np.degrees(NORMAL))


def test_windows_are_plain_sums() -> None:
    recordings = synthetic_recordings(0, scenes=2, steps=60)
    training = synthetic_recordings(1, scenes=4, steps=60)
    weights = np.full((recordings.offsets[-1], 4), 0.25)
    found = windows(training, recordings, weights, "VISION")
    steps = round(2.0 / float(np.median(training["dt_s"])))
    fused = mix(weights, substituted_increments(recordings, "VISION"))
    turn = recordings["truth.yaw_increment_rad"]
    first = slice(1, 1 + steps)
    assert found.error_rad[0] == pytest.approx(fused[first].sum() - turn[first].sum())
    assert len(found.error_rad) == sum(scene.rows - steps for scene in recordings.scenes)
    assert np.all(found.std_rad > 0.0)


def test_command_line(tmp_path, capsys, caplog) -> None:
    recordings = synthetic_recordings(0, scenes=8, steps=80)
    row = study(recordings, "VISION", ["STUDENT-T"]).rows[0]
    assert row[0] == "STUDENT-T"
    assert np.isfinite(np.array(row[1:], np.float64)).all()
    save_recordings(recordings, tmp_path / "some")
    assert main(["--recordings", str(tmp_path / "some"), "--rows", "HUBER", "--markdown"]) == 0
    assert "| HUBER |" in capsys.readouterr().out
    assert main(["--recordings", str(tmp_path / "some"), "--rows", "NOBODY"]) == 1
    assert "NOBODY" in caplog.text
