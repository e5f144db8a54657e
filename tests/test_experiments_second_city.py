"""Kendall's tau over pairs that share no letter: by hand, by property, against scipy."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from experiments.second_city import Claim, SecondCity, standings_of, tau_of_lettered
from mixo_env.errors import PolicyError
from mixo_env.leaderboard.comparisons import Comparison
from mixo_env.metrics.bootstrap import Interval
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings

REFERENCE = {"one": 1.0, "two": 2.0, "three": 3.0, "four": 4.0}
APART = {"one": "a", "two": "b", "three": "c", "four": "d"}


def test_by_hand() -> None:
    """one and two share a letter: five pairs are left; only three and four change places: (4 - 1) / 5."""
    letters = {"one": "a", "two": "ab", "three": "c", "four": "d"}
    found = tau_of_lettered(REFERENCE, letters, {"two": 1.0, "one": 2.0, "four": 3.0, "three": 4.0})
    assert found.tau == pytest.approx(3 / 5)
    assert (found.pairs, found.reversed) == (5, (("three", "four"),))


def test_same_order_reversed_order_ties_and_nothing_to_compare() -> None:
    assert tau_of_lettered(REFERENCE, APART, REFERENCE).tau == 1.0
    assert tau_of_lettered(REFERENCE, APART, {row: -error for row, error in REFERENCE.items()}).tau == -1.0
    assert tau_of_lettered(REFERENCE, APART, dict.fromkeys(REFERENCE, 1.0)).tau == 0.0
    alike = tau_of_lettered(REFERENCE, dict.fromkeys(REFERENCE, "a"), REFERENCE)
    assert math.isnan(alike.tau)
    assert tau_of_lettered(REFERENCE, APART, {"one": 1.0, "four": 2.0}).pairs == 1
    assert tau_of_lettered(REFERENCE, APART | {"one": ""}, REFERENCE).pairs == 3


def test_with_a_letter_each_it_is_that_of_scipy() -> None:
    stats = pytest.importorskip("scipy.stats")
    rng = np.random.default_rng(0)
    rows = [f"row {k}" for k in range(9)]
    first, second = rng.normal(size=(2, 9))
    apart = {row: chr(ord("a") + k) for k, row in enumerate(rows)}
    found = tau_of_lettered(dict(zip(rows, first, strict=True)), apart, dict(zip(rows, second, strict=True)))
    assert found.tau == pytest.approx(stats.kendalltau(first, second).statistic)


def compared(difference: float, p_value: float, p_holm: float) -> Comparison:
    return Comparison("one", "two", 1.0, Interval(difference, -1.0, 1.0, 9, 0.95), p_value, p_holm, 1.0, 1.0)


def test_a_difference_is_repeated_with_the_same_sign_and_p_below_5_percent() -> None:
    reference = compared(-0.1, 0.001, 0.004)
    cities = (compared(-0.2, 0.04, 0.2), compared(-0.2, 0.06, 0.2), compared(0.2, 0.001, 0.004))
    claim = Claim("VISION", "one", "two", (reference, *cities))
    assert claim.repeated == (True, False, False)
    assert not claim.holds
    assert Claim("VISION", "one", "two", (reference, cities[0])).holds
    assert not Claim("VISION", "one", "two", (compared(-0.1, 0.02, 0.08), cities[0])).holds
    assert not Claim("VISION", "one", "two", (reference,)).holds
    sentence = claim.sentence(("a", "b", "c", "d"))
    assert "one - two: significant in a, repeated in b: a -10.0 % (p .0010, Holm .0040); b -20.0 %" in sentence


def test_study_runs_on_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.second_city.names", lambda _: ("CAM_FRONT", "CAM_BACK_RIGHT", "LINEAR", "HUBER"))
    for seed in (0, 1):
        save_recordings(synthetic_recordings(seed, scenes=8, logs=8, steps=80), tmp_path / f"city-{seed}")
    other = str(tmp_path / "city-1")
    assert SecondCity((other,), str(tmp_path / "city-0"), tmp_path / "tau.json").run() == 0
    written = msgspec.json.decode((tmp_path / "tau.json").read_bytes())
    assert set(written["tau"]["city-1"]) == set(written["errors"]) == {"PAPER", "VISION", "CONSUMER"}
    assert {(claim["first"], claim["second"]) for claim in written["confirmatory"]} == {("LINEAR", "CAM_FRONT")}
    assert all(len(claim["cities"]) == 2 for claim in written["confirmatory"])
    save_recordings(synthetic_recordings(2, scenes=2, logs=1), tmp_path / "one-fold")
    with pytest.raises(PolicyError, match="expected two folds or more"):
        standings_of(str(tmp_path / "one-fold"))
