"""A gate over what the votes are without their biases, as a filter predicts them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled_unchecked
from mixo_env.policies.bias_filter import BiasFilter
from mixo_env.policies.bias_steps import point_at
from mixo_env.policies.calibration import FloatArray
from mixo_env.policies.deepset import weigh
from mixo_env.policies.policy import Observation, Weights
from mixo_env.policies.token_gate import Token
from mixo_env.policies.tokens import Seen, past, read, tokenise
from mixo_env.recordings.collection import Recordings


class Debiased(Token):
    """TOKEN's network on y_i - (c_i + b_i) dt, with the biases that BIAS FILTER predicts before the step.

    The gate judges what noise is left, with the filter's own doubt in the place of a calibrated one; the sum it makes
    of the corrected votes is then mixed from the votes themselves, as the filter's estimate is.
    """

    any_experts = False

    def __init__(self, **training: Any) -> None:
        """Set the training, as TOKEN's."""
        super().__init__(**training)
        self.filter = BiasFilter()

    def start(self, voters: tuple[str, ...]) -> None:  # type: ignore[override]
        """Take the voters."""
        super().start(voters)
        self.filter.start(voters)

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Fit the filter, then the gate on what it leaves."""
        self.filter.fit(training, track)
        super().fit(training, track, seed=seed)

    def reset(self, batch: int) -> None:
        """Gate and filter forget the past."""
        super().reset(batch)
        self.filter.reset(batch)

    def see(self, observation: Observation) -> Seen:
        """What becomes tokens, once the filter has gone a step."""
        self.filter.act(observation)
        return past(read(observation, self.calibration), (self.filter.apart, self.filter.left))

    def act(self, observation: Observation) -> Weights:
        """Rows ``(batch, experts)`` that sum to one."""
        seen = self.see(observation)
        weights = weigh(self.network, tokenise(seen, self._memory), seen.voting)
        mix(observation, self.filter.apart, seen.voting, weights)
        return weights

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Those of the filter beside TOKEN's."""
        of_filter = {f"filter.{name}": value for name, value in self.filter.tensors().items()}
        return {**super().tensors(), **of_filter}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Those of the filter beside TOKEN's."""
        self.filter.experts = self.experts
        of_filter = {f"filter.{name}": shape for name, shape in self.filter.shapes(inputs).items()}
        return {**super().shapes(inputs), **of_filter}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take both back."""
        self.filter.experts = self.experts
        own = {name: value for name, value in tensors.items() if not name.startswith("filter.")}
        super().restore(own)
        self.filter.restore({name.removeprefix("filter."): tensors[name] for name in tensors.keys() - own.keys()})


def mix(observation: Observation, apart: FloatArray, voting: NDArray[np.bool_], weights: Weights) -> None:
    """Replace ``weights`` of corrected increments ``apart`` by such of the votes that come nearest to the same sum."""
    _mix(observation["yaw_rates"], observation["dt"], apart, voting, weights)


@compiled_unchecked
def _mix(
    rates: NDArray[np.float32],
    dt: NDArray[np.float32],
    apart: FloatArray,
    voting: NDArray[np.bool_],
    weights: FloatArray,
) -> None:
    """Write what :func:`mix` does."""
    batch, n = weights.shape
    votes, std = np.empty(n), np.empty(n)
    for b in range(batch):
        target = 0.0
        for e in range(n):
            target += weights[b, e] * apart[b, e] if voting[b, e] else 0.0
            votes[e] = np.float64(rates[b, e]) * dt[b, 0]
            std[e] = 0.0 if voting[b, e] else np.inf
        point_at(target, votes, std, weights[b])
