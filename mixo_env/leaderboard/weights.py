"""Fitted policies kept in a folder: one piece for every row, track, held-out fold and seed.

A piece is used again only where fitting would give it anew: same policy and settings, same training data to the last
bit, same seed and version.
"""

from __future__ import annotations

import hashlib
import json
import logging
from pathlib import Path

import numpy as np

import mixo_env
from mixo_env.errors import PolicyError
from mixo_env.files import remove, write_json
from mixo_env.policies.fitting import drives, prepare
from mixo_env.policies.policy import Policy
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.manifest import encode_manifest

_LOG = logging.getLogger(__name__)

STAMP = "stamp.json"
"""Written last: a piece without it was interrupted and is fitted anew."""


def stamp(policy: Policy, training: Recordings, track: str, seed: int) -> str:
    """Hash of everything that a fit depends on.

    Args:
        policy: new; its name and settings enter.
        training: every column enters, and all that the manifest says (scenes, vehicles, experts, schema).
        track: whose experts vote.
        seed: of whatever is random in the fit.
    """
    said = [mixo_env.__version__, policy.name, policy.settings(), track, training.voters(track), seed]
    digest = hashlib.blake2b(json.dumps(said, sort_keys=True).encode(), digest_size=16)
    digest.update(encode_manifest(training.manifest))
    for name in sorted(training.column_names):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(training[name]).tobytes())
    return digest.hexdigest()


def fit_or_take(policy: Policy, training: Recordings, track: str, seed: int, piece: Path, *, keep: bool) -> Policy:
    """The policy of a piece if it is what fitting would give; else ``policy``, fitted.

    Args:
        policy: new.
        training: scenes of the training folds.
        track: whose experts vote.
        seed: of whatever is random in the fit.
        piece: folder of this row, track, fold and seed.
        keep: write what was fitted into ``piece``.

    Raises:
        PolicyError: when a piece that should fit is damaged, or the fit fails.
        OutputError: when a piece cannot be written.
    """
    expected = stamp(policy, training, track, seed)
    if _stamped(piece) == expected:
        taken = type(policy).load(piece)
        if taken.experts != policy.weighted(training.voters(track)) or taken.fitted_on != drives(training):
            raise PolicyError(f"{piece} does not hold what its {STAMP} says: delete it, and `mixo train` fits it anew")
        _LOG.info("%s: weights taken, not fitted", piece)
        return taken
    prepare(policy, training, track, seed=seed)
    if keep:
        remove(piece / STAMP)  # or a kill between the two writes leaves a new file, an old stamp
        policy.save(piece)
        write_json(piece / STAMP, {"stamp": expected})
    return policy


def _stamped(piece: Path) -> str | None:
    try:
        return json.loads((piece / STAMP).read_text(encoding="utf-8"))["stamp"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
