"""ROC curves and the areas under them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu

from mixo_env.errors import ConfigurationError
from mixo_env.metrics.detection import area_under_roc, false_alarms, roc

SIGNAL = np.array([0.9, 0.8, 0.8, 0.3, 0.1])
EVENT = np.array([True, True, False, False, True])


def test_area_by_hand() -> None:
    """Of six pairs .9 wins two, .8 ties one and wins one, .1 loses both: (2 + 1.5 + 0) / 6."""
    assert area_under_roc(SIGNAL, EVENT, [0] * 5).mean == pytest.approx(3.5 / 6)


def test_curve_by_hand() -> None:
    thresholds, alarmed, detected = roc(SIGNAL, EVENT)
    np.testing.assert_array_equal(thresholds, [np.inf, 0.9, 0.8, 0.3, 0.1])
    np.testing.assert_allclose(alarmed, [0, 0, 1 / 2, 1, 1])
    np.testing.assert_allclose(detected, [0, 1 / 3, 2 / 3, 2 / 3, 1])


def test_false_alarms_by_hand() -> None:
    assert false_alarms(SIGNAL, EVENT, 0.3) == (0.9, 0.0)
    assert false_alarms(SIGNAL, EVENT, 2 / 3) == (0.8, 0.5)
    assert false_alarms(SIGNAL, EVENT, 0.9) == (0.1, 1.0)


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_area_is_that_of_mann_and_whitney_and_of_the_trapezia(seed: int) -> None:
    rng = np.random.default_rng(seed)
    event = np.concatenate([[True, False], rng.random(40) < 0.3])
    signal = np.round(rng.normal(event, 1.0), 1)
    area = area_under_roc(signal, event, rng.integers(0, 4, len(event)), resamples=10).mean
    u = mannwhitneyu(signal[event], signal[~event]).statistic
    assert area == pytest.approx(u / (event.sum() * (~event).sum()))
    _, alarmed, detected = roc(signal, event)
    assert area == pytest.approx(np.trapezoid(detected, alarmed))


def test_interval_is_that_of_redrawn_samples() -> None:
    """The same bootstrap the long way: whole groups are drawn, and the area is taken anew from their samples."""
    rng = np.random.default_rng(3)
    group = np.repeat(np.arange(6), 30)
    event = rng.random(180) < 0.3
    signal = rng.normal(event, 1.0 + 0.3 * group)
    found = area_under_roc(signal, event, group, resamples=1000)
    areas = []
    for _ in range(1000):
        rows = np.concatenate([np.flatnonzero(group == g) for g in rng.integers(0, 6, 6)])
        risen, quiet = signal[rows][event[rows]], signal[rows][~event[rows]]
        areas.append(mannwhitneyu(risen, quiet).statistic / (len(risen) * len(quiet)))
    assert (found.low, found.high) == pytest.approx(np.quantile(areas, [0.025, 0.975]), abs=0.015)


def test_one_group_has_no_interval() -> None:
    area = area_under_roc(SIGNAL, EVENT, ["log"] * 5)
    assert np.isnan(area.low)
    assert area.groups == 1


@pytest.mark.parametrize("event", [np.zeros(5, bool), np.ones(5, bool)])
def test_nothing_to_tell_apart_is_refused(event: np.ndarray) -> None:
    with pytest.raises(ConfigurationError, match="events of 5"):
        roc(SIGNAL, event)


def test_unknown_values_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="finite"):
        area_under_roc([1.0, np.nan], [True, False], [0, 1])
