"""MEAN, MEDIAN and HUBER: the majority decides; HUBER learns one number an expert, the size of its errors.

python baselines/robust.py --policy MEDIAN
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from mixo_env.leaderboard.evaluation import rollout
from mixo_env.leaderboard.held_out import hold_out, table_of
from mixo_env.policies.fitting import prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.robust import Huber, Mean, Median
from mixo_env.recordings.store import load_recordings

RULES = {"MEAN": Mean, "MEDIAN": Median, "HUBER": Huber}


@dataclass(frozen=True)
class Settings:
    """Play a rule that trusts the majority and print its row beside LINEAR."""

    policy: Literal["MEAN", "MEDIAN", "HUBER"] = "HUBER"
    """Which rule."""

    recordings: str = "mixocity"
    """A folder, or the name of a bundled recording."""

    track: str = "VISION"
    """PAPER, VISION or CONSUMER: who votes besides the cameras."""

    fold: int = 3
    """Held out; the others are trained on."""

    out: Path = Path("results/baselines/robust")
    """Folder for the policy."""


def main(settings: Settings) -> None:
    """Load, fit, play, score, save."""
    recordings = load_recordings(settings.recordings)
    training, test = hold_out(recordings, settings.fold)

    chosen = RULES[settings.policy]()
    travels = {}
    for policy in (chosen, Linear()):
        prepare(policy, training, settings.track)  # a rule that does not learn is only told who votes
        travels[policy] = rollout(policy, test, settings.track)

    print(table_of(test, settings.track, travels))
    chosen.save(settings.out)
    print(f"saved in {settings.out}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
