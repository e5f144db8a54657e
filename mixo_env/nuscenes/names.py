"""Names and paths that stand in tables: what may become part of a path on disk, a column or a line on a terminal.

Tables come from elsewhere. A scene's name becomes the names of its CAN bus files and of its part of a recording; an
image's name is opened. Neither may lead out of the folder it belongs to.
"""

from __future__ import annotations

import re
import unicodedata

from mixo_env.errors import DatasetError

LONGEST_NAME = 100
LONGEST_PATH = 1_000
LONGEST_TEXT = 200

# Names that Windows keeps for devices, whatever their ending.
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
_NAME = re.compile(r"\w(?:[\w .+-]*[\w+-])?")
_CHANNEL = re.compile(r"[A-Za-z0-9_-]+")
# Endings that files beside a scene's own have: a scene called "a.timings" would overwrite the timings of "a".
_RESERVED_ENDING = (".timings", ".tmp", ".part")


def check_name(where: str, name: str) -> str:
    """A name of a scene that may become the name of a file.

    Args:
        where: the row that holds it, for the message.
        name: letters, digits, spaces, and ``_ . + -`` inside; at most ``LONGEST_NAME`` characters.

    Raises:
        DatasetError: for any other name.
    """
    if (
        len(name) > LONGEST_NAME
        or len(name.encode()) > 2 * LONGEST_NAME
        or not _NAME.fullmatch(name)
        or _DEVICE.fullmatch(name)
        or name.casefold().endswith(_RESERVED_ENDING)
        or unicodedata.normalize("NFC", name) != name
    ):
        raise DatasetError(
            f"{where}: the name {_shown(name)} cannot be the name of a file; expected one like 'scene-0061': "
            f"letters, digits and _ . + - inside, at most {LONGEST_NAME} characters"
        )
    return name


def check_channel(where: str, channel: str) -> str:
    """A channel that may become a folder and a column.

    Raises:
        DatasetError: anything but letters, digits, ``_`` and ``-``.
    """
    if len(channel) > LONGEST_NAME or not _CHANNEL.fullmatch(channel) or _DEVICE.fullmatch(channel):
        raise DatasetError(f"{where}: the channel {_shown(channel)} is no channel; expected one like 'CAM_FRONT'")
    return channel


def check_text(where: str, kind: str, text: str) -> str:
    """A short text that is printed: log, vehicle, location.

    Raises:
        DatasetError: too long, or with control characters.
    """
    if len(text) > LONGEST_TEXT or not text.isprintable():
        raise DatasetError(f"{where}: the {kind} {_shown(text)} must be printable, at most {LONGEST_TEXT} characters")
    return text


def check_path(where: str, path: str) -> str:
    """A path of a file below the root of the data set, with forward slashes.

    Raises:
        DatasetError: absolute, with a drive, a backslash, ``.``, ``..``, an empty part or an unprintable character.
    """
    parts = path.split("/")
    if (
        len(path) > LONGEST_PATH
        or not path.isprintable()
        or any(len(part.encode()) > 255 or part in ("", ".", "..") or _DEVICE.fullmatch(part) for part in parts)
        or "\\" in path
        or ":" in path
    ):
        raise DatasetError(
            f"{where}: the file name {_shown(path)} must stay below the folder of the data set, "
            "like 'samples/CAM_FRONT/....jpg'; nothing was opened: unpack the metadata again"
        )
    return path


def _shown(name: str) -> str:
    """The name as it stands in a message; a long one is cut."""
    return repr(name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME]}...")
