"""One training of an agent of Stable-Baselines3, with its errors on the held-out fold while it learns."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import NormalActionNoise

from mixo_env.envs.actions import LOGIT_SCALE
from mixo_env.envs.reward import RewardName
from mixo_env.envs.sb3 import MixoVecEnv
from mixo_env.envs.wrappers import Standardise
from mixo_env.fusion import softmax
from mixo_env.leaderboard.evaluation import Truth, rollout
from mixo_env.policies.linear import Linear
from mixo_env.policies.playing import collect
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.reinforcement import flat
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import for_learning

ALGORITHMS: dict[str, Any] = {"PPO": PPO, "A2C": A2C, "SAC": SAC, "TD3": TD3, "DQN": DQN}


@dataclass(frozen=True)
class Recipe:
    """How an agent is trained.

    Attributes:
        algorithm: of Stable-Baselines3.
        gamma: discount.
        environments: copies played at once.
        reward: option of the environment.
        standardised: observations are standardised with frozen statistics of the training scenes.
        settings: keyword arguments of the algorithm; the rest are its defaults.
        most_steps: a slow agent is trained no longer.
    """

    algorithm: str
    gamma: float = 0.0
    environments: int = 64
    reward: RewardName = "squared"
    standardised: bool = True
    settings: dict[str, Any] = field(default_factory=dict)
    most_steps: int = 10**9


@dataclass(frozen=True)
class Point:
    """Where a training stands.

    Attributes:
        steps: of the environment so far.
        seconds: CPU time of the training so far, without the evaluations.
        yaw_rmse_deg: root mean square error of one step's yaw increment on the held-out fold [deg].
        rte_deg_per_m: relative rotational error there, mean over all pieces of path [deg/m].
    """

    steps: int
    seconds: float
    yaw_rmse_deg: float
    rte_deg_per_m: float

    @property
    def errors(self) -> tuple[float, float]:
        """Yaw RMSE [deg] and RTE [deg/m]."""
        return self.yaw_rmse_deg, self.rte_deg_per_m


@dataclass(frozen=True)
class Training:
    """A finished training.

    Attributes:
        curve: from the untrained network to the end.
        environment_share: of the training's CPU time, spent inside ``step`` of the environment and its adapter.
    """

    curve: list[Point]
    environment_share: float


class Learner(Policy):
    """The network of a model as it stands now."""

    name = "LEARNER"

    def __init__(self, model: Any, standardise: Standardise | None) -> None:
        """Ask ``model``; ``standardise`` what it sees."""
        self._model, self._standardise = model, standardise

    def act(self, observation: Observation) -> Weights:
        """Weights of its deterministic action ``(batch, experts)``."""
        seen = flat(observation)
        action, _ = self._model.predict(self._standardise(seen) if self._standardise else seen, deterministic=True)
        if action.ndim == 1:  # "select"
            return np.eye(len(self.experts))[action]
        return softmax(LOGIT_SCALE * action)


class TimedEnv(MixoVecEnv):
    """Counts the CPU seconds spent in its steps."""

    seconds = 0.0

    def step_wait(self) -> Any:
        """Play the step."""
        start = time.process_time()
        result = super().step_wait()
        self.seconds += time.process_time() - start
        return result


def errors(policy: Policy, test: Recordings, track: str) -> tuple[float, float]:
    """Yaw RMSE [deg] and RTE [deg/m] of a prepared policy on scenes that carry their true poses."""
    measured = Truth(test).measure(rollout(policy, test, track))
    yaw = np.sqrt(measured.squared_yaw_increment_deg2.sum() / measured.steps.sum())
    return float(yaw), float(measured.relative.rotation_deg_per_m.mean())


class Watch(BaseCallback):
    """Evaluates whenever ``every`` steps have passed."""

    def __init__(self, learner: Learner, test: Recordings, track: str, every: int) -> None:
        """Evaluate ``learner`` on ``test``."""
        super().__init__()
        self.curve: list[Point] = []
        self._learner, self._test, self._track, self._every = learner, test, track, every
        self._seconds = self._since = 0.0

    @property
    def seconds(self) -> float:
        """CPU time of the training, without evaluations."""
        return self._seconds

    def look(self) -> None:
        """Evaluate now."""
        self._seconds += time.process_time() - self._since
        errors_now = errors(self._learner, self._test, self._track)
        self.curve.append(Point(self.num_timesteps, self._seconds, *errors_now))
        self._since = time.process_time()

    def _on_training_start(self) -> None:
        self._since = time.process_time()
        self.look()

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self.curve[-1].steps + self._every:
            self.look()

    def _on_step(self) -> bool:
        return True


@dataclass(frozen=True)
class Field:
    """What agents are trained and tested on.

    Attributes:
        training: scenes of the training folds.
        test: held-out scenes, with their true poses.
        track: who votes.
    """

    training: Recordings
    test: Recordings
    track: str

    def standardise(self) -> Standardise:
        """Statistics of what LINEAR sees on the training scenes."""
        linear = Linear()
        linear.fit(for_learning(self.training), self.track)
        return Standardise.fit(flat(collect(for_learning(self.training), self.track, linear)))


def train(recipe: Recipe, field_: Field, steps: int, every: int, seed: int) -> Training:
    """Train with one thread of torch.

    Args:
        recipe: of the agent.
        field_: scenes.
        steps: of the environment in all.
        every: steps between evaluations.
        seed: same seed, same machine: same bits.
    """
    import torch

    torch.set_num_threads(1)
    standardise = field_.standardise() if recipe.standardised else None
    env = TimedEnv(
        num_envs=recipe.environments,
        transform=standardise,
        recordings=for_learning(field_.training),
        track=field_.track,
        split="all",
        observation="rich",
        reward=recipe.reward,
        weights="select" if recipe.algorithm == "DQN" else "softmax",
    )
    settings = dict(recipe.settings)
    if recipe.algorithm == "TD3":
        width: NDArray[np.float64] = np.zeros(env.action_space.shape or 1)
        settings["action_noise"] = NormalActionNoise(width, width + 0.3)
    model = ALGORITHMS[recipe.algorithm]("MlpPolicy", env, gamma=recipe.gamma, seed=seed, device="cpu", **settings)
    learner = Learner(model, standardise)
    learner.start(field_.training.voters(field_.track))
    watch = Watch(learner, field_.test, field_.track, every)
    model.learn(steps, callback=watch)
    watch.look()
    return Training(watch.curve, env.seconds / watch.seconds)
