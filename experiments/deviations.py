"""How sure may one be of a fused turn? Any row's standard deviation from its weights, made honest on inner folds.

    python -m experiments.deviations                         the bundled recordings, track VISION
    python -m experiments.deviations --track CONSUMER --rows TOKEN

A row mixes increments y_i with weights w_i to psi. If the experts' errors were independent and as large as calibrated
(sigma_i), the variance of psi would be sum w_i^2 sigma_i^2; what the experts show in the step itself is the robust
sum w_i^2 (y_i - psi)^2 (White 1980). Both added is what a row states here, per step, added up over two seconds:
heading is made of sums, and errors last.

Conformal: the factor with which 90 % intervals hold 90 % of the windows of inner folds, where the row was not fitted
(split conformal prediction, Papadopoulos et al. 2002). Those are judged by poses, as real drives have them, whose own
noise widens everything: by exact truth intervals then hold more. Windows of a drive resemble each other, so this is
experience with drives like these and no theorem.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import MixoError
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.manoeuvres import weights_of
from mixo_env.policies.calibration import WINDOW_S, Calibration, Past, window_sums
from mixo_env.policies.fitting import prepare
from mixo_env.policies.registry import create
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.substitutes import substituted_increments
from mixo_env.recordings.truths import with_truth
from mixo_env.tables import Column, Table

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]

ROWS = ("LINEAR", "HUBER", "INVERSE VARIANCE", "STUDENT-T", "SOFTMIN", "BIAS FILTER", "TOKEN")
COVERED = 0.9
NORMAL = 1.6449
"""Half the width of a normal distribution's 90 % interval, in standard deviations."""
HARDEST = 0.75
"""Quantile of the spread of the votes above which a window is hard."""

COLUMNS = (
    Column("row"),
    Column("NLL", "log deg", ".2f"),
    Column("90 % as stated", "%", ".1f"),
    Column("worst fold", "%", ".1f"),
    Column("hardest quarter", "%", ".1f"),
    Column("half width", "deg", ".3f"),
    Column("conformal factor", "", ".2f"),
    Column("by poses", "%", ".1f"),
    Column("hardest quarter by poses", "%", ".1f"),
)


@dataclass(frozen=True)
class Windows:
    """Windows of two seconds, ``(n,)`` each.

    Attributes:
        error_rad: of the fused turn.
        std_rad: as stated.
        spread_rad: mean distance of the votes from their median.
    """

    error_rad: FloatArray
    std_rad: FloatArray
    spread_rad: FloatArray

    def hardest(self) -> Windows:
        """The quarter in which votes differ most."""
        hard = self.spread_rad >= np.quantile(self.spread_rad, HARDEST)
        return Windows(self.error_rad[hard], self.std_rad[hard], self.spread_rad[hard])


@dataclass(frozen=True)
class Deviations:
    """Print how often turns lie within what a row states."""

    recordings: Path | None = None
    """Folder of recordings. None: the bundled mixocity."""
    track: str = "VISION"
    """Whose experts vote."""
    rows: tuple[str, ...] = ROWS
    """Rows to look at."""
    markdown: bool = False
    """Print a table for a page."""

    def run(self) -> Table:
        """The table."""
        recordings = load_recordings(None if self.recordings is None else str(self.recordings))
        return study(recordings, self.track, self.rows)


def study(recordings: Recordings, track: str, rows: Sequence[str]) -> Table:
    """A line a row, all folds held out."""
    protocol = CrossValidation(recordings)
    lines = []
    for name in rows:
        folds = [_of_fold(protocol, name, track, fold) for fold in protocol.tested_folds]
        lines.append([name, *as_stated([fold.told for fold in folds]), *conformal(folds)])
    caption = (
        f"Turns over {WINDOW_S:g} s, {recordings.manifest.data_version}, track {track}, folds held out. As stated, by "
        f"{protocol.truths[0]} truth: mean negative log likelihood of a normal distribution, share within the 90 % "
        "interval, in the worst fold, in the quarter of windows in which votes differ most, median half width. With "
        "the factor of inner folds, by the poses it rests on: the same shares."
    )
    return Table(caption, COLUMNS, lines)


@dataclass(frozen=True)
class Fold:
    """A held-out fold.

    Attributes:
        told: its windows, by the headline's truth.
        by_poses: the same by poses.
        factor: of inner folds.
    """

    told: Windows
    by_poses: Windows
    factor: float


def as_stated(told: Sequence[Windows]) -> list[float]:
    """Likelihood, and coverage over all, in the worst fold and in the hardest quarter [%], half width [deg]."""
    everything = joined(told)
    return [
        likelihood(everything.error_rad, everything.std_rad),
        covered(everything),
        min(covered(one) for one in told),
        covered(everything.hardest()),
        float(np.degrees(np.median(NORMAL * everything.std_rad))),
    ]


