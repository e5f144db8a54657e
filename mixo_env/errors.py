"""Every error a user can cause, one base class, one line each: what was expected, what came, what to do."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable


class MixoError(Exception):
    """Base of all errors raised on purpose by this project."""


class ConfigurationError(MixoError):
    """A wrong option, an unknown name or a contradiction: the call must change (exit code 2)."""


class UnknownOption(ConfigurationError, TypeError):  # noqa: N818
    """A keyword that no option has (exit code 2).

    A TypeError too, with Python's own words: libraries probe what a constructor takes by catching that.
    """


class DatasetError(MixoError):
    """A nuScenes folder, image or CAN bus file that is missing or broken (exit code 1)."""


class RecordingError(MixoError):
    """A recording that is missing, truncated, edited or of another schema version (exit code 1)."""


class TrajectoryError(MixoError):
    """A trajectory or trajectory file that cannot be read or scored (exit code 1)."""


class PolicyError(MixoError):
    """A policy that does not fit the recordings or the environment it is used on (exit code 1)."""


class ResultsError(MixoError):
    """A folder of results is incomplete or contradicts itself."""


class OutputError(MixoError):
    """A file or folder that cannot be written: read-only, full, or something in the way (exit code 1)."""


def printable(text: str) -> str:
    r"""Text from data as a terminal may show it: everything that would act instead of being seen is spelt out.

    Control characters (line ends too), direction marks and other invisible format characters, line and paragraph
    separators, and halves of surrogate pairs become ``\x1b``, ``\u202e`` and so on; all other text stays as it is.
    """
    return "".join(
        character.encode("unicode_escape").decode("ascii")
        if (category := unicodedata.category(character))[0] == "C" or category in ("Zl", "Zp")
        else character
        for character in text
    )


def unknown(kind: str, name: object, valid: Iterable[str]) -> str:
    """Message for an unknown name, with the nearest valid one first.

    Args:
        kind: what the name stands for, e.g. ``"policy"``.
        name: the name that was given.
        valid: all names that would have been accepted.

    Returns:
        One line, e.g. ``unknown policy 'LINAER': did you mean 'LINEAR'? Valid: HIGHEST MATCH, LINEAR``.
    """
    names = sorted(valid)
    folded = {candidate.casefold(): candidate for candidate in names}
    near = difflib.get_close_matches(str(name).casefold(), list(folded), n=1, cutoff=0.4)
    hint = f" did you mean {folded[near[0]]!r}?" if near else ""
    return f"unknown {kind} {name!r}:{hint} Valid: {', '.join(names)}"
