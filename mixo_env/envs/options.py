"""Options checked once, against the annotations of the frozen dataclass that holds them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from mixo_env.errors import ConfigurationError, UnknownOption, unknown

WORDS: dict[Any, str] = {
    NoneType: "None",
    bool: "True or False",
    int: "a whole number",
    float: "a finite number",
    str: "text",
    Path: "a path",
    Sequence: "a list of",
    Mapping: "a mapping of names",
}
"""Type -> what it is called in an error; other classes go by their own name."""

LONGEST = 80
"""Characters of a wrong value that an error repeats."""


def check_names(given: Iterable[str], options: type) -> None:
    """Refuse names that are no field of the dataclass ``options``.

    Raises:
        UnknownOption: naming the first such name, the nearest field and all of them.
    """
    names = list(hints(options))
    for name in given:
        if name not in names:
            hint = unknown("option", name, names).partition(":")[2]
            raise UnknownOption(f"got an unexpected keyword argument {name!r}:{hint}")


def check_fields(options: Any) -> None:
    """Check every field of a dataclass instance against its annotation.

    A bool is True or False and nothing else (``"no"`` would be true); numbers are finite and no bools; text is no list;
    a ``Literal`` lists the valid names.

    Raises:
        ConfigurationError: for the first field of another type or choice.
    """
    for name, hint in hints(type(options)).items():
        value = getattr(options, name)
        choices = [choice for part in parts(hint) if get_origin(part) is Literal for choice in get_args(part)]
        if choices and isinstance(value, str) and value not in choices and str not in parts(hint):
            raise ConfigurationError(unknown(f"{name} option", value, choices))
        if not fits(value, hint):
            raise ConfigurationError(
                f"{name}: expected {described(hint)}, got {shown(value)}: {remedy(type(options), name)}"
            )


@cache
def hints(options: type) -> dict[str, Any]:
    """Field -> annotation, evaluated."""
    return get_type_hints(options)


def parts(hint: Any) -> tuple[Any, ...]:
    """Alternatives of a union; of anything else the hint itself."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def fits(value: Any, hint: Any) -> bool:
    """Whether ``value`` is what ``hint`` says."""
    if len(parts(hint)) > 1:
        return any(fits(value, part) for part in parts(hint))
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        return any(type(value) is type(choice) and value == choice for choice in inner)
    if origin is Sequence:
        listed = isinstance(value, Sequence) and not isinstance(value, str | bytes)
        return listed and all(fits(one, *inner) for one in value)
    if origin in (dict, Mapping):
        return isinstance(value, Mapping) and all(isinstance(key, str) for key in value)
    if hint is bool:
        return isinstance(value, bool)
    if hint in (int, float):
        numbers = (int, np.integer) if hint is int else (int, float, np.integer, np.floating)
        return isinstance(value, numbers) and not isinstance(value, bool) and math.isfinite(value)
    return hint is Any or isinstance(value, hint)


def shown(value: object) -> str:
    """The value and its type on one short line."""
    text = " ".join(repr(value).split())
    return f"{text if len(text) <= LONGEST else text[:LONGEST] + '...'} ({type(value).__name__})"


def remedy(options: type, name: str) -> str:
    """What to give instead."""
    default = next(field.default for field in fields(options) if field.name == name)
    return "it must be given" if default is MISSING else f"the default is {default!r}"


def described(hint: Any) -> str:
    """What ``hint`` asks for, in words."""
    if len(parts(hint)) > 1:
        return " or ".join(described(part) for part in parts(hint))
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Literal:
        return " or ".join(repr(choice) for choice in inner)
    if origin is Sequence:
        return f"{WORDS[Sequence]} ({described(*inner)})"
    return WORDS[Mapping] if origin in (dict, Mapping) else WORDS.get(hint, getattr(hint, "__name__", str(hint)))
