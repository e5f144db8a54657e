"""The protocol of every row of the leaderboard: look at an observation, return the experts' weights."""

from __future__ import annotations

import abc
from collections.abc import Mapping, Sequence
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

    :func:`~mixo_env.policies.fitting.prepare` hands a policy the names of the voters (:meth:`start`) and, if it learns,
    training scenes (:meth:`fit`); then it sees one observation after the other (:meth:`act`). Nothing it is given leads
    to the truth of a tested scene.

    Attributes:
        name: as printed in tables.
        privileged: whether the policy reads ground truth or the future; its name then says so too. Only a privileged
            policy finds ``truth_yaw_rate`` in its observation.
        learns: whether it is fitted on training scenes, anew for every fold. :meth:`fit` of others is never called.
        any_experts: what it learned names no expert, so it plays with others than those it was fitted with.
        lag: steps of the future that it sees; where it is not 0 the policy is privileged, and its name says so.
        only_track: too slow for all tracks: it has a row in this one alone; "": in all.
        expensive: too slow to fit for every fold; it is then tested on the last one only, and compared there.
        experts: those it weights, in the order of the weights; set by :meth:`start` or :meth:`load`.
        fitted_on: hashes of the drives it was fitted on, where it is refused; set by
            :func:`~mixo_env.policies.fitting.prepare` or :meth:`load`.
    """

    name: str
    privileged: ClassVar[bool] = False
    learns: ClassVar[bool] = False
    any_experts: ClassVar[bool] = False
    lag: ClassVar[int] = 0
    only_track: ClassVar[str] = ""
    expensive: ClassVar[bool] = False
    experts: tuple[str, ...] = ()
    fitted_on: frozenset[str] = frozenset()

    @property
    def sees(self) -> str:
        """Of an agent trained in the environment, which of its observations it is shown; "" for all others."""
        return ""

    def weighted(self, voters: tuple[str, ...]) -> tuple[str, ...]:
        """The experts this policy weights where ``voters`` vote, in order: just these, unless it adds a reference."""
        return voters

    def start(self, voters: Sequence[str]) -> None:
        """Take the names of the voters; all that a policy which does not learn is ever told."""
        self.experts = self.weighted(tuple(voters))

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Learn from training scenes. Policies that learn extend this, which only starts them."""
        self.start(training.voters(track))

    def reset(self, batch: int) -> None:
        """Forget the past: ``batch`` scenes start. Called before :meth:`act`; stateless policies do nothing."""

    def preview(self, observation: Observation, active: NDArray[np.bool_]) -> None:
        """See a step ``lag`` steps before it is decided, where scenes are still ``active``; not called if that is 0."""

    @abc.abstractmethod
    def act(self, observation: Observation) -> Weights:
        """Weights ``(batch, experts)`` for one step; eq. 3 sums weight x increment. They need not sum to one."""

    def settings(self) -> dict[str, Any]:
        """Keyword arguments (plain JSON values) that construct an equal, unfitted policy."""
        return {}

    def tensors(self) -> dict[str, NDArray[Any]]:
        """What :meth:`fit` learned, by name."""
        return {}

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]] | None:
        """Shapes of :meth:`tensors`, by name; ``None``: :meth:`load` does not check them, :meth:`restore` may.

        Args:
            inputs: length of the tensor ``mean``, for a policy that standardises what it sees.
        """
        return {} if type(self).tensors is Policy.tensors else None

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take back what :meth:`tensors` gave; ``settings`` and ``experts`` are in place, and all shapes fit.

        Raises:
            ValueError: for values that cannot be.
        """
        if tensors:
            raise ValueError("it has tensors, but no `restore` that takes them back")

    def save(self, folder: Path) -> None:
        """Write everything :meth:`load` needs into ``folder`` (safetensors + JSON, never pickled code)."""
        kind = type(self)
        stranger = kind.__module__.partition(".")[0] != __name__.partition(".")[0]
        description = {
            "policy": self.name,
            "experts": list(self.experts),
            "settings": self.settings(),
            "fitted_on": sorted(self.fitted_on),
        } | ({"kind": f"{kind.__module__}:{kind.__qualname__}"} if stranger else {})
        storage.write(folder, description, self.tensors())

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote.

        Raises:
            PolicyError: when the file is missing or broken, or holds another policy.
        """
        description, tensors = storage.read(folder)
        try:
            policy = cls(**description.settings)
            if policy.name != description.policy:
                raise PolicyError(f"expected {policy.name} in {folder}, got {description.policy}: load it as that")
            policy.experts, policy.fitted_on = description.experts, description.fitted_on
            found = {name: value.shape for name, value in tensors.items()}
            expected = policy.shapes(found.get("mean", (0,))[0] if found.get("mean") else 0)
            if expected is not None and found != expected:
                raise ValueError(f"expected tensors {expected}, got {found}")
            policy.restore(tensors)
        except PolicyError:
            raise
        except Exception as error:  # a stranger's class may raise anything
            reason = storage.one_line(error)
            raise PolicyError(f"{folder} does not fit {cls.__name__} ({reason}): save the policy anew") from None
        return policy
