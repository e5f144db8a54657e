"""Episodes of any policy as a Minari dataset, for offline reinforcement learning.

env = gym.make("mixo_env:MixoOdometry-v0", order="fixed")
write_minari(env, lambda observation: env.action_space.sample(), "mixo/random-v0")
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from mixo_env.errors import ConfigurationError


def write_minari(
    env: gym.Env[Any, Any],
    act: Callable[[Any], Any],
    dataset_id: str,
    *,
    episodes: int | None = None,
    seed: int = 0,
    algorithm: str = "",
    author: str = "unknown",
) -> Any:
    """Play episodes and store them in the local Minari collection (``MINARI_DATASETS_PATH``).

    Args:
        env: a single environment made by ``gymnasium.make`` from plain options (its specification is stored).
        act: observation -> action. The weights of a policy of this package are actions of ``weights="raw"`` times
            ``raw_scale``.
        dataset_id: e.g. ``"mixo/linear-v0"``.
        episodes: how many; default: one for every scene that can be played.
        seed: of the first reset; later ones go on from there.
        algorithm: name of the policy.
        author: of the dataset.

    Returns:
        The Minari dataset.

    Raises:
        ConfigurationError: when Minari is not installed, or the environment has no specification to store.
    """
    try:
        import minari  # pyright: ignore[reportMissingImports]
        from minari.data_collector import EpisodeBuffer  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ConfigurationError(
            f"Minari export: {error.name} is missing: pip install 'mixo-env[integrations]'"
        ) from None
    if env.spec is None:
        raise ConfigurationError("Minari export: expected an environment made by gymnasium.make, got one without spec")
    if episodes is None:
        episodes = len(env.unwrapped.session.recordings)  # type: ignore[attr-defined]
    buffers = [EpisodeBuffer(id=i, **played(env, act, seed if i == 0 else None)) for i in range(episodes)]
    return minari.create_dataset_from_buffers(
        dataset_id=dataset_id,
        buffer=buffers,
        env=env.spec,
        algorithm_name=algorithm,
        author=author,
        description=f"Episodes of {env.spec.id}, options {env.spec.kwargs}",
        requirements=["mixo-env"],
    )


def played(env: gym.Env[Any, Any], act: Callable[[Any], Any], seed: int | None) -> dict[str, Any]:
    """One episode, by the names of Minari's ``EpisodeBuffer``."""
    observation, info = env.reset(seed=seed)
    observations, actions, rewards, ends = [observation], [], [], []
    while not ends or not ends[-1]:
        action = act(observation)
        observation, reward, _, truncated, info = env.step(action)
        observations.append(observation)
        actions.append(action)
        rewards.append(reward)
        ends.append(truncated)
    return {
        "seed": seed,
        "options": {"scene": info["scores"]["scene"]},
        "observations": stacked(observations),
        "actions": actions,
        "rewards": rewards,
        "terminations": [False] * len(ends),
        "truncations": ends,
        "infos": {},
    }


def stacked(observations: list[Any]) -> Any:
    """Observations of one episode as arrays over time."""
    if isinstance(observations[0], dict):
        return {name: np.stack([observation[name] for observation in observations]) for name in observations[0]}
    return np.stack(observations)
