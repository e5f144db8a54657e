"""Policies of ``MixoOdometryBudget-v0``: which cameras are worth their milliseconds, and how much each expert counts.

They have a protocol of their own, since an action also switches cameras. :func:`play` drives anyone's.
"""

from __future__ import annotations

import abc
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.budget import BudgetReplay
from mixo_env.envs.stepping import TRUTH
from mixo_env.errors import ConfigurationError, PolicyError, unknown
from mixo_env.fusion import least_squares_weights
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import for_learning

Actions = NDArray[np.float32]
Split = Literal["train", "test", "all"]

RAW_SCALE = 4.0
"""Of ``weights="raw"``: weights up to 4 fit into an action."""


class BudgetPolicy(abc.ABC):
    """Weights and switches, step by step and for a batch of scenes at once.

    Attributes:
        options: of the environment it is made for: ``observation``, ``weights`` and the like.
    """

    options: Mapping[str, Any] = {"observation": "dict", "weights": "raw", "raw_scale": RAW_SCALE}

    def reset(self, batch: int) -> None:
        """Forget the past: ``batch`` scenes start. Stateless policies inherit this and do nothing."""

    @abc.abstractmethod
    def act(self, observation: Any) -> Actions:
        """Actions ``(batch, experts + cameras)`` for what the environment shows: flat, or name -> ``(batch, width)``.

        The last numbers are switches of the cameras, on if > 0.
        """


class LinearByPattern:
    """LINEAR for every set of delivering cameras, fitted on training scenes with the stateless increments.

    Attributes:
        experts: in the order of the weights.
        cameras: in the order of the switches.
        weights: which cameras deliver -> ``(experts,)``, 0 for those that sleep.
    """

    def __init__(self, training: Recordings, track: str) -> None:
        """Fit all sets, to poses free of lag: those that the environment rewards."""
        replay = BudgetReplay(for_learning(training), track=track)
        self.experts, self.cameras = replay.experts, replay.cameras
        self._columns = [self.experts.index(camera) for camera in self.cameras]
        truth = replay.table[:, TRUTH]
        self.weights: dict[tuple[bool, ...], NDArray[np.float64]] = {}
        for pattern in itertools.product((False, True), repeat=len(self._columns)):
            silent = {column for column, on in zip(self._columns, pattern, strict=True) if not on}
            voting = [j for j in range(len(self.experts)) if j not in silent]
            weights = np.zeros(len(self.experts))
            if voting:
                weights[voting] = least_squares_weights(replay.votes.increments_rad[:, voting], truth)
            self.weights[pattern] = weights

    def __call__(self, available: NDArray[np.float32]) -> NDArray[np.float64]:
        """Weights ``(batch, experts)`` for the cameras that deliver."""
        return np.stack([self.weights[tuple(row[self._columns] > 0)] for row in available])


class CameraSet(BudgetPolicy):
    """The same cameras all the time, or whenever the car turns; LINEAR's weights for those that deliver."""

    def __init__(self, linear: LinearByPattern, on: Sequence[str], turning_radps: float = 0.0) -> None:
        """Process ``on`` when the last fused yaw rate was ``turning_radps`` or more, else none.

        Raises:
            ConfigurationError: for a camera that is not among ``linear.cameras``.
        """
        for camera in on:
            if camera not in linear.cameras:
                raise ConfigurationError(unknown("camera", camera, linear.cameras))
        self._linear, self._turning_radps = linear, turning_radps
        self._on = np.array([camera in on for camera in linear.cameras])

    def act(self, observation: Any) -> Actions:
        """Weights by what delivers now; switches by the turn."""
        weights = self._linear(observation["available"]) / RAW_SCALE
        awake = self._on & (np.abs(observation["previous_yaw_rate"]) >= self._turning_radps)
        return np.concatenate([weights, np.where(awake, 1.0, -1.0)], axis=1).astype(np.float32)


