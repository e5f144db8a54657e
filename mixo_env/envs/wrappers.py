"""Transforms of flat observations, for single and batched environments and for the Stable-Baselines3 adapter alike.

env = gym.make("mixo_env:MixoOdometry-v0")
env = transformed(env, standardise(env))
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv
from gymnasium.wrappers import TransformObservation
from gymnasium.wrappers.vector import TransformObservation as TransformVectorObservation
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.files import write_text

FloatArray = NDArray[np.float32]
AnyEnv = gym.Env[Any, Any] | VectorEnv[Any, Any, Any]


class Transform(Protocol):
    """A function of flat observations ``(..., width)`` that knows the space of its results."""

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Transform one observation or a batch of them."""
        ...

    def space(self, box: spaces.Box) -> spaces.Box:
        """Space of the results, for observations from ``box``."""
        ...


@dataclass(frozen=True)
class Standardise:
    """Shift and scale every number by frozen statistics of training observations, and clip the result.

    Attributes:
        mean: ``(width,)``.
        std: ``(width,)``; 1 where a number never varied.
        clip: largest absolute result [standard deviations].
    """

    mean: FloatArray
    std: FloatArray
    clip: float = 10.0

    @classmethod
    def fit(cls, observations: FloatArray, clip: float = 10.0) -> Standardise:
        """Statistics of ``observations`` ``(rows, width)``."""
        mean, std = observations.mean(axis=0, dtype=np.float64), observations.std(axis=0, dtype=np.float64)
        return cls(mean.astype(np.float32), np.where(std > 1e-9, std, 1.0).astype(np.float32), clip)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Standardised and clipped copy."""
        # On one observation np.clip takes 3 µs longer than these two, a tenth of an agent's whole decision.
        return np.minimum(np.maximum((observation - self.mean) / self.std, -self.clip), self.clip)

    def space(self, box: spaces.Box) -> spaces.Box:
        """A Box of the same shape, from -clip to clip."""
        return spaces.Box(-self.clip, self.clip, box.shape, dtype=np.float32)

    def save(self, path: Path) -> None:
        """Write the statistics as JSON: a policy trained with them is worth nothing without them."""
        fields = {"mean": self.mean.tolist(), "std": self.std.tolist(), "clip": self.clip}
        write_text(path, json.dumps(fields))

    @classmethod
    def load(cls, path: Path) -> Standardise:
        """Read what :meth:`save` wrote.

        Raises:
            PolicyError: if the file is missing or holds something else.
        """
        try:
            fields = json.loads(path.read_text(encoding="utf-8"))
            mean, std = (np.asarray(fields[name], np.float32) for name in ("mean", "std"))
            return cls(mean, std, float(fields["clip"]))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise PolicyError(f"{path} holds no observation statistics ({error!r}): save them anew") from None


def standardise(env: AnyEnv, clip: float = 10.0) -> Standardise:
    """Standardisation with the statistics of the training scenes of ``env``, whatever split it plays.

    Args:
        env: one of this package's environments, wrapped or not.
        clip: largest absolute result [standard deviations].
    """
    flat_box(env)
    observations = env.unwrapped.session.training_observations()  # type: ignore[attr-defined, union-attr]
    return Standardise.fit(observations, clip)


def transformed(env: AnyEnv, transform: Transform) -> AnyEnv:
    """``env`` with transformed observations (Gymnasium's own wrapper of either kind)."""
    space = transform.space(flat_box(env))
    if isinstance(env, VectorEnv):
        return TransformVectorObservation(env, transform, single_observation_space=space)
    return TransformObservation(env, transform, space)


def flat_box(env: AnyEnv) -> spaces.Box:
    """Observation space of one environment, which must be flat."""
    space = env.single_observation_space if isinstance(env, VectorEnv) else env.observation_space
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise ConfigurationError("expected a flat observation, got a dictionary: choose observation='paper' or 'rich'")
    return space
