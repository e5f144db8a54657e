"""`mixo score`: anyone's policy on the leaderboard."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro


@dataclass(frozen=True)
class Score:
    """Score your policy beside CAM_FRONT, LINEAR, HUBER and MIXO, with paired differences.

    Worked examples:

      mixo score my_policy:Mine                         a class of my_policy.py in this folder, fitted fold by fold
      mixo score my_policy.py:act --observation rich    a function of one observation
      mixo score saved/                                 a folder written by Policy.save
      mixo score ppo.zip --fitted-on train --folds 3    a network of Stable-Baselines3, never unpickled
    """

    interrupted: ClassVar[str] = "nothing was written: a table is computed in one go"

    policy: Annotated[str, tyro.conf.Positional]
    """module:Class, file.py:Class (or a function), a saved folder, a zip of Stable-Baselines3, or a row's name."""

    track: str = "VISION"
    """Who votes besides the cameras: PAPER, VISION or CONSUMER."""

    recordings: Path | None = None
    """Folder written by `mixo record`, or the name of a bundled recording. None: the bundled mixocity."""

    folds: tuple[int, ...] = ()
    """Score the scenes of these folds only. Empty: all."""

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

    seed: int = 0
    """Of everything random."""

    seeds: int = 1
    """Fits of every learned policy; its row is the mean of their errors."""

    out: Path | None = None
    """Folder for the results. None: nothing is written."""

    def run(self) -> int:
        """Print the row beside the others, and write it if asked."""
        from mixo_env.cli.progress import progress
        from mixo_env.files import writable_folder, write_json
        from mixo_env.leaderboard.report import print_leaderboard
        from mixo_env.leaderboard.stranger import BESIDE, Options, score
        from mixo_env.policies.agent import Asking
        from mixo_env.policies.sb3 import Network

        folder = self.out and writable_folder(self.out)
        begun = itertools.count()
        with progress("computing rows") as report:
            scored = score(
                self.policy,
                self.recordings,
                self.track,
                folds=self.folds,
                fitted_on=self._declared(),
                options=Options(
                    Asking(self.observation, self.weights, self.raw_scale, self.vectorised),
                    Network(self.algorithm, self.activation, self.statistics),
                    self.policy_class,
                    self.seed,
                    self.seeds,
                ),
                progress=lambda _: report(next(begun), len(BESIDE) + 1),
            )
        print_leaderboard(scored.board)
        for line in scored.difference_lines():
            print(line)
        if folder:
            write_json(folder / "score.json", scored.to_json() | {"configuration": self._plain()})
            print(f"Saved in {folder}: score.json")
        return 0

    def _declared(self) -> Iterable[str] | None:
        """The word, or the lines of the file."""
        from mixo_env.errors import ConfigurationError

        if self.fitted_on in (None, "none", "train"):
            return self.fitted_on
        try:
            return Path(self.fitted_on).read_text(encoding="utf-8").split()
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                f"--fitted-on: expected none, train or a file of scenes, got {self.fitted_on!r} ({error})"
            ) from None

    def _plain(self) -> dict[str, Any]:
        return {name: str(value) if isinstance(value, Path) else value for name, value in asdict(self).items()}
