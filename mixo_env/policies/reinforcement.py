"""PPO: a gate trained by reinforcement learning on the environment, with Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.actions import LOGIT_SCALE
from mixo_env.envs.observation import RICH
from mixo_env.envs.wrappers import Standardise
from mixo_env.fusion import softmax
from mixo_env.policies.linear import Linear
from mixo_env.policies.playing import collect
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.storage import check_inputs, finite, positive
from mixo_env.recordings.collection import Recordings

Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


class PPO(Policy):
    """Proximal policy optimisation (Schulman et al. 2017) on the ``"rich"`` observation with softmax weights.

    Weighting experts is nearly a contextual bandit: an action moves the fused pose, but what the experts say next does
    not depend on it. Hence gamma = 0, the largest lever of all settings here; many environments and few, large batches
    are the next. Observations are standardised and clipped at 10 standard deviations.

    The trained actor is kept as plain matrices: using or loading it needs neither torch nor Stable-Baselines3.
    """

    name = "PPO"
    learns = True
    expensive = True
    watch: Callable[[Standardise], Any] | None = None
    """Makes a callback of Stable-Baselines3 that looks on, of how observations are standardised."""

    def __init__(
        self,
        *,
        steps: int = 61_440,
        gamma: float = 0.0,
        environments: int = 64,
        rollout: int = 64,
        batch: int = 1024,
        epochs: int = 10,
        learning_rate: float = 1e-3,
        log_std: float = -1.0,
        hidden: tuple[int, ...] = (64, 64),
    ) -> None:
        """Set the training.

        Args:
            steps: of the environment in all.
            gamma: discount.
            environments: copies played at once.
            rollout: steps of each between two updates.
            batch: size of a minibatch.
            epochs: passes over a roll-out.
            learning_rate: of Adam.
            log_std: logarithm of the standard deviation with which actions are explored at first. Logits are
                5 x action, so that SB3's 0 mostly tries weights that no good policy has.
            hidden: widths of the layers.
        """
        self.steps, self.gamma = steps, gamma
        self.environments, self.rollout = environments, rollout
        self.batch, self.epochs, self.learning_rate = batch, epochs, learning_rate
        self.log_std, self.hidden = log_std, tuple(hidden)

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Train on all scenes of ``training``; same seed, same machine: same bits."""
        import stable_baselines3
        import torch

        from mixo_env.envs.sb3 import MixoVecEnv

        super().fit(training, track)
        linear = Linear()
        linear.fit(training, track)
        self._standardise = Standardise.fit(flat(collect(training, track, linear)))
        environment = MixoVecEnv(
            num_envs=self.environments,
            transform=self._standardise,
            recordings=training,
            track=track,
            split="all",
            observation="rich",
        )
        torch.set_num_threads(1)
        with torch.random.fork_rng(devices=[]):
            model = stable_baselines3.PPO(
                "MlpPolicy",
                environment,
                gamma=self.gamma,
                n_steps=self.rollout,
                batch_size=self.batch,
                n_epochs=self.epochs,
                learning_rate=self.learning_rate,
                policy_kwargs={"net_arch": list(self.hidden), "log_std_init": self.log_std},
                seed=seed,
                device="cpu",
            )
            model.learn(self.steps, callback=self.watch and self.watch(self._standardise))
        self._layers = actor_layers(model.policy)

    def act(self, observation: Observation) -> Weights:
        """Softmax rows ``(batch, experts)`` of the actor's mean action."""
        seen = check_inputs(self.name, flat(observation), self._standardise.mean)
        action = mean_action(self._layers, self._standardise(seen))
        return softmax(LOGIT_SCALE * np.clip(action, -1.0, 1.0))

    def settings(self) -> dict[str, Any]:
        """Training settings."""
        names = ("steps", "gamma", "environments", "rollout", "batch", "epochs", "learning_rate", "log_std", "hidden")
        return {name: getattr(self, name) for name in names}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Standardisation and actor."""
        weights = {f"weight.{i}": weight for i, (weight, _) in enumerate(self._layers)}
        biases = {f"bias.{i}": bias for i, (_, bias) in enumerate(self._layers)}
        return {"mean": self._standardise.mean, "std": self._standardise.std, **weights, **biases}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Standardisation and the dense layers of the actor."""
        widths = (inputs, *self.hidden, len(self.experts))
        dense = [((f"weight.{i}", (n, m)), (f"bias.{i}", (n,))) for i, (m, n) in enumerate(pairwise(widths))]
        return {"mean": (inputs,), "std": (inputs,), **dict(pair for layer in dense for pair in layer)}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back standardisation and actor."""
        values = {name: finite(name, value).astype(np.float32) for name, value in tensors.items()}
        self._standardise = Standardise(values["mean"], positive("std", values["std"]))
        self._layers = [(values[f"weight.{i}"], values[f"bias.{i}"]) for i in range(len(self.hidden) + 1)]


def flat(observation: Observation) -> NDArray[np.float32]:
    """The ``"rich"`` observation ``(batch, width)``."""
    return np.concatenate([observation[quantity.name] for quantity in RICH], axis=1)


def actor_layers(policy: Any) -> Layers:
    """Weight and bias of every dense layer of a Stable-Baselines3 ``MlpPolicy``'s actor, in order."""
    from torch import nn

    dense = [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, nn.Linear)]
    return [(x.weight.detach().numpy().copy(), x.bias.detach().numpy().copy()) for x in (*dense, policy.action_net)]


def mean_action(layers: Layers, x: NDArray[np.float32]) -> NDArray[np.float32]:
    """What that actor's mean action is for ``x`` ``(batch, inputs)``: tanh between dense layers."""
    for weight, bias in layers[:-1]:
        x = np.tanh(x @ weight.T + bias)
    weight, bias = layers[-1]
    return x @ weight.T + bias
