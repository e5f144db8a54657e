"""What rows that were fitted here are worth elsewhere: fitted once on one recording, played unchanged on others.

    python -m experiments.transfer --recordings city-of-seed-101 city-of-seed-102
    python -m experiments.transfer --cameras CAM_FRONT CAM_BACK

Every row is fitted on all folds of the bundled recordings. Elsewhere nothing is fitted but what a car's own drives tell
of it (wheel radius, course offset, pose lag), from the other logs. Beside the rows stands LINEAR THERE: fitted, by
cross-validation over logs, on the recordings that it is scored on.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from experiments.studies import print_study
from mixo_env.errors import ConfigurationError, unknown
from mixo_env.leaderboard.comparisons import Comparison
from mixo_env.leaderboard.crossvalidation import CrossValidation, Run, Trial
from mixo_env.leaderboard.evaluation import Truth, rollout
from mixo_env.leaderboard.rows import Row, Scorer
from mixo_env.leaderboard.sentences import p_text, percent
from mixo_env.policies.fitting import prepare
from mixo_env.policies.policy import Policy
from mixo_env.policies.registry import create
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import truths_of, with_truth
from mixo_env.recordings.vehicles import with_training_constants
from mixo_env.tables import Cell, Column, Table

THERE = "LINEAR THERE"
AGAINST = ("CAM_FRONT", "LINEAR", "HUBER", "MIXO", THERE)


@dataclass(frozen=True)
class Transfer:
    """Play rows that were fitted on the bundled city in other places."""

    recordings: tuple[Path, ...] = ()
    """Recordings of other drives, by `mixo record`."""
    night: bool = True
    """The bundled drives at night, which are in no fold, too."""
    cameras: tuple[str, ...] = ()
    """Only these, in training and everywhere: another rig. Empty: all that are recorded."""
    track: str = "VISION"
    """Who votes besides the cameras."""
    rows: tuple[str, ...] = ("CAM_FRONT", "LINEAR", "HUBER", "STUDENT-T", "BIAS FILTER", "MIXO", "TOKEN", "TANDEM")
    """What is fitted and played."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> Table:
        """Fit once, play everywhere."""
        bundled = of_rig(load_recordings(None), self.cameras)
        folds = sorted({scene.fold for scene in bundled.scenes if scene.fold >= 0})
        training = with_training_constants(bundled.select(folds=folds), folds)
        policies = [create(name, training) for name in self.rows]
        for policy in policies:
            prepare(policy, training, self.track, seed=self.seed)
        places = {path.name: of_rig(load_recordings(str(path)), self.cameras) for path in self.recordings}
        lines = [line for name, there in places.items() for line in self._lines(name, policies, there, False)]
        if self.night and any(scene.fold < 0 for scene in bundled.scenes):
            lines += self._lines("night", policies, bundled, True)
        rig = f" with {', '.join(self.cameras)} alone" if self.cameras else ""
        caption = (
            f"Fitted on {len(training)} scenes of {bundled.manifest.data_version}{rig}, track {self.track}, and played "
            "elsewhere without refitting; headline truth, 95 % interval by bootstrap over logs; paired differences, "
            f"p after Holm over all pairs of a place; {THERE}: fitted by cross-validation where it is scored (not at "
            "night)"
        )
        columns = ("place", "row", "RTE deg/m", "ATE deg", *(f"- {name}" for name in AGAINST))
        begins = [i for i in range(1, len(lines)) if lines[i][0] != lines[i - 1][0]]
        return Table(caption, tuple(map(Column, columns)), lines, begins)

    def _lines(self, place: str, policies: Sequence[Policy], there: Recordings, night: bool) -> list[list[Cell]]:
        division = CrossValidation(there, Trial(self.seed), out_of_distribution=night)
        headline = truths_of(division.recordings)[0]
        tested = with_truth(division.recordings, headline)
        scorer = Scorer(tested, {headline: Truth(tested)}, floor=0.0, seed=self.seed)
        runs = [_run(policy, headline, tested, self.track) for policy in policies]
        if not night:
            own = division.run("LINEAR", self.track)
            runs.append(replace(own, name=THERE, travels={headline: own.travels[headline]}, policies={}))
        rows = [scorer.row(self.track, run) for run in runs]
        found = scorer.compare(rows)
        logs = len({scene.log for scene in tested.scenes})
        title = f"{place} ({len(tested)} scenes, {logs} logs)"
        return [[title, *_cells(row, {name: found.between(row.name, name) for name in AGAINST})] for row in rows]


def of_rig(recordings: Recordings, cameras: Sequence[str]) -> Recordings:
    """The recordings with these cameras alone, at the times of all of them.

    Raises:
        ConfigurationError: for a camera that is not recorded.
    """
    manifest = recordings.manifest
    if not cameras:
        return recordings
    for name in cameras:
        if name not in manifest.cameras:
            raise ConfigurationError(unknown("camera", name, manifest.cameras))
    variants = {name: camera for name, camera in manifest.variants.items() if camera in cameras}
    costs = {name: cost for name, cost in manifest.camera_cost_ms.items() if name in cameras}
    kept = tuple(name for name in manifest.cameras if name in cameras)
    return recordings.replace(replace(manifest, cameras=kept, variants=variants, camera_cost_ms=costs))


def _run(policy: Policy, headline: str, tested: Recordings, track: str) -> Run:
    travel = rollout(policy, tested, track)
    everything = np.ones(len(tested), dtype=np.bool_)
    return Run(policy.name, policy.privileged, policy.learns, {headline: (travel,)}, everything, {})


def _cells(row: Row, differences: Mapping[str, Comparison | None]) -> list[Cell]:
    score = row.headline
    ends = score.rotation_deg_per_m
    cells: list[Cell] = [row.name, f"{ends.mean:.5f} [{ends.low:.5f}, {ends.high:.5f}]", f"{score.ate_deg:.3f}"]
    for found in differences.values():
        cells.append(f"{percent(found.share)} ({p_text(found.p_holm)})" if found else "-")
    return cells


if __name__ == "__main__":
    sys.exit(print_study(Transfer))
