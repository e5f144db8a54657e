"""What carrying costs: yaw increments brought from each camera's own image windows to the steps by its own rate.

Three questions, against noise-free truth: how far does the method miss when it is fed with exact increments, how much
error does it add to the increments that were recorded, and how far does it miss in the first step after a loss, where
the current rate has to stand in for the one before. At every image and from key frame to key frame (2 Hz).

  python -m experiments.carry_error
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import RecordingError
from mixo_env.recordings.carry import OwnWindows, carry, own_windows
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truth import exact_own_window_increments
from mixo_env.tables import Table

FloatArray = NDArray[np.float64]
Scene = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class CarryErrors:
    """Root mean squares over all steps of all scenes of one camera.

    Attributes:
        camera: name.
        tail_s: median time from its image to the end of the round.
        own_rad: error of its own increments over its own windows.
        method_rad: carried exact increments against exact steps.
        added_rad: error of carried recorded increments less that of the increments themselves.
        after_loss_rad: as ``method_rad``, with the rate before each step unknown.
        method_2hz_rad, added_2hz_rad: from key frame to key frame.
        score: error of the carried recorded increments over the standard deviation told, robust (1: honest).
        score_2hz: from key frame to key frame.
    """

    camera: str
    tail_s: float
    own_rad: float
    method_rad: float
    added_rad: float
    after_loss_rad: float
    method_2hz_rad: float
    added_2hz_rad: float
    score: float
    score_2hz: float


def carry_errors(recordings: Recordings, camera: str) -> CarryErrors:
    """Errors of carrying one camera.

    Raises:
        RecordingError: without noise-free truth.
    """
    parts: dict[str, list[FloatArray]] = {}
    for i in range(len(recordings)):
        scene = recordings.rows(i)
        said = own_windows(scene, camera, camera)
        exact = replace(said, increment_rad=exact_own_window_increments(scene, camera))
        parts.setdefault("tail_s", []).append(said.tail_s)
        parts.setdefault("own_rad", []).append(said.increment_rad - exact.increment_rad)
        for suffix, closing in (("", np.arange(len(said.tail_s))), ("_2hz", np.flatnonzero(scene["is_keyframe"]))):
            for name, values in _errors(scene, said, exact, closing):
                parts.setdefault(name + suffix, []).append(values)
        parts.setdefault("after_loss_rad", []).append(_without_the_rate_before(exact) - _true(scene))
    if not np.isfinite(np.concatenate(parts["method"])).any():
        raise RecordingError("expected recordings with noise-free truth (a simulated folder), got none")
    joined = {name: np.concatenate(values) for name, values in parts.items()}
    return CarryErrors(
        camera=camera,
        tail_s=float(np.nanmedian(joined["tail_s"])),
        own_rad=_rms(joined["own_rad"]),
        method_rad=_rms(joined["method"]),
        added_rad=_rms(joined["added"]),
        after_loss_rad=_rms(joined["after_loss_rad"]),
        method_2hz_rad=_rms(joined["method_2hz"]),
        added_2hz_rad=_rms(joined["added_2hz"]),
        score=1.4826 * float(np.nanmedian(np.abs(joined["score"]))),
        score_2hz=1.4826 * float(np.nanmedian(np.abs(joined["score_2hz"]))),
    )


def _errors(
    scene: Scene, said: OwnWindows, exact: OwnWindows, closing: NDArray[np.int64]
) -> Iterator[tuple[str, FloatArray]]:
    """Name -> ``(steps,)`` of the errors over the steps between the rows ``closing``."""
    true = np.diff(scene["exact.yaw_rad"][closing], prepend=np.nan)
    carried, std = carry(said, closing)
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(said.increment_rad - exact.increment_rad))])[closing + 1]
    yield "method", carry(exact, closing)[0] - true
    yield "added", carried - true - np.diff(total, prepend=np.nan)
    yield "score", (carried - true) / std


def _true(scene: Scene) -> FloatArray:
    return np.diff(scene["exact.yaw_rad"], prepend=np.nan)


def _without_the_rate_before(own: OwnWindows) -> FloatArray:
    """Carried increments ``(rows,)`` as if the camera had been LOST in the round before each."""
    carried = np.full(len(own.tail_s), np.nan)
    for parity in (0, 1):
        heard = np.arange(len(carried)) % 2 == parity
        increment = np.where(heard, own.increment_rad, np.nan)
        carried[heard] = carry(replace(own, increment_rad=increment))[0][heard]
    return carried


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


def table(errors: list[CarryErrors]) -> Table:
    """The errors of all cameras, in degrees."""
    raise NotImplementedError
