"""PPO, A2C, SAC, TD3, DQN: gates trained by reinforcement learning on the environment, with Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.actions import LOGIT_SCALE, Weighting
from mixo_env.envs.reward import TERMS, RewardName
from mixo_env.envs.wrappers import Standardise
from mixo_env.errors import ConfigurationError, PolicyError, unknown
from mixo_env.fusion import softmax
from mixo_env.policies.agent import QUANTITIES, Seen
from mixo_env.policies.linear import Linear
from mixo_env.policies.networks import KINDS, Algorithm, Layers, actor_layers, deterministic_action
from mixo_env.policies.playing import collect
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.storage import check_inputs, finite, one_line, positive
from mixo_env.recordings.collection import Recordings


@dataclass(frozen=True)
class Recipe:
    """How an agent is trained; plain values that JSON can hold.

    Attributes:
        steps: of the environment in all.
        gamma: discount.
        environments: copies played at once.
        observation: what the agent sees, as in ``gym.make``: "paper" or "rich".
        standardised: it sees that standardised and clipped; else as it is.
        reward: as in ``gym.make``.
        hidden: widths of the layers.
        settings: keyword arguments of the algorithm; the rest are SB3's defaults. A number as ``action_noise`` is the
            standard deviation of normal noise.
        network: further ``policy_kwargs``.
    """

    steps: int = 61_440
    gamma: float = 0.0
    environments: int = 64
    observation: Seen = "rich"
    standardised: bool = True
    reward: RewardName = "squared"
    hidden: tuple[int, ...] = (64, 64)
    settings: dict[str, Any] = field(default_factory=dict)
    network: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check what SB3 would not say in one line.

        Raises:
            ConfigurationError: for a number out of range, or an unknown observation or reward.
        """
        for name in ("steps", "environments"):
            if getattr(self, name) < 1:
                raise ConfigurationError(f"{name}: expected 1 or more, got {getattr(self, name)}: leave it out")
        if not 0.0 <= self.gamma <= 1.0:
            raise ConfigurationError(f"gamma: expected a discount from 0 to 1, got {self.gamma}: 0 suits this task")
        if self.observation not in ("paper", "rich"):
            raise ConfigurationError(f"observation: expected paper or rich, got {self.observation!r}: choose one")
        if self.reward not in TERMS:
            raise ConfigurationError(unknown("reward", self.reward, TERMS))


