"""ATE and RTE on validation scenes while Stable-Baselines3 trains, for TensorBoard: a callback for any algorithm.

    from mixo_env.leaderboard.curves import Curves

    PPO("MlpPolicy", MixoVecEnv(fold=3)).learn(100_000, callback=Curves("curves", validation))

They are for the eye: no method of this package chooses anything by them.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from mixo_env.envs.sb3 import MixoVecEnv
from mixo_env.envs.wrappers import Transform
from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.evaluation import Truth, with_wheels
from mixo_env.policies.policy import Policy
from mixo_env.policies.reinforcement import AGENTS, Reinforced
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import truths_of

EVERY = 4096
"""Steps of the environments between two points: PPO's roll-out."""


def require_tensorboard() -> None:
    """See that the package is there, without loading it.

    Raises:
        ConfigurationError: when it is not.
    """
    if find_spec("tensorboard") is None:
        raise ConfigurationError("curves need the package tensorboard: pip install 'mixo-env[tensorboard]'")


def check_watched(rows: Sequence[str]) -> None:
    """See that there will be curves of some of these rows.

    Raises:
        ConfigurationError: without TensorBoard, or when Stable-Baselines3 trains none of them.
    """
    require_tensorboard()
    if not AGENTS.keys() & set(rows):
        raise ConfigurationError(f"curves: none of {', '.join(rows)} is trained by Stable-Baselines3: name PPO")


class Curves(BaseCallback):
    """Plays all validation scenes now and then, by the actor's mean action, and records how far off it ends up.

    ``eval/ate_m``, ``eval/ate_deg``: mean over scenes of the RMSE, not aligned; ``eval/rte_deg_per_m``,
    ``eval/rte_percent``: pooled RTE; ``eval/yaw_rmse_deg``: of the increments. All against the headline's truth, as the
    leaderboard scores. Training goes the same way with and without it.
    """

    def __init__(
        self,
        folder: str | Path | None,
        validation: Recordings,
        *,
        transform: Transform | None = None,
        every: int = EVERY,
        **options: Any,
    ) -> None:
        """Make the environment to play in.

        Args:
            folder: of TensorBoard; ``None``: wherever the algorithm logs to.
            validation: scenes that are not trained on; those outside all folds are left out.
            transform: of the observations, as in training.
            every: steps of the training environments between two points.
            options: of the environment, as in training: track, observation, weights, ...

        Raises:
            ConfigurationError: without TensorBoard, for an unknown option, or no scene.
        """
        super().__init__()
        if folder is not None:
            require_tensorboard()
        self._folder, self._every, self._next = folder, every, 0
        self._scenes = validation.select(split="all")
        options |= {"recordings": self._scenes, "split": "all", "order": "fixed"}
        self._environment = MixoVecEnv(num_envs=len(self._scenes), transform=transform, step_infos=True, **options)
        self._truth = Truth(self._scenes, truths_of(self._scenes)[0])

    def evaluate(self) -> dict[str, float]:
        """Play every scene once: name -> number."""
        errors = self._truth.measure(with_wheels(self._scenes, self._increments()))
        squared, steps = errors.squared_yaw_increment_deg2.sum(), errors.steps.sum()
        relative = errors.relative
        found = {
            "ate_m": errors.absolute.translation_m.mean(),
            "ate_deg": errors.absolute.rotation_deg.mean(),
            "yaw_rmse_deg": np.sqrt(squared / steps),
        }
        if len(relative.scene):  # no scene may be long enough for a sample
            found |= {
                "rte_deg_per_m": relative.rotation_deg_per_m.mean(),
                "rte_percent": relative.translation_percent.mean(),
            }
        return {name: float(value) for name, value in found.items()}

    def _increments(self) -> NDArray[np.float64]:
        """Fused yaw increments ``(rows,)`` of the whole validation set; NaN in row 0 of a scene."""
        self._environment.seed(0)  # the first scene first
        seen: Any = self._environment.reset()
        row = self._scenes.offsets[:-1].copy()
        increments, last = np.full(self._scenes.offsets[-1], np.nan), self._scenes.offsets[1:] - 1
        while (going := row < last).any():
            actions, _ = self.model.predict(seen, deterministic=True)
            seen, _, _, infos = self._environment.step(actions)
            for i in np.flatnonzero(going):
                row[i] += 1
                increments[row[i]] = infos[i]["yaw_increment_rad"]
        return increments

    def _init_callback(self) -> None:
        if self._folder is not None:
            self.model.set_logger(configure(str(self._folder), ["tensorboard"]))

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + self._every
            self._record()

    def _on_training_end(self) -> None:
        self._record()

    def _record(self) -> None:
        for name, value in self.evaluate().items():
            self.logger.record(f"eval/{name}", value)
        self.logger.dump(self.num_timesteps)


def watch(policy: Policy, folder: Path, validation: Recordings, track: str) -> None:
    """Let a row of the leaderboard draw its curves when it is fitted, if Stable-Baselines3 trains it.

    Args:
        policy: new.
        folder: of TensorBoard.
        validation: scenes of the held-out fold.
        track: whose experts vote.
    """
    if isinstance(policy, Reinforced):
        options: dict[str, Any] = {"observation": policy.recipe.observation, "weights": policy.weights}
        policy.watch = lambda transform: Curves(folder, validation, transform=transform, track=track, **options)
