"""Millions of steps in a loop of plain NumPy: equal weights in 1,024 scenes at once. `python vector_loop.py`."""

import sys
import time

import gymnasium as gym
import numpy as np

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 5_000_000
SCENES = 1024

if __name__ == "__main__":
    env = gym.make_vec("mixo_env:MixoOdometry-v0", SCENES, track="CONSUMER")
    equal = np.zeros(env.action_space.shape, np.float32)
    env.reset(seed=0)
    env.step(equal)  # compiles, once and for all
    total, began = 0.0, time.process_time()
    for _ in range(-(-STEPS // SCENES)):
        observation, reward, _, _, _ = env.step(equal)
        total += float(reward.mean())
    seconds, played = time.process_time() - began, -(-STEPS // SCENES) * SCENES
    print(f"{played} steps, {played / seconds / 1e6:.1f} M a second, mean reward {total * SCENES / played:.3f}")
