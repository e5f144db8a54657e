"""The protocol of every row of the leaderboard: look at an observation, return the experts' weights."""

from __future__ import annotations

import abc
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from mixo_env.recordings.collection import Recordings

Observation = dict[str, NDArray[np.float32]]
"""The environment's ``observation="dict"``, batched: every value is ``(batch, width)``."""

Weights = NDArray[np.float64]


class Policy(abc.ABC):
    """Decides, step by step and for a batch of scenes at once, how much each expert counts.

    Attributes:
        name: as printed in tables.
        privileged: whether the policy reads ground truth; its name then says so too. Only a privileged policy finds
            ``truth_yaw_rate`` in its observation.
        experts: the voters, in the order of the weights; set by :meth:`fit` or :meth:`load`.
    """

    name: ClassVar[str]
    privileged: ClassVar[bool] = False
    experts: tuple[str, ...]

    def fit(self, recordings: Recordings, track: str, *, seed: int = 0) -> None:
        """Learn from training scenes. The default only remembers the track's voters."""
        self.experts = recordings.voters(track)

    def reset(self, batch: int) -> None:
        """Forget the past: ``batch`` scenes start. Stateless policies inherit this and do nothing."""

    @abc.abstractmethod
    def act(self, observation: Observation) -> Weights:
        """Weights ``(batch, experts)`` for one step; eq. 3 sums weight x increment. They need not sum to one."""

    def save(self, folder: Path) -> None:
        """Write everything :meth:`load` needs into ``folder`` (safetensors + JSON, never pickled code)."""
        raise NotImplementedError(f"{type(self).__name__} has nothing to save")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote."""
        raise NotImplementedError(f"{cls.__name__} has nothing to load")
