"""Draw docs/figures/fusion.png: the drives on which fusion gains most on the front camera and loses most.

    python -m docs._pages.fusion_drives

Gain is the front camera's RTE [deg/m] on a scene minus that of the fused row, which learned from other logs. Both
drives are the extremes over all scenes of the folds; nobody chose them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mixo_env.errors import RecordingError
from mixo_env.experts.expert import State
from mixo_env.files import atomic_path
from mixo_env.leaderboard.board import Leaderboard, build
from mixo_env.leaderboard.evaluation import poses
from mixo_env.leaderboard.figures import from_start, line_styles
from mixo_env.leaderboard.manoeuvres import played_weights
from mixo_env.leaderboard.rows import Row
from mixo_env.recordings.presets import data_label
from mixo_env.recordings.store import load_recordings
from mixo_env.trajectory.planar import PlanarPoses

ALONE = "CAM_FRONT"
"""The row that fusion must beat."""

MAGNIFIED = 10
"""Distances from the true path are drawn so many times as large: paths that err by decimetres lie on one another."""

SMOOTHED = 12
"""Steps over which weights are averaged: one second."""


@dataclass(frozen=True)
class FusionDrives:
    """Draw the two drives."""

    out: Path = Path("docs/figures/fusion.png")
    """File to write."""
    recordings: Path | None = None
    """Folder of the recordings; default: the bundled ones."""
    track: str = "VISION"
    """Whose experts vote."""
    row: str = "TRIO"
    """The fused row: of those that weigh votes and read no truth, the best of README's table."""
    others: tuple[str, ...] = ("HUBER", "MIXO")
    """Further rows to draw."""

    def run(self) -> int:
        """Cross-validate the rows, choose, draw."""
        names = tuple(dict.fromkeys((ALONE, *self.others, self.row)))
        board = build(load_recordings(self.recordings), tracks=(self.track,), policies=names, night=False)
        scenes = extremes(board, self.row)
        draw(board, self.row, scenes, self.out)
        for scene, gain in zip(scenes, _gains(board, self.row)[list(scenes)], strict=True):
            print(f"{board.recordings.scenes[scene].name}: {self.row} gains {gain:+.4f} deg/m on {ALONE}")
        print(f"wrote {self.out}")
        return 0


def extremes(board: Leaderboard, name: str) -> tuple[int, int]:
    """Scenes of the largest gain and of the largest loss of a row on the front camera.

    Raises:
        RecordingError: where no scene is long enough for an RTE.
    """
    gains = _gains(board, name)
    if not np.isfinite(gains).any():
        raise RecordingError("no scene has a piece of path of 10 m: expected drives that move")
    return int(np.nanargmax(gains)), int(np.nanargmin(gains))


def draw(board: Leaderboard, name: str, scenes: Sequence[int], path: Path) -> None:
    """A column a scene: paths, yaw error along the way, and the row's weights with the marks of lost cameras."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    truth, standings = board.truths[board.headline], board.standings[0]
    rows = list(standings.rows)
    styles, ways = line_styles(rows), [poses(row.run.travel, truth.poses, truth.offsets) for row in rows]
    figure = Figure(figsize=(9.6, 9.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(3, len(scenes), height_ratios=(3.0, 2.4, 2.2))
    said = ("Fusion saves the day", "Fusion does not")
    for column, (scene, title) in enumerate(zip(scenes, said, strict=True)):
        steps = slice(*truth.offsets[scene : scene + 2])
        way_m = truth.travelled_m[steps]
        above, middle, below = axes[:, column]
        above.plot(*from_start(truth.poses, truth.poses, steps), color="black", linewidth=5.0, alpha=0.25)
        for row, way in zip(rows, ways, strict=True):
            above.plot(*from_start(_magnified(way, truth.poses), truth.poses, steps), **styles[row.name])
            middle.plot(way_m, _yaw_error_deg(way, truth.poses, steps), label=row.name, **styles[row.name])
        _draw_weights(below, board, _named(rows, name), steps, way_m)
        compared = (_named(rows, ALONE), _named(rows, name))
        errors = ", ".join(f"{row.name} {row.scene_deg_per_m[0, scene]:.4f}" for row in compared)
        entry = board.recordings.scenes[scene]
        above.set_title(f"{title}: {entry.name} ({', '.join(entry.conditions)})\nRTE deg/m: {errors}", fontsize=8)
        above.set_aspect("equal", adjustable="datalim")
        above.set(xlabel=f"left - right [m], errors {MAGNIFIED} x", ylabel="forward [m]")
        middle.set(ylabel="yaw error [deg]", xlim=(way_m[0], way_m[-1]))
        below.set(xlabel="distance travelled [m]", ylabel=f"weights of {name}, 1 s mean", xlim=(way_m[0], way_m[-1]))
        for panel in (above, middle, below):
            panel.grid(alpha=0.3)
    axes[1, 0].legend(fontsize=8)
    axes[2, 0].legend(
        fontsize=6.5,
        ncols=3,
        columnspacing=1.0,
        handlelength=1.8,
        frameon=False,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),  # above the panel: lines reach its top
    )
    about = f"Track {standings.track}, data {data_label(board.recordings.manifest)}"
    figure.suptitle(f"{about}: the scenes of {name}'s largest gain and largest loss on {ALONE}, of all", fontsize=9)
    with atomic_path(path) as part:
        figure.savefig(part, format=path.suffix[1:], dpi=100, metadata={"Software": None})


def _gains(board: Leaderboard, name: str) -> np.ndarray:
    alone, fused = (_named(board.standings[0].rows, one).scene_deg_per_m[0] for one in (ALONE, name))
    return alone - fused


def _named(rows: Sequence[Row], name: str) -> Row:
    return next(row for row in rows if row.name == name)


def _magnified(way: PlanarPoses, truth: PlanarPoses) -> PlanarPoses:
    x, y = (true + MAGNIFIED * (own - true) for own, true in ((way.x_m, truth.x_m), (way.y_m, truth.y_m)))
    return PlanarPoses(x, y, way.yaw_rad)


def _yaw_error_deg(way: PlanarPoses, truth: PlanarPoses, steps: slice) -> np.ndarray:
    return np.rad2deg(way.yaw_rad[steps] - truth.yaw_rad[steps])


def _draw_weights(panel: Any, board: Leaderboard, row: Row, steps: slice, way_m: np.ndarray) -> None:
    """Lines of the weights; a cross in the expert's colour at the foot wherever it is lost."""
    track = board.standings[0].track
    weights = played_weights(board.protocol, row.run, track)[steps][1:]
    window = np.ones(min(SMOOTHED, len(weights)))
    share = np.convolve(np.ones(len(weights)), window, "same")
    dashes = itertools.cycle(("-", "--", ":", "-."))
    foot = -0.06
    for expert, values, dash in zip(board.recordings.voters(track), weights.T, dashes, strict=False):
        mean = np.convolve(values, window, "same") / share
        (line,) = panel.plot(way_m[1:], mean, linestyle=dash, linewidth=1.5, label=expert)
        if f"{expert}.state" not in board.recordings:
            continue
        lost = np.flatnonzero(board.recordings[f"{expert}.state"][steps] == State.LOST)
        if len(lost):
            panel.plot(way_m[lost], np.full(len(lost), foot), "x", color=line.get_color(), label=f"{expert} lost")
            foot -= 0.06
    panel.set_ylim(foot, 1.02)


if __name__ == "__main__":
    import tyro

    raise SystemExit(tyro.cli(FusionDrives).run())
