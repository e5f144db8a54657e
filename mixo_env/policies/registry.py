"""Every policy by the name printed in tables."""

from __future__ import annotations

from pathlib import Path

from mixo_env.errors import ConfigurationError, PolicyError, unknown
from mixo_env.policies import storage
from mixo_env.policies.gate import Mixo
from mixo_env.policies.linear import Linear
from mixo_env.policies.match import HighestMatch
from mixo_env.policies.oracle import MulticameraGT, OracleAll, OracleHull
from mixo_env.policies.plugins import make, plugins
from mixo_env.policies.policy import Policy
from mixo_env.policies.reinforcement import PPO
from mixo_env.policies.robust import Huber, Mean, Median
from mixo_env.policies.single import Single
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.variants import variants

POLICIES: dict[str, type[Policy]] = {
    policy.name: policy
    for policy in (HighestMatch, Mean, Median, Linear, Huber, Mixo, PPO, MulticameraGT, OracleAll, OracleHull)
}
"""Name -> class, in the order of the tables; every expert alone (:class:`Single`) comes before them."""


def names(recordings: Recordings) -> tuple[str, ...]:
    """All policies that can be scored on ``recordings``, in the order of the tables; variants follow their camera."""
    manifest = recordings.manifest
    of = variants(recordings)
    cameras = [name for camera in manifest.cameras for name in (camera, *(v for v in of if of[v] == camera))]
    own = (*manifest.inertial, *manifest.imported, *cameras, *POLICIES)
    return (*own, *plugins(own))


def create(name: str, recordings: Recordings) -> Policy:
    """A new, unfitted policy; a variant's is that of its camera, to be played on ``as_variant(recordings, name)``.

    Raises:
        ConfigurationError: for an unknown name.
        PolicyError: for a plug-in that cannot be made.
    """
    if name in POLICIES:
        return POLICIES[name]()
    alone = variants(recordings).get(name, name)
    if alone in recordings.experts:
        return Single(alone)
    known = names(recordings)
    if name in known:
        return make(plugins(known[: known.index(name)])[name])
    raise ConfigurationError(unknown("policy", name, known))


def load(folder: Path) -> Policy:
    """Any saved policy, by the name in its file.

    Raises:
        PolicyError: when the file is missing or broken, or names no policy known here.
    """
    description, _ = storage.read(folder)
    name = description.policy
    if name in POLICIES:
        return POLICIES[name].load(folder)
    if description.settings == {"expert": name}:
        return Single.load(folder)
    raise PolicyError(f"{folder}: {unknown('policy', name, POLICIES)}")
