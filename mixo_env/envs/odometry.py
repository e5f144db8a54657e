"""``MixoOdometry-v0``: the single and the batched environment over one fusion core."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mixo_env.envs.session import Session
from mixo_env.envs.settings import Settings
from mixo_env.errors import ConfigurationError, unknown

RENDER_MODES = ["ansi", "rgb_array"]


class MixoOdometryEnv(gym.Env[Any, Any]):
    """DOC."""

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": 12}  # noqa: RUF012 (typed by Gymnasium)
    session_class: ClassVar[type[Session]] = Session
    settings_class: ClassVar[type[Settings]] = Settings

    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:
        """Build the environment; see the class for the options."""
        self.render_mode = checked_render_mode(render_mode)
        self.session = self.session_class(self.settings_class.read(options), 1)
        self.observation_space = self.session.observation_space
        self.action_space = self.session.rule.space
        self._ended = True

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start a scene: a random one, the next one (``order="fixed"``) or ``options={"scene": name}``."""
        super().reset(seed=seed)
        if seed is not None:
            self.session.rewind()
        self.session.begin(np.arange(1), self.np_random, options)
        self._ended = False
        self._scene = self.session.scene_names(np.ones(1, np.bool_))[0]
        return entry(self.session.observe(), 0), {"scene": self._scene}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Weigh the experts for one step."""
        if self._ended:
            raise ConfigurationError("the scene has ended: call reset() before step()")
        session = self.session
        observation, report, ended = session.play(session.rule.read(action, None))
        info: dict[str, Any] = dict(zip(session.reward.report, report.ravel().tolist(), strict=True))
        reward = info.pop("reward")
        self._ended = ended > 0
        if self._ended:
            scores = {name: float(values[0]) for name, values in session.replay.scores().items()}
            info["scores"] = {"scene": self._scene, **scores}
        return entry(observation, 0), reward, False, self._ended, info


class MixoOdometryVectorEnv(VectorEnv[Any, Any, Any]):
    """``num_envs`` copies of :class:`MixoOdometryEnv` stepped together; equal to it step for step, and much faster."""

    metadata: dict[str, Any] = {  # noqa: RUF012 (typed by Gymnasium)
        "render_modes": RENDER_MODES,
        "render_fps": 12,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    session_class: ClassVar[type[Session]] = Session
    settings_class: ClassVar[type[Settings]] = Settings

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        """Build the environments; see :class:`MixoOdometryEnv` for the options."""
        self.render_mode = checked_render_mode(render_mode)
        self.autoreset_mode = checked_autoreset_mode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        if not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise ConfigurationError(f"num_envs: expected a whole number >= 1, got {num_envs!r}")
        self.num_envs = int(num_envs)
        settings = self.settings_class.read(options)
        self.session = self.session_class(settings, self.num_envs, keep_trajectories=render_mode is not None)
        self.single_observation_space = self.session.observation_space
        self.single_action_space = self.session.rule.space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._ended = np.ones(self.num_envs, np.bool_)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start all scenes, or with ``options={"reset_mask": (num_envs,) bool}`` some of them.

        ``options={"scene": name}`` or a list of names, one per environment that is reset, chooses the scenes.
        """
        super().reset(seed=seed)
        if seed is not None:
            self.session.rewind()
        mask = self._reset_mask(options)
        self.session.begin(np.flatnonzero(mask), self.np_random, options)
        self._ended &= ~mask
        return self.session.observe(), self._reset_info(mask)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Weigh the experts for one step everywhere; what follows the end of a scene is the autoreset mode's affair."""
        session, mode, before = self.session, self.autoreset_mode, self._ended
        info: dict[str, Any] = {}
        played = np.ones(self.num_envs, np.bool_)
        if before.any():
            if mode is AutoresetMode.DISABLED:
                raise ConfigurationError(f"{before.sum()} scenes have ended: reset them with options reset_mask first")
            session.begin(np.flatnonzero(before), self.np_random, pause=True)  # NEXT_STEP: this step is their reset
            info, played = self._reset_info(before), ~before
        observation, report, ended = session.play(session.rule.read(actions, self.num_envs))
        truncated = session.replay.done.copy()
        reward = report[0]
        told = dict(zip(session.reward.report[1:], report[1:], strict=True))
        if ended and mode is AutoresetMode.SAME_STEP:
            info |= {"final_obs": self._listed(observation, truncated), "_final_obs": truncated.copy()}
            final = only(told, truncated) | self._scores(truncated)
            info |= {"final_info": final, "_final_info": truncated.copy()}
            session.begin(np.flatnonzero(truncated), self.np_random)
            observation = session.observe()
            info |= self._reset_info(truncated) | only(told, ~truncated)
        else:
            if played.any():
                info |= masked(told, played)
            if ended:
                info |= self._scores(truncated)
            self._ended = truncated.copy()
        return observation, reward, np.zeros(self.num_envs, np.bool_), truncated, info

    def _reset_mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise ConfigurationError(f"reset_mask: expected a bool array of shape ({self.num_envs},), got {mask!r}")
        if not mask.any():
            raise ConfigurationError("reset_mask: expected at least one True, got none: nothing would be reset")
        return mask

    def _reset_info(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        return {"scene": self.session.scene_names(mask), "_scene": mask.copy()}

    def _scores(self, truncated: NDArray[np.bool_]) -> dict[str, Any]:
        scores = {"scene": self.session.scene_names(truncated), **self.session.replay.scores()}
        mask = truncated.copy()
        return {"scores": masked(scores, mask), "_scores": mask}

    def _listed(self, observation: Any, truncated: NDArray[np.bool_]) -> NDArray[Any]:
        """Observations of the scenes that ended, one by one in an object array (Gymnasium's ``final_obs``)."""
        listed = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(truncated).tolist():
            listed[i] = entry(observation, i)
        return listed


def entry(observation: Any, i: int) -> Any:
    """Observation of one environment of a batch."""
    if isinstance(observation, dict):
        return {name: values[i] for name, values in observation.items()}
    return observation[i]


def masked(values: dict[str, NDArray[Any]], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Gymnasium's form of batched information: beside each array, 0 where it does not apply, a mask ``_name``."""
    return {key: item for name, array in values.items() for key, item in ((name, array), (f"_{name}", mask))}


def only(values: dict[str, NDArray[Any]], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """The same of ``values`` that apply only where ``mask`` is True; nothing at all if that is nowhere."""
    return masked({name: np.where(mask, array, 0.0) for name, array in values.items()}, mask) if mask.any() else {}


def checked_render_mode(mode: str | None) -> str | None:
    """The mode, if it is one."""
    if mode is not None and mode not in RENDER_MODES:
        raise ConfigurationError(unknown("render_mode", mode, RENDER_MODES))
    return mode


def checked_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """The mode as Gymnasium's enum, from its value or its name."""
    if isinstance(mode, AutoresetMode):
        return mode
    modes = {key: m for m in AutoresetMode for key in (m.value, m.name)}
    if mode not in modes:
        raise ConfigurationError(unknown("autoreset_mode", mode, [m.name for m in AutoresetMode]))
    return modes[mode]
