"""Pictures of a leaderboard. Agg only: no window is opened."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.expert import State
from mixo_env.files import atomic_path
from mixo_env.leaderboard.board import Leaderboard, Standings
from mixo_env.leaderboard.evaluation import poses
from mixo_env.leaderboard.rows import Row
from mixo_env.recordings.presets import data_label
from mixo_env.trajectory.planar import PlanarPoses

PREFERRED_TRACK = "CONSUMER"
SCENES = 4
MOST_ROWS = 9
"""Lines that one panel bears; of more rows the PREFERRED ones and the reader's own experts are drawn."""

PREFERRED = {
    "CAM_FRONT": "#0072B2",
    "CAM_FRONT_LEFT": "#56B4E9",
    "CAM_BACK": "#009E73",
    "CAM_BACK_RIGHT": "#CC79A7",
    "INERTIAL_CONSUMER": "#E69F00",
    "LINEAR": "#7A4FB5",
    "HUBER": "#222222",
    "MIXO": "#D55E00",
}
"""Colours of the rows that a reader looks for; colour-blind eyes tell them apart (Okabe and Ito 2008)."""

OTHERS = ("#8C564B", "#7F7F7F", "#17BECF", "#BCBD22", "#1B6CA8", "#AA3377", "#666600", "#44AA99", "#882255")
"""Colours of all other rows, in the order of the table."""

DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1)), (0, (5, 1.5, 1, 1.5)))
"""Neighbouring rows also differ by the pattern of their line: the figure survives grey print."""


