"""What a decision costs: every row of the leaderboard, one scene and 1,024 at once, beside HUBER in the same run.

Run ``python -m experiments.speed.deciding``. A round decides some steps with every row in turn; the ratio to HUBER is
taken within a round, and its interval is that of the median over rounds (order statistics, 95 %). CPU time of one
thread.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from dataclasses import dataclass

# Before numpy is loaded: threads for the products of an agent's layers go on spinning for a while, and their CPU time
# would be counted with whatever is timed next.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from experiments.studies import print_study
from mixo_env.envs.replay import Replay
from mixo_env.policies.fitting import prepare
from mixo_env.policies.policy import Observation, Policy
from mixo_env.policies.registry import POLICIES, create
from mixo_env.recordings.store import load_recordings
from mixo_env.tables import Cell, Column, Table

PEER = "HUBER"
BATCHES = (1, 1024)
STEPS = {1: 100, 1024: 40}
"""Decided in a round, by scenes at once. Many: a scene has some two hundred, and the first is dear, for its memory is
new."""


@dataclass(frozen=True)
class Deciding:
    """Time the decisions of fitted rows on the bundled recordings."""

    track: str = "CONSUMER"
    """Who votes besides the cameras."""
    rows: tuple[str, ...] = ()
    """Rows; all that act without the truth or the future by default."""
    rounds: int = 15
    """Timed rounds, after one that is not."""

    def run(self) -> Table:
        """Fit on two folds, time on the others."""
        recordings = load_recordings(None)
        training = recordings.select(folds=[0, 1])
        names = self.rows or tuple(n for n, kind in POLICIES.items() if not kind.privileged and not kind.expensive)
        policies = {name: create(name, training) for name in dict.fromkeys((PEER, *names))}
        for policy in policies.values():
            prepare(policy, training, self.track)
        timed = {batch: self._rounds(policies, batch) for batch in BATCHES}
        rows: list[list[Cell]] = []
        for name in policies:
            row: list[Cell] = [name]
            for batch in BATCHES:
                own, peer = timed[batch][name], timed[batch][PEER]
                ratios = [a / b for a, b in zip(own, peer, strict=True)]
                low, high = median_interval(ratios)
                row += [statistics.median(own), f"{statistics.median(ratios):.2f} [{low:.2f}, {high:.2f}]"]
            rows.append(row)
        caption = (
            f"One decision, track {self.track}, {len(training.voters(self.track))} experts, CPU time of one thread, "
            f"median of {self.rounds} rounds; ratio to {PEER} in the same round with its 95 % interval"
        )
        columns = [Column("row")]
        for batch in BATCHES:
            scenes = "1 scene" if batch == 1 else f"{batch:,} scenes"
            columns += [Column(scenes, "µs a scene", ".2f"), Column(f"to {PEER}")]
        return Table(caption, tuple(columns), rows)

    def _rounds(self, policies: dict[str, Policy], batch: int) -> dict[str, list[float]]:
        looks = observations(self.track, batch, STEPS[batch])
        found: dict[str, list[float]] = {name: [] for name in policies}
        for number in range(self.rounds + 1):
            for name, policy in policies.items():
                policy.reset(batch)
                start = time.process_time()
                for look in looks:
                    policy.act(look)
                spent = time.process_time() - start
                if number:
                    found[name].append(1e6 * spent / (len(looks) * batch))
        return found


def observations(track: str, batch: int, steps: int) -> list[Observation]:
    """What ``batch`` scenes show in ``steps`` consecutive steps; scenes are repeated as needed."""
    replay = Replay(load_recordings(None).select(folds=[2, 3]), track=track, keep_trajectories=False)
    replay.reset(np.arange(len(replay)))
    rows = np.arange(batch) % len(replay)
    nobody = np.zeros((len(replay), len(replay.experts)))
    looks = []
    for _ in range(steps + 20):  # the first steps are before most cameras track
        looks.append({name: np.ascontiguousarray(values[rows]) for name, values in replay.observe().items()})
        replay.step(nobody)
    return looks[20:]


def median_interval(values: list[float]) -> tuple[float, float]:
    """Interval of 95 % for the median by order statistics (binomial with its normal approximation)."""
    ordered, n = sorted(values), len(values)
    reach = 0.98 * n**0.5
    low, high = max(0, int(n / 2 - reach)), min(n - 1, round(n / 2 + reach))
    return ordered[low], ordered[high]


if __name__ == "__main__":
    sys.exit(print_study(Deciding))
