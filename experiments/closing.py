"""How much of the way from LINEAR to MULTICAMERA GT a row closes, how sure that is, and how much of it seeds decide.

    python -m experiments.closing                                           bundled recordings: 15 CPU minutes
    python -m experiments.closing --rows TRIO --more city-of-seed-101 city-of-seed-102    would more drives help?

The share is that of the mean errors over seeds, by the headline's truth. Its interval draws logs and takes the share of
all three rows anew; a new fit with other seeds is another matter, told by the standard deviation of single seeds.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.studies import print_study
from mixo_env.errors import ConfigurationError
from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.evaluation import Errors, Truth, mean_errors
from mixo_env.leaderboard.sentences import count_of
from mixo_env.leaderboard.weights import shipped
from mixo_env.metrics.bootstrap import RESAMPLES, Interval, per_group, percentile_interval, resampled_means
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.folds import OUT_OF_DISTRIBUTION
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import with_truth
from mixo_env.tables import Cell, Column, Table

FROM, TO = "LINEAR", "MULTICAMERA GT"
"""The way: from the paper's constant weights to the oracle of its equation 2."""


@dataclass(frozen=True)
class Closing:
    """Print what rows close, with intervals over logs and the spread of seeds."""

    recordings: Path | None = None
    """Folder of recordings. None: the bundled mixocity."""
    more: tuple[Path, ...] = ()
    """Recordings of other drives with the same experts, which every row learns from as well; they are not scored."""
    tracks: tuple[str, ...] = ("VISION", "CONSUMER")
    """Who votes besides the cameras."""
    rows: tuple[str, ...] = ("TANDEM", "TRIO")
    """What is scored."""
    seeds: int = 3
    """Of every row that learns."""

    def run(self) -> Table:
        """A line a row, two columns a track.

        Raises:
            ConfigurationError: for recordings of fewer than two folds, or other drives with other experts.
        """
        own = load_recordings(None if self.recordings is None else str(self.recordings))
        others = [load_recordings(str(folder)) for folder in self.more]
        trial = Trial(seeds=self.seeds, weights=shipped())
        scale = CrossValidation(own, trial)
        if scale.foreign:
            raise ConfigurationError(
                f"expected recordings of 2 or more folds, got {len(scale.folds)}: record more logs"
            )
        taught = CrossValidation(beside(own, others), trial, tested_folds=scale.folds) if others else scale
        lines: list[list[Cell]] = [[row] for row in self.rows]
        logs = np.array([scene.log for scene in scale.recordings.scenes])
        truth = Truth(with_truth(scale.recordings, scale.truths[0]))
        for track in self.tracks:
            worst, best = (mean_errors(errors_of(scale, truth, name, track)) for name in (FROM, TO))
            for line, row in zip(lines, self.rows, strict=True):
                seeds = errors_of(taught, truth, row, track)
                for of in (relative, absolute):
                    line.append(told(of(worst, logs), of(best, logs), [of(errors, logs) for errors in seeds]))
        manifest = scale.recordings.manifest
        learned = f", learning from {sum(map(len, others))} scenes of other drives as well" if others else ""
        spread = "; ± standard deviation of a single seed" if self.seeds > 1 else ""
        columns = (Column(f"{track}, {score} closed [%]") for track in self.tracks for score in ("RTE", "ATE"))
        return Table(
            f"{manifest.data_version}, {len(scale.recordings)} scenes, {len(np.unique(logs))} logs, {scale.truths[0]} "
            f"truth{learned}: share of the way from {FROM} to {TO} (privileged) by RTE in deg/m and by ATE in deg, "
            f"of the mean errors of {count_of(self.seeds, 'seed')}, with its 95 % interval over logs{spread}",
            (Column("row"), *columns),
            lines,
        )


