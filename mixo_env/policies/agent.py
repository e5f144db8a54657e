"""Agents of the environment as policies: a function of observations, played as it is.

What it sees and what its numbers mean are the options of ``MixoOdometry-v0``: ``observation`` and ``weights``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.actions import ActionRule, Weighting
from mixo_env.envs.observation import PAPER, RICH
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.policies.policy import Observation, Policy, Weights

Seen = Literal["paper", "rich", "dict"]
QUANTITIES = {"paper": PAPER, "rich": RICH, "dict": RICH}


@dataclass(frozen=True)
class Asking:
    """How an agent is asked.

    Attributes:
        observation: what it sees, as in ``gym.make``: flat float32 ``(width,)``, or name -> ``(width,)``.
        weights: what its action means, as in ``gym.make``.
        raw_scale: factor of ``weights="raw"``.
        vectorised: it takes all scenes at once: ``(scenes, width)`` -> ``(scenes, numbers)``.
    """

    observation: Seen = "paper"
    weights: Weighting = "softmax"
    raw_scale: float = 4.0
    vectorised: bool = False

    def __post_init__(self) -> None:
        """Check the names.

        Raises:
            ConfigurationError: for an observation or weighting that does not exist.
        """
        if self.observation not in QUANTITIES:
            raise ConfigurationError(
                f"observation: expected one of {', '.join(QUANTITIES)}, got {self.observation!r}: use one of them"
            )
        if self.weights not in ("softmax", "simplex", "raw", "select"):
            raise ConfigurationError(
                f"weights: expected one of softmax, simplex, raw, select, got {self.weights!r}: use one of them"
            )


class Agent(Policy):
    """A plain ``observation -> action`` function."""

    def __init__(self, function: Callable[[Any], Any], name: str, asking: Asking) -> None:
        """Play ``function`` under ``name``."""
        self.name = name
        self._function, self._asking = function, asking

    def act(self, observation: Observation) -> Weights:
        """Ask for every scene, or once for all, and turn the actions into weights as the environment does.

        Raises:
            PolicyError: when the function fails, or its action is none of the environment's.
        """
        names = [quantity.name for quantity in QUANTITIES[self._asking.observation]]
        named = {name: observation[name] for name in names}
        seen: Any = named if self._asking.observation == "dict" else np.concatenate(list(named.values()), axis=1)
        batch, experts = observation["yaw_rates"].shape
        rule = ActionRule(self._asking.weights, experts, self._asking.raw_scale)
        try:
            if self._asking.vectorised:
                actions = np.asarray(self._function(seen))
            else:
                one = isinstance(seen, dict)
                actions = np.stack(
                    [
                        np.asarray(self._function({k: v[i] for k, v in seen.items()} if one else seen[i]))
                        for i in range(batch)
                    ]
                )
        except Exception as error:
            raise PolicyError(
                f"{self.name} failed when asked ({type(error).__name__}: {error}): try it alone"
            ) from None
        try:
            numbers = rule.read(actions, batch)
            rule.complain(numbers)
        except ConfigurationError as error:
            raise PolicyError(f"{self.name}: {error}") from None
        return rule.weights(numbers, np.ones((batch, experts), dtype=np.bool_))


class Frozen(Policy):
    """A policy that was fitted elsewhere, played as it is; refused on the drives it was fitted on."""

    def __init__(self, policy: Policy, name: str, fitted_on: frozenset[str]) -> None:
        """Show ``policy`` as ``name``; ``fitted_on`` holds the hashes of its training drives."""
        self.name, self.fitted_on = name, fitted_on
        self.policy = policy
        self.privileged = bool(policy.privileged)  # type: ignore[misc]
        self.lag = int(policy.lag)  # type: ignore[misc]

    def weighted(self, voters: tuple[str, ...]) -> tuple[str, ...]:
        """As the policy itself."""
        return self.policy.weighted(voters)

    def start(self, voters: Any) -> None:
        """Keep the experts it was fitted for; one that learned nothing, or of no expert, takes those that vote."""
        if self.policy.any_experts or not self.policy.experts:
            self.policy.start(voters)
        self.experts = self.policy.experts

    def reset(self, batch: int) -> None:
        """Forget the past."""
        self.policy.reset(batch)

    def preview(self, observation: Observation, active: NDArray[np.bool_]) -> None:
        """Show it the future, if it asks for it."""
        self.policy.preview(observation, active)

    def act(self, observation: Observation) -> Weights:
        """Its weights."""
        return self.policy.act(observation)

    def tensors(self) -> dict[str, Any]:
        """What was learned; it must then say where."""
        return self.policy.tensors()
