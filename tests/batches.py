"""What a scene's place in a batch may not change."""

from __future__ import annotations

import numpy as np

from mixo_env.policies.playing import collect
from mixo_env.policies.policy import Policy
from mixo_env.recordings.collection import Recordings

SCENES = 37
"""More than one block of scenes, the last of which is not full."""


def assert_same_alone_and_among_many(policy: Policy, drives: Recordings, track: str) -> None:
    """Two steps of a fitted policy have the same bits for every scene by itself.

    Vectors of numbers end somewhere: where a scene stands in them must not matter.
    """
    look = {name: values[:SCENES] for name, values in collect(drives, track, policy).items()}
    policy.reset(SCENES)
    together = [policy.act(look) for _ in range(2)]
    for k in range(SCENES):
        policy.reset(1)
        for weights in together:
            alone = policy.act({name: values[k : k + 1] for name, values in look.items()})
            np.testing.assert_array_equal(alone[0], weights[k])
