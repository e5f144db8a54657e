"""What policies and their files refuse at the border."""

from __future__ import annotations

import logging
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from mixo_env.errors import PolicyError
from mixo_env.policies import plugins, storage
from mixo_env.policies.drift import Drift
from mixo_env.policies.fitting import check, prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.match import HighestMatch
from tests.synthetic import synthetic_recordings


def test_a_tensor_of_whole_numbers_is_not_saved(tmp_path):
    with pytest.raises(PolicyError, match=r"'w': expected floating-point numbers, got int64"):
        storage.write(tmp_path, {}, {"w": np.ones(2, np.int64)})
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_is_no_saved_policy(tmp_path):
    with pytest.raises(PolicyError, match=r"expected a saved policy at .* found none"):
        storage.read(tmp_path)


def test_bytes_that_are_no_policy_are_one_line(tmp_path):
    (tmp_path / storage.FILE).write_bytes(b"no safetensors")
    with pytest.raises(PolicyError, match="is not a saved policy") as caught:
        storage.read(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [2.0 * storage.LARGEST, -2.0 * storage.LARGEST, np.nan, np.inf])
def test_values_beyond_the_largest_are_refused(value):
    with pytest.raises(ValueError, match="tensor w holds values beyond"):
        storage.finite("w", np.array([1.0, value]))


@pytest.mark.parametrize("value", [0.0, -1.0, 0.5 * storage.SMALLEST_DIVISOR])
def test_a_divisor_is_not_tiny(value):
    with pytest.raises(ValueError, match=r"tensor s must be .* at least"):
        storage.positive("s", np.array([1.0, value]))


def test_sound_values_come_back_as_they_are():
    values = np.array([storage.SMALLEST_DIVISOR, storage.LARGEST])
    assert storage.positive("s", values) is values


def test_the_width_of_what_is_seen_is_checked():
    seen = np.zeros((2, 3), np.float32)
    assert storage.check_inputs("P", seen, np.zeros(3)) is seen
    with pytest.raises(PolicyError, match="P was fitted on 4 inputs a step, here are 3"):
        storage.check_inputs("P", seen, np.zeros(4))


def test_the_highest_match_needs_matches():
    with pytest.raises(PolicyError, match="needs match counts"):
        HighestMatch().act({"matches": np.zeros((2, 0)), "available": np.ones((2, 3))})


def test_a_policy_is_played_only_where_it_was_fitted_for_and_not_on_its_own_drives():
    recordings = synthetic_recordings(scenes=3)
    policy = Linear()
    with pytest.raises(PolicyError, match="was fitted for nothing yet"):
        check(policy, recordings, "PAPER")
    prepare(policy, recordings, "PAPER")
    with pytest.raises(PolicyError, match="was fitted on the drive of"):
        check(policy, recordings, "PAPER")
    with pytest.raises(PolicyError, match="but track VISION of these recordings has"):
        check(policy, recordings, "VISION")
    policy.fitted_on = ()
    with pytest.raises(PolicyError, match="does not say on which drives"):
        check(policy, recordings, "PAPER")


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("memory_s", 0.0, "memory_s above 0"),
        ("white_share", -0.1, "white_share of 0 to"),
        ("slow_radps", 2.0 * storage.LARGEST, "slow_radps of 0 to"),
    ],
)
def test_a_drift_that_no_fit_gives_is_refused(name, value, said):
    sound = {field: np.full(shape, 0.5) for field, shape in Drift.shapes(2).items()}
    assert Drift.restore(sound | {"constant_radps": np.full(2, -0.1)}).constant_radps[0] == -0.1  # the one with a sign
    with pytest.raises(ValueError, match=said):
        Drift.restore(sound | {name: np.array([0.5, value])})


def test_plug_ins_with_a_taken_or_unprintable_name_are_left_out_with_a_warning(monkeypatch, caplog):
    names = ("FINE", "huber", "two\nlines", "fine")
    points = [EntryPoint(name, "somewhere:Policy", plugins.GROUP) for name in names]
    monkeypatch.setattr(plugins, "entry_points", lambda group: points)
    plugins._warn.cache_clear()
    with caplog.at_level(logging.WARNING):
        assert list(plugins.plugins(("HUBER",))) == ["FINE"]
    assert [record.getMessage().split(": ", 1)[1] for record in caplog.records] == [
        "the name huber is taken by another policy: left out",
        "'two\\nlines' is no name for a policy: left out",
        "the name fine is taken by another policy: left out",
    ]
