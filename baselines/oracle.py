"""Privileged rows: what choosing perfectly among the experts could gain. They read the truth and are no entries.

python baselines/oracle.py --policy "ORACLE HULL"
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
from mixo_env.policies.oracle import MulticameraGT, OracleAll, OracleHull
from mixo_env.recordings.store import load_recordings

ORACLES = {"MULTICAMERA GT": MulticameraGT, "ORACLE ALL": OracleAll, "ORACLE HULL": OracleHull}


@dataclass(frozen=True)
class Settings:
    """Play an oracle, which reads the truth, and print its row (marked †) beside LINEAR."""

    policy: Literal["MULTICAMERA GT", "ORACLE ALL", "ORACLE HULL"] = "MULTICAMERA GT"
    """The best camera (the paper's), the best expert, or the best mixture."""

    recordings: str = "mixocity"
    """A folder, or the name of a bundled recording."""

    track: str = "VISION"
    """PAPER, VISION or CONSUMER: who votes besides the cameras."""

    fold: int = 3
    """Played; LINEAR is fitted on the others."""

    out: Path = Path("results/baselines/oracle")
    """Folder for the policy."""


def main(settings: Settings) -> None:
    """Load, play, score, save."""
    recordings = load_recordings(settings.recordings)
    training, test = hold_out(recordings, settings.fold)

    chosen = ORACLES[settings.policy]()
    travels = {}
    for policy in (chosen, Linear()):
        prepare(policy, training, settings.track)
        # The true yaw rate enters the observation of a privileged policy and of no other.
        travels[policy] = rollout(policy, test, settings.track, privileged=policy.privileged)

    print(table_of(test, settings.track, travels))
    chosen.save(settings.out)
    print(f"saved in {settings.out}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
