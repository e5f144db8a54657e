"""The drawings of docs/metrics.md, made with the library they explain: ``python -m docs._pages.metric_drawings``."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mixo_env.geometry import FloatArray
from mixo_env.metrics.absolute import absolute_errors
from mixo_env.metrics.aggregate import statistics
from mixo_env.metrics.alignment import align
from mixo_env.metrics.anatomy import split_error
from mixo_env.metrics.association import associate
from mixo_env.metrics.bootstrap import interval_over_groups
from mixo_env.metrics.increments import skill
from mixo_env.metrics.pairs import PairRule, find_kitti_pairs, find_pairs, path_length
from mixo_env.metrics.relative import relative_errors
from mixo_env.metrics.tracks import count_lost_tracks
from mixo_env.metrics.uncertainty import uncertainty_score
from mixo_env.scoring.score_figures import COLOURS, TRUTH_COLOUR, save
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.planar import PlanarPoses

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FOLDER = Path(__file__).parents[1] / "figures"
ESTIMATE, SECOND, THIRD = COLOURS[1], COLOURS[0], COLOURS[2]


def drawings() -> dict[str, Figure]:
    """File stem -> drawing."""
    return {
        "metric-association": association(),
        "metric-ate": absolute(),
        "metric-pairs": pairs(),
        "metric-rte": relative(),
        "metric-kitti": kitti(),
        "metric-lost-tracks": lost_tracks(),
        "metric-anatomy": anatomy(),
        "metric-skill": skill_over_zero(),
        "metric-uncertainty": uncertainty(),
        "metric-intervals": intervals(),
    }


def association() -> Figure:
    """Two clocks and the pairs taken, the closest first."""
    truth_s = np.arange(0.0, 0.5, 0.05)
    estimate_s = np.array([0.008, 0.062, 0.09, 0.105, 0.19, 0.275, 0.345, 0.352, 0.41])
    rows, columns = associate(truth_s, estimate_s)
    figure, axes = _figure(8.0, 2.0)
    for row, column in zip(rows, columns, strict=True):
        axes.plot([truth_s[row], estimate_s[column]], [1, 0], color=THIRD)
    axes.plot(truth_s, np.ones(len(truth_s)), "o", color=TRUTH_COLOUR)
    axes.plot(estimate_s, np.zeros(len(estimate_s)), "o", color=ESTIMATE)
    axes.set_yticks([0, 1], ["estimate", "ground truth"])
    axes.set(xlabel="time [s]", ylim=(-0.4, 1.4))
    axes.set_title("each pose at most once, the closest pairs first, only |dt| < 0.02 s", fontsize=10)
    return figure


def absolute() -> Figure:
    """The same estimate unaligned and aligned, with the distances the ATE is made of."""
    truth, estimate = _drive()
    figure, row = _figure(10.0, 3.4, columns=3)
    shown = []
    for axes, method in zip(row, ("none", "se3", "sim3"), strict=True):
        aligned = align(truth, estimate, method).apply(estimate)
        ate_m = statistics(absolute_errors(truth, aligned).translation_m).rmse
        (x, y, _), (u, v, _) = truth.planar(), aligned.planar()
        axes.plot([x[::4], u[::4]], [y[::4], v[::4]], color="0.6", linewidth=0.8)
        _paths(axes, truth, aligned)
        axes.set_title(f"{method}: ATE {ate_m:.2f} m", fontsize=10)
        shown += [np.stack([x, y]), np.stack([u, v])]
    _alike(row, np.concatenate(shown, axis=1))
    row[0].legend(fontsize=8, loc="upper left")
    return figure


def pairs() -> Figure:
    """Frames along the path: the end of a piece is the first frame nearest to d_i + L."""
    distance = np.array([0.0, 1, 2, 3.5, 4, 5, 6, 7, 8.0, 8.8, 9.4, 9.4, 9.4, 9.4, 10.6, 11.7, 17, 18, 19, 20])
    figure, axes = _figure(8.5, 2.4)
    axes.plot(distance, np.zeros(len(distance)), "|", markersize=14, color=TRUTH_COLOUR)
    found = find_pairs(distance, PairRule((6.0,)))
    for height, start, colour in ((1.0, 3, ESTIMATE), (2.0, 6, SECOND), (3.0, 7, THIRD)):
        (end,) = found.end[found.start == start]
        axes.annotate(
            "", (distance[end], height), (distance[start], height), arrowprops={"arrowstyle": "->", "color": colour}
        )
        axes.plot([distance[start] + 6.0] * 2, [0.2, height + 0.3], color=colour, linestyle=":")
        axes.text(distance[start] - 0.2, height, f"start {distance[start]:g} m", ha="right", va="center", color=colour)
    axes.text(9.4, -0.9, "standstill:\n4 frames,\nthe first counts", ha="center", va="top", fontsize=8)
    axes.text(14.3, -0.9, "gap: the nearest frame\nmay be far", ha="center", va="top", fontsize=8)
    axes.set(xlabel="path travelled [m]", ylim=(-3.4, 3.8), yticks=[])
    axes.set_title("L = 6 m: dotted the wanted end d_i + L, arrow the piece taken", fontsize=10)
    return figure


def relative() -> Figure:
    """One piece of path, the estimate laid on its first pose."""
    truth, estimate = _drive()
    found = find_pairs(path_length(truth.positions_m), PairRule((20.0,)))
    which = len(found.start) // 2
    samples = relative_errors(truth, estimate, found)
    i, j = int(found.start[which]), int(found.end[which])
    laid = align(truth[i : j + 1], estimate[i : j + 1], "se3", 1).apply(estimate[i : j + 1])
    figure, (left, right) = _figure(9.0, 3.6, columns=2)
    _paths(left, truth, estimate)
    x, y, _ = truth.planar()
    left.plot(x[[i, j]], y[[i, j]], "o", color=TRUTH_COLOUR)
    left.set_title("the whole paths; dots: pose i and pose j", fontsize=10)
    _paths(right, truth[i : j + 1], laid)
    (u, v, _), end = laid.planar(), (x[j], y[j])
    right.plot([end[0], u[-1]], [end[1], v[-1]], color=SECOND, linewidth=2)
    right.set_title(
        f"L = 20 m, laid on pose i: off by {samples.translation_m[which]:.2f} m\n"
        f"= {samples.translation_percent[which]:.1f} %, turned by {samples.rotation_deg[which]:.1f} deg",
        fontsize=10,
    )
    left.legend(fontsize=8)
    return figure


def kitti() -> Figure:
    """Starts every ten frames; the end is the first frame beyond the length."""
    distance = np.cumsum(np.full(60, 4.3)) - 4.3
    found = find_kitti_pairs(distance, lengths_m=(100.0,))
    figure, axes = _figure(8.5, 2.0)
    axes.plot(distance, np.zeros(len(distance)), "|", markersize=10, color=TRUTH_COLOUR)
    for height, (start, end) in enumerate(zip(found.start, found.end, strict=True), start=1):
        span = {"arrowstyle": "->", "color": ESTIMATE}
        axes.annotate("", (distance[end], height), (distance[start], height), arrowprops=span)
        axes.plot([distance[start] + 100.0] * 2, [0.3, height + 0.3], color=ESTIMATE, linestyle=":")
    axes.set(xlabel="path travelled [m]", ylim=(-0.8, len(found.start) + 0.8), yticks=[])
    axes.set_title("KITTI, L = 100 m: a start every 10 frames, the end is the first frame beyond", fontsize=10)
    return figure


def lost_tracks() -> Figure:
    """States of one camera over time; only TRACKING to LOST counts."""
    words = ("INITIALISING", "TRACKING", "LOST")
    state = np.repeat([0, 1, 2, 0, 1, 2, 1], [6, 14, 5, 4, 16, 3, 8])
    result = count_lost_tracks(state == 1, lost=state == 2)
    figure, axes = _figure(8.5, 1.9)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(state)) + 1, [len(state)]])
    for k, (word, colour) in enumerate(zip(words, ("#d62728", THIRD, "#1f4fd8"), strict=True)):
        runs = [(first, stop - first) for first, stop in itertools.pairwise(edges.tolist()) if state[first] == k]
        axes.broken_barh(runs, (0, 1), color=colour, label=word)
    for step in np.flatnonzero((state[:-1] == 1) & (state[1:] == 2)):
        axes.annotate("counts", (step + 1, 1.0), (step + 1, 1.5), ha="center", arrowprops={"arrowstyle": "->"})
    axes.set(xlabel="step", ylim=(0, 1.9), yticks=[], xlim=(0, len(state)))
    counted = f"lost tracks {result.counts[0]}, lost steps {result.steps[0]}, longest run {result.longest_run[0]}"
    axes.set_title(counted, fontsize=10)
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def anatomy() -> Figure:
    """A position error split along and across the true heading."""
    truth, estimate = _drive()
    (x, y, yaw), (u, v, other_yaw) = truth.planar(), estimate.planar()
    along, across = split_error(PlanarPoses(x, y, yaw), PlanarPoses(u, v, other_yaw))
    k = 30
    figure, axes = _figure(6.0, 3.6)
    _paths(axes, truth, estimate)
    forward = np.array([np.cos(yaw[k]), np.sin(yaw[k])])
    corner = np.array([x[k], y[k]]) + along[k] * forward
    axes.plot([x[k], corner[0]], [y[k], corner[1]], color=SECOND, linewidth=2.5, label=f"along {along[k]:.1f} m: scale")
    axes.plot([corner[0], u[k]], [corner[1], v[k]], color=THIRD, linewidth=2.5, label=f"across {across[k]:.1f} m: yaw")
    axes.legend(fontsize=8)
    return figure


def skill_over_zero() -> Figure:
    """Yaw increments of a straight road and of a bend: the same error is worth more in the bend."""
    rng = np.random.default_rng(0)
    steps = np.arange(120)
    figure, row = _figure(9.0, 2.8, columns=2)
    noise = rng.normal(0, 0.05, len(steps))
    for axes, name, bend in ((row[0], "straight road", 0.06), (row[1], "bend", 0.8)):
        truth = bend * np.sin(steps / 15.0)
        axes.plot(steps, truth, color=TRUTH_COLOUR, label="truth")
        axes.plot(steps, truth + noise, color=ESTIMATE, linewidth=0.9, label="estimate")
        rmse = np.sqrt(np.mean(noise**2))
        axes.set_title(f"{name}: RMSE {rmse:.3f} deg, skill over zero {skill(noise, truth):.2f}", fontsize=10)
        axes.set(xlabel="step", ylim=(-1.1, 1.1))
    row[0].set(ylabel="yaw increment [deg]")
    row[0].legend(fontsize=8)
    return figure


def uncertainty() -> Figure:
    """Errors over their stated standard deviation, for a calibrated and for an overconfident method."""
    rng = np.random.default_rng(1)
    ratio = rng.standard_normal(4000)
    figure, row = _figure(9.0, 3.0, columns=2)
    for axes, name, stated in ((row[0], "calibrated", 1.0), (row[1], "overconfident", 0.5)):
        result = uncertainty_score(ratio, np.full(len(ratio), stated))
        axes.hist(ratio / stated, bins=np.linspace(-6, 6, 60), density=True, color=ESTIMATE, alpha=0.7)
        z = np.linspace(-6, 6, 200)
        axes.plot(z, np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi), color=TRUTH_COLOUR)
        held = f"stated 68 % holds {100 * result.coverage_68:.0f} %, stated 95 % holds {100 * result.coverage_95:.0f} %"
        axes.set_title(f"{name}: NEES {result.nees:.2f}\n{held}", fontsize=9)
        axes.set(xlabel="error / stated standard deviation", yticks=[])
    return figure


def intervals() -> Figure:
    """Samples of a drive lie together, so resampling samples gives too short an interval."""
    rng = np.random.default_rng(2)
    groups = np.repeat(np.arange(8), 60)
    values = 1.4 + 0.4 * rng.standard_normal(8)[groups] + 0.15 * rng.standard_normal(len(groups))
    figure, axes = _figure(8.5, 2.8)
    axes.plot(groups + rng.uniform(-0.3, 0.3, len(groups)), values, ".", markersize=3, color="0.5")
    for place, label, unit, colour in ((8.5, "over drives", groups, ESTIMATE), (9.5, "over samples", None, SECOND)):
        interval = interval_over_groups(values, np.arange(len(values)) if unit is None else unit, resamples=2000)
        reach = [[interval.mean - interval.low], [interval.high - interval.mean]]
        axes.errorbar([place], [interval.mean], yerr=reach, fmt="o", capsize=5, color=colour, label=label)
    axes.set_xticks(range(8), [f"drive {k}" for k in range(8)])
    axes.set(ylabel="error of a sample [%]", xlim=(-0.6, 10.2))
    axes.set_title("95 % intervals of the mean: samples of a drive are not independent", fontsize=10)
    axes.legend(fontsize=8, loc="lower right")
    return figure


def _drive() -> tuple[Trajectory, Trajectory]:
    """A curved drive and an estimate of it with a wrong scale and a yaw drift."""
    turn = 0.035 * np.sin(np.arange(60) / 9.0)
    return _dead_reckon(turn, 1.0), _dead_reckon(turn - 0.006, 1.12)


def _dead_reckon(turn: FloatArray, step_m: float) -> Trajectory:
    yaw = np.concatenate([[0.3], 0.3 + np.cumsum(turn)])
    x = np.concatenate([[0.0], np.cumsum(step_m * np.cos(yaw[:-1]))])
    y = np.concatenate([[0.0], np.cumsum(step_m * np.sin(yaw[:-1]))])
    return Trajectory.from_planar(x, y, yaw)


def _paths(axes: Axes, truth: Trajectory, estimate: Trajectory) -> None:
    axes.plot(*truth.planar()[:2], color=TRUTH_COLOUR, linewidth=2, label="ground truth")
    axes.plot(*estimate.planar()[:2], color=ESTIMATE, linewidth=1.5, label="estimate")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [m]", ylabel="y [m]")


def _alike(row: Any, shown_m: FloatArray) -> None:
    """One scale and one section of the plane for all panels, around points ``(2, N)``."""
    low, high = shown_m.min(axis=1) - 3.0, shown_m.max(axis=1) + 3.0
    for axes in row:
        axes.set_aspect("equal", adjustable="box")
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def _figure(width: float, height: float, columns: int = 1) -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(1, columns)


def main() -> None:
    """Draw all."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for stem, figure in drawings().items():
        save(figure, FOLDER / f"{stem}.png")


if __name__ == "__main__":
    main()
