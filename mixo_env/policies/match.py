"""HIGHEST MATCH: follow the camera that matched most features (PAPER.md, baselines)."""

from __future__ import annotations

import numpy as np

from mixo_env.errors import PolicyError
from mixo_env.policies.policy import Observation, Policy, Weights


class HighestMatch(Policy):
    """All weight on the camera with most matches among those that delivered an increment.

    An imported odometry with match counts counts as a camera. When none delivered, the first one is chosen: all of them
    then hold the same substitute.
    """

    name = "HIGHEST MATCH"

    def act(self, observation: Observation) -> Weights:
        """One-hot rows ``(batch, experts)``; the earlier camera wins a tie.

        Raises:
            PolicyError: where no match counts are recorded.
        """
        matches = observation["matches"]
        if not matches.shape[1]:
            raise PolicyError(f"{self.name} needs match counts, and no expert here has any")
        available = observation["available"]
        best = np.argmax(matches * available[:, : matches.shape[1]], axis=1)
        return np.eye(available.shape[1])[best]
