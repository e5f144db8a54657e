"""Episodes of LINEAR as a Minari data set, for offline reinforcement learning: `python minari_episodes.py`.

Needs `pip install 'mixo-env[integrations]'`; the data set goes where MINARI_DATASETS_PATH says, else to ~/.minari.
"""

import gymnasium as gym
import numpy as np

from mixo_env.envs.episodes import write_minari
from mixo_env.recordings.store import load_recordings

TRACK = "CONSUMER"

if __name__ == "__main__":
    env = gym.make("mixo_env:MixoOdometry-v0", track=TRACK, order="fixed", weights="raw", raw_scale=4.0)
    recordings = load_recordings()
    linear = recordings.manifest.linear_weights[TRACK]["3"]  # fitted without fold 3, which split "train" does not play
    action = np.array([linear[expert] for expert in recordings.voters(TRACK)], np.float32) / 4.0
    dataset = write_minari(env, lambda observation: action, "mixo/linear-v0", algorithm="LINEAR")
    print(f"{dataset.id}: {dataset.total_episodes} episodes, {dataset.total_steps} steps")
