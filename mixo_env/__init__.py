"""MixoOdometry: a Gymnasium benchmark of mixture-of-experts visual odometry for multi-camera cars.

Importing the package registers the environments, so that ``gymnasium.make("mixo_env:MixoOdometry-v0")`` finds them.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import Any

import gymnasium

__version__ = version("mixo-env")

ENVIRONMENTS = {
    "MixoOdometry-v0": "mixo_env.envs.odometry:MixoOdometry",
    "MixoOdometryBudget-v0": "mixo_env.envs.budget:MixoOdometryBudget",
}
"""Id -> module and name of its two classes, less their endings ``Env`` and ``VectorEnv``."""

for _id, _entry_point in ENVIRONMENTS.items():
    if _id not in gymnasium.registry:
        gymnasium.register(_id, entry_point=f"{_entry_point}Env", vector_entry_point=f"{_entry_point}VectorEnv")


def score(policy: Any, recordings: Any = None, track: str = "VISION", **options: Any) -> Any:
    """Score a policy from outside: see :func:`mixo_env.leaderboard.stranger.score`, imported when it is needed.

    By name, because compiled code is kept by what its modules import, and every module imports this one.
    """
    return import_module("mixo_env.leaderboard.stranger").score(policy, recordings, track, **options)
