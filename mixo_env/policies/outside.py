"""Policies from outside: a class, a file, a saved folder, an SB3 zip or a function, told from what is given."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.policies import registry
from mixo_env.policies.agent import Agent, Asking, Frozen
from mixo_env.policies.policy import Policy
from mixo_env.policies.sb3 import Network, read_network
from mixo_env.recordings.collection import Recordings


@dataclass(frozen=True)
class Outside:
    """A policy from outside.

    Attributes:
        name: of its row.
        kind: its class, of which a new one is fitted for every fold, or the frozen policy.
        builtin: it is one of the registry's own rows.
    """

    name: str
    kind: type[Policy] | Frozen
    builtin: bool = False


@dataclass(frozen=True)
class Reading:
    """How something from outside is read.

    Attributes:
        asking: how a function or a network is asked.
        network: what a zip does not say in plain JSON.
        policy_class: ``module:Class`` or ``file.py:Class`` that wrote a saved folder; imported because this says so.
    """

    asking: Asking = field(default_factory=Asking)
    network: Network = field(default_factory=Network)
    policy_class: str | None = None


def resolve(given: Any, recordings: Recordings, reading: Reading, fitted_on: frozenset[str] | None = None) -> Outside:
    """Find the policy that ``given`` means.

    Args:
        given: a :class:`Policy`, its class, a function, or text: a registered name, ``module:Class``,
            ``file.py:Class``, a folder written by ``Policy.save``, a zip of Stable-Baselines3.
        recordings: for the names of their experts.
        reading: how.
        fitted_on: hashes of the drives that a function or network was trained on; empty: on none.

    Raises:
        ConfigurationError: for text that means nothing, or a network that does not say where it was trained.
        PolicyError: for a policy that cannot be made or read.
    """
    if not isinstance(given, str | Path):
        return _of_object(given, reading.asking, fitted_on, recordings)
    text, path = str(given), Path(given)
    if path.is_dir():
        loaded = _class(reading.policy_class).load(path) if reading.policy_class else registry.load(path)
        return _frozen(loaded, f"{loaded.name} (saved)", fitted_on, recordings)
    if path.suffix == ".zip":
        if fitted_on is None:
            raise ConfigurationError(
                f"{text}: a trained network must say on which drives it was trained: give fitted_on (--fitted-on none, "
                "train, or a file of scenes)"
            )
        function, seen = read_network(path, reading.network, reading.asking)
        name = f"{path.stem} (zip)"
        return _frozen(Agent(function, name, seen), name, fitted_on, recordings)
    meant = {name.casefold().replace("_", " "): name for name in registry.names(recordings)}
    if found := meant.get(text.casefold().replace("-", " ").replace("_", " ")):
        return Outside(found, registry.kind(found, recordings), builtin=True)
    if ":" in text:
        return _of_object(import_object(text), reading.asking, fitted_on, recordings)
    raise ConfigurationError(
        f"policy {text!r}: expected a name of the leaderboard, module:Class, file.py:Class, a folder written by "
        "Policy.save or a zip of Stable-Baselines3: found none of these"
    )


def import_object(text: str) -> Any:
    """What ``module:Name`` or ``file.py:Name`` names; the current folder is importable, as for ``python -m``.

    Raises:
        PolicyError: when the module cannot be imported or lacks the name.
    """
    source, _, name = text.rpartition(":")
    try:
        if source.endswith(".py"):
            spec = importlib.util.spec_from_file_location(Path(source).stem, source)
            assert spec
            assert spec.loader
            module = importlib.util.module_from_spec(spec)
            sys.modules.setdefault(spec.name, module)
            spec.loader.exec_module(module)
        else:
            if str(Path.cwd()) not in sys.path:
                sys.path.insert(0, str(Path.cwd()))
            module = importlib.import_module(source)
        return getattr(module, name)
    except Exception as error:
        raise PolicyError(f"policy {text!r} cannot be imported ({type(error).__name__}: {error})") from None


def _class(text: str) -> type[Policy]:
    found = import_object(text)
    if not isinstance(found, type) or not issubclass(found, Policy):
        raise PolicyError(f"{text}: expected a subclass of Policy, got {found!r}: name the class that saved the folder")
    return found


def make_policy(kind: type[Policy]) -> Policy:
    """A new policy of a stranger's class.

    Raises:
        PolicyError: when it cannot be made without arguments or has no name.
    """
    try:
        policy = kind()
    except Exception as error:
        raise PolicyError(
            f"{kind.__name__}: cannot be made without arguments ({type(error).__name__}: {error})"
        ) from None
    if not isinstance(getattr(policy, "name", None), str) or not policy.name.strip() or not policy.name.isprintable():
        raise PolicyError(
            f"{kind.__name__}: expected a printable text as `name`, got {getattr(policy, 'name', None)!r}"
        )
    return policy


def _of_object(given: Any, asking: Asking, fitted_on: frozenset[str] | None, recordings: Recordings) -> Outside:
    if isinstance(given, type):
        if not issubclass(given, Policy):
            raise PolicyError(f"{given.__name__}: expected a subclass of Policy: derive from it")
        return Outside(_free(make_policy(given).name, recordings), given)
    if isinstance(given, Policy):
        return _frozen(given, given.name, fitted_on, recordings)
    if callable(given):
        name = getattr(given, "__name__", type(given).__name__)
        return _frozen(Agent(given, name, asking), name, fitted_on or frozenset(), recordings)
    raise PolicyError(f"expected a policy, its class or a function, got {type(given).__name__}: see docs/policies.md")


def _frozen(policy: Policy, name: str, fitted_on: frozenset[str] | None, recordings: Recordings) -> Outside:
    drives = policy.fitted_on | (fitted_on or frozenset())
    if not drives and policy.learns:
        raise PolicyError(
            f"{name} does not say on which drives it was fitted: give its class, or fit it with `prepare`"
        )
    frozen = Frozen(policy, _free(name, recordings), drives)
    return Outside(frozen.name, frozen)


def _free(name: str, recordings: Recordings) -> str:
    """``name``, if no row of the leaderboard has it."""
    if name.casefold() in {taken.casefold() for taken in registry.names(recordings)}:
        raise PolicyError(f"{name} is the name of a row of the leaderboard: give yours another `name`")
    return name
