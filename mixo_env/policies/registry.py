"""Every policy by the name printed in tables."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

from mixo_env.errors import ConfigurationError, PolicyError, printable, unknown
from mixo_env.policies import plugins, storage
from mixo_env.policies.affine_gate import LinearGate
from mixo_env.policies.bias_filter import BiasFilter
from mixo_env.policies.consensus import StudentT
from mixo_env.policies.covariance_intersection import CovarianceIntersection
from mixo_env.policies.fixed_share import FixedShare
from mixo_env.policies.gate import Mixo
from mixo_env.policies.inverse_variance import InverseVariance
from mixo_env.policies.linear import Linear
from mixo_env.policies.match import HighestMatch
from mixo_env.policies.oracle import MulticameraGT, OracleAll, OracleHull
from mixo_env.policies.policy import Policy
from mixo_env.policies.reinforcement import AGENTS
from mixo_env.policies.robust import Huber, Mean, Median
from mixo_env.policies.simplex import LinearSimplex
from mixo_env.policies.single import Single
from mixo_env.policies.smoother import Smoother
from mixo_env.policies.softmin import Softmin
from mixo_env.policies.tandem import Tandem
from mixo_env.policies.token_gate import Token
from mixo_env.policies.trio import Trio
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.variants import variants

POLICIES: dict[str, type[Policy]] = {
    policy.name: policy
    for policy in (
        *(HighestMatch, Mean, Median, Linear, LinearSimplex),
        *(InverseVariance, CovarianceIntersection, Huber, StudentT, Softmin, FixedShare, BiasFilter),
        *(LinearGate, Mixo, Token, Tandem, Trio, *AGENTS.values()),
        *(Smoother, MulticameraGT, OracleAll, OracleHull),
    )
}
"""Name -> class, in the order of the tables; every expert alone (:class:`Single`) comes before them."""


def names(recordings: Recordings) -> tuple[str, ...]:
    """All policies that can be scored on ``recordings``, in the order of the tables.

    Variants follow their camera, experts of other families (shown in track UNEQUAL alone) the last camera.
    """
    manifest = recordings.manifest
    of = variants(recordings)
    cameras = [name for camera in manifest.cameras for name in (camera, *(v for v in of if of[v] == camera))]
    own = (*manifest.inertial, *recordings.headline_imported, *cameras, *recordings.further, *POLICIES)
    return (*own, *plugins.plugins(own))


def kind(name: str, recordings: Recordings) -> type[Policy]:
    """The class of a policy.

    Raises:
        ConfigurationError: for an unknown name.
        PolicyError: for a plug-in that cannot be imported.
    """
    if name in POLICIES:
        return POLICIES[name]
    if variants(recordings).get(name, name) in recordings.experts:
        return Single
    return plugins.kind(_plugin(name, recordings))


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
    return plugins.make(_plugin(name, recordings))


def _plugin(name: str, recordings: Recordings) -> EntryPoint:
    known = names(recordings)
    if name not in known:
        raise ConfigurationError(unknown("policy", name, known))
    return plugins.plugins(known[: known.index(name)])[name]


def load(folder: Path) -> Policy:
    """Any saved policy of this package or of an installed distribution, by the name in its file.

    No file decides what is imported: another class reads what it saved by its own ``load``.

    Raises:
        PolicyError: when the file is missing or broken, or names no policy known here.
    """
    description, _ = storage.read(folder)
    name = description.policy
    if not description.kind:
        if name in POLICIES:
            return POLICIES[name].load(folder)
        if description.settings == {"expert": name}:
            return Single.load(folder)
    elif point := plugins.plugins(POLICIES).get(name):
        return plugins.kind(point).load(folder)
    else:
        raise PolicyError(
            f"{folder} was saved by {printable(description.kind)}, a class that mixo_env does not know and imports "
            "only when told to: name it if you trust it (--policy-class module:Class or file.py:Class)"
        )
    raise PolicyError(f"{folder}: {unknown('policy', name, POLICIES)}")