def beside(own: Recordings, others: Sequence[Recordings]) -> Recordings:
    """Recordings with a further fold that holds all scenes of others; their logs and vehicles keep apart.

    Raises:
        ConfigurationError: for others whose experts are not the same.
    """
    fold = 1 + max(scene.fold for scene in own.scenes)
    scenes, vehicles, variants = list(own.scenes), dict(own.manifest.vehicles), dict(own.manifest.variants)
    for number, other in enumerate(others, start=1):
        if other.manifest.cameras != own.manifest.cameras or other.manifest.inertial != own.manifest.inertial:
            raise ConfigurationError(
                f"expected other drives with the experts {', '.join(own.experts)}, got {', '.join(other.experts)}: "
                "record them alike"
            )
        scenes += [
            replace(
                scene,
                name=f"{number}: {scene.name}",
                log=f"{number}: {scene.log}",
                vehicle=f"{number}: {scene.vehicle}",
                fold=scene.fold if scene.fold == OUT_OF_DISTRIBUTION else fold,
            )
            for scene in other.scenes
        ]
        vehicles |= {f"{number}: {vehicle}": constants for vehicle, constants in other.manifest.vehicles.items()}
        variants = {name: camera for name, camera in variants.items() if name in other.manifest.variants}
    manifest = replace(own.manifest, scenes=tuple(scenes), vehicles=vehicles, variants=variants)
    shared = [name for name in own.column_names if all(name in recordings for recordings in others)]
    return Recordings(manifest, {name: np.concatenate([part[name] for part in (own, *others)]) for name in shared})


def errors_of(protocol: CrossValidation, truth: Truth, name: str, track: str) -> list[Errors]:
    """Of every seed; ``truth`` is the headline's of the scenes that are scored."""
    return [truth.measure(travel) for travel in protocol.run(name, track).travels[protocol.truths[0]]]


Sums = tuple[FloatArray, FloatArray]
"""Sums of the errors of every log, and their number, ``(logs,)`` each."""


def relative(errors: Errors, logs: NDArray[np.str_]) -> Sums:
    """RTE [deg/m] of all pieces of path; ``logs`` ``(scenes,)``."""
    return per_group(errors.relative.rotation_deg_per_m, logs[errors.relative.scene])


def absolute(errors: Errors, logs: NDArray[np.str_]) -> Sums:
    """ATE [deg] of all scenes."""
    return per_group(errors.absolute.rotation_deg, logs)


def closed(own: Sums, worst: Sums, best: Sums, *, seed: int = 0) -> Interval:
    """Share of the way [%] from the worst mean to the best, with the interval of that share over logs.

    Args:
        own: errors of the row.
        worst: of the same samples where the way begins.
        best: where it ends.
        seed: of the draws.
    """
    sums, counts = np.stack([own[0], worst[0], best[0]], axis=1), own[1]
    drawn = resampled_means(sums, counts, RESAMPLES, seed)
    return percentile_interval(float(share(sums.sum(axis=0) / counts.sum())), share(drawn.T), len(counts))


def share(means: FloatArray) -> FloatArray:
    """What own means close of the way from worst to best ones [%]; ``means`` holds the three, ``(3, ...)``."""
    own, worst, best = means
    return 100.0 * (worst - own) / (worst - best)


def told(worst: Sums, best: Sums, seeds: Sequence[Sums]) -> str:
    """The share of the mean over seeds, its interval, and how far single seeds scatter."""
    mean = np.mean([sums for sums, _ in seeds], axis=0), seeds[0][1]
    found = closed(mean, worst, best)
    text = f"{found.mean:.1f} [{found.low:.1f}, {found.high:.1f}]"
    if len(seeds) < 2:
        return text
    return f"{text} ± {np.std([closed(one, worst, best).mean for one in seeds], ddof=1):.1f}"


def main(arguments: list[str] | None = None) -> int:
    """Run the command line."""
    return print_study(Closing, arguments, lambda study, table: table.markdown())


if __name__ == "__main__":
    sys.exit(main())
