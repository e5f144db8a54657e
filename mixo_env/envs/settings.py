"""The options of the environments: one frozen dataclass, checked once."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from mixo_env.envs.actions import Weighting
from mixo_env.envs.faults import Fault, inject, read_faults
from mixo_env.envs.opening import identity, shared_recordings
from mixo_env.envs.options import check_fields, check_names
from mixo_env.envs.replay import Lost, Previous
from mixo_env.envs.reward import RewardName
from mixo_env.errors import ConfigurationError
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.pose_lag import lag_corrected
from mixo_env.recordings.schema import SPLITS

ObservationName = Literal["paper", "rich", "dict", "pixels"]
Order = Literal["random", "fixed"]
Track = Literal["PAPER", "VISION", "CONSUMER", "UNEQUAL"]
Split = Literal["train", "test", "all", "ood"]


@dataclass(frozen=True)
class Settings:
    """Everything an environment can be asked for; the environments' docstrings explain each."""

    recordings: Recordings | str | Path | None = None
    track: Track = "CONSUMER"
    split: Split = "train"
    fold: int = 3
    conditions: Sequence[str] | None = None
    experts: Sequence[str] | None = None
    observation: ObservationName = "paper"
    privileged: bool = False
    weights: Weighting = "softmax"
    raw_scale: float = 4.0
    previous: Previous = "fused"
    lost: Lost = "inertial"
    reward: RewardName = "squared"
    order: Order = "random"
    faults: Sequence[Fault | dict[str, Any]] = ()
    dataroot: str | Path | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.raw_scale <= 0:
            raise ConfigurationError(f"raw_scale: expected a positive number, got {self.raw_scale!r}: e.g. 4.0")
        if self.observation == "pixels" and self.dataroot is None:
            raise ConfigurationError(
                "observation='pixels' needs the images: give dataroot=, the nuScenes folder recorded"
            )

    @classmethod
    def read(cls, options: dict[str, Any]) -> Settings:
        """Settings from keyword arguments; an unknown one is an error that names the nearest."""
        check_names(options, cls)
        return cls(**options)

    @property
    def key(self) -> Hashable:
        """Equal for settings that play the same: None for recordings in memory, which their owner may change."""
        if isinstance(self.recordings, Recordings):
            return None
        options = ((field.name, repr(getattr(self, field.name))) for field in fields(self))
        return type(self), identity(self.recordings), *options

    def all_recordings(self) -> Recordings:
        """The recordings before any choice among them; those from a folder are shared and read only."""
        return self.recordings if isinstance(self.recordings, Recordings) else shared_recordings(self.recordings)

    def open(self) -> tuple[Recordings, Recordings]:
        """The scenes to play and the scenes a reference may be fitted on, both with the faults asked for.

        The held-out ``fold`` is never fitted on, except where the recordings hold nothing else. The manifest's vehicle
        constants come from the split "train", so another held-out fold needs its own. Their pose lag is removed: the
        true poses of an environment, and with them its rewards, are those of the moment.

        Raises:
            ConfigurationError: for unknown names, or when no scene is left.
            RecordingError: when the recordings cannot be read.
        """
        recordings = self.all_recordings()
        present = sorted({scene.fold for scene in recordings.scenes})
        valid = sorted({*SPLITS["all"], *(fold for fold in present if fold >= 0)})
        if self.fold not in valid:
            raise ConfigurationError(f"fold: expected one of {tuple(valid)}, got {self.fold!r}: it is the one held out")
        others = [fold for fold in present if fold >= 0 and fold != self.fold]
        folds = {"train": others, "test": [self.fold], "all": [f for f in present if f >= 0], "ood": [-1]}[self.split]
        if self.fold not in SPLITS["test"]:
            from mixo_env.recordings.vehicles import with_training_constants

            recordings = with_training_constants(recordings, others)
        recordings = lag_corrected(recordings)
        faults = read_faults(self.faults)
        played = inject(recordings.select(folds=folds, conditions=self.conditions), faults)
        return played, inject(recordings.select(folds=others), faults) if others else played
