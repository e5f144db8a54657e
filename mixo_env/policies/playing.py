"""Playing a policy through recorded scenes, and the table of what it saw: the training data of learned policies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.replay import Replay
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.recordings.collection import Recordings


def play(policy: Policy, replay: Replay) -> Iterator[tuple[NDArray[np.bool_], Observation, Weights]]:
    """Drive all scenes of ``replay`` in lockstep, once, to the end of the longest.

    Yields:
        After each step: which scenes took it, ``(scenes,)``, what the policy saw before it, and its weights.
    """
    replay.reset(np.arange(len(replay)))
    policy.reset(len(replay))
    look_ahead = _foresight(policy, replay) if policy.lag else None
    while not replay.done.all():
        active = ~replay.done
        if look_ahead is not None:
            next(look_ahead)
        observation = replay.observe()
        weights = policy.act(observation)
        replay.step(weights)
        yield active, observation, weights


def _foresight(policy: Policy, replay: Replay) -> Iterator[None]:
    """Drive the same scenes ``policy.lag`` steps ahead of it and tell it what is seen there."""
    scout = replay.another(len(replay), keep_trajectories=False)
    scout.reset(np.arange(len(replay)))
    nothing = np.zeros((len(replay), len(replay.experts)))
    shown = 0
    while True:
        policy.preview(scout.observe(), ~scout.done)
        scout.step(nothing)
        shown += 1
        if shown > policy.lag:
            yield


def collect(recordings: Recordings, track: str, policy: Policy) -> Observation:
    """What ``policy`` sees at every step of training scenes, with ``truth_yaw_rate``, for other policies to learn from.

    Returns:
        Name -> ``(steps, width)``, step by step, the scenes of a step in order.
    """
    replay = Replay(recordings, track=track, privileged=True)
    seen = [{name: values[active] for name, values in look.items()} for active, look, _ in play(policy, replay)]
    return {name: np.concatenate([look[name] for look in seen]) for name in seen[0]}
