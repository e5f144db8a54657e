"""TRIO: a gate over the votes, one over the votes without their biases, and the filter that tells those."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked
from mixo_env.policies.debiased import Debiased, mix
from mixo_env.policies.deepset import weigh
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.token_gate import Token
from mixo_env.policies.tokens import Room, blank_memory, look_twice
from mixo_env.recordings.collection import Recordings

SHARE = 0.4
"""Of each gate; the filter has the rest."""


class Trio(Policy):
    """Two fifths of every weight are a TOKEN's, two fifths a gate's over debiased votes, and one fifth BIAS FILTER's.

    Each learns alone, and so they err apart: a mean errs less than its members on average (Perrone and Cooper 1993).
    Both gates also learn from every scene in the opposite order of its steps. Shares and epochs: by inner folds.
    """

    name = "TRIO"
    learns = True

    def __init__(self, *, epochs: int = 20) -> None:
        """Set the training of the gates; all else is TOKEN's own."""
        self.epochs = epochs
        self._token = Token(epochs=epochs, backwards=True)
        self._debiased = Debiased(epochs=epochs, backwards=True)
        self._gates: dict[str, Token] = {"token": self._token, "debiased": self._debiased}

    def start(self, voters: tuple[str, ...]) -> None:  # type: ignore[override]
        """Take the voters."""
        super().start(voters)
        for gate in self._gates.values():
            gate.start(voters)

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Fit one after the other, each with a seed of its own; same seed, same machine: same bits."""
        super().fit(training, track)
        seeds = np.random.SeedSequence(seed).generate_state(len(self._gates))
        for gate, own in zip(self._gates.values(), seeds, strict=True):
            gate.fit(training, track, seed=int(own))

    def reset(self, batch: int) -> None:
        """All forget the past."""
        self._debiased.filter.reset(batch)
        size = batch, len(self.experts), len(self._gates)
        self._memory, self._room = blank_memory(*size), Room.blank(*size)
        self._votes, self._left = self._room.views(len(self._gates))

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        token, debiased, voting = self._token, self._debiased, self._room.voting
        alone = debiased.filter.act(observation)
        biases = debiased.filter.apart, debiased.filter.left
        look_twice(observation, token.calibration, biases, self._memory, self._room)
        without = weigh(debiased.network, self._left, voting)
        mix(observation, biases[0], voting, without)
        _average(weigh(token.network, self._votes, voting), without, alone)
        return alone

    def settings(self) -> dict[str, Any]:
        """Training of the gates."""
        return {"epochs": self.epochs}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Those of all."""
        return {f"{of}.{name}": value for of, gate in self._gates.items() for name, value in gate.tensors().items()}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Those of all."""
        for gate in self._gates.values():
            gate.experts = self.experts
        own = {of: gate.shapes(inputs) for of, gate in self._gates.items()}
        return {f"{of}.{name}": shape for of, shapes in own.items() for name, shape in shapes.items()}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take all back."""
        for of, gate in self._gates.items():
            gate.experts = self.experts
            own = {name.removeprefix(f"{of}."): value for name, value in tensors.items() if name.startswith(f"{of}.")}
            gate.restore(own)


@compiled_unchecked
def _average(token: Weights, without: Weights, alone: Weights) -> None:
    """Replace the filter's weights by the mean of all, each ``(batch, experts)``."""
    for b in range(len(alone)):
        for e in range(alone.shape[1]):
            alone[b, e] = SHARE * (token[b, e] + without[b, e]) + (1.0 - 2.0 * SHARE) * alone[b, e]
