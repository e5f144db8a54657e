"""Ways to break the folder of :func:`tests.nuscenes_fixture.write_nuscenes`: one row, one column, one file.

A fault is a way and the words by which it is found. The folder holds one scene, so its faults stop a recording.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

VERSION, SCENE = "v1.0-mini", "scene-2061"
Change = Callable[[list[dict[str, Any]]], Any]
Fault = tuple[Callable[[Path], None], str]


def table(name: str, change: Change) -> Callable[[Path], None]:
    """Change the rows of a table, in place or by what ``change`` returns."""

    def apply(root: Path) -> None:
        path = root / VERSION / f"{name}.json"
        rows = json.loads(path.read_text())
        changed = change(rows)
        path.write_text(json.dumps(changed if isinstance(changed, list) else rows))

    return apply


def each(key: str, value: Callable[[Any], Any]) -> Change:
    """One field of every row becomes a function of itself."""

    def change(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row[key] = value(row[key])

    return change


def one(key: str, value: Any, row: int = 0) -> Change:
    """One field of one row; a function is applied to the field."""

    def change(rows: list[dict[str, Any]]) -> None:
        rows[row][key] = value(rows[row][key]) if callable(value) else value

    return change


def cameras(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of ``sample_data`` that are images, in order of time."""
    return sorted((row for row in rows if "/CAM_" in row["filename"]), key=lambda row: row["timestamp"])


def image_row(key: str, value: Any, position: int = 1) -> Callable[[Path], None]:
    """One field of one image row; the second of a scene is CAM_FRONT's."""
    return table("sample_data", lambda rows: one(key, value, position)(cameras(rows)))


def can(message: str, change: Change) -> Callable[[Path], None]:
    """Change the rows of a CAN bus message."""

    def apply(root: Path) -> None:
        path = root / "can_bus" / f"{SCENE}_{message}.json"
        rows = json.loads(path.read_text())
        changed = change(rows)
        path.write_text(json.dumps(changed if isinstance(changed, list) else rows))

    return apply


def text(name: str, change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """Change the bytes of a file, by its path below the root."""

    def apply(root: Path) -> None:
        path = root / name
        path.write_bytes(change(path.read_bytes()))

    return apply


TOO_MANY = 3
"""Broken images of 43; two would cost their steps only."""


def image(content: bytes | Callable[[bytes], bytes], count: int = TOO_MANY) -> Callable[[Path], None]:
    """Other bytes in the first key frames of CAM_FRONT."""

    def apply(root: Path) -> None:
        for path in images(root)[:count]:
            new = content(path.read_bytes()) if callable(content) else content
            path.unlink()
            path.write_bytes(new)

    return apply


def instead(make: Callable[[Path], Any], name: str | None = None, count: int = TOO_MANY) -> Callable[[Path], None]:
    """Something that is no file in place of the first key frames of CAM_FRONT, or of the file ``name``."""

    def apply(root: Path) -> None:
        for path in [root / name] if name else images(root)[:count]:
            path.unlink()
            make(path)

    return apply


def images(root: Path) -> list[Path]:
    return sorted((root / "samples" / "CAM_FRONT").iterdir())


def bomb(jpeg: bytes) -> bytes:
    at = max(jpeg.find(b"\xff\xc0"), jpeg.find(b"\xff\xc2"))
    return jpeg[: at + 5] + (65_500).to_bytes(2, "big") * 2 + jpeg[at + 9 :]


def xyzw(q: list[float]) -> list[float]:
    return [*q[1:], q[0]]


def conjugate(q: list[float]) -> list[float]:
    return [q[0], *(-v for v in q[1:])]


def yaw_rates(factor: float = 1.0, offset: float = 0.0) -> Change:
    return each("rotation_rate", lambda rate: [rate[0], rate[1], factor * rate[2] + offset])


def shifted(ms: int) -> Change:
    return each("utime", lambda time: time + 1000 * ms)


def wheels(value: Callable[[float], float], *names: str) -> Change:
    keys = names or ("FL_wheel_speed", "FR_wheel_speed", "RL_wheel_speed", "RR_wheel_speed")

    def change(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row.update({key: value(row[key]) for key in keys})

    return change


def swap(rows: list[dict[str, Any]], key: str, i: int, j: int) -> None:
    rows[i][key], rows[j][key] = rows[j][key], rows[i][key]


def later(ms: int, *, of: str) -> Callable[[Path], None]:
    """All images of one camera are stamped later, in the tables alone."""
    return table(
        "sample_data",
        lambda rows: [
            row | {"timestamp": row["timestamp"] + 1000 * ms} if f"/{of}/" in row["filename"] else row for row in rows
        ],
    )


NO_FILES: dict[str, Callable[[Path], Any]] = {
    "folder": Path.mkdir,
    "pipe": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "loop": lambda path: path.symlink_to(path),
}
