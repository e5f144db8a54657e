"""Faults of cameras that a simulated folder tells of: noted in the manifest, so that nobody takes them for sound."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mixo_env.errors import DatasetError

CAMERA_FAULTS = "camera_faults"
"""Key of the manifest's parameters: scene -> kind, camera, seconds and seed of its fault. Absent without faults."""


def told_faults(root: Path) -> dict[str, dict[str, Any]]:
    """Scene -> its fault, as ``simulation.json`` tells; empty for real folders and sound cameras.

    Raises:
        DatasetError: when the file is damaged.
    """
    import msgspec

    note = root / "simulation.json"
    if not note.exists():
        return {}
    try:
        told = msgspec.json.decode(note.read_bytes(), type=dict[str, Any]).get("faults", {})
        return msgspec.convert(told, dict[str, dict[str, Any]])
    except (OSError, UnicodeDecodeError, msgspec.MsgspecError) as error:
        raise DatasetError(f"cannot read {note}: {error}; simulate the folder anew, or delete this file") from None
