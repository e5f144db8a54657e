"""Does this odometry lie now? How well each signal an odometry gives warns of a large error.

    python -m experiments.lies                                  the bundled recordings
    python -m experiments.lies --recordings recorded --track PAPER --figure lies.png

An odometry lies in a step whose increment errs by more than ``limit`` sigma_0 (the unit of rewards: the robust spread
of LINEAR's error). Signals are compared by the area under their ROC curve, 0.5 for a coin and 1 for a perfect alarm,
with an interval over logs, and by the false alarms that finding 90 % of the lies costs. What is learned (how large an
expert's errors are, for the consensus; one regression) comes from folds that hold none of the judged scenes.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.lie_signals import COMBINED, combined, fit_combined, signals
from mixo_env.errors import MixoError
from mixo_env.leaderboard.conditions import condition_of
from mixo_env.leaderboard.crossvalidation import UNFOLDED, CrossValidation
from mixo_env.leaderboard.manoeuvres import MANOEUVRES, manoeuvre_of
from mixo_env.metrics.bootstrap import Interval
from mixo_env.metrics.detection import area_under_roc, false_alarms, roc
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.folds import OUT_OF_DISTRIBUTION
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import for_learning, truths_of, with_truth
from mixo_env.tables import Column, Table

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]

DETECTION = 0.9
LEAST_LIES = 10
"""Fewer tell nothing."""
CONDITIONS = ("all", "day", "rain", "night", "turning", "together")
"""``together``: of all lies only those in which at least one other expert lies to the same side."""
LEAST_LOGS = 5
"""With lies on fewer logs there is no interval."""

COLUMNS = (
    Column("expert"),
    Column("condition"),
    Column("signal"),
    Column("lies", "%", ".2f"),
    Column("area", "", ".3f"),
    Column("low", "", ".3f"),
    Column("high", "", ".3f"),
    Column("false alarms", "1/min", ".1f"),
    Column("at", "", ".3g"),
)


@dataclass(frozen=True)
class Watched:
    """One expert, all steps in which it gives an increment and scenes that were held out; ``(n,)`` each.

    Attributes:
        expert: its name.
        lies: whether it errs by more than the limit.
        signals: name -> value, the higher the more it warns; NaN where there is none.
        log: whose scene it is.
        condition: day, rain or night.
        turning: the car turns, by the truth.
        in_company: at least one other expert lies to the same side.
        dt_s: duration of a step [s].
    """

    expert: str
    lies: NDArray[np.bool_]
    signals: Mapping[str, FloatArray]
    log: NDArray[np.str_]
    condition: NDArray[np.str_]
    turning: NDArray[np.bool_]
    in_company: NDArray[np.bool_]
    dt_s: FloatArray

    def where(self, condition: str) -> NDArray[np.bool_]:
        """``(n,)`` the steps under one of ``CONDITIONS``."""
        if condition == "all":
            return np.ones(len(self.lies), dtype=np.bool_)
        if condition == "together":
            return ~self.lies | self.in_company
        return self.turning if condition == "turning" else self.condition == condition


@dataclass(frozen=True)
class Verdict:
    """How well one signal warns of one expert's lies under one condition.

    Attributes:
        expert, condition, signal: which.
        share: of lies among the steps.
        area: under the ROC curve, with its interval over logs; NaN where there are hardly any lies.
        per_minute: false alarms a minute of driving where 90 % of the lies are found, every step counted.
        threshold: of the signal there.
    """

    expert: str
    condition: str
    signal: str
    share: float
    area: Interval
    per_minute: float
    threshold: float


@dataclass(frozen=True)
class Lies:
    """Print how well each signal warns of a large error."""

    recordings: Path | None = None
    """Folder of recordings. None: the bundled mixocity."""
    track: str = "VISION"
    """Whose experts are judged, and make up the consensus."""
    limit: float = 4.0
    """Errors beyond so many sigma_0 are lies."""
    figure: Path | None = None
    """Picture of the ROC curves."""

    def run(self) -> Table:
        """The table, and the figure where one is asked for."""
        recordings = load_recordings(None if self.recordings is None else str(self.recordings))
        watched = watch(recordings, self.track, self.limit)
        if self.figure is not None:
            draw(watched, self.figure)
        limit_deg = float(np.degrees(self.limit * recordings.manifest.reward_scale_rad[self.track]))
        return table(judge(watched), f"{recordings.manifest.data_version}, errors above {limit_deg:.3f} deg a step")


def parts(recordings: Recordings) -> Iterator[tuple[Recordings, Recordings]]:
    """Training scenes and held-out scenes, fold by fold; night scenes are judged with everything else as training."""
    inside = CrossValidation(recordings)
    for fold in inside.folds if not inside.foreign else (UNFOLDED,):
        tested = inside.recordings if inside.foreign else inside.recordings.select(folds=[fold])
        yield for_learning(inside.training(fold)), tested
    if inside.folds and any(scene.fold == OUT_OF_DISTRIBUTION for scene in recordings.scenes):
        night = CrossValidation(recordings, out_of_distribution=True)
        yield for_learning(night.training(UNFOLDED)), night.recordings


def watch(recordings: Recordings, track: str = "VISION", limit: float = 4.0) -> list[Watched]:
    """Signals and lies of every expert of a track, on held-out scenes.

    Raises:
        ConfigurationError: for a track that these recordings do not have.
    """
    experts = recordings.voters(track)
    bound = limit * recordings.manifest.reward_scale_rad[track]
    found: dict[str, list[Watched]] = {expert: [] for expert in experts}
    for training, tested in parts(recordings):
        known, told = signals(training, training, experts), signals(training, tested, experts)
        truth = training["truth.yaw_increment_rad"]
        judged = with_truth(tested, truths_of(tested)[0])
        errors = np.stack(
            [judged[f"{e}.yaw_increment_rad"] - judged["truth.yaw_increment_rad"] for e in experts], axis=1
        )
        rows = np.diff(judged.offsets)
        log = np.repeat([scene.log for scene in judged.scenes], rows)
        condition = np.repeat([condition_of(scene) for scene in judged.scenes], rows)
        turning = np.isin(manoeuvre_of(judged), [MANOEUVRES.index(side) for side in ("left", "right")])
        for i, expert in enumerate(experts):
            weights = fit_combined(known[expert], training[f"{expert}.yaw_increment_rad"] - truth)
            by_signal = {**told[expert], COMBINED: combined(told[expert], weights)}
            given = np.isfinite(errors[:, i])
            found[expert].append(
                Watched(
                    expert,
                    np.abs(errors[given, i]) > bound,
                    {name: values[given] for name, values in by_signal.items()},
                    log[given],
                    condition[given],
                    turning[given],
                    in_company(errors, i, bound)[given],
                    judged["dt_s"][given].astype(np.float64),
                )
            )
    return [joined(pieces) for pieces in found.values()]


def joined(pieces: list[Watched]) -> Watched:
    """One expert's folds, one after the other."""
    first = pieces[0]
    return Watched(
        first.expert,
        np.concatenate([p.lies for p in pieces]),
        {name: np.concatenate([p.signals[name] for p in pieces]) for name in first.signals},
        np.concatenate([p.log for p in pieces]),
        np.concatenate([p.condition for p in pieces]),
        np.concatenate([p.turning for p in pieces]),
        np.concatenate([p.in_company for p in pieces]),
        np.concatenate([p.dt_s for p in pieces]),
    )


