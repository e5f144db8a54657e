"""The protocol of every row of the leaderboard: look at an observation, return the experts' weights."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import PolicyError
from mixo_env.policies import storage
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
        learns: whether :meth:`fit` learns from the training scenes; only such policies are fitted anew for every fold.
        experts: the voters, in the order of the weights; set by :meth:`fit` or :meth:`load`.
    """

    name: str
    privileged: ClassVar[bool] = False
    learns: ClassVar[bool] = False
    experts: tuple[str, ...] = ()

    def voters(self, recordings: Recordings, track: str) -> tuple[str, ...]:
        """The experts this policy weights in ``track``, in order."""
        return recordings.voters(track)

    def fit(self, recordings: Recordings, track: str, *, seed: int = 0) -> None:
        """Learn from training scenes. The default only remembers the track's voters."""
        self.experts = self.voters(recordings, track)

    def check(self, recordings: Recordings, track: str) -> None:
        """Raise :class:`PolicyError` unless this policy was fitted for exactly these voters in this order."""
        expected = self.voters(recordings, track)
        if self.experts != expected:
            raise PolicyError(
                f"{self.name} was fitted for {', '.join(self.experts) or 'nothing yet'}, but track {track} of these "
                f"recordings has {', '.join(expected)}, in this order: fit it on recordings with these experts"
            )

    def reset(self, batch: int) -> None:
        """Forget the past: ``batch`` scenes start. Stateless policies inherit this and do nothing."""

    @abc.abstractmethod
    def act(self, observation: Observation) -> Weights:
        """Weights ``(batch, experts)`` for one step; eq. 3 sums weight x increment. They need not sum to one."""

    def settings(self) -> dict[str, Any]:
        """Keyword arguments (plain JSON values) that construct an equal, unfitted policy."""
        return {}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """What :meth:`fit` learned, by name."""
        return {}

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back what :meth:`tensors` gave; ``settings`` and ``experts`` are already in place."""

    def save(self, folder: Path) -> None:
        """Write everything :meth:`load` needs into ``folder`` (safetensors + JSON, never pickled code)."""
        description = {"policy": self.name, "experts": list(self.experts), "settings": self.settings()}
        storage.write(folder, description, self.tensors())

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote.

        Raises:
            PolicyError: when the file is missing or broken, or holds another policy.
        """
        description, tensors = storage.read(folder)
        try:
            policy = cls(**description["settings"])
            if policy.name != description["policy"]:
                raise PolicyError(f"expected {policy.name} in {folder}, got {description['policy']}: load it as that")
            policy.experts = tuple(description["experts"])
            policy.restore(tensors)
        except (TypeError, KeyError, ValueError, RuntimeError) as error:
            raise PolicyError(f"{folder} does not fit {cls.__name__} ({error}): save the policy anew") from None
        return policy
