"""Actors of Stable-Baselines3's ``MlpPolicy`` as plain matrices: playing one needs neither torch nor SB3."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Algorithm = Literal["PPO", "A2C", "SAC", "TD3", "DQN"]
Activation = Literal["tanh", "relu"]
Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]
"""Weight ``(outputs, inputs)`` and bias ``(outputs,)`` of every dense layer."""


@dataclass(frozen=True)
class Kind:
    """Where an algorithm keeps its actor, and SB3's default activation.

    Attributes:
        hidden: prefix of the hidden layers (all layers if ``head`` is empty).
        head: name of the last layer.
        activation: SB3's default of its ``MlpPolicy``.
        squash: tanh after the last layer.
        discrete: the greatest output is the choice.
    """

    hidden: str
    head: str
    activation: Activation
    squash: bool = False
    discrete: bool = False


KINDS: dict[str, Kind] = {
    "PPO": Kind("mlp_extractor.policy_net.", "action_net", "tanh"),
    "A2C": Kind("mlp_extractor.policy_net.", "action_net", "tanh"),
    "SAC": Kind("actor.latent_pi.", "actor.mu", "relu", squash=True),
    "TD3": Kind("actor.mu.", "", "relu", squash=True),
    "DQN": Kind("q_net.q_net.", "", "relu", discrete=True),
}
"""As stable-baselines3 names the tensors of ``MlpPolicy``."""


def layer_names(kind: Kind, tensors: Iterable[str]) -> list[str]:
    """Names of the dense layers of the actor, in order, among those of all tensors."""
    pattern = re.compile(re.escape(kind.hidden) + r"(\d+)\.weight")
    numbers = sorted(int(found[1]) for name in tensors if (found := pattern.fullmatch(name)))
    return [f"{kind.hidden}{number}" for number in numbers] + ([kind.head] if kind.head else [])


def actor_layers(algorithm: Algorithm, policy: Any) -> Layers:
    """Copies of the dense layers of an ``MlpPolicy``'s actor, in order."""
    state = policy.state_dict()

    def values(name: str) -> NDArray[np.float32]:
        return state[name].detach().numpy().copy()

    return [(values(f"{name}.weight"), values(f"{name}.bias")) for name in layer_names(KINDS[algorithm], state)]


def deterministic_action(
    kind: Kind, layers: Layers, x: NDArray[np.float32], activation: Activation | None = None
) -> NDArray[Any]:
    """What ``model.predict(x, deterministic=True)`` gives for ``x`` ``(batch, inputs)``.

    Returns:
        ``(batch, numbers)`` in [-1, 1], or choices ``(batch,)`` of a discrete kind.
    """
    for weight, bias in layers[:-1]:
        x = x @ weight.T + bias
        x = np.tanh(x) if (activation or kind.activation) == "tanh" else np.maximum(x, 0.0)
    weight, bias = layers[-1]
    x = x @ weight.T + bias
    if kind.discrete:
        return np.argmax(x, axis=1)
    return np.tanh(x) if kind.squash else np.minimum(np.maximum(x, -1.0), 1.0)  # sooner done than np.clip
