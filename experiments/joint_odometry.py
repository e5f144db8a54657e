"""Tight against loose coupling: JOINT beside the single cameras and HUBER of the same cameras, from a recording.

mixo record city --out recorded --experts JOINT
python -m experiments.joint_odometry --recordings recorded
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.studies import exact_turn, print_study
from mixo_env.errors import RecordingError
from mixo_env.leaderboard.board import build
from mixo_env.leaderboard.paper.parts import folder_of, median_spent_ms
from mixo_env.leaderboard.rows import Row
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.joint import JOINT
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.variants import as_variant
from mixo_env.tables import Column, Table

TURNING_RAD = np.radians(45.0)
"""A scene whose heading covers more than this is a turning one."""

COLUMNS = (
    Column("row"),
    Column("all", "deg/m", ".5f"),
    *(Column(part, "deg/m", ".5f") for part in ("day", "rain", "turning")),
    Column("increment", "deg", ".4f"),
    Column("within 1 std", "%", ".0f"),
    Column("within 1.96 std", "%", ".0f"),
    Column("CPU", "ms", ".2f"),
)


@dataclass(frozen=True)
class JointOdometryStudy:
    """Print accuracy, calibration and cost of JOINT."""

    recordings: Path
    """Folder of a recording made with ``--experts JOINT``, or the name of a bundled one."""

    def run(self) -> Table:
        """Score every row against the headline's truth."""
        recordings = load_recordings(str(self.recordings))
        return study(recordings, median_spent_ms(folder_of(self.recordings)))


def study(recordings: Recordings, spent_ms: dict[str, float]) -> Table:
    """The table of a recording.

    Args:
        recordings: with JOINT.
        spent_ms: median CPU time of an image, or of a step of JOINT; empty: unknown.

    Raises:
        RecordingError: without JOINT.
    """
    if JOINT not in recordings.manifest.variants:
        raise RecordingError(f"expected a recording with {JOINT}, got none: mixo record ... --experts {JOINT}")
    names = (*recordings.manifest.cameras, JOINT, "HUBER")
    board = build(recordings, policies=names, tracks=("VISION",), night=False)
    rain = np.array(["rain" in scene.conditions for scene in board.recordings.scenes])
    turning = _turning(board.recordings)
    subsets = (np.ones_like(rain), ~rain, rain, turning)
    rows = []
    for row in board.standings[0].rows:
        inside = _coverage(recordings, row.name)
        increment = row.headline.yaw_increment_rmse_deg
        rows.append([row.name, *_relative(row, subsets), increment, *inside, spent_ms.get(row.name, np.nan)])
    caption = (
        f"Mean relative rotation error in track VISION against {board.headline}, {len(board.recordings)} scenes, "
        f"{int(rain.sum())} of them in rain, {int(turning.sum())} turning; CPU: median of an image, of {JOINT} the "
        "solve of a step."
    )
    return Table(caption, COLUMNS, rows)


def _turning(recordings: Recordings) -> NDArray[np.bool_]:
    """``(scenes,)``."""
    yaws = [recordings.rows(i)["truth.yaw_rad"] for i in range(len(recordings))]
    return np.array([np.ptp(yaw) > TURNING_RAD for yaw in yaws])


def _relative(row: Row, subsets: Sequence[NDArray[np.bool_]]) -> list[float]:
    """Mean error [deg/m] in each subset ``(scenes,)``; NaN where it is empty."""
    relative = next(iter(row.errors.values())).relative
    parts = (relative.rotation_deg_per_m[(row.run.tested & subset)[relative.scene]] for subset in subsets)
    return [float(part.mean()) if len(part) else np.nan for part in parts]


def _coverage(recordings: Recordings, name: str) -> list[float]:
    """Share [%] of the increments within 1 and 1.96 of their standard deviations of the exact truth."""
    expert = recordings.manifest.variants.get(name, name)
    if expert not in recordings.manifest.cameras:
        return [np.nan, np.nan]
    shown = as_variant(recordings, name)
    error = shown[f"{expert}.yaw_increment_rad"] - exact_turn(shown)
    told = np.abs(error) / shown[f"{expert}.yaw_std_rad"]
    told = told[np.isfinite(told)]
    return [100.0 * float(np.mean(told < limit)) for limit in (1.0, 1.96)] if len(told) else [np.nan, np.nan]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    return print_study(JointOdometryStudy, arguments)


if __name__ == "__main__":
    sys.exit(main())
