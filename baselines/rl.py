"""PPO, A2C, SAC, TD3, DQN: a gate that learns from rewards in the environment, with Stable-Baselines3.

python baselines/rl.py --algorithm PPO --steps 122880
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from mixo_env.envs.sb3 import MixoVecEnv
from mixo_env.leaderboard.evaluation import rollout
from mixo_env.leaderboard.held_out import hold_out, table_of
from mixo_env.policies.fitting import drives, prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.policy import Policy
from mixo_env.policies.reinforcement import AGENTS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import for_learning


@dataclass(frozen=True)
class Settings:
    """Train an agent on the scenes of the training folds, play the held-out one, print its row beside LINEAR."""

    recordings: str = "mixocity"
    """A folder, or the name of a bundled recording."""

    track: str = "CONSUMER"
    """PAPER, VISION or CONSUMER: who votes besides the cameras."""

    fold: int = 3
    """Held out; the others are trained on."""

    algorithm: Literal["PPO", "A2C", "SAC", "TD3", "DQN"] = "PPO"
    """Of Stable-Baselines3; each has settings that suit this task."""

    steps: int = 61_440
    """Of the environment, over all copies."""

    environments: int = 64
    """Copies played at once; many of them matter more than long roll-outs."""

    gamma: float = 0.0
    """Discount. An action does not change what the experts say next, hence 0."""

    observation: Literal["paper", "rich"] = "rich"
    """What the agent sees: the paper's gate input and the experts' yaw rates, or all that a deployed system knows."""

    parts: int = 5
    """The held-out score is printed so many times while it learns."""

    seed: int = 0
    """Same seed, same machine: same bits."""

    out: Path = Path("results/baselines/rl")
    """Folder for the trained actor."""


def main(settings: Settings) -> None:
    """Load, train, play, score, save."""
    recordings = load_recordings(settings.recordings)
    training, test = hold_out(recordings, settings.fold, seed=settings.seed)
    seen = for_learning(training)  # poses as any policy may learn from them: no exact ones, no lag

    # 1. The agent: a policy like all others, but its numbers will come from Stable-Baselines3.
    agent = AGENTS[settings.algorithm](
        environments=settings.environments, gamma=settings.gamma, observation=settings.observation
    )
    agent.start(training.voters(settings.track))
    agent.fitted_on = drives(training)  # where it must not be scored
    agent.standardise_by(seen, settings.track)  # frozen statistics: what it sees must not drift while it learns

    # 2. The environment: `environments` scenes of the training folds at once; one that ends makes place for another.
    env: MixoVecEnv = agent.environment(seen, settings.track)
    model = agent.model(env, settings.seed)  # stable_baselines3.PPO("MlpPolicy", env, gamma=0.0, ...)

    # 3. Learning. The reward of a step is -(yaw error / LINEAR's usual error)^2, so more is better and 0 is perfect.
    print(f"{model.action_space} for {model.observation_space.shape[0]} numbers seen\n  steps  CPU s  held-out yaw deg")
    began = time.process_time()
    for part in range(settings.parts):
        model.learn(settings.steps // settings.parts, reset_num_timesteps=part == 0)
        agent.take(model)  # its actor as plain matrices
        yaw_deg = yaw_rmse_deg(agent, test, settings.track)
        print(f"{model.num_timesteps:7} {time.process_time() - began:6.1f}  {yaw_deg:.4f}")

    # 4. Its row, beside the constant weights that any gate must beat.
    linear = Linear()
    prepare(linear, training, settings.track)
    print(table_of(test, settings.track, {one: rollout(one, test, settings.track) for one in (agent, linear)}))
    agent.save(settings.out)
    print(f"saved in {settings.out}")


def yaw_rmse_deg(agent: Policy, test: Recordings, track: str) -> float:
    """Of one step, over the held-out scenes; shown while learning, never chosen by."""
    error_rad = rollout(agent, test, track).yaw_increment_rad - test["truth.yaw_increment_rad"]
    return float(np.degrees(np.sqrt(np.nanmean(error_rad**2))))


if __name__ == "__main__":
    main(tyro.cli(Settings))
