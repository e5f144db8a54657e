"""How fast the environments are, against Gymnasium's own CartPole in the same run (CPU time, one thread).

python -m experiments.speed.environment
"""

from __future__ import annotations

import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from mixo_env.recordings.store import load_recordings

ROUNDS = 30
"""Candidates take turns this often; the median of the rounds counts, so that a busy moment hits all alike."""


def batched(env_id: str, num_envs: int, **options: Any) -> Callable[[], int]:
    """A burst of steps of a vector environment; returns how many single steps it was."""
    env = gym.make_vec(env_id, num_envs, **options)
    env.reset(seed=0)
    actions = env.action_space.sample()
    bursts = max(10, 20_000 // num_envs)

    def burst() -> int:
        for _ in range(bursts):
            env.step(actions)
        return bursts * num_envs

    return burst


def single(env_id: str, **options: Any) -> Callable[[], int]:
    """A burst of steps of one environment made by ``gymnasium.make``, with resets."""
    env = gym.make(env_id, **options)
    env.action_space.seed(0)
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(1000)]

    def burst() -> int:
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return len(actions)

    return burst


def race(candidates: dict[str, Callable[[], int]]) -> dict[str, float]:
    """Median steps per CPU second of every candidate."""
    rates: dict[str, list[float]] = {name: [] for name in candidates}
    for round_ in range(ROUNDS + 1):
        for name, burst in candidates.items():
            start = time.process_time()
            steps = burst()
            if round_:  # the first one warms up
                rates[name].append(steps / (time.process_time() - start))
    return {name: float(np.median(values)) for name, values in rates.items()}


def ppo_share() -> float:
    """Share of the environment in the CPU time of Stable-Baselines3's PPO with FINDINGS-like settings."""
    import torch
    from stable_baselines3 import PPO

    from mixo_env.envs.sb3 import MixoVecEnv

    torch.set_num_threads(1)

    class Timed(MixoVecEnv):
        """Adds up the time in the environment."""

        spent = 0.0

        def step_wait(self) -> Any:
            start = time.process_time()
            outcome = super().step_wait()
            Timed.spent += time.process_time() - start
            return outcome

    env = Timed("MixoOdometry-v0", 64)
    settings: dict[str, Any] = {"n_steps": 64, "batch_size": 1024, "n_epochs": 10, "gamma": 0.0, "device": "cpu"}
    model = PPO("MlpPolicy", env, seed=0, **settings)
    model.learn(4096)
    Timed.spent, start = 0.0, time.process_time()
    model.learn(32_768)
    return Timed.spent / (time.process_time() - start)


def memory_growth_bytes(steps: int = 1_000_000) -> int:
    """Python and NumPy memory gained over ``steps`` single steps."""
    burst = batched("MixoOdometry-v0", 1024)
    burst()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    done = 0
    while done < steps:
        done += burst()
    growth = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    return growth


def opening_s() -> float:
    """Median CPU seconds to open the bundled recordings."""
    times = []
    for _ in range(7):
        start = time.process_time()
        load_recordings()
        times.append(time.process_time() - start)
    return float(np.median(times))


def import_s() -> float:
    """Median CPU seconds of ``import mixo_env`` in a fresh interpreter, less those of starting it."""
    code = "import time; s = time.process_time(); import mixo_env; print(time.process_time() - s)"
    runs = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(5)]
    return float(np.median([float(run.stdout) for run in runs]))


def frames_per_s() -> float:
    """Rendered frames per CPU second."""
    env = gym.make("MixoOdometry-v0", render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(120):
        env.step(env.action_space.sample())
    start = time.process_time()
    for _ in range(50):
        env.render()
    return 50 / (time.process_time() - start)


def main() -> None:
    """Print every figure with its aim."""
    rates = race(
        {
            "batched 1,024": batched("MixoOdometry-v0", 1024),
            "CartPole-v1 vector 1,024": batched("CartPole-v1", 1024, vectorization_mode="vector_entry_point"),
            "SyncVectorEnv 64": batched("MixoOdometry-v0", 64, vectorization_mode="sync"),
            "single": single("MixoOdometry-v0"),
            "CartPole-v1": single("CartPole-v1"),
            "budget batched 1,024": batched("MixoOdometryBudget-v0", 1024),
        }
    )
    for name, rate in rates.items():
        print(f"{name:28} {rate:14,.0f} steps per CPU second")
    fast = rates["batched 1,024"]
    rows = [
        ("batched 1,024 / CartPole-v1 vector 1,024", f"{fast / rates['CartPole-v1 vector 1,024']:.2f}", ">= 2"),
        ("batched 1,024 / SyncVectorEnv 64", f"{fast / rates['SyncVectorEnv 64']:.0f}", ">= 150"),
        ("single / CartPole-v1, both gym.make", f"{rates['single'] / rates['CartPole-v1']:.2f}", ">= 1.3"),
        ("environment's share of SB3 PPO", f"{100 * ppo_share():.1f} %", "< 10 %"),
        ("memory gained over 1,000,000 steps", f"{memory_growth_bytes():,} bytes", "constant"),
        ("opening the bundled recordings", f"{opening_s():.3f} s", "< 0.3 s"),
        ("import mixo_env", f"{import_s():.2f} s", "< 1 s"),
        ("frames per second, 540 x 960", f"{frames_per_s():.0f}", ">= 20"),
    ]
    print()
    for name, value, aim in rows:
        print(f"{name:44} {value:>14}   aim {aim}")


if __name__ == "__main__":
    main()
