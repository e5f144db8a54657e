"""LINEAR: constant weights by least squares, the baseline that every other row is compared with.

python baselines/linear.py --track PAPER
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from mixo_env.leaderboard.evaluation import rollout
from mixo_env.leaderboard.held_out import hold_out, table_of
from mixo_env.policies.fitting import prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.robust import Mean
from mixo_env.policies.single import Single
from mixo_env.recordings.store import load_recordings


@dataclass(frozen=True)
class Settings:
    """Fit constant weights, print their row, save them."""

    recordings: str = "mixocity"
    """A folder, or the name of a bundled recording."""

    track: str = "VISION"
    """PAPER, VISION or CONSUMER: who votes besides the cameras."""

    fold: int = 3
    """Held out; the others are trained on."""

    out: Path = Path("results/baselines/linear")
    """Folder for the fitted policy."""


def main(settings: Settings) -> None:
    """Load, fit, play, score, save."""
    recordings = load_recordings(settings.recordings)
    training, test = hold_out(recordings, settings.fold)

    # What constant weights are worth shows between the front camera, all experts alike, and LINEAR.
    linear = Linear()
    travels = {}
    for policy in (Single("CAM_FRONT"), Mean(), linear):
        prepare(policy, training, settings.track)
        travels[policy] = rollout(policy, test, settings.track)

    print(table_of(test, settings.track, travels))
    for expert, weight in zip(linear.experts, linear.weights, strict=True):
        print(f"{expert:20}{weight:7.3f}")  # nothing forces the sum to one: the paper's is 1.037
    linear.save(settings.out)
    print(f"saved in {settings.out}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
