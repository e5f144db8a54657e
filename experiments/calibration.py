"""Do the experts know how wrong they are? Increments against their own standard deviations, by condition.

    python -m experiments.calibration                          the bundled recordings
    python -m experiments.calibration --recordings recorded --figure calibration.png

An expert is calibrated when 68.3 % of its increments lie within one standard deviation of the truth and 95 % within
1.96. The truth is the simulator's noise-free pose. Row 0 of a scene and steps without an increment or a standard
deviation do not count; an expert that states none (TUTORIAL, imported ones without a file) has no row.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.studies import exact_turn, print_study
from mixo_env.leaderboard.conditions import condition_of
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.joint import JOINT
from mixo_env.recordings.presets import data_label
from mixo_env.recordings.store import load_recordings
from mixo_env.tables import Column, Table

FloatArray = NDArray[np.float64]

CONDITIONS = ("day", "rain", "night")
"""A rainy day counts as rain alone."""

LIMITS = {"68 %": 1.0, "95 %": 1.96}

COLUMNS = (
    Column("expert"),
    Column("condition"),
    Column("steps", "", ",.0f"),
    *(Column(f"within {share}", "%", ".1f") for share in LIMITS),
    Column("error / std, RMS", "", ".2f"),
    Column("error, RMS", "deg", ".4f"),
    Column("std, median", "deg", ".4f"),
)


@dataclass(frozen=True)
class Told:
    """One expert under one condition.

    Attributes:
        expert: its name.
        condition: one of ``CONDITIONS``.
        error_rad: ``(n,)`` of its increments over the steps, against exact truth.
        std_rad: ``(n,)`` what it said.
    """

    expert: str
    condition: str
    error_rad: FloatArray
    std_rad: FloatArray

    def within(self, limit: float) -> float:
        """Share [%] of the errors within ``limit`` standard deviations."""
        return 100.0 * float(np.mean(np.abs(self.error_rad) <= limit * self.std_rad))


@dataclass(frozen=True)
class CalibrationStudy:
    """Print how often increments lie within their standard deviations."""

    recordings: Path | None = None
    """Folder of recordings of a simulated drive. None: the bundled mixocity."""
    figure: Path | None = None
    """Picture of stated against observed coverage."""

    def run(self) -> Table:
        """The table, and the figure where one is asked for."""
        recordings = load_recordings(None if self.recordings is None else str(self.recordings))
        told = collect(recordings)
        if self.figure is not None:
            draw(told, self.figure)
        return study(recordings, told)


def collect(recordings: Recordings) -> list[Told]:
    """Errors and standard deviations of every expert that states any, by expert and condition.

    Raises:
        RecordingError: without exact truth.
    """
    truth = exact_turn(recordings)
    condition = np.repeat([condition_of(scene) for scene in recordings.scenes], np.diff(recordings.offsets))
    joint = (JOINT,) if JOINT in recordings.manifest.variants else ()
    found = []
    for expert in (*recordings.experts, *joint):
        error = recordings[f"{expert}.yaw_increment_rad"].astype(np.float64) - truth
        std = recordings[f"{expert}.yaw_std_rad"].astype(np.float64)
        stated = np.isfinite(error) & (std > 0.0)
        for name in CONDITIONS:
            here = stated & (condition == name)
            if here.any():
                found.append(Told(expert, name, error[here], std[here]))
    return found


def study(recordings: Recordings, told: list[Told]) -> Table:
    """The table of what was collected."""
    rows = []
    for part in told:
        ratio = part.error_rad / part.std_rad
        error, std = np.degrees(part.error_rad), np.degrees(part.std_rad)
        inside = [part.within(limit) for limit in LIMITS.values()]
        row = [*inside, _rms(ratio), _rms(error), float(np.median(std))]
        rows.append([part.expert, part.condition, float(len(ratio)), *row])
    caption = (
        f"Increments within their own standard deviations, {data_label(recordings.manifest)}, {len(recordings)} "
        "scenes, against exact truth; a calibrated expert has 68.3 and 95.0 %."
    )
    return Table(caption, COLUMNS, rows)


def draw(told: list[Told], path: Path) -> None:
    """Observed against stated coverage, one panel a condition: above the diagonal an expert is too modest."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from mixo_env.files import atomic_path

    limits = np.linspace(0.0, 3.0, 61)
    stated = [100.0 * math.erf(limit / math.sqrt(2.0)) for limit in limits]
    shown = [name for name in CONDITIONS if any(part.condition == name for part in told)]
    styles = dict(zip(dict.fromkeys(part.expert for part in told), _styles(), strict=False))
    figure = Figure(figsize=(3.4 * len(shown) + 0.6, 4.9), layout="constrained")
    FigureCanvasAgg(figure)
    panels: Any = figure.subplots(1, len(shown), squeeze=False, sharey=True)[0]
    for panel, name in zip(panels, shown, strict=True):
        panel.plot([0, 100], [0, 100], color="black", linewidth=0.8, alpha=0.5)
        for part in (part for part in told if part.condition == name):
            panel.plot(stated, [part.within(limit) for limit in limits], label=part.expert, **styles[part.expert])
        panel.set_title(name, fontsize=9)
        panel.set_xlabel("stated coverage [%]", fontsize=8)
        panel.set_aspect("equal")
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=8)
    panels[0].set_ylabel("observed coverage [%]", fontsize=8)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, handlelength=3.5)
    with atomic_path(path) as part_file:
        figure.savefig(part_file, format="png", dpi=110, metadata={"Software": None})


def _styles() -> list[dict[str, Any]]:
    """Colours that colour-blind eyes tell apart (Okabe and Ito 2008), then the same dashed."""
    colours = ("#0072B2", "#56B4E9", "#009E73", "#CC79A7", "#E69F00", "#D55E00", "#222222")
    return [{"color": colour, "linestyle": dash} for dash in ("-", "--", ":") for colour in colours]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    return print_study(CalibrationStudy, arguments)


if __name__ == "__main__":
    sys.exit(main())
