"""Weights of the gates, over time and by manoeuvre, on scenes that were held out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mixo_env.files import atomic_path
from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.manoeuvres import MANOEUVRES, Preference, played_weights, preference
from mixo_env.leaderboard.paper.parts import NotHereError, Subject, marked, yaw_error_rad
from mixo_env.tables import Cell, Column, Table

GATES = ("LINEAR", "LINEAR GATE", "MIXO", "HUBER", "SOFTMIN", "TOKEN", "TANDEM", "TRIO", "MULTICAMERA GT")
COLOURS = ("#0072B2", "#56B4E9", "#E69F00", "#CC79A7", "#999999", "#009E73", "#D55E00", "#222222")
"""Of experts; colour-blind eyes tell them apart (Okabe and Ito 2008)."""
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1)), (0, (5, 1.5, 1, 1.5)))


def gates_weights(subject: Subject) -> dict[str, FloatArray]:
    """Gate -> ``(rows, voters)`` weights, NaN in scenes on which it was not tested.

    Raises:
        NotHereError: when no gate was run.
    """
    protocol, voters = subject.board.protocol, subject.board.recordings.voters(subject.track)
    runs = {name: row.run for name, row in subject.rows.items() if name in GATES and row.run.policies}
    fitting = {name: run for name, run in runs.items() if all(p.experts == voters for p in run.policies.values())}
    if not fitting:
        raise NotHereError(f"none of {', '.join(GATES)} was run")
    return {name: played_weights(protocol, run, subject.track) for name, run in fitting.items()}


def preferences(subject: Subject, weights: Mapping[str, FloatArray]) -> list[Preference]:
    """Of every gate, by manoeuvre."""
    rows = ((subject.rows[name], given) for name, given in weights.items())
    return [
        preference(marked(row), given, yaw_error_rad(subject, row), subject.board.recordings, subject.track)
        for row, given in rows
    ]


def by_manoeuvre(subject: Subject, found: Sequence[Preference]) -> Table:
    """A line a gate and manoeuvre; a weight with a star differs from that on straight roads by more than chance."""
    lines: list[list[Cell]] = []
    begins = []
    for one in found:
        begins.append(len(lines))
        for k in np.flatnonzero(one.steps):
            cells = [f"{one.mean[k, e]:.3f}{'*' if one.changed[k, e] else ''}" for e in range(len(one.experts))]
            lines.append([one.row, MANOEUVRES[k], int(one.steps[k]), *cells, float(one.rms_deg[k])])
    caption = (
        f"Mean weights by manoeuvre on held-out scenes. {subject.data}; steps in which every expert gives an "
        "increment. * differs from straight: the 95 % interval over logs excludes 0. Error: RMS of the yaw step."
    )
    experts = (Column(name) for name in found[0].experts)
    columns = Column("row"), Column("manoeuvre"), Column("steps", "", ",.0f"), *experts, Column("error", "deg", ".4f")
    return Table(caption, columns, lines, begins[1:])


def draw_by_manoeuvre(found: Sequence[Preference], path: Path) -> None:
    """Stacked weights, one panel a row; an expert whose weight differs from straight by more than chance is framed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(len(found), 3)
    rows = -(-len(found) // columns)
    figure = Figure(figsize=(3.3 * columns, 2.5 * rows + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    panels: Any = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for panel in panels[len(found) :]:
        panel.set_visible(False)
    for panel, one in zip(panels, found, strict=False):
        bottom = np.zeros(len(MANOEUVRES))
        for e, (expert, colour) in enumerate(zip(one.experts, COLOURS, strict=False)):
            height = np.nan_to_num(np.maximum(one.mean[:, e], 0.0))
            edges = ["black" if framed else "none" for framed in one.changed[:, e]]
            panel.bar(MANOEUVRES, height, bottom=bottom, color=colour, edgecolor=edges, linewidth=1.4, label=expert)
            bottom += height
        panel.set_title(one.row, fontsize=9)
        panel.tick_params(labelsize=7)
        panel.set_ylim(0.0, 1.05)
    panels[0].set_ylabel("weight", fontsize=8)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(5, 2 * columns), fontsize=8)
    with atomic_path(path) as part_file:
        figure.savefig(part_file, format="png", dpi=110, metadata={"Software": None})


def draw_over_time(subject: Subject, weights: Mapping[str, FloatArray], path: Path) -> None:
    """Weights of every gate that reads no truth along the scene that turns most, over the true yaw rate.

    Raises:
        NotHereError: when there is no such gate, or no scene on which all were tested.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = {name: given for name, given in weights.items() if not subject.rows[name].run.privileged}
    recordings = subject.judged
    offsets, voters = recordings.offsets, recordings.voters(subject.track)
    played = [i for i in range(len(recordings)) if all(np.isfinite(w[offsets[i] + 1]).all() for w in shown.values())]
    if not shown or not played:
        raise NotHereError("no gate that reads no truth was run on any common scene")
    scene = max(played, key=lambda i: np.ptp(recordings["truth.yaw_rad"][offsets[i] : offsets[i + 1]]))
    steps = slice(offsets[scene] + 1, offsets[scene + 1])
    time_s = recordings["time_s"][steps] - recordings["time_s"][offsets[scene]]
    figure = Figure(figsize=(9.0, 1.5 * (len(shown) + 1) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels: Any = figure.subplots(len(shown) + 1, 1, sharex=True)
    for panel, (name, given) in zip(panels, shown.items(), strict=False):
        for e, expert in enumerate(voters):
            colour, dashes = COLOURS[e % len(COLOURS)], DASHES[e % len(DASHES)]
            panel.plot(time_s, given[steps, e], color=colour, linestyle=dashes, linewidth=1.2, label=expert)
        panel.set_ylabel("weight", fontsize=8)
        panel.set_title(marked(subject.rows[name]), fontsize=9, loc="left")
    rate = np.degrees(recordings["truth.yaw_increment_rad"][steps]) / recordings["dt_s"][steps]
    panels[-1].plot(time_s, rate, color="black", linewidth=1.2)
    panels[-1].set_title("true yaw rate, left is positive", fontsize=9, loc="left")
    panels[-1].set_ylabel("deg/s", fontsize=8)
    panels[-1].set_xlabel(f"time in {recordings.scenes[scene].name} [s]", fontsize=8)
    for panel in panels:
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=8)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, handlelength=3.5)
    figure.suptitle(subject.data, fontsize=9)
    with atomic_path(path) as part_file:
        figure.savefig(part_file, format="png", dpi=110, metadata={"Software": None})
