"""MIXO: the paper's gate, a small network that weights the experts by driving state and match counts (eqs. 3 and 5).

python baselines/mixo.py --learning-rate 0.01 --seed 1
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from mixo_env.leaderboard.evaluation import rollout
from mixo_env.leaderboard.held_out import hold_out, table_of
from mixo_env.policies.fitting import prepare
from mixo_env.policies.gate import Mixo
from mixo_env.policies.linear import Linear
from mixo_env.recordings.store import load_recordings


@dataclass(frozen=True)
class Settings:
    """Train the gate on the training folds, play the held-out one, print its row beside LINEAR."""

    recordings: str = "mixocity"
    """A folder, or the name of a bundled recording."""

    track: str = "VISION"
    """PAPER, VISION or CONSUMER: who votes besides the cameras."""

    fold: int = 3
    """Held out; the others are trained on."""

    hidden: tuple[int, int] = (16, 16)
    """Units of the two hidden layers: the paper's N1 N2."""

    dropout: tuple[float, float] = (0.1, 0.1)
    """Behind each of them: d1 d2."""

    learning_rate: float = 0.02
    """At the start: eta0."""

    decay: float = 0.05
    """What is left of it at the end: alpha."""

    min_updates: int = 400
    """Of the weights, however few scenes there are."""

    seed: int = 0
    """Same seed, same machine: same bits."""

    out: Path = Path("results/baselines/mixo")
    """Folder for the trained gate."""


def main(settings: Settings) -> None:
    """Load, train, play, score, save."""
    recordings = load_recordings(settings.recordings)
    training, test = hold_out(recordings, settings.fold, seed=settings.seed)

    mixo = Mixo(
        hidden=settings.hidden,
        dropout=settings.dropout,
        learning_rate=settings.learning_rate,
        decay=settings.decay,
        min_updates=settings.min_updates,
    )
    travels = {}
    for policy in (mixo, Linear()):
        prepare(policy, training, settings.track, seed=settings.seed)
        travels[policy] = rollout(policy, test, settings.track)  # each step sees the yaw rate it fused before

    print(table_of(test, settings.track, travels))
    mixo.save(settings.out)
    print(f"saved in {settings.out}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
