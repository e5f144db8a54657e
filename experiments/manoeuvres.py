"""Does a gate prefer cameras by manoeuvre, and does that pay? Weights of every gate, straight, left, right, standing.

    python -m experiments.manoeuvres                              the paper's experts, bundled recordings
    python -m experiments.manoeuvres --track CONSUMER --rows MIXO TOKEN --figure manoeuvres.png

Besides the gates: MULTICAMERA GT †, whose weights are how often each camera is nearest the truth, and LINEAR BY
MANOEUVRE †, which is told the manoeuvre by the truth and has constant weights for each, fitted on the other folds: all
that a preference by manoeuvre alone can bring.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import MixoError
from mixo_env.fusion import least_squares_weights, mix
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.evaluation import Truth, with_wheels
from mixo_env.leaderboard.manoeuvres import MANOEUVRES, Preference, manoeuvre_of, played_weights, preference
from mixo_env.leaderboard.paper.weights import draw_by_manoeuvre
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.substitutes import substituted_increments
from mixo_env.recordings.truths import with_truth
from mixo_env.tables import Column, Table

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]

GATES = ("LINEAR", "LINEAR GATE", "MIXO", "HUBER", "SOFTMIN", "TOKEN", "TANDEM", "TRIO")
BEST = "MULTICAMERA GT"
TOLD = "LINEAR BY MANOEUVRE †"


@dataclass(frozen=True)
class Finding:
    """One row: whom it prefers when, and how well it does.

    Attributes:
        preference: weights and errors by manoeuvre.
        deg_per_m: its relative rotation error over everything.
    """

    preference: Preference
    deg_per_m: float


@dataclass(frozen=True)
class Manoeuvres:
    """Print the weights of gates by manoeuvre."""

    recordings: Path | None = None
    """Folder of recordings. None: the bundled mixocity."""
    track: str = "PAPER"
    """Whose experts vote."""
    rows: tuple[str, ...] = GATES
    """Gates to look at; one that is too slow to fit for every fold (PPO) is shown on the last one."""
    seeds: int = 3
    """Of learned gates; weights and errors are their means."""
    figure: Path | None = None
    """Picture of the weights."""

    def run(self) -> Table:
        """The table, and the figure where one is asked for."""
        recordings = load_recordings(None if self.recordings is None else str(self.recordings))
        findings = study(recordings, self.track, self.rows, self.seeds)
        if self.figure is not None:
            draw_by_manoeuvre([finding.preference for finding in findings], self.figure)
        return table(findings, f"{recordings.manifest.data_version}, track {self.track}")


def study(recordings: Recordings, track: str, rows: Sequence[str] = GATES, seeds: int = 3) -> list[Finding]:
    """Every row, on held-out scenes.

    Raises:
        ConfigurationError: for an unknown row or track.
        PolicyError: for a row that cannot be fitted here.
    """
    protocol = CrossValidation(recordings)
    return [*(_looked_at(recordings, protocol, name, track, seeds) for name in (*rows, BEST)), told(protocol, track)]


def _looked_at(recordings: Recordings, protocol: CrossValidation, name: str, track: str, seeds: int) -> Finding:
    weights, squares, relative = [], [], []
    truth = Truth(protocol.recordings, protocol.truths[0])
    folds = protocol.tested_folds[-1:] if protocol.expensive(name) else None
    shown = name
    for seed in range(seeds):
        trial = protocol if seed == 0 else CrossValidation(recordings, Trial(seed))
        run = trial.run(name, track, folds=folds)
        weights.append(played_weights(trial, run, track))
        squares.append((run.travel.yaw_increment_rad - _turns(protocol)) ** 2)
        pieces = truth.measure(run.travel).relative
        relative.append(pieces.rotation_deg_per_m[run.tested[pieces.scene]].mean())
        shown = f"{name} †" if run.privileged else name
        if not run.learns:
            break
    error = np.sqrt(np.mean(squares, axis=0))
    one = preference(shown, np.mean(weights, axis=0), error, protocol.recordings, track)
    return Finding(one, float(np.mean(relative)))


def told(protocol: CrossValidation, track: str) -> Finding:
    """Constant weights for each manoeuvre, of least squared error on the other folds; the truth tells the manoeuvre."""
    recordings = protocol.recordings
    votes, manoeuvre = substituted_increments(recordings, track), manoeuvre_of(recordings)
    weights = np.full(votes.shape, np.nan)
    fold_of_row = np.repeat([scene.fold for scene in recordings.scenes], np.diff(recordings.offsets))
    for fold in protocol.folds:
        training = protocol.training(fold)
        seen, turns = substituted_increments(training, track), training["truth.yaw_increment_rad"]
        usable = np.isfinite(turns) & np.isfinite(seen).all(axis=1)
        doing = manoeuvre_of(training)
        for k in range(len(MANOEUVRES)):
            rows = usable & (doing == k)
            weights[(fold_of_row == fold) & (manoeuvre == k)] = least_squares_weights(seen[rows], turns[rows])
    travel = with_wheels(recordings, mix(weights, votes))
    relative = Truth(recordings, protocol.truths[0]).measure(travel).relative.rotation_deg_per_m
    error = travel.yaw_increment_rad - _turns(protocol)
    return Finding(preference(TOLD, weights, error, recordings, track), float(relative.mean()))


def _turns(protocol: CrossValidation) -> FloatArray:
    return with_truth(protocol.recordings, protocol.truths[0])["truth.yaw_increment_rad"]


def table(findings: Sequence[Finding], what: str) -> Table:
    """A line a row and manoeuvre."""
    experts = findings[0].preference.experts
    columns = (
        Column("row"),
        Column("manoeuvre"),
        Column("steps", "", ",.0f"),
        *(
            column
            for expert in experts
            for column in (Column(expert, "", ".3f"), *(Column(name, "", "+.3f") for name in ("change", "low", "high")))
        ),
        Column("error, RMS", "deg", ".4f"),
        Column("all", "10⁻³ deg/m", ".2f"),
    )
    lines = []
    for finding in findings:
        one = finding.preference
        for k in np.flatnonzero(one.steps):
            cells = [[one.mean[k, e], *one.change[:, k, e]] for e in range(len(experts))]
            numbers = [float(value) for cell in cells for value in cell]
            lines.append(
                [one.row, MANOEUVRES[k], int(one.steps[k]), *numbers, float(one.rms_deg[k]), 1e3 * finding.deg_per_m]
            )
    caption = (
        f"Mean weights by manoeuvre on held-out scenes, {what}, steps in which every expert gives an increment; change "
        "from straight with its 95 % interval over logs; RMS error of the yaw step there; relative rotation error over "
        "all steps. † reads ground truth."
    )
    return Table(caption, columns, lines, [k for k in range(1, len(lines)) if lines[k][0] != lines[k - 1][0]])


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    import tyro

    try:
        print(tyro.cli(Manoeuvres, args=arguments).run().text(), end="")
    except MixoError as error:
        logger.error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
