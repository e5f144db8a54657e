"""A policy of one's own on the leaderboard: `python own_policy.py`, or `mixo score own_policy:Surest`."""

import mixo_env
from mixo_env.policies.policy import Policy


class Surest(Policy):
    """Cameras count by how sure they are of themselves (inverse variance)."""

    name = "SUREST"

    def act(self, observation):
        """Weights of a batch of scenes."""
        precision = 1.0 / observation["yaw_rate_std"].clip(1e-3) ** 2
        return precision / precision.sum(axis=1, keepdims=True)


if __name__ == "__main__":
    print("\n".join(mixo_env.score(Surest, folds=[3]).lines()))
