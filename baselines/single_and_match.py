"""One expert alone, or HIGHEST MATCH, which follows the camera with most matches: nothing is learned.

python baselines/single_and_match.py --policy CAM_BACK
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from mixo_env.leaderboard.evaluation import rollout
from mixo_env.leaderboard.held_out import hold_out, table_of
from mixo_env.policies.fitting import prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.match import HighestMatch
from mixo_env.policies.single import Single
from mixo_env.recordings.store import load_recordings


@dataclass(frozen=True)
class Settings:
    """Play one expert, or the camera that matches most, and print its row beside LINEAR."""

    policy: str = "HIGHEST MATCH"
    """That, or the name of an expert: CAM_FRONT, INERTIAL, ..."""

    recordings: str = "mixocity"
    """A folder, or the name of a bundled recording."""

    track: str = "VISION"
    """PAPER, VISION or CONSUMER: who votes besides the cameras; any other expert is shown for reference."""

    fold: int = 3
    """Held out; LINEAR is fitted on the others."""

    out: Path = Path("results/baselines/single_and_match")
    """Folder for the policy."""


def main(settings: Settings) -> None:
    """Load, play, score, save."""
    recordings = load_recordings(settings.recordings)
    training, test = hold_out(recordings, settings.fold)

    chosen = HighestMatch() if settings.policy == HighestMatch.name else Single(settings.policy)
    travels = {}
    for policy in (chosen, Linear()):
        prepare(policy, training, settings.track)
        travels[policy] = rollout(policy, test, settings.track)

    print(table_of(test, settings.track, travels))
    chosen.save(settings.out)
    print(f"saved in {settings.out}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
