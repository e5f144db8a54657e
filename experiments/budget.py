"""Accuracy against milliseconds: trivial, greedy and learned policies in ``MixoOdometryBudget-v0``.

    python -m experiments.budget

Every point is the mean over all scenes of a cross-validation by folds. Trivial policies leave the same cameras on all
the time; the greedy one grows that set by the best gain per millisecond on the training folds, and wakes it only while
the car turns. Their weights are LINEAR's, fitted for every set of delivering cameras. PPO learns weights and switches
together, for several prices.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.budget import BudgetReplay
from mixo_env.envs.stepping import TRUTH
from mixo_env.envs.wrappers import standardise
from mixo_env.fusion import least_squares_weights
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings

Actor = Callable[[Any], NDArray[np.float32]]

RAW_SCALE = 4.0


@dataclass(frozen=True)
class Point:
    """One policy on one fold: scores ``(scenes,)`` and mean cost [ms per step]."""

    ate_m: NDArray[np.float64]
    yaw_rmse_deg: NDArray[np.float64]
    cost_ms: NDArray[np.float64]


class LinearByPattern:
    """LINEAR for every set of delivering cameras, fitted on training scenes with the stateless increments."""

    def __init__(self, training: Recordings, track: str) -> None:
        """Fit all sets; the weights of cameras that sleep are 0."""
        replay = BudgetReplay(training, track=track)
        self.experts, self.cameras = replay.experts, replay.cameras
        columns = [self.experts.index(camera) for camera in self.cameras]
        truth = replay.table[:, TRUTH]
        self.weights: dict[tuple[bool, ...], NDArray[np.float64]] = {}
        for pattern in itertools.product((False, True), repeat=len(columns)):
            silent = [column for column, on in zip(columns, pattern, strict=True) if not on]
            voting = [j for j in range(len(self.experts)) if j not in silent]
            weights = np.zeros(len(self.experts))
            if voting:
                weights[voting] = least_squares_weights(replay.votes.increments_rad[:, voting], truth)
            self.weights[pattern] = weights

    def __call__(self, available: NDArray[np.float32]) -> NDArray[np.float64]:
        """Weights ``(batch, experts)`` for the cameras that deliver."""
        columns = [self.experts.index(camera) for camera in self.cameras]
        return np.stack([self.weights[tuple(row[columns] > 0)] for row in available])


def always(linear: LinearByPattern, on: tuple[str, ...], turning_radps: float = 0.0) -> Actor:
    """Cameras ``on`` are awake whenever the car turned at ``turning_radps`` or more."""
    chosen = np.array([camera in on for camera in linear.cameras])

    def act(observation: dict[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        weights = linear(observation["available"]) / RAW_SCALE
        awake = chosen & (np.abs(observation["previous_yaw_rate"]) >= turning_radps)
        return np.concatenate([weights, np.where(awake, 1.0, -1.0)], axis=1).astype(np.float32)

    return act


def greedy_order(recordings: Recordings, fold: int, track: str, linear: LinearByPattern) -> list[str]:
    """Cameras by the yaw error they take away on the training folds, the best first."""
    order: list[str] = []
    while len(order) < len(linear.cameras):
        rest = [camera for camera in linear.cameras if camera not in order]
        scores = {
            camera: play(recordings, fold, track, always(linear, (*order, camera)), split="train").yaw_rmse_deg.mean()
            for camera in rest
        }
        order.append(min(scores, key=scores.__getitem__))
    return order


def play(recordings: Recordings, fold: int, track: str, act: Actor, split: str = "test", **options: Any) -> Point:
    """Every scene of a split once."""
    options = {"weights": "raw", "raw_scale": RAW_SCALE, "observation": "dict", **options}
    scenes = sum((scene.fold == fold) == (split == "test") and scene.fold >= 0 for scene in recordings.scenes)
    env = gym.make_vec(
        "mixo_env:MixoOdometryBudget-v0",
        scenes,
        recordings=recordings,
        fold=fold,
        split=split,
        track=track,
        order="fixed",
        **options,
    )
    observation, _ = env.reset(seed=0)
    names = ("ate_m", "yaw_rmse_deg")
    scores = {name: np.full(scenes, np.nan) for name in names}
    cost, steps = np.zeros(scenes), np.zeros(scenes)
    while np.isnan(scores["ate_m"]).any():
        running = np.isnan(scores["ate_m"])
        observation, _, _, truncated, info = env.step(act(observation))
        cost += np.where(running, info.get("cost_ms", 0.0), 0.0)
        steps += running
        for i in np.flatnonzero(truncated & running):
            for name in names:
                scores[name][i] = info["scores"][name][i]
    return Point(scores["ate_m"], scores["yaw_rmse_deg"], cost / steps)


def learn(recordings: Recordings, fold: int, track: str, price_per_ms: float, steps: int, seed: int) -> Point:
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
    model = PPO("MlpPolicy", env, seed=seed, policy_kwargs={"log_std_init": -0.5}, device="cpu", **settings)
    model.learn(steps)
    actor: Actor = lambda observation: model.predict(transform(observation), deterministic=True)[0]  # noqa: E731
    return play(recordings, fold, track, actor, **options)


def policies(recordings: Recordings, fold: int, track: str, study: BudgetStudy) -> Iterator[tuple[str, str, Point]]:
    """Kind, name and point of every policy on one fold."""
    training = recordings.select(folds=[f for f in range(4) if f != fold])
    linear = LinearByPattern(training, track)
    cameras = linear.cameras
    for on in ((), *((camera,) for camera in cameras), cameras):
        name = {0: "no camera", len(cameras): "all cameras"}.get(len(on), "".join(on))
        yield "trivial", name, play(recordings, fold, track, always(linear, on))
    order = greedy_order(recordings, fold, track, linear)
    for count in range(1, len(order) + 1):
        yield "greedy set", f"best {count}", play(recordings, fold, track, always(linear, tuple(order[:count])))
    for rate in study.turning_radps:
        name = f"best 2 above {np.rad2deg(rate):.1f} deg/s"
        yield "greedy while turning", name, play(recordings, fold, track, always(linear, tuple(order[:2]), rate))
    for price in study.prices_per_ms if study.ppo_steps else ():
        yield "PPO", f"price {price:g} per ms", learn(recordings, fold, track, price, study.ppo_steps, study.seed)


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
    turning_radps: tuple[float, ...] = (0.01, 0.03, 0.1)
    """Thresholds of the greedy policy that wakes cameras in turns."""
    seed: int = 0
    """Of PPO."""

    def run(self) -> int:
        """Play, print and draw."""
        recordings = load_recordings(self.recordings)
        folds = sorted({scene.fold for scene in recordings.scenes if scene.fold >= 0})
        points: dict[tuple[str, str], list[Point]] = {}
        for fold in folds:
            for kind, name, point in policies(recordings, fold, self.track, self):
                points.setdefault((kind, name), []).append(point)
        rows = []
        for (kind, name), parts in points.items():
            cost, yaw, ate = (
                float(np.mean(np.concatenate([getattr(part, field) for part in parts])))
                for field in ("cost_ms", "yaw_rmse_deg", "ate_m")
            )
            rows.append((kind, name, cost, yaw, ate))
        print(
            f"track {self.track}, data {recordings.manifest.data_version}, {len(recordings)} scenes, {len(folds)} folds"
        )
        print(f"{'':22}{'':22}{'ms/step':>8} {'yaw RMSE [deg]':>15} {'ATE [m]':>8}")
        for kind, name, cost, yaw, ate in rows:
            print(f"{kind:22}{name:22}{cost:8.1f} {yaw:15.4f} {ate:8.3f}")
        self._draw(rows)
        return 0

    def _draw(self, rows: list[tuple[str, str, float, float, float]]) -> None:
        import matplotlib as mpl

        mpl.use("Agg")
        from matplotlib import pyplot as plt

        figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
        markers = {"trivial": "o", "greedy set": "s", "greedy while turning": "D", "PPO": "^"}
        for axis, column, label in zip(axes, (3, 4), ("yaw increment RMSE [deg]", "ATE [m]"), strict=True):
            for kind in dict.fromkeys(row[0] for row in rows):
                mine = sorted((row for row in rows if row[0] == kind), key=lambda row: row[2])
                line = "none" if kind == "trivial" else "-"
                x, y = [row[2] for row in mine], [row[column] for row in mine]
                axis.plot(x, y, marker=markers[kind], linestyle=line, label=kind)
                if kind == "trivial":
                    for row in mine:
                        text = row[1].replace("CAM_", "").lower().replace("_", " ")
                        axis.annotate(text, (row[2], row[column]), (5, 4), textcoords="offset points", fontsize=7)
            axis.set(xlabel="image processing [ms per step]", ylabel=label)
            axis.grid(alpha=0.3)
        axes[0].legend(fontsize=8)
        self.out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(self.out, dpi=110)
        plt.close(figure)
        print(f"wrote {self.out}")


if __name__ == "__main__":
    import tyro

    raise SystemExit(tyro.cli(BudgetStudy).run())
