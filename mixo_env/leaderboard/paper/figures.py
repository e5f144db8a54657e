"""Figures 3 to 7 of the paper, from what a leaderboard holds. Agg only: no window is opened."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.expert import State
from mixo_env.files import atomic_path
from mixo_env.leaderboard.evaluation import poses
from mixo_env.leaderboard.figures import from_start, line_styles
from mixo_env.leaderboard.paper import printed
from mixo_env.leaderboard.paper.parts import FRONT, NotHereError, Subject, marked
from mixo_env.leaderboard.rows import Row
from mixo_env.metrics.aggregate import HIGH_ATE_M

STATES = (
    (State.TRACKING, "tracking", "#222222", 2.0),
    (State.INITIALISING, "initialising", "#D62728", 7.0),
    (State.LOST, "lost", "#1F4FD6", 4.0),
)
"""State, label, colour as in the paper, width: colour alone does not tell them apart."""

FAR_STDS = 5.0
"""A tracking camera that errs by more of its usual errors (1.4826 x their median) is far off."""


def new_figure(width: float, height: float) -> Any:
    """An empty figure that draws without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Any, path: Path) -> None:
    with atomic_path(path) as part:
        figure.savefig(part, format="png", dpi=110, metadata={"Software": None})


def side_cameras(subject: Subject) -> list[str]:
    """Those that look neither ahead nor back; all others than the front one where there is none.

    Raises:
        NotHereError: without a camera besides the front one.
    """
    others = [camera for camera in subject.cameras() if camera != FRONT]
    if not others:
        raise NotHereError("these recordings have no camera but the front one")
    return [camera for camera in others if camera != "CAM_BACK"] or others


def figure_3(subject: Subject, path: Path) -> str:
    """The side camera that errs most while it tracks: what it claims, and how sure RANSAC was.

    Returns:
        What the figure shows; the paper's is an image, and images are not recorded.

    Raises:
        NotHereError: when no side camera is far off while it tracks.
    """
    recordings = subject.judged
    worst = max((_far_off(subject, camera) for camera in side_cameras(subject)), key=lambda one: one[2].max())
    camera, error, far = worst
    if not np.isfinite(far).any() or far.max() <= FAR_STDS:
        raise NotHereError("no side camera is far off while it tracks")
    scene = int(np.searchsorted(recordings.offsets, far.argmax(), side="right")) - 1
    steps = slice(recordings.offsets[scene] + 1, recordings.offsets[scene + 1])
    time_s = recordings["time_s"][steps] - recordings["time_s"][recordings.offsets[scene]]
    dt_s = recordings["dt_s"][steps]
    figure = new_figure(9.0, 4.8)
    above, below = figure.subplots(2, 1, sharex=True)
    truth = recordings["truth.yaw_increment_rad"]
    above.plot(time_s, np.degrees(truth[steps]) / dt_s, color="black", linewidth=3.0, alpha=0.35, label="truth")
    claim = np.degrees(recordings[f"{camera}.yaw_increment_rad"][steps]) / dt_s
    above.plot(time_s, claim, color="#D55E00", linewidth=1.1, label=camera)
    bad = far[steps] > FAR_STDS
    above.plot(time_s[bad], claim[bad], "x", color="#D55E00", markersize=6, label="far off")
    above.set_ylabel("yaw rate [deg/s]", fontsize=8)
    for column, dashes in (("matches", "-"), ("inliers", (0, (5, 1.5)))):
        below.plot(time_s, recordings[f"{camera}.{column}"][steps], color="#222222", linestyle=dashes, label=column)
    below.set_ylabel("features", fontsize=8)
    below.set_xlabel(f"time in {recordings.scenes[scene].name} [s]", fontsize=8)
    _tidy((above, below))
    figure.suptitle(f"{camera}, {subject.data}", fontsize=9)
    _save(figure, path)
    share = 100.0 * float(np.mean(far[np.isfinite(error)] > FAR_STDS))
    return (
        f"Fig. 3. The paper shows an image of a side view full of moving cars; images are not recorded. Shown is the "
        f"step at which a tracking side camera errs most, {camera} in {recordings.scenes[scene].name}: crosses are "
        f"more than {FAR_STDS:g} of its usual errors (1.4826 x median) from the truth, {share:.1f} % of its "
        "tracking steps."
    )


def _far_off(subject: Subject, camera: str) -> tuple[str, NDArray[np.float64], NDArray[np.float64]]:
    """The camera, its errors while tracking [rad], NaN elsewhere, and the same in its usual errors, 0 elsewhere."""
    recordings = subject.judged
    tracking = recordings[f"{camera}.state"] == State.TRACKING
    error = np.abs(recordings[f"{camera}.yaw_increment_rad"] - recordings["truth.yaw_increment_rad"])
    error = np.where(tracking, error, np.nan)
    if not np.isfinite(error).any():
        return camera, error, np.zeros_like(error)
    usual = max(1.4826 * float(np.nanmedian(error)), 1e-9)
    return camera, error, np.nan_to_num(error / usual)


