"""What can be told of an image file without decoding it, and how many broken ones a camera may have."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.files import open_file, read_file

LARGEST_IMAGE_PIXELS = 50_000_000
"""Thirty times a nuScenes image. A header can ask for 4 Gpx in a file of 19 kB."""

BROKEN_SHARE = 0.05
"""Of a camera's images in one scene may be broken, and one in any case: that costs their steps and not the scene."""

BROKEN_IN_A_ROW = 10
"""Broken images (0.8 s) at most: after a longer gap the odometry would begin anew."""

UNDECODABLE = "not to be decoded"
"""Of a file that is damaged between a sound beginning and a sound end."""

_HEADER_BYTES = 1_024
_LONGEST_HEADER_BYTES = 2**22
_TAIL_BYTES = 64
_SIZE_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_START, _END = b"\xff\xd8", b"\xff\xd9"


def image_fault(path: str | Path, width: int, height: int) -> str | None:
    """What is wrong with an image file; a kilobyte of it is read, nothing is decoded.

    Args:
        path: of the file.
        width: expected, pixels.
        height: expected, pixels.

    Returns:
        A few words to follow "is" or "are", such as ``"missing"``; ``None`` for a sound file.
    """
    try:
        with open_file(path) as file:
            return _fault(file, width, height)
    except FileNotFoundError:
        return "missing"
    except (DatasetError, OSError):
        return "unreadable or no files"


def _fault(file: BinaryIO, width: int, height: int) -> str | None:
    size = jpeg_size(file)
    length = file.seek(0, 2)
    file.seek(max(0, length - _TAIL_BYTES))
    tail = file.read(_TAIL_BYTES)
    if length == 0:
        return "empty"
    if size is None:
        return "no JPEG"
    if size != (width, height):
        return f"{size[0]} x {size[1]} (the tables say {width} x {height})"
    # Some writers pad; inside the picture these two bytes cannot follow each other.
    return None if _END in tail else "cut short"


def too_many_broken(faults: Mapping[int, str], images: int) -> bool:
    """Whether a camera cannot be used because of its broken images.

    Args:
        faults: position of a broken image among the camera's in the scene -> what is wrong with it.
        images: of the camera in the scene.
    """
    allowed = min(max(1.0, BROKEN_SHARE * images), images - 1)
    return len(faults) > allowed or _longest_run(faults) > BROKEN_IN_A_ROW


def _longest_run(positions: Mapping[int, object]) -> int:
    longest, run, before = 0, 0, None
    for position in sorted(positions):
        run = run + 1 if before is not None and position == before + 1 else 1
        longest, before = max(longest, run), position
    return longest


def describe_broken(camera: str, faults: Mapping[int, str], paths: Sequence[Path]) -> list[str]:
    """One line for every kind of fault, in the words of every command that meets it.

    Args:
        camera: channel.
        faults: as in :func:`too_many_broken`, of which there is one.
        paths: of the camera's images in the scene.
    """
    if too_many_broken(faults, len(paths)):
        limit = f"at most {BROKEN_SHARE:.0%} (one in any case) and {BROKEN_IN_A_ROW} in a row may be broken"
    else:
        limit = "no image in these steps"
    return [
        f"{camera}: {count} of {len(paths)} images are {fault}, "
        f"first {paths[min(position for position in faults if faults[position] == fault)]}: {limit}"
        for fault, count in Counter(faults[position] for position in sorted(faults)).items()
    ]


def jpeg_size(file: BinaryIO) -> tuple[int, int] | None:
    """Width and height in the header of a JPEG; ``None`` if it is none, or if its header never ends."""
    head = file.read(_HEADER_BYTES)
    if not head.startswith(_START):
        return None
    start, at = 0, 2  # of `head` in the file, and in `head`
    while True:
        if at + 9 > len(head):
            start += at
            if start > _LONGEST_HEADER_BYTES:
                return None
            file.seek(start)
            head, at = file.read(_HEADER_BYTES), 0
            if len(head) < 9:
                return None
        marker, length = head[at + 1], int.from_bytes(head[at + 2 : at + 4], "big")
        if head[at] != 0xFF:
            return None
        if marker in _SIZE_MARKERS:
            return int.from_bytes(head[at + 7 : at + 9], "big"), int.from_bytes(head[at + 5 : at + 7], "big")
        if marker == 0xFF:  # fill bytes, of which a hostile file may have millions
            at = len(head) - len(head[at:].lstrip(b"\xff")) - 1
        elif marker in (0xD9, 0xDA) or length < 2:  # end or picture data before any size
            return None
        else:
            at += 2 + length


def read_jpeg(path: Path) -> bytes:
    """The bytes of a JPEG that is safe to decode.

    Raises:
        DatasetError: it is missing, no file, no JPEG, or larger than ``LARGEST_IMAGE_PIXELS`` by its own header.
    """
    import io

    try:
        content = read_file(path)
    except FileNotFoundError:
        raise DatasetError(f"{path} cannot be read, it is missing: unpack or simulate it again") from None
    size = jpeg_size(io.BytesIO(content))
    if size is None:
        raise DatasetError(f"{path} cannot be read as JPEG (it has no JPEG header): unpack or simulate it again")
    if size[0] * size[1] > LARGEST_IMAGE_PIXELS:
        raise DatasetError(
            f"{path} is {size[0]} x {size[1]} pixels by its header; at most {LARGEST_IMAGE_PIXELS:,} are decoded"
        )
    return content
