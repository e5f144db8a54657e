"""Faults of cameras that a simulated folder tells of: noted in the manifest, so that nobody takes them for sound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError, RecordingError
from mixo_env.recordings.collection import Recordings

CAMERA_FAULTS = "camera_faults"
"""Key of the manifest's parameters: scene -> kind, camera, seconds and seed of its fault. Absent without faults."""


@dataclass(frozen=True)
class NotedFault:
    """What a manifest tells of the fault of one scene.

    Attributes:
        kind: e.g. ``"frozen"``.
        camera: whose pictures were spoilt.
        begin_us: time of the scene's first key frame.
        start_s, end_s: of the fault, since then.
    """

    kind: str
    camera: str
    begin_us: int
    start_s: float
    end_s: float


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


def noted_faults(recordings: Recordings) -> dict[tuple[str, str], NDArray[np.bool_]]:
    """What is wrong with the pictures behind some recordings.

    Returns:
        Camera and kind -> ``(rows,)``, True where the fault lasts when the row's step ends.

    Raises:
        RecordingError: when the manifest's note is damaged.
    """
    noted: Mapping[str, Any] = recordings.manifest.parameters.get(CAMERA_FAULTS, {})
    if not noted:
        return {}
    import msgspec

    try:
        told = msgspec.convert(noted, dict[str, NotedFault])
    except msgspec.ValidationError as error:
        raise RecordingError(f"manifest: {CAMERA_FAULTS}: {error}; record the folder anew") from None
    lasting: dict[tuple[str, str], NDArray[np.bool_]] = {}
    for i, scene in enumerate(recordings.scenes):
        if scene.name in told:
            fault = told[scene.name]
            rows = slice(recordings.offsets[i], recordings.offsets[i + 1])
            since_s = (recordings["timestamp_us"][rows] - fault.begin_us) / 1e6
            everywhere = lasting.setdefault((fault.camera, fault.kind), np.zeros(recordings.offsets[-1], np.bool_))
            everywhere[rows] = (fault.start_s <= since_s) & (since_s < fault.end_s)
    return lasting
