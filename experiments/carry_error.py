"""What carrying costs: yaw increments brought from each camera's own image windows to the steps by its own rate.

Three questions, against noise-free truth: how far does the method miss when it is fed with exact increments, how much
error does it add to the increments that were recorded, and how far does it miss in the first step after a loss, where
the current rate has to stand in for the one before. At every image, and from key frame to key frame (2 Hz).

  python -m experiments.carry_error
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from experiments.studies import print_study
from mixo_env.errors import RecordingError
from mixo_env.geometry import MAD_TO_SIGMA
from mixo_env.recordings.carry import OwnWindows, carry, own_windows, scaled_to_step
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truth import exact_own_window_increments
from mixo_env.tables import Column, Table

FloatArray = NDArray[np.float64]

COLUMNS = {
    "tail": Column("tail", "ms", ".1f"),
    "own": Column("own error", "deg", ".4f"),
    "method": Column("method", "deg", ".4f"),
    "added": Column("added", "deg", ".4f"),
    "after loss": Column("after loss", "deg", ".4f"),
    "method 2 Hz": Column("method 2 Hz", "deg", ".4f"),
    "added 2 Hz": Column("added 2 Hz", "deg", ".4f"),
    "error / std": Column("error / std", "", ".2f"),
    "error / std 2 Hz": Column("error / std 2 Hz", "", ".2f"),
}

CAPTION = (
    "Root mean squares over all steps against noise-free truth. own error: of the recorded increments over their own "
    "windows; method: exact increments, carried; added: recorded increments, carried, less their own error; after "
    "loss: exact increments whose rate before is unknown; error / std: robust, of what was recorded (1: the standard "
    "deviation is honest)."
)


@dataclass(frozen=True)
class CarryError:
    """Print the error of carrying by camera."""

    recordings: str = "mixocity"
    """A bundled recording or a folder; it must hold noise-free truth."""

    def run(self) -> Table:
        """Measure all cameras in the scenes of all folds (not at night)."""
        recordings = load_recordings(self.recordings).select(split="all")
        rows = [[camera, *carry_errors(recordings, camera).values()] for camera in recordings.manifest.cameras]
        return Table(CAPTION, (Column("camera"), *COLUMNS.values()), rows)


def carry_errors(recordings: Recordings, camera: str) -> dict[str, float]:
    """The numbers of COLUMNS for one camera.

    Raises:
        RecordingError: without noise-free truth.
    """
    parts: dict[str, list[FloatArray]] = {name: [] for name in COLUMNS}
    for i in range(len(recordings)):
        scene = recordings.rows(i)
        said = own_windows(scene, camera, camera)
        exact = replace(said, increment_rad=exact_own_window_increments(scene, camera))
        parts["tail"].append(said.tail_s)
        parts["own"].append(said.increment_rad - exact.increment_rad)
        every = np.arange(len(said.tail_s))
        for suffix, closing in (("", every), (" 2 Hz", np.flatnonzero(scene["is_keyframe"]))):
            true = np.diff(scene["exact.yaw_rad"][closing], prepend=np.nan)
            for name, values in _errors(said, exact, closing, true):
                parts[name + suffix].append(values)
        # The rule after a loss is that of the stateless increments: the own increment scaled to the step.
        alone = scaled_to_step(exact.increment_rad, exact.window_s, exact.tail_s)
        parts["after loss"].append(alone - np.diff(scene["exact.yaw_rad"], prepend=np.nan))
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    if not np.isfinite(joined["method"]).any():
        raise RecordingError("expected recordings with noise-free truth (a simulated folder), got none")
    numbers = {"tail": 1e3 * float(np.nanmedian(joined.pop("tail")))}
    for name, values in joined.items():
        if "std" in name:
            numbers[name] = MAD_TO_SIGMA * float(np.nanmedian(np.abs(values)))
        else:
            numbers[name] = float(np.degrees(np.sqrt(np.nanmean(np.square(values)))))
    return {name: numbers[name] for name in COLUMNS}


def _errors(
    said: OwnWindows, exact: OwnWindows, closing: NDArray[np.int64], true: FloatArray
) -> Iterator[tuple[str, FloatArray]]:
    """Name -> ``(steps,)`` of the errors over the steps between the rows ``closing``."""
    own_error = np.cumsum(np.nan_to_num(said.increment_rad - exact.increment_rad))[closing]
    carried, std = carry(said, closing)
    yield "method", carry(exact, closing)[0] - true
    yield "added", carried - true - np.diff(own_error, prepend=np.nan)
    yield "error / std", np.divide(carried - true, std, out=np.full(len(std), np.nan), where=std > 0)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    return print_study(CarryError, arguments)


if __name__ == "__main__":
    sys.exit(main())
