"""How unequal experts are: errors and lost tracks of every expert of a recording, against exact truth.

    mixo record city --out recorded --experts TUTORIAL JOINT
    python -m experiments.unequal_experts --recordings recorded

Per expert: share of steps with an increment, tracks lost per scene, and the error of one step's increment: median, RMS,
the least of the worst 5 %, and the largest; then the RMS and the worst 5 % of the steps in which the car moves.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.studies import exact_turn, print_study
from mixo_env.leaderboard.evaluation import lost_tracks
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.joint import JOINT
from mixo_env.recordings.presets import data_label
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.variants import as_variant
from mixo_env.tables import Cell, Column, Table

FloatArray = NDArray[np.float64]

MOVING_MPS = 0.5

COLUMNS = (
    Column("expert"),
    Column("tells", "%", ".1f"),
    Column("lost", "per scene", ".2f"),
    Column("median", "deg", ".4f"),
    Column("RMS", "deg", ".4f"),
    Column("worst 5 %", "deg", ".3f"),
    Column("largest", "deg", ".2f"),
    Column("moving: RMS", "deg", ".4f"),
    Column("moving: worst 5 %", "deg", ".3f"),
)


@dataclass(frozen=True)
class UnequalExpertsStudy:
    """Print errors and lost tracks of every expert."""

    recordings: Path | None = None
    """Folder of recordings of a simulated drive. None: the bundled mixocity."""

    def run(self) -> Table:
        """The table."""
        return study(load_recordings(None if self.recordings is None else str(self.recordings)))


def study(recordings: Recordings) -> Table:
    """Every expert of the recordings, inertial ones too.

    Raises:
        RecordingError: without exact truth.
    """
    truth = exact_turn(recordings)
    moving = recordings["speed_mps"] > MOVING_MPS
    joint = (JOINT,) if JOINT in recordings.manifest.variants else ()
    rows: list[list[Cell]] = []
    for expert in (*recordings.experts, *joint):
        error = np.degrees(recordings[f"{expert}.yaw_increment_rad"].astype(np.float64) - truth)
        steps = np.isfinite(truth)
        told = steps & np.isfinite(error)
        share = 100.0 * float(told.sum() / steps.sum())
        size, driving = np.abs(error[told]), np.abs(error[told & moving])
        rows.append([expert, share, _lost(recordings, expert), *_spread(size), *_tail(driving)])
    caption = (
        f"Errors of one step's yaw increment, {data_label(recordings.manifest)}, {len(recordings)} scenes, against "
        f"exact truth; moving: faster than {MOVING_MPS:g} m/s."
    )
    return Table(caption, COLUMNS, rows)


def _lost(recordings: Recordings, expert: str) -> float:
    """Tracks lost per scene; NaN for an expert that has none to lose."""
    camera = recordings.manifest.variants[JOINT] if expert == JOINT else expert
    lost = lost_tracks(as_variant(recordings, expert), camera)
    return np.nan if lost is None else float(lost.counts.mean())


def _spread(size: FloatArray) -> list[float]:
    """Median, RMS, least of the worst 5 % and largest; NaN of nothing."""
    if not len(size):
        return [np.nan] * 4
    rms, worst = _tail(size)
    return [float(np.median(size)), rms, worst, float(size.max())]


def _tail(size: FloatArray) -> list[float]:
    """RMS, and the least of the worst 5 %; NaN of nothing."""
    if not len(size):
        return [np.nan] * 2
    return [float(np.sqrt(np.mean(size**2))), float(np.quantile(size, 0.95))]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    return print_study(UnequalExpertsStudy, arguments)


if __name__ == "__main__":
    sys.exit(main())