class Reinforced(Policy):
    """An agent of Stable-Baselines3; softmax weights, or (DQN) one expert alone.

    Weighting experts is nearly a contextual bandit: an action moves the fused pose, but what the experts say next does
    not depend on it. Hence gamma = 0, the largest lever of all settings here; many environments and few, large batches
    are the next. Observations are standardised with frozen statistics of what LINEAR sees on the training scenes, and
    clipped at 10 standard deviations.

    The trained actor is kept as plain matrices: using or loading it needs neither torch nor Stable-Baselines3.

    Attributes:
        algorithm: of Stable-Baselines3.
        usual: the recipe, unless told otherwise.
        recipe: that of this agent.
    """

    learns = True
    algorithm: ClassVar[Algorithm]
    usual: ClassVar[Recipe]
    watch: Callable[[Standardise], Any] | None = None
    """Makes a callback of Stable-Baselines3 that looks on, of how observations are standardised."""

    def __init__(self, **changes: Any) -> None:
        """Change fields of the usual recipe; ``settings`` and ``network`` are added to it."""
        usual = self.usual
        for name in ("settings", "network"):
            changes[name] = getattr(usual, name) | changes.get(name, {})
        changes["hidden"] = tuple(changes.get("hidden", usual.hidden))
        self.recipe = replace(usual, **changes)

    @property
    def sees(self) -> str:
        """The environment's observation that it is shown."""
        return self.recipe.observation

    @property
    def weights(self) -> Weighting:
        """What its actions mean, as in ``gym.make``."""
        return "select" if KINDS[self.algorithm].discrete else "softmax"

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Train on all scenes of ``training``; same seed, same machine: same bits.

        Raises:
            RecordingError: for a reward that is no number.
            PolicyError: when the training goes astray.
        """
        import torch

        super().fit(training, track)
        self.standardise_by(training, track)
        with torch.random.fork_rng(devices=[]):
            model = self.model(self.environment(training, track), seed)
            try:
                model.learn(self.recipe.steps, callback=self.watch and self.watch(self._standardise))
            except ValueError as error:  # torch on a network that has become NaN
                raise PolicyError(
                    f"{self.name}: training went astray ({one_line(error)}): lower its learning_rate"
                ) from None
        self.take(model)

    def standardise_by(self, training: Recordings, track: str) -> None:
        """Take statistics of what LINEAR sees on these scenes."""
        linear = Linear()
        linear.fit(training, track)
        found = Standardise.fit(flat(collect(training, track, linear), self.recipe.observation))
        self._standardise = self._shown(found.mean, found.std)

    def standardise_flat(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """What the network is given for flat observations ``(batch, width)``."""
        return self._standardise(check_inputs(self.name, seen, self._standardise.mean))

    def _shown(self, mean: NDArray[np.float32], std: NDArray[np.float32]) -> Standardise:
        if self.recipe.standardised:
            return Standardise(mean, std)
        return Standardise(np.zeros_like(mean), np.ones_like(std), clip=np.inf)

    def environment(self, training: Recordings, track: str, kind: Any = None) -> Any:
        """What it is trained in: a :class:`~mixo_env.envs.sb3.MixoVecEnv`, or a ``kind`` of it."""
        from mixo_env.envs.sb3 import MixoVecEnv

        return (kind or MixoVecEnv)(
            num_envs=self.recipe.environments,
            transform=self._standardise,
            recordings=training,
            track=track,
            split="all",
            observation=self.recipe.observation,
            reward=self.recipe.reward,
            weights=self.weights,
        )

    def model(self, environment: Any, seed: int) -> Any:
        """The untrained model of Stable-Baselines3, on one thread of torch."""
        import stable_baselines3
        import torch
        from stable_baselines3.common.noise import NormalActionNoise

        torch.set_num_threads(1)
        settings, recipe = dict(self.recipe.settings), self.recipe
        if "action_noise" in settings:
            none = np.zeros(environment.action_space.shape)
            settings["action_noise"] = NormalActionNoise(none, none + settings["action_noise"])
        return getattr(stable_baselines3, self.algorithm)(
            "MlpPolicy",
            environment,
            gamma=recipe.gamma,
            policy_kwargs={"net_arch": list(recipe.hidden), **recipe.network},
            seed=seed,
            device="cpu",
            **settings,
        )

    def take(self, model: Any) -> None:
        """Keep the actor of a model as it stands.

        Raises:
            PolicyError: when its weights are not finite.
        """
        self._layers: Layers = actor_layers(self.algorithm, model.policy)
        if not all(np.isfinite(values).all() for layer in self._layers for values in layer):
            raise PolicyError(f"{self.name}: training ended with weights that are not finite: lower its learning_rate")

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` of the actor's deterministic action."""
        seen = self.standardise_flat(flat(observation, self.recipe.observation))
        kind = KINDS[self.algorithm]
        action = deterministic_action(kind, self._layers, seen)
        return np.eye(len(self.experts))[action] if kind.discrete else softmax(LOGIT_SCALE * action)

    def settings(self) -> dict[str, Any]:
        """The recipe."""
        return asdict(self.recipe) | {"hidden": list(self.recipe.hidden)}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Standardisation and actor."""
        weights = {f"weight.{i}": weight for i, (weight, _) in enumerate(self._layers)}
        biases = {f"bias.{i}": bias for i, (_, bias) in enumerate(self._layers)}
        return {"mean": self._standardise.mean, "std": self._standardise.std, **weights, **biases}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Standardisation and the dense layers of the actor."""
        widths = (inputs, *self.recipe.hidden, len(self.experts))
        dense = [((f"weight.{i}", (n, m)), (f"bias.{i}", (n,))) for i, (m, n) in enumerate(pairwise(widths))]
        return {"mean": (inputs,), "std": (inputs,), **dict(pair for layer in dense for pair in layer)}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back standardisation and actor."""
        values = {name: finite(name, value).astype(np.float32) for name, value in tensors.items()}
        self._standardise = self._shown(values["mean"], positive("std", values["std"]))
        self._layers = [(values[f"weight.{i}"], values[f"bias.{i}"]) for i in range(len(self.recipe.hidden) + 1)]


def flat(observation: Observation, seen: Seen = "rich") -> NDArray[np.float32]:
    """What the environment shows as ``observation=seen``, ``(batch, width)``."""
    return np.concatenate([observation[quantity.name] for quantity in QUANTITIES[seen]], axis=1)


class PPO(Reinforced):
    """Proximal policy optimisation (Schulman et al. 2017).

    Exploration begins with a standard deviation of e^-1: logits are 5 x action, so that SB3's 1 mostly tries weights
    that no good policy has.
    """

    name = algorithm = "PPO"
    usual = Recipe(
        settings={"n_steps": 64, "batch_size": 1024, "n_epochs": 10, "learning_rate": 1e-3},
        network={"log_std_init": -1.0},
    )


class A2C(Reinforced):
    """Advantage actor-critic (Mnih et al. 2016), with all actors in step."""

    name = algorithm = "A2C"
    only_track = "CONSUMER"
    expensive = True
    usual = Recipe(steps=245_760, settings={"n_steps": 16, "learning_rate": 1e-3}, network={"log_std_init": -1.0})


OFF_POLICY = {
    "train_freq": 1,
    "gradient_steps": 4,
    "batch_size": 256,
    "learning_rate": 1e-3,
    "learning_starts": 4096,
    "buffer_size": 65_536,
}
"""64 environments write 64 steps between two rounds of 4 updates, so that an update costs more than its data."""


class SAC(Reinforced):
    """Soft actor-critic (Haarnoja et al. 2018); |error| as the reward, whose tails are lighter than the square's."""

    name = algorithm = "SAC"
    only_track = "CONSUMER"
    expensive = True
    usual = Recipe(steps=30_720, reward="abs", settings=OFF_POLICY)


class TD3(Reinforced):
    """Twin delayed deterministic policy gradient (Fujimoto et al. 2018), which explores by noise on its actions."""

    name = algorithm = "TD3"
    only_track = "CONSUMER"
    expensive = True
    usual = Recipe(steps=30_720, reward="abs", settings=OFF_POLICY | {"action_noise": 0.3})


class DQN(Reinforced):
    """Deep Q-learning (Mnih et al. 2015), which names one expert a step."""

    name = algorithm = "DQN"
    only_track = "CONSUMER"
    expensive = True
    usual = Recipe(steps=61_440, reward="abs", settings=OFF_POLICY)


AGENTS: dict[str, type[Reinforced]] = {agent.name: agent for agent in (PPO, A2C, SAC, TD3, DQN)}
"""By name, in the order of the tables."""
