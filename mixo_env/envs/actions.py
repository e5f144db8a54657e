"""From an action to the experts' weights: the border where every wrong action gets its line."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mixo_env.envs.stepping import LARGEST_EXPONENT
from mixo_env.errors import ConfigurationError
from mixo_env.fusion import project_to_simplex

Weighting = Literal["softmax", "simplex", "raw", "select"]

LOGIT_SCALE = LARGEST_EXPONENT
"""``weights="softmax"``: logits = 5 x action, so that one expert can outweigh another by e^10."""


class ActionRule:
    """How actions become the scores that the fusion core mixes with.

    Attributes:
        space: of one environment: Box(-1, 1, (experts + switches,)) or Discrete(experts).
        scale: factor on the numbers of :meth:`read`.
        exponential: the scores are e to the scaled numbers.
        shares: the scores are normalised over the experts that vote (all rules but ``"raw"``).
    """

    def __init__(self, weights: Weighting, experts: int, raw_scale: float, switches: int = 0) -> None:
        """Prepare the rule for ``experts`` weights, followed by ``switches`` further numbers in the same Box."""
        self.space: spaces.Discrete[np.int64] | spaces.Box
        if weights == "select":
            self.space = spaces.Discrete(experts)
        else:
            self.space = spaces.Box(-1.0, 1.0, (experts + switches,), dtype=np.float32)
        self.scale = {"softmax": LOGIT_SCALE, "raw": float(raw_scale)}.get(weights, 1.0)
        self.exponential = weights == "softmax"
        self.shares = weights != "raw"
        self._shape = (experts + switches,) if weights != "select" else ()
        self._weights = weights
        self._experts = experts
        self._kinds = "iu" if weights == "select" else "f"

    def read(self, actions: Any, batch: int | None) -> NDArray[np.float32]:
        """The numbers ``(batch, width)`` behind checked actions; projected (``"simplex"``) or one-hot (``"select"``).

        Args:
            actions: ``(batch, *space.shape)``.
            batch: number of environments; ``None``: one action of a single environment, without the batch axis.

        Raises:
            ConfigurationError: for a wrong shape or dtype; see :meth:`complain` for the rest.
        """
        given = np.asarray(actions)
        shape = self._shape if batch is None else (batch, *self._shape)
        if given.shape != shape:
            raise ConfigurationError(f"action: expected shape {shape}, got {given.shape}: see action_space")
        if given.dtype.kind not in self._kinds:
            raise ConfigurationError(f"action: expected dtype {self.space.dtype}, got {given.dtype}: convert it first")
        if self._weights == "select":
            return self._one_hot(given.reshape(-1))
        numbers = np.array(given, np.float32, ndmin=2, order="C", copy=None)
        if self._weights == "simplex":
            self.complain(numbers)
            shares = project_to_simplex(numbers[:, : self._experts])
            return np.concatenate([shares, numbers[:, self._experts :]], axis=1).astype(np.float32)
        return numbers

    def weights(self, numbers: NDArray[np.float32], votes: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Weights ``(batch, experts)`` that :meth:`read` numbers amount to, for those who want to see them.

        Args:
            numbers: ``(batch, width)``.
            votes: ``(batch, experts)``: which experts vote; the others weigh nothing.
        """
        scores = self.scale * numbers[:, : self._experts].astype(np.float64)
        if self.exponential:
            scores = np.exp(scores)
        scores = np.where(votes, scores, 0.0)
        if not self.shares:
            return scores
        total = scores.sum(axis=-1, keepdims=True)
        return np.where(total > 0.0, scores, votes) / np.where(
            total > 0.0, total, np.maximum(votes.sum(-1, keepdims=True), 1)
        )

    def complain(self, numbers: NDArray[np.float32]) -> None:
        """Raise :class:`ConfigurationError` about the first of ``numbers`` that is not in [-1, 1], if there is one."""
        wrong = numbers[~(np.abs(numbers) <= 1.0)]
        if wrong.size:
            raise ConfigurationError(f"action: expected numbers in [-1, 1], got {wrong[0]}: clip or rescale the action")

    def _one_hot(self, choice: NDArray[np.integer]) -> NDArray[np.float32]:
        wrong = choice[(choice < 0) | (choice >= self._experts)]
        if wrong.size:
            raise ConfigurationError(f"action: expected an expert's number in 0..{self._experts - 1}, got {wrong[0]}")
        numbers = np.zeros((len(choice), self._experts), np.float32)
        numbers[np.arange(len(choice)), choice] = 1.0
        return numbers
