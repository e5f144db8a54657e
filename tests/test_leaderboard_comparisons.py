"""Sign flips, Holm, letters and families: by hand, by property, and against scipy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from mixo_env.leaderboard.comparisons import CONFIRMATORY, compare_rows, detectable
from mixo_env.leaderboard.letters import letters
from mixo_env.metrics.bootstrap import holm, interval_over_groups
from mixo_env.metrics.signflips import EXACT_GROUPS, sign_flip_p_values
from tests.paired import paired_difference


def test_sign_flips_of_three_groups_by_hand() -> None:
    """Sums 3, 2, -1: total 4. The eight patterns give +-6 (3+2+1), +-4, +-2 and +-0: four reach 4 in magnitude."""
    assert sign_flip_p_values([[3.0], [2.0], [-1.0]]) == pytest.approx(4 / 8)
    assert sign_flip_p_values([[3.0], [2.0], [1.0]]) == pytest.approx(2 / 8)
    assert sign_flip_p_values([[0.0], [0.0], [0.0]]) == pytest.approx(1.0)


@pytest.mark.parametrize("groups", [1, 2, 5, 11])
def test_halves_count_what_enumeration_counts(groups: int) -> None:
    rng = np.random.default_rng(groups)
    sums = rng.normal(0.4, 1.0, (groups, 4))
    sums[:, 3] = rng.integers(-2, 3, groups)  # many ties
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=groups)))
    expected = [np.mean(np.abs(signs @ column) >= abs(column.sum()) - 1e-9) for column in sums.T]
    assert sign_flip_p_values(sums) == pytest.approx(expected)


def test_sign_flips_are_those_of_scipy() -> None:
    stats = pytest.importorskip("scipy.stats")
    sums = np.random.default_rng(3).normal(0.5, 1.0, 12)
    oracle = stats.permutation_test(
        (sums,), lambda x, axis: np.sum(x, axis=axis), permutation_type="samples", n_resamples=np.inf, vectorized=True
    )
    assert sign_flip_p_values(sums[:, None])[0] == pytest.approx(oracle.pvalue)


def test_exact_up_to_24_groups_whatever_the_order() -> None:
    sums = np.random.default_rng(0).normal(0.2, 1.0, (EXACT_GROUPS, 1))
    assert sign_flip_p_values(sums, seed=1) == pytest.approx(sign_flip_p_values(-sums[::-1], seed=2), rel=1e-12)
    assert sign_flip_p_values(np.ones((24, 1)))[0] == pytest.approx(2 / 2**24, rel=1e-12)


def test_drawn_signs_agree_with_all_and_are_never_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    sums = np.random.default_rng(0).normal(0.5, 1.0, (14, 3))
    exact = sign_flip_p_values(sums)
    monkeypatch.setattr("mixo_env.metrics.signflips.EXACT_GROUPS", 3)
    drawn = sign_flip_p_values(sums, seed=5)
    assert drawn == pytest.approx(exact, abs=0.002)
    assert np.array_equal(drawn, sign_flip_p_values(sums, seed=5))
    assert not np.array_equal(drawn, sign_flip_p_values(sums, seed=6))
    assert sign_flip_p_values(np.ones((60, 1)), draws=1000)[0] == pytest.approx(1 / 1001)


def test_holm_of_the_textbook() -> None:
    """p .01 .04 .03 .005 of four: .005 x 4, .01 x 3, .03 x 2, .04 x 1, none below the one before."""
    corrected = holm({"H1": 0.01, "H2": 0.04, "H3": 0.03, "H4": 0.005})
    assert corrected == pytest.approx({"H1": 0.03, "H2": 0.06, "H3": 0.06, "H4": 0.02})


def test_letters_of_a_known_matrix() -> None:
    """A row of four in which only neighbours are alike makes the chain a, ab, bc, c."""
    far = [("one", "three"), ("one", "four"), ("two", "four")]
    assert letters(["one", "two", "three", "four"], far) == {"one": "a", "two": "ab", "three": "bc", "four": "c"}
    assert letters(["x", "y"], []) == {"x": "a", "y": "a"}
    assert letters(["x", "y"], [("y", "x")]) == {"x": "a", "y": "b"}


@pytest.mark.parametrize("seed", range(20))
def test_rows_share_a_letter_exactly_if_they_do_not_differ(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = [f"row {k}" for k in range(9)]
    pairs = list(itertools.combinations(rows, 2))
    differ = [pair for pair in pairs if rng.uniform() < 0.4]
    found = letters(rows, differ)
    for pair in pairs:
        assert bool(set(found[pair[0]]) & set(found[pair[1]])) is (pair not in differ)


def rows(seed: int = 0) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Eight drives of 30 pieces: MIXO a little better than LINEAR, CAM_FRONT much worse, HUBER like MIXO."""
    rng = np.random.default_rng(seed)
    logs = np.repeat([f"log-{k}" for k in range(8)], 30)
    shared = rng.gamma(2.0, 1.0, 240)
    return {
        "CAM_FRONT": shared + 2.0 + rng.normal(0, 0.1, 240),
        "LINEAR": shared + 0.5 + rng.normal(0, 0.1, 240),
        "HUBER": shared + rng.normal(0, 0.1, 240),
        "MIXO": shared + rng.normal(0, 0.1, 240),
    }, logs


