"""PPO in one file, in the manner of CleanRL: plain torch on the vector environment. `python cleanrl_ppo.py`.

gamma is 0, since an action changes almost nothing of what comes next; a return is then a reward, and the advantage is
the reward less what the critic expected. With another gamma, put generalised advantage estimation in its place.
Errors are printed against the recorded poses of the environment, which err by about .01 deg a step themselves.
"""

import sys

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn
from torch.distributions import Normal

from mixo_env.envs.wrappers import standardise

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 122_880
ENVIRONMENTS, ROLLOUT, BATCH, EPOCHS = 64, 64, 1024, 10
RATE, CLIP, VALUE = 1e-3, 0.2, 0.5
TASK = {"track": "CONSUMER", "fold": 3, "observation": "rich", "weights": "softmax"}


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Two hidden layers."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


def held_out(actor: nn.Module, transform) -> float:
    """Mean yaw RMSE [deg] of the held-out scenes, each driven once."""
    scenes = 24
    env = gym.make_vec("mixo_env:MixoOdometry-v0", scenes, **TASK, split="test", order="fixed")
    seen, _ = env.reset(seed=0)
    errors = np.full(scenes, np.nan)
    while np.isnan(errors).any():
        with torch.no_grad():
            action = actor(torch.as_tensor(transform(seen))).clamp(-1, 1).numpy()
        seen, _, _, over, info = env.step(action)
        first = over & np.isnan(errors)
        if first.any():
            errors[first] = info["scores"]["yaw_rmse_deg"][first]
    return float(errors.mean())


if __name__ == "__main__":
    torch.manual_seed(0)
    torch.set_num_threads(1)
    transform = standardise(gym.make("mixo_env:MixoOdometry-v0", **TASK))
    env = gym.make_vec("mixo_env:MixoOdometry-v0", ENVIRONMENTS, autoreset_mode=AutoresetMode.SAME_STEP, **TASK)
    (width,), (experts,) = env.single_observation_space.shape, env.single_action_space.shape
    actor, critic, log_std = network(width, experts), network(width, 1), nn.Parameter(torch.full((experts,), -0.5))
    nn.init.orthogonal_(actor[-1].weight, 0.01)
    optimiser = torch.optim.Adam([*actor.parameters(), *critic.parameters(), log_std], RATE)
    print(f"untrained: {held_out(actor, transform):.4f} deg")

    seen, _ = env.reset(seed=0)
    for _ in range(STEPS // (ENVIRONMENTS * ROLLOUT)):
        states, actions, rewards = [], [], []
        for _ in range(ROLLOUT):
            states.append(torch.as_tensor(transform(seen)))
            with torch.no_grad():
                actions.append(Normal(actor(states[-1]), log_std.exp()).sample())
            seen, reward, _, _, _ = env.step(actions[-1].clamp(-1, 1).numpy())
            rewards.append(torch.as_tensor(reward, dtype=torch.float32))
        state, action, returns = torch.cat(states), torch.cat(actions), torch.cat(rewards)
        with torch.no_grad():
            before = Normal(actor(state), log_std.exp()).log_prob(action).sum(1)
            advantage = returns - critic(state)[:, 0]
        for _ in range(EPOCHS):
            for batch in torch.randperm(len(state)).split(BATCH):
                better = advantage[batch]
                better = (better - better.mean()) / (better.std() + 1e-8)
                now = Normal(actor(state[batch]), log_std.exp()).log_prob(action[batch]).sum(1)
                ratio = (now - before[batch]).exp()
                gain = torch.minimum(ratio * better, ratio.clamp(1 - CLIP, 1 + CLIP) * better).mean()
                loss = VALUE * (critic(state[batch])[:, 0] - returns[batch]).square().mean() - gain
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters(), log_std], 0.5)
                optimiser.step()
    print(f"after {STEPS} steps: {held_out(actor, transform):.4f} deg")
