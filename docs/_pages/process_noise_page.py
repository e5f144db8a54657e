"""Write docs/inertial.md: how much depends on the process noise Q of inertial odometry, which the paper does not give.

    python -m docs._pages.process_noise_page ~/.cache/mixocity/city --workers 2

The CAN bus of every recorded scene is filtered anew with Q times 0.01 to 100; the cameras stay as they were recorded.
The folder is the one the recordings were made from (for the bundled ones that of ``experiments.mixocity``), or the same
simulated without images, in seconds: with Q as it is, every increment must come out as recorded, or nothing is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import tyro
from numpy.typing import NDArray

from mixo_env.errors import DatasetError, MixoError
from mixo_env.experts.inertial import (
    GRADES,
    SPEED_VARIANCE,
    YAW_RATE_VARIANCE,
    InertialOdometry,
    ProcessNoise,
    grade_inputs,
)
from mixo_env.files import atomic_path, write_text
from mixo_env.leaderboard.board import build
from mixo_env.leaderboard.rows import Score
from mixo_env.leaderboard.sentences import conventions
from mixo_env.nuscenes.can_bus import read_can_bus
from mixo_env.nuscenes.scene import CanBus, FloatArray, Signal
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.processes import processes
from mixo_env.recordings.store import load_recordings
from mixo_env.tables import Column, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FACTORS = (0.01, 0.1, 1.0, 10.0, 100.0)

TRACK, VOTER = "CONSUMER", "INERTIAL_CONSUMER"
"""Four cameras and one inertial expert; each grade in turn takes that expert's place."""

PAPER_WEIGHT = 0.1222
"""LINEAR's weight of the inertial expert as printed in the paper."""

DOCS = Path(__file__).parents[1]
PICTURE = Path("figures") / "process-noise.png"
COLUMNS = (
    Column("grade"),
    Column("Q", "times", "g"),
    Column("speed follows in", "s", ".2f"),
    Column("yaw rate follows in", "s", ".2f"),
    Column("RTE", "%", ".2f"),
    Column("RTE", "deg/m", ".4f"),
    Column("yaw increment RMSE", "deg", ".4f"),
    Column("LINEAR's weight of it (folds)"),
    Column("LINEAR's RTE", "%", ".2f"),
    Column("LINEAR's RTE", "deg/m", ".4f"),
)
COLOURS = {"INERTIAL": "#0072b2", "INERTIAL_POSE": "#009e73", "INERTIAL_CONSUMER": "#d55e00"}


@dataclass(frozen=True)
class Outcome:
    """One grade with one Q.

    Attributes:
        alone: score of the grade without cameras.
        linear: score of LINEAR over the four cameras and the grade.
        weights: ``(folds,)`` LINEAR's weight of the grade, by held-out fold.
    """

    alone: Score
    linear: Score
    weights: FloatArray


Outcomes = dict[tuple[str, float], Outcome]
"""By grade and factor of Q."""


def scaled(factor: float) -> ProcessNoise:
    """Both densities of Q times ``factor``."""
    usual = ProcessNoise()
    return ProcessNoise(factor * usual.acceleration, factor * usual.yaw_acceleration)


