"""Signals that warn of a large error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from docs._pages.lies_page import page
from experiments.lie_signals import COMBINED, combined, fit_combined, lately, of_the_others, signals
from experiments.lies import Verdict, Watched, draw, in_company, judge, main, parts, watch
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(0, scenes=8, steps=200)


@pytest.fixture(scope="module")
def watched(recordings: Recordings) -> list[Watched]:
    return watch(recordings)


@pytest.fixture(scope="module")
def verdicts(watched: list[Watched]) -> list[Verdict]:
    return judge(watched)


def test_nothing_of_the_truth_of_judged_scenes_is_in_a_signal(recordings: Recordings) -> None:
    """Another truth in one fold: its own signals stay the same to the last bit, those of the other folds need not."""
    inside = np.repeat([scene.fold == 1 for scene in recordings.scenes], np.diff(recordings.offsets))
    changed = {
        name: np.where(inside, recordings[name] * 1.5 + 0.1, recordings[name])
        for name in recordings.column_names
        if name.split(".")[0] in ("truth", "exact") or "truth" in name
    }
    assert len(changed) > 8
    for one, other in zip(parts(recordings), parts(recordings.replace(columns=changed)), strict=True):
        if one[1].scenes[0].fold != 1:
            continue
        experts = recordings.voters("VISION")
        told, again = (signals(training, tested, experts) for training, tested in (one, other))
        for expert in experts:
            for name, values in told[expert].items():
                np.testing.assert_array_equal(values, again[expert][name])
        break
    else:
        pytest.fail("fold 1 was never judged")


UNCHANGED = ("few inliers", "two images")
"""Shares, and differences of two equal columns, stay the same when all is scaled."""


def test_signals_do_not_see_later_steps(recordings: Recordings) -> None:
    experts = recordings.voters("VISION")
    end = int(recordings.offsets[0] + 100)
    later = np.arange(len(recordings["step"])) >= end
    changed = {
        name: np.where(later, recordings[name] * 1.3, recordings[name])
        for name in recordings.column_names
        if name.split(".")[0] in experts and "truth" not in name and not name.endswith("state")
    }
    told, again = (signals(recordings, r, experts) for r in (recordings, recordings.replace(columns=changed)))
    for expert in experts:
        for name, values in told[expert].items():
            np.testing.assert_array_equal(values[:end], again[expert][name][:end])
            assert not np.array_equal(values[end:], again[expert][name][end:], equal_nan=True) or name in UNCHANGED


def test_consensus_of_the_others_leaves_the_judged_one_out() -> None:
    increments = np.array([[1.0, 1.1, 1.05, 9.0], [9.0, 1.0, 1.2, 1.1], [1.0, np.nan, np.nan, np.nan]])
    value = of_the_others(increments, np.full(increments.shape, 0.1), 0)
    assert value[0] == pytest.approx(1.075, abs=0.01)
    assert value[1] == pytest.approx(1.1, abs=0.01)
    assert np.isnan(value[2])


def test_lately_by_hand() -> None:
    apart = np.array([np.nan, 1.0, np.nan, 2.0, np.nan, 4.0])
    np.testing.assert_allclose(lately(apart, np.array([0, 4, 6])), [np.nan, 1.0, 1.0, 1.1, np.nan, 4.0])


def test_company_is_somebody_else_to_the_same_side() -> None:
    errors = np.array([[2.0, 2.0, 0.0], [2.0, -2.0, 0.0], [2.0, 0.5, np.nan], [0.0, 2.0, 2.0]])
    assert in_company(errors, 0, 1.0).tolist() == [True, False, False, False]


def test_combination_finds_the_signal_that_tells() -> None:
    rng = np.random.default_rng(0)
    telling = np.exp(rng.normal(-7.0, 1.0, 2000))
    told = {"stated deviation": telling, "residual": rng.random(2000) + 0.1, "few matches": np.full(2000, np.nan)}
    weights = fit_combined(told, telling * rng.standard_normal(2000))
    assert set(weights) == {"stated deviation", "residual"}
    assert weights["stated deviation"][0] > 10 * abs(weights["residual"][0])
    order = np.argsort(combined(told, weights))
    assert np.corrcoef(np.argsort(order), np.argsort(np.argsort(telling)))[0, 1] > 0.99


def test_a_camera_that_knows_its_errors_warns_and_one_that_does_not_fails(verdicts: list[Verdict]) -> None:
    """The synthetic cameras err in proportion to what they state; the flow, always 10, is a coin."""
    by = {(v.expert, v.condition, v.signal): v for v in verdicts}
    side = by["CAM_FRONT_LEFT", "all", "stated deviation"]
    assert side.area.mean > 0.6
    assert side.area.low < side.area.mean < side.area.high or np.isnan(side.area.low)
    assert by["CAM_FRONT_LEFT", "all", "flow"].area.mean == 0.5
    assert by["CAM_FRONT_LEFT", "all", "disagreement"].area.mean > 0.9
    assert 0.0 < side.share < 0.5


def test_false_alarms_a_minute_count_steps(watched: list[Watched], verdicts: list[Verdict]) -> None:
    one = next(one for one in watched if one.expert == "CAM_FRONT_LEFT")
    verdict = next(v for v in verdicts if (v.expert, v.condition, v.signal) == (one.expert, "all", "residual"))
    alarms = np.sum((one.signals["residual"] >= verdict.threshold) & ~one.lies)
    assert verdict.per_minute == pytest.approx(alarms / (one.dt_s.sum() / 60.0))
    found = np.mean(one.signals["residual"][one.lies] >= verdict.threshold)
    assert 0.9 <= found < 0.95


def test_night_is_judged_by_all_folds(recordings: Recordings) -> None:
    scenes = tuple(
        replace(s, fold=-1, conditions=("night",)) if i % 4 == 3 else s for i, s in enumerate(recordings.scenes)
    )
    with_night = recordings.replace(replace(recordings.manifest, scenes=scenes))
    found = list(parts(with_night))
    assert [tested.scenes[0].fold for _, tested in found] == [0, 1, 2, -1]
    assert {s.fold for s in found[-1][0].scenes} == {0, 1, 2}


def test_page_and_figure(watched: list[Watched], verdicts: list[Verdict], tmp_path) -> None:
    draw(watched, tmp_path / "lies.png")
    assert (tmp_path / "lies.png").read_bytes().startswith(b"\x89PNG")
    text = page(verdicts, 4.0, 0.1, 8)
    assert f"| {COMBINED} |" in text
    assert "| CAM_BACK_RIGHT, turning |" in text


def test_command_line(recordings: Recordings, tmp_path, capsys, caplog) -> None:
    save_recordings(recordings, tmp_path / "some")
    assert main(["--recordings", str(tmp_path / "some"), "--limit", "3"]) == 0
    assert "CAM_FRONT_LEFT" in capsys.readouterr().out
    assert main(["--recordings", str(tmp_path / "some"), "--track", "NONE"]) == 1
    assert "NONE" in caplog.text
