"""HIGHEST MATCH: follow the camera that matched most features (PAPER.md, baselines)."""

from __future__ import annotations

import numpy as np

from mixo_env.policies.policy import Observation, Policy, Weights


class HighestMatch(Policy):
    """All weight on the camera with most matches among those that delivered an increment.

    When none did, the first camera is chosen: every camera then holds the same inertial substitute.
    """

    name = "HIGHEST MATCH"

    def act(self, observation: Observation) -> Weights:
        """One-hot rows ``(batch, experts)``; the earlier camera wins a tie."""
        matches = observation["matches"]
        available = observation["available"]
        best = np.argmax(matches * available[:, : matches.shape[1]], axis=1)
        return np.eye(available.shape[1])[best]