def conformal(folds: Sequence[Fold]) -> list[float]:
    """Mean factor, and coverage with it by poses: over all, in the hardest quarter [%]."""
    scaled = joined([replace(one.by_poses, std_rad=one.factor * one.by_poses.std_rad) for one in folds])
    return [float(np.mean([one.factor for one in folds])), covered(scaled), covered(scaled.hardest())]


def covered(told: Windows) -> float:
    """Share [%] within the 90 % interval."""
    return 100.0 * float(np.mean(np.abs(told.error_rad) <= NORMAL * told.std_rad))


def likelihood(error_rad: FloatArray, std_rad: FloatArray) -> float:
    """Mean negative logarithm of the normal density of errors in degrees."""
    z = error_rad / std_rad
    return float(np.mean(0.5 * z**2 + np.log(np.degrees(std_rad)) + 0.5 * np.log(2.0 * np.pi)))


def conformal_factor(told: Windows) -> float:
    """With which factor of the standard deviations the 90 % interval holds 90 % of these windows, and one more."""
    ratio = np.sort(np.abs(told.error_rad) / (NORMAL * told.std_rad))
    return float(ratio[min(int(np.ceil((len(ratio) + 1) * COVERED)), len(ratio)) - 1])


def mixed_std(weights: FloatArray, increments: FloatArray, std: FloatArray) -> FloatArray:
    """Standard deviation ``(rows,)`` of a mixture: what is usual of the experts, and what they show in the step.

    Args:
        weights: ``(rows, experts)``.
        increments: ``(rows, experts)`` [rad].
        std: ``(rows, experts)`` usual size of their errors [rad]; infinite ones are left out.
    """
    fused = np.sum(weights * increments, axis=1, keepdims=True)
    usual = np.where(np.isfinite(std), std, 0.0)
    return np.sqrt(np.sum(weights**2 * (usual**2 + (increments - fused) ** 2), axis=1))


def windows(training: Recordings, tested: Recordings, weights: FloatArray, track: str) -> Windows:
    """Windows of two seconds of tested scenes, their deviations from a calibration on ``training``.

    Args:
        training: scenes with true increments.
        tested: the same, with the truth that judges.
        weights: ``(rows, experts)`` on ``tested``.
        track: whose experts vote.
    """
    experts = tested.voters(track)
    calibration = Calibration.fit(Past.read(training, experts))
    stated = np.stack([tested[f"{expert}.yaw_std_rad"].astype(np.float64) for expert in experts], axis=1)
    usual = np.where(np.isfinite(calibration.factor * stated), calibration.factor * stated, calibration.std_rad)
    increments = substituted_increments(tested, track)
    error = np.sum(weights * increments, axis=1) - tested["truth.yaw_increment_rad"]
    variance = mixed_std(weights, increments, usual) ** 2
    spread = np.mean(np.abs(increments - np.median(increments, axis=1, keepdims=True)), axis=1)
    steps = max(1, round(WINDOW_S / float(np.nanmedian(training["dt_s"]))))
    sums = window_sums(np.stack([error, variance, spread], axis=1), tested.offsets, steps)
    sums = sums[np.isfinite(sums).all(axis=1)]
    return Windows(sums[:, 0], np.sqrt(sums[:, 1]), sums[:, 2] / steps)


def _of_fold(protocol: CrossValidation, name: str, track: str, fold: int) -> Fold:
    """Windows of the fold, and the factor from the other folds, each held out from a fit on the rest of them."""
    training = protocol.training(fold)
    tested = protocol.recordings.select(folds=[fold])
    others = [other for other in protocol.folds if other != fold]
    inner = [
        _held_out(name, training.select(folds=[o for o in others if o != held_out]), training, held_out, track)
        for held_out in others
    ]
    policy = create(name, tested)
    prepare(policy, training, track)
    weights = weights_of(policy, tested, track)
    judged = with_truth(tested, protocol.truths[0])
    told, by_poses = (windows(training, truth, weights, track) for truth in (judged, tested))
    return Fold(told, by_poses, conformal_factor(joined(inner)))


def _held_out(name: str, rest: Recordings, training: Recordings, fold: int, track: str) -> Windows:
    held_out = training.select(folds=[fold])
    policy = create(name, held_out)
    prepare(policy, rest, track)
    return windows(rest, held_out, weights_of(policy, held_out, track), track)


def joined(parts: Sequence[Windows]) -> Windows:
    """One after the other."""
    names = ("error_rad", "std_rad", "spread_rad")
    return Windows(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    import tyro

    try:
        study = tyro.cli(Deviations, args=arguments)
        result = study.run()
        print(result.markdown() if study.markdown else result.text(), end="")
    except MixoError as error:
        logger.error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
