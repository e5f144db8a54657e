"""One training of an agent of Stable-Baselines3, with its errors on the held-out fold while it learns."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from experiments.rl_cloning import clone
from mixo_env.envs.sb3 import MixoVecEnv
from mixo_env.leaderboard.evaluation import Truth, rollout
from mixo_env.policies.fitting import drives
from mixo_env.policies.policy import Policy
from mixo_env.policies.reinforcement import AGENTS, Recipe, Reinforced
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import for_learning

CLONE = "CLONE"


@dataclass(frozen=True)
class Learner:
    """One row of the study.

    Attributes:
        algorithm: of Stable-Baselines3, or CLONE: PPO's actor taught by an oracle.
        recipe: how it is trained; the study says for how many steps.
        most_steps: a slow agent is trained no longer.
    """

    algorithm: str
    recipe: Recipe
    most_steps: int = 10**9

    def agent(self) -> Reinforced:
        """A new agent of this recipe and nothing else."""
        agent = AGENTS["PPO" if self.algorithm == CLONE else self.algorithm]()
        agent.recipe = self.recipe
        return agent


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

    def errors(self, policy: Policy) -> tuple[float, float]:
        """Yaw RMSE [deg] and RTE [deg/m] of a prepared policy on the held-out scenes."""
        measured = self._truth.measure(rollout(policy, self.test, self.track))
        yaw = np.sqrt(measured.squared_yaw_increment_deg2.sum() / measured.steps.sum())
        return float(yaw), float(measured.relative.rotation_deg_per_m.mean())

    @cached_property
    def _truth(self) -> Truth:
        return Truth(self.test)


class TimedEnv(MixoVecEnv):
    """Counts the CPU seconds spent in its steps."""

    seconds = 0.0

    def step_wait(self) -> Any:
        """Play the step."""
        start = time.process_time()
        result = super().step_wait()
        self.seconds += time.process_time() - start
        return result


class Watch(BaseCallback):
    """Evaluates whenever ``every`` steps have passed."""

    def __init__(self, agent: Reinforced, field: Field, every: int) -> None:
        """Evaluate ``agent`` with the actor as it then stands."""
        super().__init__()
        self.curve: list[Point] = []
        self._agent, self._field, self._every = agent, field, every
        self._seconds = self._since = 0.0

    @property
    def seconds(self) -> float:
        """CPU time of the training, without evaluations."""
        return self._seconds

    def look(self) -> None:
        """Evaluate now."""
        self._seconds += time.process_time() - self._since
        self._agent.take(self.model)
        errors_now = self._field.errors(self._agent)
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


def train(learner: Learner, field: Field, steps: int, every: int, seed: int) -> Training:
    """Train with one thread of torch, on poses free of lag.

    Args:
        learner: whom.
        field: scenes.
        steps: of the environment in all.
        every: steps between evaluations.
        seed: same seed, same machine: same bits.
    """
    agent, training = learner.agent(), for_learning(field.training)
    agent.start(training.voters(field.track))
    agent.fitted_on = drives(field.training)
    agent.standardise_by(training, field.track)
    env = agent.environment(training, field.track, TimedEnv)
    model = agent.model(env, seed)
    if learner.algorithm == CLONE:
        return Training(_cloned(agent, field, model, steps), 0.0)
    watch = Watch(agent, field, every)
    model.learn(steps, callback=watch)
    watch.look()
    return Training(watch.curve, env.seconds / watch.seconds)


def _cloned(agent: Reinforced, field: Field, model: Any, steps: int) -> list[Point]:
    curve: list[Point] = []

    def look(shown: int, seconds: float) -> None:
        agent.take(model)
        curve.append(Point(shown, seconds, *field.errors(agent)))

    look(0, 0.0)
    clone(agent, for_learning(field.training), field.track, model, steps, look)
    return curve
