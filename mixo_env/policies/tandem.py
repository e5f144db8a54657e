"""TANDEM: the mean of TOKEN and BIAS FILTER, the gate trained for its place beside the filter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.replay import Replay
from mixo_env.policies.bias_filter import BiasFilter
from mixo_env.policies.playing import play
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.token_gate import Token
from mixo_env.policies.tokens import UNIT_RAD
from mixo_env.recordings.collection import Recordings


class Tandem(Policy):
    """Half of every weight is TOKEN's, half BIAS FILTER's.

    One is a network that judges the moment, the other a model that remembers drifts: they err in different scenes. The
    gate learns in the loss of the fused heading of both, so that it sees to what the filter leaves; in scenes with
    experts that break, which the filter never saw, it learns alone. Share and epochs are chosen on inner folds; beside
    the filter it takes longer than TOKEN until the gate learns its training scenes by heart.
    """

    name = "TANDEM"
    learns = True

    def __init__(self, *, epochs: int = 40) -> None:
        """Set the training of the gate; all else is TOKEN's own."""
        self.epochs = epochs
        self._members: dict[str, Policy] = {"token": Token(epochs=epochs), "filter": BiasFilter()}

    def start(self, voters: tuple[str, ...]) -> None:  # type: ignore[override]
        """Take the voters."""
        super().start(voters)
        for member in self._members.values():
            member.start(voters)

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Fit the filter, then the gate beside it; same seed, same machine: same bits."""
        token, beside = self._members["token"], self._members["filter"]
        assert isinstance(token, Token)
        beside.fit(training, track)
        token.fit_beside(training, track, fused_increments(beside, training, track), seed=seed)
        self.experts = token.experts

    def reset(self, batch: int) -> None:
        """Both forget the past."""
        for member in self._members.values():
            member.reset(batch)

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        token, beside = (member.act(observation) for member in self._members.values())
        return 0.5 * (token + beside)

    def settings(self) -> dict[str, Any]:
        """Training of the gate."""
        return {"epochs": self.epochs}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Those of both."""
        return {f"{of}.{name}": value for of, one in self._members.items() for name, value in one.tensors().items()}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Those of both."""
        for member in self._members.values():
            member.experts = self.experts
        own = {of: member.shapes(inputs) or {} for of, member in self._members.items()}
        return {f"{of}.{name}": shape for of, shapes in own.items() for name, shape in shapes.items()}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take both back."""
        for of, member in self._members.items():
            member.experts = self.experts
            own = {name.removeprefix(f"{of}."): value for name, value in tensors.items() if name.startswith(f"{of}.")}
            member.restore(own)


def fused_increments(policy: Policy, recordings: Recordings, track: str) -> NDArray[np.float32]:
    """Yaw increments ``(scenes, steps)`` in UNIT_RAD that a fitted policy fuses; idle after the end of a scene."""
    replay = Replay(recordings, track=track, keep_trajectories=False)
    steps = [
        np.einsum("be,be,b->b", weights, look["yaw_rates"], look["dt"][:, 0]) / UNIT_RAD
        for _, look, weights in play(policy, replay)
    ]
    return np.stack(steps, axis=1).astype(np.float32)
