"""Accuracy against milliseconds: trivial, greedy and learned policies in ``MixoOdometryBudget-v0``.

    python -m experiments.budget

Every point is the mean over all scenes of a cross-validation by folds. Trivial policies leave the same cameras on all
the time; the greedy one grows that set by the best gain per millisecond on the training folds, and wakes it only while
the car turns. Their weights are LINEAR's, fitted for every set of delivering cameras. PPO learns weights and switches
together, for several prices.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym

from mixo_env.envs.wrappers import standardise
from mixo_env.leaderboard.paper.cost import TURNING_RADPS, averaged, camera_sets, draw_cost
from mixo_env.policies.budget import Actions, BudgetPolicy, Played, play
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.presets import data_label
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


def learn(recordings: Recordings, fold: int, track: str, price_per_ms: float, study: BudgetStudy) -> BudgetPolicy:
    """PPO at one price, trained on the other folds."""
    import torch
    from stable_baselines3 import PPO

    from mixo_env.envs.sb3 import MixoVecEnv

    torch.set_num_threads(1)
    options: dict[str, Any] = {"observation": "rich", "weights": "softmax", "price_per_ms": price_per_ms}
    same: dict[str, Any] = {"recordings": recordings, "fold": fold, "track": track, **options}
    transform = standardise(gym.make("mixo_env:MixoOdometryBudget-v0", **same))
    env = MixoVecEnv("MixoOdometryBudget-v0", 64, transform=transform, **same)
    settings: dict[str, Any] = {"n_steps": 64, "batch_size": 1024, "learning_rate": 1e-3, "gamma": 0.8}
    model = PPO("MlpPolicy", env, seed=study.seed, policy_kwargs={"log_std_init": -0.5}, device="cpu", **settings)
    model.learn(study.ppo_steps)
    return Network(model, transform, options)


def policies(
    recordings: Recordings, fold: int, track: str, study: BudgetStudy
) -> Iterator[tuple[str, str, BudgetPolicy]]:
    """Kind and name of every policy, fitted without one fold."""
    yield from camera_sets(recordings, fold, track, study.turning_radps)
    for price in study.prices_per_ms if study.ppo_steps else ():
        yield "PPO", f"price {price:g} per ms", learn(recordings, fold, track, price, study)


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
    prices_per_ms: tuple[float, ...] = (0.003, 0.01, 0.03)
    """Prices PPO is trained for."""
    turning_radps: tuple[float, ...] = TURNING_RADPS
    """Thresholds of the greedy policy that wakes cameras in turns."""
    seed: int = 0
    """Of PPO."""

    def run(self) -> int:
        """Play, print and draw."""
        recordings = load_recordings(self.recordings)
        folds = sorted({scene.fold for scene in recordings.scenes if scene.fold >= 0})
        points: dict[tuple[str, str], list[Played]] = {}
        for fold in folds:
            for kind, name, policy in policies(recordings, fold, self.track, self):
                points.setdefault((kind, name), []).append(play(policy, recordings, self.track, fold=fold))
        rows = [averaged(kind, name, parts) for (kind, name), parts in points.items()]
        print(
            f"track {self.track}, data {data_label(recordings.manifest)}, {len(recordings)} scenes, {len(folds)} folds"
        )
        print(f"{'':22}{'':22}{'ms/step':>8} {'yaw RMSE [deg]':>15} {'ATE [m]':>8}")
        for one in rows:
            print(f"{one.kind:22}{one.name:22}{one.cost_ms:8.1f} {one.yaw_rmse_deg:15.4f} {one.ate_m:8.3f}")
        draw_cost(rows, self.out)
        print(f"wrote {self.out}")
        return 0


if __name__ == "__main__":
    import tyro

    raise SystemExit(tyro.cli(BudgetStudy).run())