def figure_4(subject: Subject, path: Path) -> str:
    """Wrong ways of side cameras, by the state that the camera was in.

    Returns:
        What the figure shows.

    Raises:
        NotHereError: without side cameras, or when their rows were not run.
    """
    rows = [subject.row(camera) for camera in side_cameras(subject)][:2]
    recordings, truth = subject.board.recordings, subject.board.truths[subject.board.headline]
    shown = [(row, int(i)) for row in rows for i in np.argsort(-subject.absolute(row).translation_m)[:2]]
    figure = new_figure(3.6 * len(shown), 4.4)
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for panel, (row, scene) in zip(panels, shown, strict=True):
        steps = slice(*truth.offsets[scene : scene + 2])
        way = poses(row.run.travel, truth.poses, truth.offsets)
        panel.plot(*from_start(truth.poses, truth.poses, steps), color="black", linewidth=5.0, alpha=0.2, label="truth")
        x, y = from_start(way, truth.poses, steps)
        state = recordings[f"{row.name}.state"][steps]
        for which, label, colour, width in STATES:
            there = (state == which) | (state == State.NO_IMAGE if which is State.TRACKING else False)
            kept = there | np.append(there[1:], False)  # a step is drawn from the pose before it
            line = np.where(kept, x, np.nan), np.where(kept, y, np.nan)
            panel.plot(*line, color=colour, linewidth=width, alpha=0.85, label=label, solid_capstyle="butt")
        ate = subject.absolute(row).translation_m[scene]
        panel.set_title(f"{row.name}\n{recordings.scenes[scene].name}: ATE {ate:.2f} m", fontsize=8)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_xlabel("left - right [m]", fontsize=8)
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=8)
    panels[0].set_ylabel("forward [m]", fontsize=8)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    figure.suptitle(subject.data, fontsize=9)
    _save(figure, path)
    return "Fig. 4. The two scenes of largest ATE of each side camera, coloured by its state as in the paper."


def figure_5(subject: Subject, path: Path) -> str:
    """Ways of the front camera and MIXO in the paper's scenes, else where the front camera errs most.

    Returns:
        What the figure shows.

    Raises:
        NotHereError: when one of the rows was not run.
    """
    rows = [subject.row(name) for name in (FRONT, "MIXO")]
    board, truth = subject.board, subject.board.truths[subject.board.headline]
    names = [scene.name for scene in board.recordings.scenes]
    theirs = [names.index(name) for name in printed.FIGURE_5_ATE_M if name in names]
    scenes = theirs or _worst_of_different_logs(subject, rows[0])
    styles = line_styles(rows)
    figure = new_figure(3.6 * len(scenes), 6.8)
    panels, errors = figure.subplots(2, len(scenes), squeeze=False, height_ratios=(3, 2))
    for panel, below, scene in zip(panels, errors, scenes, strict=True):
        steps = slice(*truth.offsets[scene : scene + 2])
        panel.plot(*from_start(truth.poses, truth.poses, steps), color="black", linewidth=4, alpha=0.3, label="truth")
        for row in rows:
            way = poses(row.run.travel, truth.poses, truth.offsets)
            panel.plot(*from_start(way, truth.poses, steps), **styles[row.name], label=row.name)
            error = np.hypot(way.x_m - truth.poses.x_m, way.y_m - truth.poses.y_m)[steps]
            below.plot(truth.travelled_m[steps], error, **styles[row.name])
        ate = " / ".join(f"{subject.absolute(row).translation_m[scene]:.3f}" for row in rows)
        title = f"{names[scene]}\nATE {ate} m"
        if theirs:
            title += "\nprinted " + " / ".join(f"{value:.3f}" for value in printed.FIGURE_5_ATE_M[names[scene]])
        panel.set_title(title, fontsize=8)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_xlabel("left - right [m]", fontsize=8)
        below.set_xlabel("distance travelled [m]", fontsize=8)
        for one in (panel, below):
            one.grid(alpha=0.3)
            one.tick_params(labelsize=8)
    panels[0].set_ylabel("forward [m]", fontsize=8)
    errors[0].set_ylabel("position error [m]", fontsize=8)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    figure.suptitle(subject.data, fontsize=9)
    _save(figure, path)
    which = "the paper's scenes" if theirs else "of different logs, the scenes of CAM_FRONT's largest ATE"
    values = ", ".join(f"{name[-4:]}: {a:.3f}/{b:.3f}" for name, (a, b) in printed.FIGURE_5_ATE_M.items())
    return (
        f"Fig. 5. CAM_FRONT / MIXO, {which}. Printed ATE [m], other data unless the scene's name is the same: {values}."
    )


