"""Rewards: named terms whose sum is the reward of a step.

An error is measured in units of sigma_0, the robust spread of LINEAR's yaw error (docs/decisions.md), and capped at ten
of them, so that one wild increment does not drown a scene.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mixo_env.envs.replay import Replay
from mixo_env.envs.stepping import LINEAR_ERROR, TRUTH
from mixo_env.envs.tables import collect_votes, step_rows
from mixo_env.errors import ConfigurationError, unknown
from mixo_env.fusion import least_squares_weights, mix
from mixo_env.recordings.collection import Recordings

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

    def __init__(self, name: RewardName, replay: Replay, track: str, training: Recordings) -> None:
        """Prepare the reward of ``replay``; LINEAR, where needed, is fitted on ``training``."""
        if name not in TERMS:
            raise ConfigurationError(unknown("reward option", name, TERMS))
        self.code = list(TERMS).index(name)
        self.terms = TERMS[name]
        self.scale_rad = replay.recordings.manifest.reward_scale_rad.get(track, DEFAULT_SCALE_RAD)
        if name == "improvement":
            steps = step_rows(training)
            votes = collect_votes(training, steps, replay.experts, replay.cameras, track, replay.camera_increments)
            linear = least_squares_weights(votes.increments_rad, training["truth.yaw_increment_rad"][steps])
            replay.table[:, LINEAR_ERROR] = mix(linear, replay.votes.increments_rad) - replay.table[:, TRUTH]