def judge(watched: list[Watched]) -> list[Verdict]:
    """Every expert, condition and signal; a signal that an expert does not have is left out."""
    verdicts = []
    for one in watched:
        for condition in CONDITIONS:
            here = one.where(condition)
            if not here.any():
                continue
            share = float(one.lies[here].mean())
            for name, values in one.signals.items():
                told = here & np.isfinite(values)
                if told.any():
                    verdicts.append(Verdict(one.expert, condition, name, share, *_judged(one, values, told)))
    return verdicts


def _judged(one: Watched, values: FloatArray, told: NDArray[np.bool_]) -> tuple[Interval, float, float]:
    lies, logs = one.lies[told], one.log[told]
    if lies.sum() < LEAST_LIES or lies.all():
        return Interval(np.nan, np.nan, np.nan, len(np.unique(logs)), 0.95), np.nan, np.nan
    threshold, alarmed = false_alarms(values[told], lies, DETECTION)
    quiet_per_minute = 60.0 * float(np.sum(~lies)) / float(np.sum(one.dt_s[told]))
    area = area_under_roc(values[told], lies, logs)
    if len(np.unique(logs[lies])) < LEAST_LOGS:
        area = replace(area, low=np.nan, high=np.nan)
    return area, alarmed * quiet_per_minute, threshold


