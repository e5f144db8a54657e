"""Fitted policies kept in a folder: one piece for every row, track, held-out fold and seed.

A piece is used again only where fitting would give it anew: same policy, settings and code, same training data to the
last bit, same seed and version. Some come with the package, and are found by :func:`shipped`.
"""

from __future__ import annotations

import json
import logging
from hashlib import blake2b
from importlib.resources import files
from pathlib import Path

import mixo_env
from mixo_env.errors import ConfigurationError, PolicyError, unknown
from mixo_env.files import remove, write_json
from mixo_env.leaderboard.code_hash import code_hash
from mixo_env.policies.fitting import drives, prepare
from mixo_env.policies.policy import Policy
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.manifest import encode_manifest

_FITTING = "mixo_env.policies.fitting"
_LOG = logging.getLogger(__name__)

STAMP = "stamp.json"
"""Written last: a piece without it was interrupted and is fitted anew."""

UNFOLDED = -1
"""Stands for the held-out fold where none is held out."""

SHIPPED = Path(str(files("mixo_env.policies"))) / "weights"
"""What ``make weights`` writes: rows fitted on the bundled mixocity."""

PREFIX = "shipped:"


def part(name: str, track: str, fold: int, repetition: int) -> Path:
    """Where a piece lies in a folder of weights."""
    held_out = "all-folds" if fold == UNFOLDED else f"fold-{fold}"
    return Path(name) / track / f"{held_out}-seed-{repetition}"


def shipped() -> Path | None:
    """The folder of weights that come with the package, if any do."""
    return SHIPPED if SHIPPED.is_dir() else None


def shipped_piece(text: str, track: str) -> Path:
    """The piece that ``shipped:ROW`` means: fitted on all folds of the bundled recordings.

    Args:
        text: with the prefix; case, hyphens and underscores of the row do not matter.
        track: whose experts vote.

    Raises:
        ConfigurationError: when no such weights come with the package.
    """
    name = text.removeprefix(PREFIX)
    there = {path.parts[-3]: path for path in sorted(SHIPPED.glob(str(part("*", track, UNFOLDED, 0))))}
    plain = {row.casefold().replace("-", " "): path for row, path in there.items()}
    found = plain.get(name.casefold().replace("-", " ").replace("_", " "))
    if found is None:
        raise ConfigurationError(f"weights that come with the package, track {track}: {unknown('row', name, there)}")
    return found


def stamp(policy: Policy, training: Recordings, track: str, seed: int) -> str:
    """Hash of everything that a fit depends on.

    Which processor and which versions of libraries computed does not enter, though either may change last digits:
    weights would then be of use on the machine alone that made them.

    Args:
        policy: new; its name, settings and code enter.
        training: every column enters, and all that the manifest says (scenes, vehicles, experts, schema).
        track: whose experts vote.
        seed: of whatever is random in the fit.
    """
    kind = type(policy)
    code = [kind.__qualname__, code_hash(kind.__module__), code_hash(_FITTING)]
    said = [mixo_env.__version__, policy.name, policy.settings(), code, track, training.voters(track), seed]
    digest = blake2b(json.dumps(said, sort_keys=True).encode(), digest_size=16)
    digest.update(encode_manifest(training.manifest))
    digest.update(training.fingerprint)
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
    if holds(piece, policy, training, track, seed):
        taken = type(policy).load(piece)
        if taken.experts != policy.weighted(training.voters(track)) or taken.fitted_on != drives(training):
            raise PolicyError(f"{piece} does not hold what its {STAMP} says: delete it, and `mixo train` fits it anew")
        _LOG.info("%s: weights taken, not fitted", piece)
        return taken
    expected = stamp(policy, training, track, seed) if keep else ""  # of the policy as it is before it is fitted
    prepare(policy, training, track, seed=seed)
    if keep:
        remove(piece / STAMP)  # or a kill between the two writes leaves a new file, an old stamp
        policy.save(piece)
        write_json(piece / STAMP, {"stamp": expected})
    return policy


def holds(piece: Path, policy: Policy, training: Recordings, track: str, seed: int) -> bool:
    """Whether a folder says that it holds what fitting would give; arguments as those of :func:`fit_or_take`."""
    found = _stamped(piece)
    return found is not None and found == stamp(policy, training, track, seed)  # a stamp costs time


def _stamped(piece: Path) -> str | None:
    try:
        return json.loads((piece / STAMP).read_text(encoding="utf-8"))["stamp"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
