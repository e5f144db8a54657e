"""One expert alone: every camera and every inertial grade."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.policies.policy import Observation, Policy, Weights


class Single(Policy):
    """All weight on one expert.

    An expert without a vote in the track (an inertial grade kept as reference line) is appended to the voters.
    """

    def __init__(self, expert: str) -> None:
        """Follow ``expert``, which also names the policy."""
        self.name = expert

    def weighted(self, voters: tuple[str, ...]) -> tuple[str, ...]:
        """The voters, then this expert if it is none of them."""
        return voters if self.name in voters else (*voters, self.name)

    def act(self, observation: Observation) -> Weights:
        """The same one-hot row for every scene."""
        weights = np.zeros(observation["yaw_rates"].shape)
        weights[:, self.experts.index(self.name)] = 1.0
        return weights

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Nothing was learned; its expert must be among those it weights."""
        if self.name not in self.experts:
            raise ValueError(f"{self.name} is not among its experts")

    def settings(self) -> dict[str, Any]:
        """The expert's name."""
        return {"expert": self.name}
