"""Scenes that are already recorded: parts of an unfinished run, and the scenes of a finished recording."""

from __future__ import annotations

import logging
import shutil
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from mixo_env.errors import ConfigurationError, RecordingError
from mixo_env.recordings.schema import SceneEntry
from mixo_env.recordings.steps import TIMING_COLUMNS, Columns
from mixo_env.recordings.store import (
    MANIFEST_FILE,
    TIMINGS_FILE,
    load_recordings,
    read_columns,
    values_hash,
    write_columns,
)

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Part:
    """One recorded scene.

    Attributes:
        entry: as in the manifest; its fold is not decided yet.
        inputs: hash of what the experts were given.
        columns: all columns of the schema.
        timings: CPU time by image.
    """

    entry: SceneEntry
    inputs: str
    columns: Columns
    timings: Columns


class PartFolder:
    """Parts of an unfinished run, ``parts-<configuration>/<scene>.parquet``: another configuration never mixes in."""

    def __init__(self, out: Path, configuration: str) -> None:
        self.path = out / f"parts-{configuration}"

    def write(self, part: Part) -> None:
        """Keep a part; it counts once its main file is complete, which is written last."""
        name = part.entry.name
        metadata = {
            "entry": msgspec.json.encode(part.entry).decode(),
            "inputs": part.inputs,
            "values": values_hash(part.columns),
        }
        write_columns(self.path / f"{name}.timings.parquet", part.timings, [len(part.timings["timestamp_us"])])
        write_columns(self.path / f"{name}.parquet", part.columns, [part.entry.rows], metadata)

    def read(self) -> dict[str, Part]:
        """Sound parts by scene; a damaged one is as good as none."""
        parts = {}
        for path in sorted(self.path.glob("*.parquet")):
            if path.name.endswith(".timings.parquet"):
                continue
            try:
                columns, _, metadata = read_columns(path.read_bytes())
                timings, _, _ = read_columns(path.with_suffix(".timings.parquet").read_bytes())
                entry = msgspec.json.decode(metadata["entry"], type=SceneEntry)
                sound = values_hash(columns) == metadata["values"]
            except (RecordingError, OSError, KeyError, msgspec.MsgspecError):
                continue
            if sound:
                parts[entry.name] = Part(entry, metadata["inputs"], columns, timings)
        return parts

    def remove(self) -> None:
        """The recording is complete."""
        shutil.rmtree(self.path, ignore_errors=True)


def finished_parts(out: Path, configuration: str) -> dict[str, Part]:
    """Scenes of the recording that ``out`` already holds, so that a rerun only adds what is missing.

    A recording that cannot be read (damaged, or of another schema version) counts as none: recording anew is its cure.

    Raises:
        ConfigurationError: if it was made by another configuration or version of the software.
    """
    if not (out / MANIFEST_FILE).exists():
        return {}
    try:
        recordings = load_recordings(out)
    except RecordingError as error:
        logger.warning("%s: recording anew", error)
        return {}
    parameters = recordings.manifest.parameters
    if parameters.get("configuration") != configuration or recordings.manifest.imported:
        raise ConfigurationError(
            f"{out} holds a recording of another configuration, version or set of experts: choose another --out"
        )
    try:
        timings, _, _ = read_columns((out / TIMINGS_FILE).read_bytes())
    except (OSError, RecordingError):
        timings = {name: np.array([], dtype) for name, dtype in TIMING_COLUMNS.items()}
    return {
        scene.name: Part(
            scene,
            parameters["inputs"][scene.name],
            recordings.rows(scene.name),
            {name: values[timings["scene"] == scene.name] for name, values in timings.items()},
        )
        for scene in recordings.scenes
    }