def filtered(
    recordings: Recordings, buses: Sequence[CanBus], grade: str, factor: float, workers: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Yaw increment [rad] and distance [m] of every step, ``(rows,)``; NaN in row 0 and where the grade is missing."""
    from joblib import Parallel, delayed

    tasks = (
        delayed(_filter_scene)(bus, grade, factor, recordings.rows(i)["timestamp_us"]) for i, bus in enumerate(buses)
    )
    with processes(workers):
        yaw, distance = np.concatenate(cast("list[FloatArray]", Parallel()(tasks)), axis=1)
    return yaw, distance


def _filter_scene(bus: CanBus, grade: str, factor: float, timestamp_us: NDArray[np.int64]) -> FloatArray:
    """``(2, rows)`` yaw increments and distances of one scene."""
    found = np.full((2, len(timestamp_us)), np.nan)
    try:
        odometry = InertialOdometry(bus, grade, process_noise=scaled(factor))
    except DatasetError:  # as recorded: the scene lacks this grade
        return found
    track = odometry.at(timestamp_us)
    found[:, 1:] = np.diff(track.yaw_rad), np.diff(track.distance_m)
    return found


def study(recordings: Recordings, buses: Sequence[CanBus], workers: int = 1) -> Outcomes:
    """All grades with all Q.

    Raises:
        DatasetError: the CAN bus is not the one that was recorded.
    """
    outcomes: Outcomes = {}
    for factor in sorted(FACTORS, key=lambda factor: factor != 1.0):  # as recorded first: it may fail
        motion = {grade: filtered(recordings, buses, grade, factor, workers) for grade in GRADES}
        columns = {f"{grade}.yaw_increment_rad": yaw.astype(np.float32) for grade, (yaw, _) in motion.items()}
        columns["distance_m"] = motion["INERTIAL"][1].astype(np.float32)
        if factor == 1.0:
            for name, values in columns.items():
                check(recordings, name, values)
        for grade in GRADES:
            chosen = columns | {f"{VOTER}.yaw_increment_rad": columns[f"{grade}.yaw_increment_rad"]}
            board = build(recordings.replace(columns=chosen), tracks=(TRACK,), policies=(VOTER, "LINEAR"))
            (table,) = board.standings
            alone, linear = (row.headline for row in table.rows)
            weights = np.array([by_expert[VOTER] for by_expert in table.linear_weights().values()])
            outcomes[grade, factor] = Outcome(alone, linear, weights)
    return outcomes


def check(recordings: Recordings, column: str, again: np.ndarray[Any, Any]) -> None:
    """Raise :class:`DatasetError` unless ``again`` ``(rows,)`` is what ``column`` holds, but for the last digit."""
    recorded = recordings[column]
    wrong = ~np.isclose(again, recorded, rtol=1e-5, atol=1e-9, equal_nan=True)
    if wrong.any():
        row = int(np.argmax(wrong))
        scene = recordings.scenes[int(np.searchsorted(recordings.offsets, row, side="right")) - 1].name
        raise DatasetError(
            f"{scene}: expected {column} {recorded[row]:.7g} as recorded, its CAN bus gives {again[row]:.7g}: give the "
            "folder that was recorded, or simulate its configuration"
        )


def time_constant_s(signals: Sequence[Signal], measurement_variance: float, density: float) -> float:
    """How long the filtered rate takes to follow a step of the measured one down to 1/e, at the usual message rate.

    In steady state the variance p before a message solves p^2 = q (p + R), with q the density times the interval, and
    every message leaves the share R / (p + R) of an error.
    """
    interval_s = 1e-6 * float(np.median(np.concatenate([np.diff(signal.timestamp_us) for signal in signals])))
    q = density * interval_s
    prior = 0.5 * (q + np.sqrt(q * q + 4.0 * q * measurement_variance))
    return float(interval_s / np.log1p(prior / measurement_variance))


def table(buses: Sequence[CanBus], outcomes: Outcomes) -> Table:
    """One line per grade and Q."""
    inputs = {grade: [grade_inputs(bus, grade) for bus in buses if _has(bus, grade)] for grade in GRADES}
    rows = []
    for grade in GRADES:
        speeds, rates = (list(signals) for signals in zip(*inputs[grade], strict=True))
        for factor in FACTORS:
            noise, outcome = scaled(factor), outcomes[grade, factor]
            rows.append(
                (
                    f"`{grade}`",
                    factor,
                    time_constant_s(speeds, SPEED_VARIANCE, noise.acceleration),
                    time_constant_s(rates, YAW_RATE_VARIANCE[grade], noise.yaw_acceleration),
                    outcome.alone.translation_percent.mean,
                    outcome.alone.rotation_deg_per_m.mean,
                    outcome.alone.yaw_increment_rmse_deg,
                    f"{outcome.weights.mean():.3f} ({outcome.weights.min():.3f} to {outcome.weights.max():.3f})",
                    outcome.linear.translation_percent.mean,
                    outcome.linear.rotation_deg_per_m.mean,
                )
            )
    return Table("", COLUMNS, rows)


def crossing(outcomes: Outcomes, grade: str) -> str:
    """The factor of Q at which LINEAR's mean weight of a grade is the paper's, in words."""
    weights = np.array([outcomes[grade, factor].weights.mean() for factor in FACTORS])
    above = weights > PAPER_WEIGHT
    if above.all() or not above.any():
        return f"`{grade}`: {'above' if above.all() else 'below'} it everywhere"
    k = int(np.flatnonzero(above[1:] != above[:-1])[0])
    share = (PAPER_WEIGHT - weights[k]) / (weights[k + 1] - weights[k])
    decades = np.interp(share, (0.0, 1.0), np.log10(FACTORS[k : k + 2]))
    return f"`{grade}`: at Q x {10.0**decades:.2g}"


def _has(bus: CanBus, grade: str) -> bool:
    try:
        grade_inputs(bus, grade)
    except DatasetError:
        return False
    return True


def draw(outcomes: Outcomes) -> Figure:
    """LINEAR's weight of the inertial expert, and the error of one step, against the factor of Q."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    weight, yaw = figure.subplots(1, 2)
    for grade in GRADES:
        mine = [outcomes[grade, factor] for factor in FACTORS]
        style = {"color": COLOURS[grade], "marker": "o", "markersize": 4, "label": grade}
        weight.plot(FACTORS, [one.weights.mean() for one in mine], **style)
        low, high = ([edge(one.weights) for one in mine] for edge in (np.min, np.max))
        weight.fill_between(FACTORS, low, high, color=COLOURS[grade], alpha=0.15, linewidth=0)
        yaw.plot(FACTORS, [one.alone.yaw_increment_rmse_deg for one in mine], **style)
    weight.axhline(PAPER_WEIGHT, color="0.3", linestyle="--", label="the paper's")
    weight.set(ylabel="LINEAR's weight of the inertial expert")
    yaw.set(ylabel="yaw increment RMSE, alone [deg]")
    for axis in (weight, yaw):
        axis.set_ylim(bottom=0.0)
        axis.set(xscale="log", xlabel="process noise Q, times the default", xticks=FACTORS)
        axis.set_xticklabels([f"{factor:g}" for factor in FACTORS])
        axis.grid(alpha=0.3)
    weight.legend(fontsize=8)
    return figure


TEXT = """# Inertial odometry and its process noise

<!-- Written by `python -m docs._pages.process_noise_page`; change that. -->

The inertial expert is the paper's discrete Kalman filter on speed and yaw rate from the CAN bus, with its printed
`R = diag(0.1, 0.01)` and `P0 = 0` (`mixo_env.experts.inertial`). The paper does not print the process noise Q, and with
`Q = 0` the filter would keep its first speed for ever. Here acceleration and yaw acceleration are white noise with the
densities {acceleration:g} m^2/s^3 and {yaw_acceleration:g} rad^2/s^3, the most likely ones for wheels and gyro of real
scenes (`python -m experiments.fit_process_noise`). This page multiplies both by 0.01 to 100.

The only trace that the paper's Q left in print is the weight of its inertial odometry in LINEAR, which fits one
constant weight per expert: {paper:.3f}.

![LINEAR's weight and the error of one step against Q](figures/process-noise.png)

Shaded: lowest and highest weight among the held-out folds. LINEAR's mean weight of the inertial expert is the paper's
{paper:.3f} (interpolated on the logarithmic scale of Q):

{crossings}

The paper's own sensor is the CAN message `pose` (`INERTIAL_POSE`); the cameras that compete with it for the weight are
this project's, not the paper's.

Q decides how late a *change* of speed or yaw rate enters ("follows in": down to 1/e of a step of the sensor). It hardly
decides where the car ends up: what the filter is late with in one step it makes good in the next ones. So RTE stays
almost the same where the error of single steps, on which LINEAR fits its weights, changes a lot.

| grade | speed | yaw rate | its variance in R [rad^2/s^2] |
|---|---|---|---|
| `INERTIAL` | rear wheels | `ms_imu`, 100 Hz; bias taken off after standstill | {inertial:g} |
| `INERTIAL_POSE` | `pose` | `pose`, 50 Hz, as in the paper | {pose:g} |
| `INERTIAL_CONSUMER` | rear wheels | production gyro (simulated), else `vehicle_monitor`; as above | {consumer:g} |

{table}
RTE and yaw increment RMSE are those of the inertial expert alone; LINEAR mixes it with the {cameras} cameras, whose
increments stay as they were recorded; as everywhere it stands in for a camera that is lost, and distance comes from the
wheels, here filtered with the same Q. Q x 1 is the recording itself.

{conventions}
"""


@dataclass(frozen=True)
class ProcessNoisePage:
    """Write docs/inertial.md and its figure.

    Example: python -m docs._pages.process_noise_page ~/.cache/mixocity/city --workers 2
    """

    root: tyro.conf.Positional[Path]
    """Folder that holds can_bus/: of the data set that was recorded, or simulated like it without images."""
    recordings: str | None = None
    """Folder of the recordings, or the name of bundled ones; None: the bundled mixocity."""
    out: Path = DOCS
    """Folder of the page; the figure goes into its folder figures."""
    workers: int = 1
    """Processes; the page does not depend on it."""

    def run(self) -> int:
        """Filter, score, write."""
        recordings = load_recordings(self.recordings)
        buses = []
        for scene in recordings.scenes:
            bus = read_can_bus(self.root / "can_bus", scene.name)
            if bus is None:
                raise DatasetError(f"{self.root / 'can_bus'} holds no messages of {scene.name}: give another folder")
            buses.append(bus)
        outcomes = study(recordings, buses, self.workers)
        noise = ProcessNoise()
        recorded = build(recordings, tracks=(TRACK,), policies=("LINEAR",))
        text = TEXT.format(
            acceleration=noise.acceleration,
            yaw_acceleration=noise.yaw_acceleration,
            paper=PAPER_WEIGHT,
            crossings="\n".join(f"* {crossing(outcomes, grade)}" for grade in GRADES),
            inertial=YAW_RATE_VARIANCE["INERTIAL"],
            pose=YAW_RATE_VARIANCE["INERTIAL_POSE"],
            consumer=YAW_RATE_VARIANCE["INERTIAL_CONSUMER"],
            table=table(buses, outcomes).markdown().lstrip(),
            cameras=len(recordings.manifest.cameras),
            conventions="\n".join(f"* {line}" for line in conventions(recorded)),
        )
        (self.out / PICTURE).parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(self.out / PICTURE) as temporary:
            draw(outcomes).savefig(temporary, dpi=110, format="png")
        write_text(self.out / "inertial.md", text)
        print(f"wrote {self.out / 'inertial.md'} and {self.out / PICTURE}")
        return 0


if __name__ == "__main__":
    import sys

    try:
        sys.exit(tyro.cli(ProcessNoisePage, description=__doc__).run())
    except MixoError as error:
        sys.exit(f"process_noise_page: {error}")
