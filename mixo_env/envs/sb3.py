"""Stable-Baselines3 on the batched environment: its algorithms take no Gymnasium vector environments.

from mixo_env.envs.sb3 import MixoVecEnv

PPO("MlpPolicy", MixoVecEnv("MixoOdometry-v0", num_envs=64), gamma=0.0).learn(1_000_000)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from mixo_env import ENVIRONMENTS
from mixo_env.envs.odometry import MixoOdometryVectorEnv, entry
from mixo_env.envs.wrappers import Transform, flat_box
from mixo_env.errors import ConfigurationError, RecordingError, unknown

Indices = None | int | Iterable[int]


class MixoVecEnv(VecEnv):
    """A batched environment of this package as Stable-Baselines3's ``VecEnv``, without a Python loop over environments.

    ``infos`` stay empty but at the end of a scene (``terminal_observation``, ``TimeLimit.truncated``, ``scores``) and,
    with ``step_infos``, for the terms of the reward. Wrap it in SB3's ``VecMonitor`` to see episode returns.
    """

    def __init__(
        self,
        env_id: str = "MixoOdometry-v0",
        num_envs: int = 64,
        *,
        transform: Transform | None = None,
        step_infos: bool = False,
        **options: Any,
    ) -> None:
        """Make the environments.

        Args:
            env_id: a registered id of this package, with or without the prefix ``mixo_env:``.
            num_envs: how many.
            transform: of the observations, see :mod:`mixo_env.envs.wrappers`.
            step_infos: fill in every step's ``infos`` too, which costs time.
            options: of the environment.
        """
        if "autoreset_mode" in options:
            raise ConfigurationError("autoreset_mode: Stable-Baselines3 resets in the same step, leave it out")
        env_id = env_id.removeprefix("mixo_env:")
        if env_id not in ENVIRONMENTS:
            raise ConfigurationError(unknown("environment of this package", env_id, ENVIRONMENTS))
        env = gym.make_vec(env_id, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **options)
        assert isinstance(env, MixoOdometryVectorEnv)
        self.env = env
        self.transform = transform
        self._step_infos = step_infos
        self._actions: Any = None
        space = transform.space(flat_box(env)) if transform else env.single_observation_space
        super().__init__(env.num_envs, space, env.single_action_space)

    def reset(self) -> Any:
        """Start all scenes; ``seed`` and ``set_options`` take effect here."""
        options = {key: [one[key] for one in self._options] for key in self._options[0]} or None
        observation, info = self.env.reset(seed=self._seeds[0], options=options)
        self.reset_infos = [{"scene": scene} for scene in info["scene"]]
        self._reset_seeds()
        self._reset_options()
        return self._seen(observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Remember the actions."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Play the step: observations, rewards, dones, infos."""
        observation, reward, _, done, info = self.env.step(self._actions)
        if not np.isfinite(reward).all():  # else a network learns it, and torch complains of something else much later
            scene = self.reset_infos[np.flatnonzero(~np.isfinite(reward))[0]]["scene"]
            raise RecordingError(
                f"{scene}: expected finite rewards, got NaN: its true poses are broken, record it anew"
            )
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if self._step_infos:
            self._tell(infos, info)
        if "final_info" in info:
            self._tell(infos, info["final_info"])
            for i in np.flatnonzero(done):
                final = info["final_obs"][i]
                infos[i]["terminal_observation"] = self.transform(final) if self.transform else final
                infos[i]["TimeLimit.truncated"] = True
                self.reset_infos[i] = {"scene": info["scene"][i]}
        return self._seen(observation), reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the environments."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """The attribute of the batched environment, once per index."""
        return [getattr(self.env, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the batched environment; single environments have none of their own."""
        self._chosen_all(indices)
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Call a method of the batched environment once, and return its result once per index."""
        self._chosen_all(indices)
        return [getattr(self.env, method_name)(*args, **kwargs)] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[gym.Wrapper], indices: Indices = None) -> list[bool]:
        """Nothing is wrapped."""
        return [False] * len(self._chosen(indices))

    def get_images(self) -> Sequence[np.ndarray | None]:
        """A frame per environment with ``render_mode="rgb_array"``."""
        return self.env.render() or [None] * self.num_envs

    def _seen(self, observation: Any) -> Any:
        return self.transform(observation) if self.transform else observation

    def _tell(self, infos: list[dict[str, Any]], info: dict[str, Any]) -> None:
        """Hand Gymnasium's batched information out to single dictionaries."""
        for key, values in info.items():
            if not key.startswith("_") and key not in ("final_obs", "final_info", "scene"):
                for i in np.flatnonzero(info[f"_{key}"]).tolist():
                    if isinstance(values, dict):
                        infos[i][key] = {k: v for k, v in entry(values, i).items() if not k.startswith("_")}
                    else:
                        infos[i][key] = values[i]

    def _chosen(self, indices: Indices) -> list[int]:
        return list(self._get_indices(indices))

    def _chosen_all(self, indices: Indices) -> None:
        if len(self._chosen(indices)) != self.num_envs:
            raise ConfigurationError("the environments of a batch share everything: leave indices out")
