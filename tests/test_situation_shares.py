"""The study of staged situations: what is chosen, how orders are compared."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from experiments import situation_shares
from experiments import stored_figures as stored
from experiments.situation_shares import (
    SCORES,
    Choice,
    SituationStudy,
    choose,
    compare_orders,
    kendall_tau,
    kept_scores,
    leaderboard_scores,
    ranks,
    staged_scenes,
)
from mixo_env.errors import ConfigurationError
from tests.synthetic import synthetic_recordings

STAGED = {f"scene-{k:04d}": k % 5 in (0, 1) for k in range(50)}  # 40 %
FACTORS = (0.0, 0.5, 1.0, 2.0)


def test_sets_have_one_size_and_the_shares_asked_for():
    choices = choose(STAGED, FACTORS, draws=2, seed=0)
    assert [(c.factor, c.draw) for c in choices] == [(f, d) for d in (0, 1) for f in FACTORS]
    for choice in choices:
        assert len(choice.plain) + len(choice.staged) == 25  # 20 staged scenes are 80 % of it
        assert len(choice.staged) == round(0.4 * choice.factor * 25)
        assert not any(STAGED[name] for name in choice.plain)
        assert all(STAGED[name] for name in choice.staged)


def test_sets_of_a_draw_are_nested_and_draws_differ():
    first, second = (choose(STAGED, FACTORS, 2, seed=0)[k : k + 4] for k in (0, 4))
    for fewer, more in itertools.pairwise(first):
        assert set(fewer.staged) < set(more.staged)
        assert set(more.plain) < set(fewer.plain)
    assert set(first[2].plain) != set(second[2].plain)
    assert choose(STAGED, FACTORS, 2, seed=0)[:4] == first


def test_what_counts_as_staged():
    sheet = {
        "situations": {"a": "ordinary", "b": "standing", "c": "standing_cross_traffic", "d": "ordinary"},
        "logs": [{"low_texture": False, "scenes": ["a", "b", "c"]}, {"low_texture": True, "scenes": ["d"]}],
    }
    assert staged_scenes(sheet) == {"a": False, "b": False, "c": True, "d": True}


@pytest.mark.parametrize("factors", [(0.0, 2.0), (1.0, 2.5), (1.0, -1.0)])
def test_impossible_factors(factors: tuple[float, ...]):
    with pytest.raises(ConfigurationError, match="factors must include 1"):
        choose(STAGED, factors, 1, 0)


def test_both_kinds_of_scenes_are_needed():
    with pytest.raises(ConfigurationError, match="0 staged"):
        choose({"a": False, "b": False}, FACTORS, 1, 0)


def test_tau_and_ranks_agree_with_scipy():
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = rng.integers(0, 6, (2, 9)).astype(float)
        assert kendall_tau(a, b) == pytest.approx(stats.kendalltau(a, b).statistic)
        assert np.array_equal(ranks(a), stats.rankdata(a))
    line = np.arange(5.0)
    assert (kendall_tau(line, line), kendall_tau(line, -line)) == (1.0, -1.0)


def scores(**rows: float) -> situation_shares.Scores:
    return {"VISION": dict.fromkeys(SCORES, rows)}


def test_orders_hand_worked():
    found = compare_orders(
        {
            (1.0, 0): scores(A=1.0, B=2.0, C=3.0),
            (1.0, 1): scores(A=1.0, B=2.0, C=4.0),
            (2.0, 0): scores(A=1.0, B=3.0, C=2.0),  # one of three pairs is reversed
            (2.0, 1): scores(A=3.0, B=2.0, C=1.0),  # all are
        }
    )
    score = SCORES[0]
    assert found["tau"]["VISION"][score]["1"] == {"mean": 1.0, "lowest": 1.0}
    assert found["tau"]["VISION"][score]["2"] == {"mean": pytest.approx((1 / 3 - 1) / 2), "lowest": -1.0}
    assert found["chance"]["VISION"][score] == {"mean": 1.0, "lowest": 1.0}
    assert found["ranks"]["VISION"][score]["2"] == {"A": 2.0, "B": 2.5, "C": 1.5}
    assert found["scores"]["VISION"][score]["1"] == {"A": 1.0, "B": 2.0, "C": 3.5}


def test_leaderboard_of_a_choice_is_that_of_its_scenes(monkeypatch: pytest.MonkeyPatch):
    recordings = synthetic_recordings(0, steps=120)
    names = [scene.name for scene in recordings.scenes]
    monkeypatch.setattr("mixo_env.leaderboard.board.policy_names", lambda _: ("INERTIAL", "CAM_FRONT"))
    found = leaderboard_scores(recordings, Choice(1.0, 0, tuple(names[:2]), tuple(names[2:4])))
    assert set(found) == {"PAPER", "VISION", "CONSUMER"}
    assert set(found["VISION"]["rotation_deg_per_m"]) == {"INERTIAL", "CAM_FRONT"}
    everything = leaderboard_scores(recordings, Choice(1.0, 0, tuple(names), ()))
    assert everything["VISION"] != found["VISION"]


def test_study_from_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recordings = synthetic_recordings(0, steps=60)
    names = [scene.name for scene in recordings.scenes]
    stored.save(
        tmp_path / "sheet.json",
        {"situations": {name: "ordinary" if k % 3 else "tight_turn" for k, name in enumerate(names)}, "logs": []},
    )
    monkeypatch.setattr(situation_shares, "load_recordings", lambda _: recordings)
    monkeypatch.setattr("mixo_env.leaderboard.board.policy_names", lambda _: ("INERTIAL", "CAM_FRONT", "CAM_BACK"))
    out = tmp_path / "study.json"
    kept = tmp_path / "unfinished"
    SituationStudy(sheet=tmp_path / "sheet.json", draws=2, out=out, unfinished=kept).run()
    assert not kept.exists()
    found = stored.load(out)
    assert found["tau"]["CONSUMER"]["rotation_deg_per_m"]["1"]["mean"] == 1.0
    assert list(found["staged"]) == ["0", "0.5", "1", "2"]
    stored.save(tmp_path / "sheet.json", {"situations": {}, "logs": []})
    with pytest.raises(ConfigurationError, match="says nothing"):
        SituationStudy(sheet=tmp_path / "sheet.json", out=out, unfinished=kept).run()


def test_an_interrupted_study_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recordings, computed = synthetic_recordings(0, steps=20), []

    def score(_: object, choice: Choice) -> dict[str, dict[str, dict[str, float]]]:
        computed.append(choice)
        return {"VISION": {"yaw_increment_rmse_deg": {"MEDIAN": float(len(computed))}}}

    monkeypatch.setattr(situation_shares, "leaderboard_scores", score)
    one, other = Choice(1.0, 0, ("a",), ("b",)), Choice(1.0, 1, ("b",), ("a",))
    for _ in range(2):
        assert kept_scores(recordings, one, tmp_path)["VISION"]["yaw_increment_rmse_deg"]["MEDIAN"] == 1.0
        assert kept_scores(recordings, other, tmp_path)["VISION"]["yaw_increment_rmse_deg"]["MEDIAN"] == 2.0
    assert computed == [one, other]
