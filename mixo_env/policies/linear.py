"""LINEAR: constant weights that minimise the RMSE of the yaw increment on the training scenes (PAPER.md, baselines)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.fusion import least_squares_weights
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.storage import finite
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.substitutes import substituted_increments


class Linear(Policy):
    """Unconstrained least squares: the paper's printed weights sum to 1.037, so they are not forced to sum to one.

    Attributes:
        weights: ``(experts,)`` after :meth:`fit`.
    """

    name = "LINEAR"
    learns = True
    weights: Weights

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Solve for the weights; lost experts count with their inertial substitutes, as they will when scored."""
        super().fit(training, track)
        self.weights = least_squares_weights(*self._samples(training, track))

    def act(self, observation: Observation) -> Weights:
        """The same row for every scene and step."""
        return np.tile(self.weights, (len(observation["yaw_rates"]), 1))

    def _samples(self, training: Recordings, track: str) -> tuple[Weights, Weights]:
        """Increments ``(T, experts)`` and true increments ``(T,)`` of all steps."""
        increments, truth = substituted_increments(training, track), training["truth.yaw_increment_rad"]
        steps = np.isfinite(truth) & np.isfinite(increments).all(axis=1)  # not row 0 of a scene
        return increments[steps], truth[steps]

    def tensors(self) -> dict[str, NDArray[Any]]:
        """The weights."""
        return {"weights": self.weights}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """One weight an expert."""
        return {"weights": (len(self.experts),)}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back the weights."""
        self.weights = finite("weights", tensors["weights"])