@dataclass(frozen=True)
class Played:
    """What came out, by scene.

    Attributes:
        ate_m: absolute trajectory error [m], ``(scenes,)``.
        yaw_rmse_deg: RMSE of one step's yaw increment [deg], ``(scenes,)``.
        cost_ms: mean cost [ms per step], ``(scenes,)``.
        yaw_reward: mean reward of a step without its cost, ``(scenes,)``.
    """

    ate_m: NDArray[np.float64]
    yaw_rmse_deg: NDArray[np.float64]
    cost_ms: NDArray[np.float64]
    yaw_reward: NDArray[np.float64]

    def reward(self, price_per_ms: float) -> float:
        """Mean reward of a step at a price, over all steps of scenes of equal weight."""
        return float(np.mean(self.yaw_reward - price_per_ms * self.cost_ms))


def play_sets(recordings: Recordings, track: str, linear: LinearByPattern) -> dict[tuple[str, ...], Played]:
    """Every constant set of cameras, the smallest first, on all scenes of ``recordings``."""
    sets = (s for count in range(len(linear.cameras) + 1) for s in itertools.combinations(linear.cameras, count))
    return {on: play(CameraSet(linear, on), recordings, track, split="all") for on in sets}


def greedy_order(sets: Mapping[tuple[str, ...], Played]) -> list[str]:
    """Cameras by the yaw error they take away in what :func:`play_sets` returned, the best first."""
    cameras = max(sets, key=len)
    order: list[str] = []
    while rest := [camera for camera in cameras if camera not in order]:
        grown = {camera: tuple(c for c in cameras if c in (*order, camera)) for camera in rest}
        order.append(min(rest, key=lambda camera: sets[grown[camera]].yaw_rmse_deg.mean()))
    return order


def best_set(sets: Mapping[tuple[str, ...], Played], price_per_ms: float) -> tuple[str, ...]:
    """The constant set that earns most in what :func:`play_sets` returned."""
    return max(sets, key=lambda on: sets[on].reward(price_per_ms))


def play(
    policy: BudgetPolicy, recordings: Recordings, track: str = "CONSUMER", *, fold: int = 3, split: Split = "test"
) -> Played:
    """Drive every scene of a split once, all at the same time.

    Args:
        policy: anyone's: anything with ``options``, ``reset`` and ``act`` as :class:`BudgetPolicy` has them.
        recordings: of all folds: constants of the vehicles come from the folds that are not scored.
        track: who votes.
        fold: held out for testing.
        split: "test": the scenes of ``fold``, "train": of the other folds, "all": of all.

    Raises:
        ConfigurationError: for a fold without scenes.
        PolicyError: when the policy's actions are none of the environment's.
    """
    scenes = sum(
        scene.fold >= 0 and (split == "all" or (scene.fold == fold) == (split == "test")) for scene in recordings.scenes
    )
    if not scenes:
        raise ConfigurationError(f"fold: expected one with scenes in split {split!r}, got {fold}: use another")
    chosen = {"recordings": recordings, "track": track, "fold": fold, "split": split, "order": "fixed"}
    env = gym.make_vec("mixo_env:MixoOdometryBudget-v0", scenes, **{**policy.options, **chosen})
    observation, _ = env.reset(seed=0)
    policy.reset(scenes)
    scores = {name: np.full(scenes, np.nan) for name in ("ate_m", "yaw_rmse_deg")}
    running = np.ones(scenes, np.bool_)
    cost_ms, earned, steps = np.zeros((3, scenes))
    while running.any():
        actions = policy.act(observation)
        try:
            observation, reward, _, truncated, info = env.step(actions)
        except ConfigurationError as error:
            raise PolicyError(f"{type(policy).__name__}: {error}") from None
        cost_ms += np.where(running, info["cost_ms"], 0.0)
        earned += np.where(running, reward - info["reward_cost"], 0.0)
        steps += running
        for i in np.flatnonzero(truncated & running):
            for name, values in scores.items():
                values[i] = info["scores"][name][i]
        running &= ~truncated
    env.close()
    return Played(scores["ate_m"], scores["yaw_rmse_deg"], cost_ms / steps, earned / steps)
