"""PPO: a gate that learns from rewards in the environment, with Stable-Baselines3.

python baselines/rl.py --steps 245760 --environments 64
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from mixo_env.leaderboard.evaluation import rollout
from mixo_env.leaderboard.held_out import hold_out, table_of
from mixo_env.policies.fitting import prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.reinforcement import PPO
from mixo_env.recordings.store import load_recordings


@dataclass(frozen=True)
class Settings:
    """Train PPO on the scenes of the training folds, play the held-out one, print its row beside LINEAR."""

    recordings: str = "mixocity"
    """A folder, or the name of a bundled recording."""

    track: str = "VISION"
    """PAPER, VISION or CONSUMER: who votes besides the cameras."""

    fold: int = 3
    """Held out; the others are trained on."""

    steps: int = 61_440
    """Of the environment, over all copies."""

    environments: int = 64
    """Copies played at once; many of them matter more than long roll-outs."""

    rollout: int = 64
    """Steps of each copy between two updates."""

    gamma: float = 0.0
    """Discount. An action does not change what the experts say next, hence 0."""

    learning_rate: float = 1e-3
    """Of Adam."""

    seed: int = 0
    """Same seed, same machine: same bits."""

    out: Path = Path("results/baselines/rl")
    """Folder for the trained actor."""


def main(settings: Settings) -> None:
    """Load, train, play, score, save."""
    recordings = load_recordings(settings.recordings)
    training, test = hold_out(recordings, settings.fold, seed=settings.seed)

    ppo = PPO(
        steps=settings.steps,
        environments=settings.environments,
        rollout=settings.rollout,
        gamma=settings.gamma,
        learning_rate=settings.learning_rate,
    )
    travels = {}
    for policy in (ppo, Linear()):
        prepare(policy, training, settings.track, seed=settings.seed)
        travels[policy] = rollout(policy, test, settings.track)

    print(table_of(test, settings.track, travels))
    ppo.save(settings.out)
    print(f"saved in {settings.out}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
