"""What policies share that learn nothing but a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from numpy.typing import NDArray

from mixo_env.policies.calibration import Calibration, Past
from mixo_env.policies.policy import Policy
from mixo_env.recordings.collection import Recordings


class Calibrated(Policy):
    """A policy whose only learned numbers are the standard deviations of the experts' errors."""

    learns: ClassVar[bool] = True
    _calibration: Calibration

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        """Calibrate on the training scenes."""
        super().fit(training, track)
        self._calibration = Calibration.fit(Past.read(training, self.experts))

    def tensors(self) -> dict[str, NDArray[Any]]:
        """The calibration."""
        return self._calibration.tensors()

    def shapes(self, inputs: int) -> dict[str, tuple[int, ...]]:
        """Of the calibration."""
        return Calibration.shapes(len(self.experts))

    def restore(self, tensors: Mapping[str, NDArray[Any]]) -> None:
        """Take it back."""
        self._calibration = Calibration.restore(tensors)
