"""Every policy on real odometries of the same real drives, each drive left out once.

MIXO_REAL_DATA=/data python -m experiments.real_experts
python -m experiments.real_experts --data drives --rate 10 --markdown

The folder holds a folder a sequence, with ``groundtruth.txt`` and a file an odometry in any of them.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.studies import print_study
from mixo_env.cli.import_ import Import
from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.evaluation import Travel, Truth
from mixo_env.policies.registry import names as policy_names
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.tables import Column, Table

logger = logging.getLogger(__name__)

TRUTH = "groundtruth"
CHOSEN, HINDSIGHT = "best of the training sequences", "best in hindsight †"
REFERENCE = "HUBER"


@dataclass(frozen=True)
class RealExperts:
    """Print how every policy does on real experts."""

    data: Path | None = None
    """A folder a sequence: groundtruth.txt and one file an odometry. Default: kitti_experts in MIXO_REAL_DATA."""
    rate: float = 9.648
    """Poses a second. KITTI's nominal 10 Hz is 0.10365 s a frame."""
    policies: tuple[str, ...] = ()
    """Rows besides the experts and HUBER; none: all that can be fitted on every fold."""
    seed: int = 0
    """Of learned policies."""
    markdown: bool = False
    """Print a table for a page."""

    def run(self) -> Table:
        """Import, fit on all sequences but one, play that one.

        Raises:
            ConfigurationError: without data.
        """
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / "drives"
            imported(self.folder(), self.rate, out)
            recordings = load_recordings(str(out))
        return study(recordings, self.policies, self.seed)

    def folder(self) -> Path:
        """Where the sequences lie.

        Raises:
            ConfigurationError: when nobody said.
        """
        if self.data is not None:
            return self.data
        if "MIXO_REAL_DATA" not in os.environ:
            raise ConfigurationError("expected --data FOLDER, or MIXO_REAL_DATA with kitti_experts in it, got neither")
        return Path(os.environ["MIXO_REAL_DATA"]) / "kitti_experts"


def imported(folder: Path, rate: float, out: Path) -> None:
    """`mixo import` of all odometries in ``folder``, leave one sequence out.

    Raises:
        ConfigurationError: when no sequence with a ground truth and an odometry is there.
    """
    sequences = [path.parent for path in sorted(folder.glob(f"*/{TRUTH}.txt"))]
    experts = sorted({path.stem for sequence in sequences for path in sequence.glob("*.txt")} - {TRUTH})
    if not experts:
        raise ConfigurationError(
            f"expected folders with {TRUTH}.txt and a file an odometry in {folder}, found none: one folder a sequence"
        )
    pairs = tuple(f"{name}={folder}" for name in experts)
    # An odometry that breaks may contradict the truth: that is what the table is about.
    command = Import(out, groundtruth=folder, expert=(pairs,), rate=rate, leave_one_out=True, despite=(tuple(experts),))
    with contextlib.redirect_stdout(sys.stderr):
        command.run()


@dataclass(frozen=True)
class Scored:
    """One row.

    Attributes:
        rms_deg: ``(sequences,)`` RMS error of one step.
        deg_per_m: ``(sequences,)`` relative rotation error, pooled over all pieces of the sequence.
    """

    rms_deg: NDArray[np.float64]
    deg_per_m: NDArray[np.float64]


def study(recordings: Recordings, policies: Sequence[str], seed: int = 0) -> Table:
    """The table of a recording.

    Args:
        recordings: imported, every sequence a fold of its own.
        policies: rows besides experts and HUBER; empty: all.
        seed: of learned policies.
    """
    protocol = CrossValidation(recordings, Trial(seed))
    truth = Truth(protocol.recordings, protocol.truths[0])
    experts = recordings.manifest.imported
    wanted = dict.fromkeys((*experts, REFERENCE, *(policies or policy_names(recordings))))
    scores: dict[str, Scored] = {}
    privileged: set[str] = set()
    for name in wanted:
        if protocol.expensive(name):
            continue
        try:
            run = protocol.run(name, "VISION")
        except PolicyError as error:
            if name in policies:
                raise
            logger.info("%s: %s", name, error)
            continue
        scores[name] = scored(truth, run.travel)
        if run.privileged:
            privileged.add(name)
    alone = {name: scores.pop(name) for name in experts}
    scores = {**alone, CHOSEN: chosen(alone), HINDSIGHT: hindsight(alone), **scores}
    return table(scores, privileged, [scene.name for scene in protocol.recordings.scenes])


def scored(truth: Truth, travel: Travel) -> Scored:
    """Errors of a travel, sequence by sequence."""
    errors = truth.measure(travel)
    relative, count = errors.relative, len(errors.steps)
    pieces = np.bincount(relative.scene, minlength=count)
    total = np.bincount(relative.scene, weights=relative.rotation_deg_per_m, minlength=count)
    with np.errstate(invalid="ignore"):
        return Scored(np.sqrt(errors.squared_yaw_increment_deg2 / errors.steps), total / pieces)


def chosen(alone: Mapping[str, Scored]) -> Scored:
    """The single expert a careful user would take: of each sequence that of least deg/m on average of the others."""
    table = np.stack([score.deg_per_m for score in alone.values()])
    others = (np.nansum(table, axis=1, keepdims=True) - np.nan_to_num(table)) / (table.shape[1] - 1)
    return _picked(alone, np.argmin(others, axis=0))


def hindsight(alone: Mapping[str, Scored]) -> Scored:
    """The single expert that turns out best in each sequence, by deg/m: nobody knows it beforehand."""
    return _picked(alone, np.argmin(np.stack([score.deg_per_m for score in alone.values()]), axis=0))


def _picked(alone: Mapping[str, Scored], which: NDArray[np.intp]) -> Scored:
    rows, sequences = list(alone.values()), range(len(which))
    return Scored(
        np.array([rows[which[i]].rms_deg[i] for i in sequences]),
        np.array([rows[which[i]].deg_per_m[i] for i in sequences]),
    )


def table(scores: Mapping[str, Scored], privileged: set[str], sequences: Sequence[str]) -> Table:
    """Rows in order; ratios are means over the sequences of policy / HUBER, and the largest of policy / CHOSEN."""
    reference, single = scores[REFERENCE], scores[CHOSEN]
    columns = (
        Column("row"),
        *(Column(f"{name} RMS", "deg", ".4f") for name in sequences),
        *(Column(f"{name}", "10⁻³ deg/m", ".2f") for name in sequences),
        Column("RMS / HUBER", spec=".2f"),
        Column("deg/m / HUBER", spec=".2f"),
        Column("worst deg/m / training's best", spec=".2f"),
    )
    rows = []
    for name, score in scores.items():
        ratios = (
            float(np.mean(score.rms_deg / reference.rms_deg)),
            float(np.nanmean(score.deg_per_m / reference.deg_per_m)),
            float(np.nanmax(score.deg_per_m / single.deg_per_m)),
        )
        mark = " †" if name in privileged else ""
        rows.append([name + mark, *score.rms_deg.tolist(), *(1e3 * score.deg_per_m).tolist(), *ratios])
    caption = (
        "Real experts, each sequence left out once: RMS error of the yaw step and relative rotation error; means over "
        "the sequences of row / HUBER, and the worst sequence beside the single expert that was best on the training "
        "sequences. † reads ground truth or the future."
    )
    return Table(caption, columns, rows)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""

    def form(study: RealExperts, table: Table) -> str:
        return table.markdown() if study.markdown else table.text()

    return print_study(RealExperts, arguments, form)


if __name__ == "__main__":
    sys.exit(main())
