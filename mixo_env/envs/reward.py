"""Rewards: named terms whose sum is the reward of a step.

An error is measured in units of sigma_0, the robust spread of LINEAR's yaw error (docs/decisions.md), and capped at ten
of them, so that one wild increment does not drown a scene.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.replay import Replay
from mixo_env.envs.stepping import TRUTH
from mixo_env.fusion import least_squares_weights
from mixo_env.recordings.schema import Manifest

RewardName = Literal["squared", "abs", "improvement", "pose"]

TERMS: dict[str, tuple[str, ...]] = {
    "squared": ("reward_yaw",),
    "abs": ("reward_yaw",),
    "improvement": ("reward_yaw", "reward_linear"),
    "pose": ("reward_position",),
}
"""Reward option -> names of its terms."""

DEFAULT_SCALE_RAD = float(np.deg2rad(0.05))
"""sigma_0 of recordings without one in their manifest, e.g. imported ones."""


class Reward:
    """The reward of one environment option.

    Attributes:
        code: of the option, for the compiled loop.
        terms: names of the terms; they are the rows of a step's report after REPORT.
        scale_rad: sigma_0.
    """

    def __init__(self, name: RewardName, track: str, manifest: Manifest) -> None:
        """Look the option up, and sigma_0 of ``track``."""
        self.code = list(TERMS).index(name)
        self.terms = TERMS[name]
        self.scale_rad = manifest.reward_scale_rad.get(track, DEFAULT_SCALE_RAD)


def fit_linear(training: Replay) -> NDArray[np.float64]:
    """Weights ``(experts,)`` of LINEAR, the reference of ``"improvement"``, fitted on all steps of ``training``."""
    return least_squares_weights(training.votes.increments_rad, training.table[:, TRUTH])