def draw_trajectories(board: Leaderboard, path: Path) -> None:
    """Top views of a few scenes over the position error along the way and the stretches in which cameras were lost.

    The scenes are those of different logs that turn most, in the CONSUMER track if it was run, start at the origin and
    heading up. Every row that was asked for is drawn, up to ``MOST_ROWS``; a row that was tested on some folds only is
    drawn in their scenes. Errors are drawn on a square-root scale, so that small ones can be told apart beside a large
    one.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    standings = next((one for one in board.standings if one.track == PREFERRED_TRACK), board.standings[0])
    rows = shown_rows(board, standings)
    scenes = _most_winding_of_different_logs(board, rows)
    manifest = board.recordings.manifest
    cameras = [camera for camera in manifest.cameras or manifest.imported if f"{camera}.state" in board.recordings]
    figure = Figure(figsize=(4.2 * len(scenes), 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    lanes = 0.35 + 0.22 * len(cameras)
    axes: Any = figure.subplots(3, len(scenes), squeeze=False, height_ratios=(3.4, 2.6, lanes))
    truth = board.truths[board.headline]
    styles = line_styles(rows)
    travels = [(row, poses(row.run.travel, truth.poses, truth.offsets)) for row in rows]
    for column, scene in enumerate(scenes):
        steps = slice(*truth.offsets[scene : scene + 2])
        above, middle, below = axes[:, column]
        entry = board.recordings.scenes[scene]
        way_m = truth.travelled_m[steps]
        above.plot(*from_start(truth.poses, truth.poses, steps), color="black", linewidth=3.0, alpha=0.35)
        for row, estimate in travels:
            if not row.run.tested[scene]:
                continue
            above.plot(*from_start(estimate, truth.poses, steps), **styles[row.name])
            error = np.hypot(estimate.x_m - truth.poses.x_m, estimate.y_m - truth.poses.y_m)[steps]
            middle.plot(way_m, error, **styles[row.name])
        _draw_lost(below, board, cameras, steps, way_m)
        above.set_title(f"{entry.name}\n{entry.log}", fontsize=8)
        above.set_aspect("equal", adjustable="datalim")
        above.set_xlabel("left - right [m]", fontsize=8)
        middle.set_yscale("function", functions=(lambda e: np.sqrt(np.abs(e)), np.square))
        middle.set_ylim(bottom=0.0)
        below.set_xlabel("distance travelled [m]", fontsize=8)
        for panel in (above, middle, below):
            panel.grid(alpha=0.3)
            panel.tick_params(labelsize=8)
        for panel in (middle, below):
            panel.set_xlim(way_m[0], max(way_m[-1], way_m[0] + 1.0))
        middle.tick_params(labelbottom=False)
        if column:
            below.tick_params(labelleft=False)
    axes[0, 0].set_ylabel("forward [m]", fontsize=8)
    axes[1, 0].set_ylabel("position error [m], square-root scale", fontsize=8)
    _legend(figure, rows, styles)
    figure.suptitle(_title(board, standings), fontsize=9)
    with atomic_path(path) as part:
        figure.savefig(part, format="png", dpi=110, metadata={"Software": None})


def shown_rows(board: Leaderboard, standings: Standings) -> list[Row]:
    """The rows to draw: all of them, or of too many the preferred ones, then imported experts, then the rest."""
    rows = {row.name: row for row in (*standings.one_fold_rows, *standings.rows)}
    order = [row.name for row in standings.rows] + [row.name for row in standings.one_fold_rows]
    order = list(dict.fromkeys(order))
    if len(order) > MOST_ROWS:
        first = [name for name in (*PREFERRED, *board.recordings.headline_imported) if name in rows]
        rest = [name for name in order if name not in first and not rows[name].run.privileged]
        kept = set([*first, *rest][:MOST_ROWS])
        order = [name for name in order if name in kept]
    return [rows[name] for name in order]


def line_styles(rows: list[Row]) -> dict[str, dict[str, Any]]:
    """Colour, dashes and width of every row: fused rows are thicker than single experts."""
    others = iter(itertools.cycle(OTHERS))
    return {
        row.name: {
            "color": PREFERRED.get(row.name) or next(others),
            "linestyle": DASHES[i % len(DASHES)],
            "linewidth": 1.6 if row.fused else 1.1,
        }
        for i, row in enumerate(rows)
    }


def _legend(figure: Any, rows: list[Row], styles: dict[str, dict[str, Any]]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color="black", linewidth=3.0, alpha=0.35, label="truth")]
    handles += [
        Line2D([], [], label=row.name + (" †" if row.run.privileged else ""), **styles[row.name]) for row in rows
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 6), fontsize=8, handlelength=3.5)


def _draw_lost(panel: Any, board: Leaderboard, cameras: list[str], steps: slice, way_m: NDArray[np.float64]) -> None:
    """One lane a camera: a bar from where the step begins to where it ends while the camera was lost."""
    for lane, camera in enumerate(cameras):
        lost = np.flatnonzero(board.recordings[f"{camera}.state"][steps] == State.LOST)
        before = np.maximum(lost - 1, 0)
        width = np.maximum(way_m[lost] - way_m[before], 0.5)  # half a metre is still seen when the car stands
        colour = PREFERRED.get(camera, OTHERS[lane % len(OTHERS)])
        panel.broken_barh(list(zip(way_m[before], width, strict=True)), (lane - 0.35, 0.7), facecolors=colour)
    panel.set_ylim(max(len(cameras), 1) - 0.5, -0.5)
    panel.set_yticks(range(len(cameras)), [camera.removeprefix("CAM_").lower() + " lost" for camera in cameras])


def _title(board: Leaderboard, standings: Standings) -> str:
    return (
        f"Track {standings.track}, data {data_label(board.recordings.manifest)}, seed {board.protocol.trial.seed}; "
        "no alignment, the first pose is the truth's; learned policies on scenes they have not seen"
    )


def _most_winding_of_different_logs(board: Leaderboard, rows: list[Row]) -> list[int]:
    """Up to ``SCENES`` scenes, one per log while there are enough logs, in the order of the recordings.

    Scenes on which all ``rows`` were tested come first.
    """
    truth, entries = board.truths[board.headline], board.recordings.scenes
    turned = np.array([np.ptp(truth.poses.yaw_rad[first:stop]) for first, stop in itertools.pairwise(truth.offsets)])
    everywhere = np.all([row.run.tested for row in rows], axis=0) if rows else np.ones(len(entries), np.bool_)
    order = np.lexsort((-turned, ~everywhere)).tolist()
    first_of_log = {entries[i].log: i for i in reversed(order)}
    chosen = [i for i in order if first_of_log[entries[i].log] == i]
    return sorted((chosen + [i for i in order if i not in chosen])[:SCENES])


def from_start(way: PlanarPoses, truth: PlanarPoses, rows: slice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right and forward [m] as seen from the true first pose."""
    dx, dy = way.x_m[rows] - truth.x_m[rows][0], way.y_m[rows] - truth.y_m[rows][0]
    cos, sin = np.cos(truth.yaw_rad[rows][0]), np.sin(truth.yaw_rad[rows][0])
    return sin * dx - cos * dy, cos * dx + sin * dy
