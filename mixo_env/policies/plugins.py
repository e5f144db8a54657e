"""Policies of other installed distributions: the entry-point group ``mixo_env.policies``, name of the row -> class."""

from __future__ import annotations

import logging
from collections.abc import Collection
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from mixo_env.errors import PolicyError, printable
from mixo_env.policies.policy import Policy

GROUP = "mixo_env.policies"

_log = logging.getLogger(__name__)


def plugins(taken: Collection[str]) -> dict[str, EntryPoint]:
    """Name of the row -> entry point, not loaded. One whose name is taken or unprintable is left out, with a warning.

    Args:
        taken: names of the rows that exist without plug-ins.
    """
    found: dict[str, EntryPoint] = {}
    known = {name.casefold() for name in taken}
    for point in entry_points(group=GROUP):
        if not point.name.strip() or printable(point.name) != point.name:
            _warn(f"distribution {distribution(point)}: {point.name!r} is no name for a policy: left out")
        elif point.name.casefold() in known:
            _warn(f"distribution {distribution(point)}: the name {point.name} is taken by another policy: left out")
        else:
            found[point.name] = point
            known.add(point.name.casefold())
    return found


@cache
def _warn(text: str) -> None:
    """Once a process."""
    _log.warning("%s", text)


def make(point: EntryPoint) -> Policy:
    """A new policy of a plug-in.

    Raises:
        PolicyError: naming the distribution, when it cannot be imported or made, or is no policy of that name.
    """
    loaded = kind(point)
    where = "distribution {}, policy {}".format(*told(point))
    try:
        policy = loaded()
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise PolicyError(f"{where}: cannot be made ({what}): mend or uninstall it") from None
    if getattr(policy, "name", None) != point.name:
        raise PolicyError(f"{where}: expected a Policy of that name, got {loaded!r}: mend or uninstall it")
    return policy


def kind(point: EntryPoint) -> type[Policy]:
    """The class of a plug-in.

    Raises:
        PolicyError: naming the distribution, when it cannot be imported or is no policy.
    """
    where = "distribution {}, policy {}".format(*told(point))
    try:
        loaded = point.load()
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise PolicyError(f"{where}: cannot be imported ({what}): mend or uninstall it") from None
    if not isinstance(loaded, type) or not issubclass(loaded, Policy):
        raise PolicyError(f"{where}: expected a subclass of Policy, got {loaded!r}: mend or uninstall it")
    return loaded


def told(point: EntryPoint) -> tuple[str, str]:
    """Names of the distribution and of the policy."""
    return distribution(point), point.name


def distribution(point: EntryPoint) -> str:
    """Name of the distribution."""
    return point.dist.name if point.dist else "(unknown)"