def table(verdicts: list[Verdict], what: str) -> Table:
    """All verdicts; features, shares, px, rad and rad/s in the column of thresholds."""
    rows = [
        [
            *(v.expert, v.condition, v.signal, 100.0 * v.share),
            *(v.area.mean, v.area.low, v.area.high, v.per_minute, v.threshold),
        ]
        for v in verdicts
    ]
    begins = [k for k in range(1, len(rows)) if rows[k][:2] != rows[k - 1][:2]]
    caption = (
        f"Warnings of lies on held-out scenes, {what}: area under the ROC curve (95 % interval over logs), false "
        f"alarms a minute where {100.0 * DETECTION:.0f} % of the lies are found, and the signal there."
    )
    return Table(caption, COLUMNS, rows, begins)


def draw(watched: list[Watched], path: Path) -> None:
    """ROC curves, one panel an expert."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from mixo_env.files import atomic_path

    shown = [one for one in watched if LEAST_LIES <= one.lies.sum() < len(one.lies)]
    columns = min(len(shown), 2)
    rows = -(-len(shown) // columns)
    figure = Figure(figsize=(4.2 * columns, 4.0 * rows + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    panels: Any = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for panel, one in zip(panels, shown, strict=False):
        for name, style in zip(one.signals, _styles(), strict=False):
            values = one.signals[name]
            told = np.isfinite(values)
            if told.any():
                _, alarmed, detected = roc(values[told], one.lies[told])
                panel.plot(100.0 * alarmed, 100.0 * detected, label=name, **style)
        panel.axhline(100.0 * DETECTION, color="black", linewidth=0.6, alpha=0.4)
        panel.plot([0, 100], [0, 100], color="black", linewidth=0.6, alpha=0.4)
        panel.set_title(f"{one.expert}: {100.0 * one.lies.mean():.2f} % of its steps are lies", fontsize=9)
        panel.set_aspect("equal")
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=8)
    for panel in panels[-columns:]:
        panel.set_xlabel("steps without a lie that raise an alarm [%]", fontsize=8)
    for panel in panels[::columns]:
        panel.set_ylabel("lies that raise an alarm [%]", fontsize=8)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, handlelength=3.5)
    with atomic_path(path) as part_file:
        figure.savefig(part_file, format="png", dpi=110, metadata={"Software": None})


def _styles() -> list[dict[str, Any]]:
    """Colours that colour-blind eyes tell apart; what an odometry says of itself dashed, the rest solid."""
    own = ("#0072B2", "#56B4E9", "#009E73", "#CC79A7", "#E69F00", "#D55E00", "#999999")
    alone = [{"color": colour, "linestyle": "--", "linewidth": 1.1} for colour in own]
    return [*alone, *({"color": c, "linestyle": "-", "linewidth": 1.8} for c in ("#0072B2", "#D55E00", "#222222"))]


def in_company(errors: FloatArray, expert: int, bound: float) -> NDArray[np.bool_]:
    """``(rows,)`` whether at least one other lies to the same side as ``expert``; ``errors`` ``(rows, experts)``."""
    side = np.sign(errors) * (np.abs(errors) > bound)
    return ((side == side[:, [expert]]) & (side != 0.0)).sum(axis=1) > 1


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    import tyro

    try:
        print(tyro.cli(Lies, args=arguments).run().text(), end="")
    except MixoError as error:
        logger.error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
