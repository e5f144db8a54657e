"""Pictures of a leaderboard. Agg only: no window is opened."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.expert import State
from mixo_env.files import atomic_path
from mixo_env.leaderboard.board import Leaderboard, Table
from mixo_env.leaderboard.evaluation import Poses, poses
from mixo_env.leaderboard.rows import Row

PREFERRED_TRACK = "CONSUMER"
SCENES = 4
COLOURS = {
    "CAM_FRONT": "#0072B2",
    "CAM_FRONT_LEFT": "#56B4E9",
    "CAM_BACK": "#009E73",
    "CAM_BACK_RIGHT": "#CC79A7",
    "INERTIAL": "#999999",
    "INERTIAL_CONSUMER": "#E69F00",
    "LINEAR": "#7A4FB5",
    "MIXO": "#D55E00",
}
"""Fixed per policy; distinguishable by colour-blind readers (Okabe and Ito 2008, violet instead of yellow)."""


def draw_trajectories(board: Leaderboard, path: Path) -> None:
    """Top views of a few scenes, start at the origin and heading up, above the position error along the way.

    The scenes are those of different logs that turn most, in the CONSUMER track if it was run. Dots mark where a camera
    was lost.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    table = next((table for table in board.tables if table.track == PREFERRED_TRACK), board.tables[0])
    shown = [row for row in table.rows if row.name in COLOURS]
    scenes = _most_winding_of_different_logs(board)
    figure = Figure(figsize=(4.0 * len(scenes), 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(2, len(scenes), squeeze=False, height_ratios=(3, 2))
    course = board.courses[board.headline]
    motions = [(row, poses(row.run.motion, course.poses, course.offsets)) for row in shown]
    for column, scene in enumerate(scenes):
        rows = slice(*course.offsets[scene : scene + 2])
        above, below = axes[:, column]
        entry = board.recordings.scenes[scene]
        true = _from_start(course.poses, course.poses, rows)
        above.plot(*true, color="black", linewidth=2.5, label="truth")
        for row, estimate in motions:
            style = {"color": COLOURS[row.name], "label": row.name}
            way = _from_start(estimate, course.poses, rows)
            above.plot(*way, linewidth=1.2, **style)
            lost = _lost(board, row, rows)
            above.plot(way[0][lost], way[1][lost], ".", color=COLOURS[row.name], markersize=5)
            error = np.hypot(estimate.x_m - course.poses.x_m, estimate.y_m - course.poses.y_m)[rows]
            below.plot(course.travelled_m[rows], error, linewidth=1.2, **style)
        above.set_title(f"{entry.name} ({entry.log})", fontsize=9)
        above.set_aspect("equal", adjustable="datalim")
        above.set_xlabel("left - right [m]")
        below.set_xlabel("distance travelled [m]")
        below.set_ylim(bottom=0.0)
        for panel in (above, below):
            panel.grid(alpha=0.3)
    axes[0, 0].set_ylabel("forward [m]")
    axes[1, 0].set_ylabel("position error [m]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=9)
    figure.suptitle(_title(board, table), fontsize=10)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})


def _title(board: Leaderboard, table: Table) -> str:
    return (
        f"Track {table.track}, data {board.recordings.manifest.data_version}, seed {board.protocol.seed}; "
        "no alignment, the first pose is the truth's; learned policies on scenes they have not seen; dots: camera lost"
    )


def _most_winding_of_different_logs(board: Leaderboard) -> list[int]:
    """Up to ``SCENES`` scenes, one per log while there are enough logs, in the order of the recordings."""
    course, entries = board.courses[board.headline], board.recordings.scenes
    turned = [np.ptp(course.poses.yaw_rad[first:stop]) for first, stop in itertools.pairwise(course.offsets)]
    order = np.argsort(-np.array(turned), kind="stable").tolist()
    first_of_log = {entries[i].log: i for i in reversed(order)}
    chosen = [i for i in order if first_of_log[entries[i].log] == i]
    return sorted((chosen + [i for i in order if i not in chosen])[:SCENES])


def _from_start(way: Poses, truth: Poses, rows: slice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right and forward [m] as seen from the true first pose."""
    dx, dy = way.x_m[rows] - truth.x_m[rows][0], way.y_m[rows] - truth.y_m[rows][0]
    cos, sin = np.cos(truth.yaw_rad[rows][0]), np.sin(truth.yaw_rad[rows][0])
    return sin * dx - cos * dy, cos * dx + sin * dy


def _lost(board: Leaderboard, row: Row, rows: slice) -> NDArray[np.bool_]:
    """Where the camera of this row, if it is one, was lost."""
    column = f"{row.name}.state"
    if column not in board.recordings:
        return np.zeros(rows.stop - rows.start, dtype=np.bool_)
    return board.recordings[column][rows] == State.LOST