def test_families_are_corrected_apart() -> None:
    errors, logs = rows()
    found = compare_rows(errors, logs)
    assert [(c.first, c.second) for c in found.confirmatory] == list(CONFIRMATORY)
    assert len(found.exploratory) == 6
    raw = {(c.first, c.second): c.p_value for c in found.confirmatory}
    assert {(c.first, c.second): c.p_holm for c in found.confirmatory} == holm(raw)
    everything = {(c.first, c.second): c.p_value for c in found.exploratory}
    assert {(c.first, c.second): c.p_holm for c in found.exploratory} == holm(everything)
    without = compare_rows({name: errors[name] for name in ("LINEAR", "HUBER")}, logs)
    assert (len(without.confirmatory), len(without.exploratory)) == (0, 1)


def test_comparisons_are_those_of_paired_difference() -> None:
    errors, logs = rows()
    for comparison in compare_rows(errors, logs, seed=4).exploratory:
        alone = paired_difference(errors[comparison.first], errors[comparison.second], logs, seed=4)
        assert comparison.p_value == pytest.approx(alone.p_value)
        assert comparison.difference.mean == pytest.approx(alone.difference.mean)
        assert comparison.difference.low == pytest.approx(alone.difference.low)
        assert comparison.detectable == pytest.approx(detectable(alone.standard_error))
        assert comparison.share == pytest.approx(alone.difference.mean / errors[comparison.second].mean())


def test_letters_follow_the_order_of_the_rows_and_stop_at_the_noise_floor() -> None:
    errors, logs = rows()
    found = compare_rows(errors, logs)
    assert found.letters["LINEAR"] != found.letters["MIXO"]
    assert found.letters["MIXO"] == found.letters["HUBER"] == "a"
    assert found.letters["CAM_FRONT"] == "c"
    floored = compare_rows(errors, logs, floor=float(errors["LINEAR"].mean()) - 0.01)
    assert set(floored.letters) == {"LINEAR", "CAM_FRONT"}


def test_a_comparison_reads_the_same_from_both_sides() -> None:
    errors, logs = rows()
    found = compare_rows(errors, logs)
    there, back = found.between("CAM_FRONT", "LINEAR"), found.between("LINEAR", "CAM_FRONT")
    assert there is not None
    assert back is not None
    assert there.difference.mean == pytest.approx(-back.difference.mean)
    assert (there.difference.low, there.difference.high) == pytest.approx((-back.difference.high, -back.difference.low))
    assert back.share == pytest.approx(back.difference.mean / errors["CAM_FRONT"].mean())
    assert found.between("LINEAR", "LINEAR") is None
    assert found.between("PERFECT YAW", "LINEAR") is None


def test_detectable_difference_is_2_8_standard_errors() -> None:
    assert detectable(1.0) == pytest.approx(2.80, abs=0.005)
    assert detectable(1.0, 0.05 / 4) == pytest.approx(3.34, abs=0.005)


def test_one_drive_gives_no_interval_and_no_letter_of_its_own() -> None:
    errors, _ = rows()
    found = compare_rows(errors, np.zeros(240))
    assert all(c.p_holm == 1.0 for c in found.exploratory)
    assert all(np.isnan(c.difference.low) and np.isnan(c.detectable) for c in found.exploratory)
    assert set(found.letters.values()) == {"a"}
    assert compare_rows({"LINEAR": np.empty(0)}, np.empty(0)).letters == {"LINEAR": ""}


def test_power_is_what_is_printed() -> None:
    """A true difference of 2.8 standard errors is found in about four of five data sets."""
    rng, found = np.random.default_rng(0), 0
    groups = np.repeat(np.arange(20), 5)
    for _ in range(200):
        values = 2.80 / np.sqrt(20) + np.repeat(rng.normal(0, 1, 20), 5)
        found += paired_difference(values, np.zeros(100), groups, resamples=2).p_value < 0.05
    assert 0.7 < found / 200 < 0.88
    assert interval_over_groups([1.0, 2.0], [0, 1]).groups == 2