def _worst_of_different_logs(subject: Subject, row: Row) -> list[int]:
    """Up to four scenes."""
    entries = subject.board.recordings.scenes
    order = np.argsort(-subject.absolute(row).translation_m, kind="stable").tolist()
    first_of_log: dict[str, int] = {}
    for i in order:
        first_of_log.setdefault(entries[i].log, i)
    return list(first_of_log.values())[:4]


def figure_6(subject: Subject, path: Path) -> str:
    """Boxes of the scenes' ATE, one a row, with how many scenes are above 0.5 m.

    Returns:
        What the figure shows.
    """
    rows = list(subject.rows.values())
    values = [subject.absolute(row).translation_m[row.run.tested] for row in rows]
    figure = new_figure(9.0, 0.26 * len(rows) + 1.4)
    axis = figure.subplots()
    for line, ate_m in enumerate(values, start=1):
        _box(axis, line, ate_m)
    axis.axvline(HIGH_ATE_M, color="#D55E00", linestyle="--", linewidth=1.0)
    axis.set_xscale("function", functions=(lambda e: np.sqrt(np.abs(e)), np.square))
    axis.set_xlim(left=0.0)
    high = [f"{int((one > HIGH_ATE_M).sum())} of {len(one)}" for one in values]
    labels = [f"{marked(row)}   ({count})" for row, count in zip(rows, high, strict=True)]
    axis.set_yticks(range(1, len(rows) + 1), labels, fontsize=7)
    axis.set_ylim(len(rows) + 0.7, 0.3)
    axis.set_xlabel(
        f"ATE of a scene [m]; in brackets: scenes above {HIGH_ATE_M:g} m (dashed); square-root scale", fontsize=8
    )
    axis.grid(alpha=0.3, axis="x")
    figure.suptitle(subject.data, fontsize=9)
    _save(figure, path)
    front = f"; ours: {high[list(subject.rows).index(FRONT)]}" if FRONT in subject.rows else ""
    return (
        f"Fig. 6. ATE by scene. Printed: CAM_FRONT above {HIGH_ATE_M:g} m in {printed.HIGH_ATE_SCENES} of "
        f"{printed.SCENES} scenes of nuScenes{front}."
    )


def _box(axis: Any, line: int, values: NDArray[np.float64]) -> None:
    """Quartiles, median, whiskers to the last value within 1.5 times their distance, and what is beyond."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    near = (values >= low - 1.5 * (high - low)) & (values <= high + 1.5 * (high - low))
    axis.hlines(line, values[near].min(), values[near].max(), color="#222222", linewidth=1.0)
    axis.broken_barh([(low, high - low)], (line - 0.3, 0.6), facecolors="#BFD7EA", edgecolors="#222222")
    axis.vlines(middle, line - 0.3, line + 0.3, color="#222222", linewidth=2.0)
    axis.plot(values[~near], np.full((~near).sum(), line), "o", color="#222222", markersize=2.5, fillstyle="none")


def figure_7(subject: Subject, path: Path) -> str:
    """RTE over the length of a piece.

    Returns:
        What the figure shows.

    Raises:
        NotHereError: when no scene is long enough.
    """
    rows = subject.by_length()
    styles = line_styles(rows)
    length, *ends = printed.FIGURE_7_END
    figure = new_figure(10.0, 4.6)
    panels = figure.subplots(1, 2)
    fields = ("translation_percent", "rotation_deg_per_m")
    for panel, field, label, end in zip(panels, fields, ("translation [%]", "rotation [deg/m]"), ends, strict=True):
        for row in rows:
            x = [at.length_m for at in row.lengths]
            panel.plot(x, [getattr(at, field).mean for at in row.lengths], **styles[row.name], label=marked(row))
        panel.plot([length], [end], "k*", markersize=9, label="printed end of the curve, other data")
        panel.set_xlabel("length [m]", fontsize=8)
        panel.set_ylabel(label, fontsize=8)
        panel.grid(alpha=0.3, which="both")
        panel.tick_params(labelsize=8)
    panels[0].set_ylim(bottom=0.0)
    panels[1].set_yscale("log")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, handlelength=3.5)
    figure.suptitle(subject.data, fontsize=9)
    _save(figure, path)
    return f"Fig. 7. RTE by length; printed curves end at {ends[0]:g} % and {ends[1]:g} deg/m at {length:g} m."


def _tidy(panels: tuple[Any, ...]) -> None:
    for panel in panels:
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=8)
        panel.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
