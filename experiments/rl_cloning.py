"""Behaviour cloning of an oracle: privileged training, honest acting.

The actor is PPO's, but it learns what the oracle that reads the truth would weigh, from what an agent sees; played, it
reads no truth. Steps count the observations it was shown.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from mixo_env.envs.actions import LOGIT_SCALE
from mixo_env.policies.oracle import OracleHull
from mixo_env.policies.playing import collect
from mixo_env.policies.reinforcement import Reinforced, flat
from mixo_env.recordings.collection import Recordings

BATCH = 1024


def clone(
    agent: Reinforced, training: Recordings, track: str, model: Any, steps: int, look: Callable[[int, float], None]
) -> None:
    """Train the actor of ``model`` to give ORACLE HULL's weights.

    Args:
        agent: started and with its standardisation.
        training: scenes with poses free of lag.
        track: who votes.
        model: of the agent; changed in place.
        steps: observations to learn from in all.
        look: told after every pass how many have been shown, and the CPU time [s] so far.
    """
    import torch

    began = time.process_time()
    oracle = OracleHull()
    oracle.start(training.voters(track))
    seen = collect(training, track, oracle)
    inputs = torch.from_numpy(agent.standardise_flat(flat(seen, agent.recipe.observation)))
    target = torch.from_numpy(oracle.act(seen).astype(np.float32))
    actor = torch.nn.Sequential(model.policy.mlp_extractor.policy_net, model.policy.action_net)
    optimiser = torch.optim.Adam(actor.parameters(), agent.recipe.settings["learning_rate"])
    shown = 0
    while shown < steps:
        for batch in torch.randperm(len(inputs)).split(BATCH):
            logits = LOGIT_SCALE * actor(inputs[batch]).clamp(-1.0, 1.0)
            loss = -(target[batch] * torch.log_softmax(logits, dim=1)).sum(dim=1).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        shown += len(inputs)
        look(shown, time.process_time() - began)
