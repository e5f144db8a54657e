"""Options of `mixo score` and `mixo export`: how a policy from outside is read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from mixo_env.policies.outside import Reading


@dataclass(frozen=True)
class OutsideOptions:
    """How a saved folder, a function or a network is read."""

    fitted_on: str | None = None
    """Where a frozen policy was trained: none, train (folds 0 to 2), or a file with a scene or drive hash a line."""

    policy_class: str | None = None
    """module:Class or file.py:Class that wrote a saved folder. None: one of mixo's own or of an installed plug-in."""

    observation: Literal["paper", "rich", "dict"] = "paper"
    """What a function or network sees, as in gym.make."""

    weights: Literal["softmax", "simplex", "raw", "select"] = "softmax"
    """What its action means, as in gym.make."""

    raw_scale: float = 4.0
    """Factor of --weights raw."""

    vectorised: bool = False
    """The function takes all scenes at once."""

    algorithm: Literal["PPO", "A2C", "SAC", "TD3", "DQN"] | None = None
    """Of a zip. None: told from its tensors."""

    activation: Literal["tanh", "relu"] | None = None
    """Of a zip. None: as its plain text says, else the default of the algorithm."""

    statistics: Path | None = None
    """Of VecNormalize, as safetensors with mean and var; a pickled one is never opened."""

    def reading(self) -> Reading:
        """As the policies' reader takes them.

        Raises:
            ConfigurationError: for options that do not fit.
        """
        from mixo_env.policies.agent import Asking
        from mixo_env.policies.outside import Reading
        from mixo_env.policies.sb3 import Network

        return Reading(
            Asking(self.observation, self.weights, self.raw_scale, self.vectorised),
            Network(self.algorithm, self.activation, self.statistics),
            self.policy_class,
        )

    def declared(self) -> Iterable[str] | None:
        """The word of ``fitted_on``, or the lines of the file.

        Raises:
            ConfigurationError: for a file that cannot be read.
        """
        from mixo_env.errors import ConfigurationError

        if self.fitted_on in (None, "none", "train"):
            return self.fitted_on
        try:
            return Path(self.fitted_on).read_text(encoding="utf-8").split()
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                f"--fitted-on: expected none, train or a file of scenes, got {self.fitted_on!r} ({error})"
            ) from None

    def plain(self) -> dict[str, Any]:
        """The options as plain JSON values."""
        return {name: str(value) if isinstance(value, Path) else value for name, value in asdict(self).items()}
