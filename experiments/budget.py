"""Accuracy against milliseconds: trivial, greedy and learned policies in ``MixoOdometryBudget-v0``.

    python -m experiments.budget

Every point is the mean over all scenes of a cross-validation by folds. Sets of cameras are those of
:mod:`mixo_env.leaderboard.paper.cost`. PPO learns weights and switches together, for several prices, and begins as the
constant set that earns most on the training folds. Errors are against exact poses where the recordings have them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.actions import LOGIT_SCALE
from mixo_env.envs.wrappers import standardise
from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.paper.cost import (
    PRICES_PER_MS,
    TURNING_RADPS,
    Division,
    Named,
    at_price,
    camera_sets,
    cost_table,
    cross_validated,
    draw_cost,
)
from mixo_env.policies.budget import Actions, BudgetPolicy, LinearByPattern, best_set
from mixo_env.recordings.store import load_recordings


class Network(BudgetPolicy):
    """A model of Stable-Baselines3."""

    def __init__(self, model: Any, transform: Callable[[Any], Any], options: dict[str, Any]) -> None:
        """Show it what ``transform`` makes of an observation."""
        self.options = options
        self._model, self._transform = model, transform

    def act(self, observation: Any) -> Actions:
        """Its deterministic action."""
        return self._model.predict(self._transform(observation), deterministic=True)[0]


def learn(division: Division, price: float, study: BudgetStudy) -> BudgetPolicy:
    """PPO at one price, which begins as the constant set that earns most there and explores close to it.

    From a random network it would find nothing of the kind: while all four switches are coins, a camera delivers in a
    quarter of the steps, and costs in half of them.
    """
    import torch
    from stable_baselines3 import PPO

    from mixo_env.envs.sb3 import MixoVecEnv

    torch.set_num_threads(1)
    linear = division.linear
    options: dict[str, Any] = {"observation": "rich", "weights": "softmax", "price_per_ms": price}
    same: dict[str, Any] = {"recordings": division.training, "split": "all", "track": division.track, **options}
    transform = standardise(gym.make("mixo_env:MixoOdometryBudget-v0", **same))
    env = MixoVecEnv("MixoOdometryBudget-v0", 64, transform=transform, **same)
    settings: dict[str, Any] = {"n_steps": 64, "batch_size": 1024, "learning_rate": 1e-3, "gamma": study.gamma}
    model = PPO("MlpPolicy", env, seed=study.seed, policy_kwargs={"log_std_init": -1.5}, device="cpu", **settings)
    if study.begin_at_set:
        with torch.no_grad():
            start = first_action(linear, best_set(division.sets, price))
            policy: Any = model.policy
            policy.action_net.bias[:] = torch.from_numpy(start)
            policy.log_std[-len(linear.cameras) :] = -0.7
    model.learn(study.ppo_steps)
    return Network(model, transform, options)


def first_action(linear: LinearByPattern, on: Sequence[str]) -> NDArray[np.float32]:
    """The action of a constant set, ``(experts + cameras,)``: softmax weights near LINEAR's, switches at +-0.5."""
    awake = np.array([camera in on for camera in linear.cameras])
    logits = np.log(np.clip(linear.weights[tuple(awake.tolist())], 0.01, None))
    weights = np.clip((logits - logits.max()) / LOGIT_SCALE + 0.5, -1.0, 1.0)
    return np.concatenate([weights, np.where(awake, 0.5, -0.5)]).astype(np.float32)


@dataclass(frozen=True)
class BudgetStudy:
    """Draw accuracy against cost."""

    recordings: Path | None = None
    """Folder of recordings; default: the bundled ones."""
    track: str = "CONSUMER"
    """Who votes."""
    out: Path = Path("docs/figures/budget.png")
    """Figure to write."""
    ppo_steps: int = 122_880
    """Steps of training per fold and price; 0 leaves PPO out."""
    turning_radps: tuple[float, ...] = TURNING_RADPS
    """Thresholds of the greedy policy that wakes cameras in turns."""
    seed: int = 0
    """Of PPO."""
    gamma: float = 0.8
    """Its discount: a woken camera delivers one step later."""
    begin_at_set: bool = True
    """PPO begins as the best constant set, not as coins."""

    def run(self) -> int:
        """Play, print and draw."""
        if self.ppo_steps < 0:
            raise ConfigurationError(f"ppo_steps: expected 0 or more, got {self.ppo_steps}: 0 leaves PPO out")
        recordings = load_recordings(self.recordings)
        points = cross_validated(recordings, self.track, self._policies)
        print(cost_table(recordings, self.track, points).text())
        draw_cost(points, self.out)
        print(f"wrote {self.out}")
        return 0

    def _policies(self, division: Division) -> Iterator[Named]:
        yield from camera_sets(division, self.turning_radps)
        for price in PRICES_PER_MS if self.ppo_steps else ():
            yield "PPO", at_price(price), learn(division, price, self)


if __name__ == "__main__":
    import tyro

    raise SystemExit(tyro.cli(BudgetStudy).run())
