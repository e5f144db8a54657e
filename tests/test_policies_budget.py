"""Policies of the budget environment: one protocol, one player, anyone's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mixo_env.envs.budget import BudgetReplay
from mixo_env.envs.stepping import TRUTH
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.policies.budget import (
    Actions,
    BudgetPolicy,
    CameraSet,
    LinearByPattern,
    Played,
    best_set,
    greedy_order,
    play,
    play_sets,
)
from mixo_env.recordings.collection import Recordings
from tests.synthetic import synthetic_recordings

TRACK = "CONSUMER"


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(scenes=4, steps=30)


@pytest.fixture(scope="module")
def linear(recordings: Recordings) -> LinearByPattern:
    return LinearByPattern(recordings.select(folds=[0, 1, 2]), TRACK)


def test_weights_of_every_set_are_least_squares_of_those_that_deliver(
    recordings: Recordings, linear: LinearByPattern
) -> None:
    replay = BudgetReplay(recordings.select(folds=[0, 1, 2]), track=TRACK)
    cameras = len(linear.cameras)
    assert len(linear.weights) == 2**cameras
    for pattern in ((True,) * cameras, (True, *(False,) * (cameras - 1))):
        silent = [c for c, on in zip(linear.cameras, pattern, strict=True) if not on]
        voting = [j for j, expert in enumerate(linear.experts) if expert not in silent]
        expected, *_ = np.linalg.lstsq(replay.votes.increments_rad[:, voting], replay.table[:, TRUTH], rcond=None)
        np.testing.assert_allclose(linear.weights[pattern][voting], expected, rtol=1e-3, atol=1e-4)
        assert np.count_nonzero(linear.weights[pattern]) == len(voting)


class Stranger(BudgetPolicy):
    """Equal weights, all cameras; remembers how it was asked."""

    def __init__(self, linear: LinearByPattern, numbers: int | None = None) -> None:
        self.numbers = numbers or len(linear.experts) + len(linear.cameras)
        self.batches: list[int] = []
        self.options = {"observation": "rich", "weights": "softmax"}

    def reset(self, batch: int) -> None:
        self.batches.append(batch)

    def act(self, observation: Any) -> Actions:
        return np.ones((len(observation), self.numbers), np.float32)


def test_anyones_policy_is_played_over_every_scene_once(recordings: Recordings, linear: LinearByPattern) -> None:
    stranger = Stranger(linear)
    every = play(CameraSet(linear, linear.cameras), recordings, TRACK, split="train")
    played = play(stranger, recordings, TRACK, split="train")
    assert stranger.batches == [3]
    np.testing.assert_array_equal(played.cost_ms, every.cost_ms)
    assert np.isfinite([played.ate_m, played.yaw_rmse_deg]).all()
    assert not np.array_equal(played.yaw_rmse_deg, every.yaw_rmse_deg)
    with pytest.raises(PolicyError, match="Stranger: "):
        play(Stranger(linear, numbers=2), recordings, TRACK)
    with pytest.raises(ConfigurationError, match="expected one with scenes"):
        play(stranger, recordings, TRACK, fold=9)


def test_a_set_costs_its_cameras_and_none_costs_nothing(recordings: Recordings, linear: LinearByPattern) -> None:
    costs = recordings.manifest.camera_cost_ms
    steps = int(np.diff(recordings.select(folds=[3]).offsets)[0]) - 1
    for on in ((), linear.cameras[:1], linear.cameras[1:3]):
        (cost,) = play(CameraSet(linear, on), recordings, TRACK).cost_ms
        assert cost == pytest.approx(sum(costs[c] for c in on) * (steps - 1) / steps, rel=0.06)
    (straight,) = play(CameraSet(linear, linear.cameras, turning_radps=99.0), recordings, TRACK).cost_ms
    assert straight == 0.0
    with pytest.raises(ConfigurationError, match="unknown camera"):
        CameraSet(linear, ("CAM_NONE",))


def outcome(yaw_rmse_deg: float, cost_ms: float, yaw_reward: float) -> Played:
    return Played(*(np.array([value]) for value in (1.0, yaw_rmse_deg, cost_ms, yaw_reward)))


SETS = {
    (): outcome(0.9, 0.0, -3.0),
    ("A",): outcome(0.5, 20.0, -1.5),
    ("B",): outcome(0.4, 20.0, -1.4),
    ("C",): outcome(0.6, 20.0, -2.0),
    ("A", "B"): outcome(0.35, 40.0, -1.3),
    ("A", "C"): outcome(0.1, 40.0, -1.2),
    ("B", "C"): outcome(0.3, 40.0, -1.25),
    ("A", "B", "C"): outcome(0.09, 60.0, -1.1),
}


def test_the_greedy_order_adds_what_takes_away_most_error() -> None:
    assert greedy_order(SETS) == ["B", "C", "A"]  # not the best pair, A and C


@pytest.mark.parametrize(("price", "on"), [(0.0, ("A", "B", "C")), (0.006, ("A", "C")), (0.05, ("B",)), (0.1, ())])
def test_the_best_set_of_a_price_earns_most(price: float, on: tuple[str, ...]) -> None:
    assert best_set(SETS, price) == on


def test_every_set_is_played_on_all_scenes(recordings: Recordings, linear: LinearByPattern) -> None:
    training = recordings.select(folds=[0, 1, 2])
    sets = play_sets(training, TRACK, linear)
    assert len(sets) == 2 ** len(linear.cameras)
    assert all(len(played.cost_ms) == 3 for played in sets.values())
    assert (sets[()].cost_ms == 0.0).all()
    np.testing.assert_allclose(
        sets[linear.cameras[:1]].yaw_rmse_deg,
        play(CameraSet(linear, linear.cameras[:1]), training, TRACK, split="all").yaw_rmse_deg,
    )
