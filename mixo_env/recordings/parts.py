"""Scenes that are already recorded: parts of an unfinished run, and the scenes of a finished recording."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from mixo_env.errors import ConfigurationError, RecordingError
from mixo_env.recordings.folder import writing
from mixo_env.recordings.salvage import set_aside, sound_scenes
from mixo_env.recordings.schema import Manifest, SceneEntry
from mixo_env.recordings.steps import TIMING_COLUMNS, Columns
from mixo_env.recordings.store import (
    MANIFEST_FILE,
    TIMINGS_FILE,
    read_columns,
    read_manifest,
    settled,
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
        broken_images: camera -> images that could not be read; cameras without any are left out.
        remarks: on these images, to be said when they were met; not kept.
    """

    entry: SceneEntry
    inputs: str
    columns: Columns
    timings: Columns
    broken_images: Mapping[str, int]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finished:
    """What a folder holds of earlier, finished runs.

    Attributes:
        parts: sound scenes by name.
        lost: scenes of the manifest that can no longer be read.
    """

    parts: Mapping[str, Part]
    lost: tuple[str, ...] = ()


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
            "broken_images": msgspec.json.encode(part.broken_images).decode(),
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
                broken = msgspec.json.decode(metadata["broken_images"], type=dict[str, int])
                sound = values_hash(columns) == metadata["values"]
            except (RecordingError, OSError, KeyError, msgspec.MsgspecError):
                continue
            if sound:
                parts[entry.name] = Part(entry, metadata["inputs"], columns, timings, broken)
        return parts

    def remove(self) -> None:
        """The recording is complete."""
        shutil.rmtree(self.path, ignore_errors=True)


def finished_parts(out: Path, configuration: str) -> Finished:
    """Scenes of the recording that a claimed folder already holds, so that a rerun only adds what is missing.

    Of a damaged recording the sound scenes are kept; its files are copied aside before anything is written.

    Raises:
        ConfigurationError: if it was made by another configuration or version of the software.
        RecordingError: if its manifest cannot be read: nobody knows what is in it then.
    """
    try:
        recordings = settled(out)
        if recordings is None:
            return Finished({})
        manifest = recordings.manifest
        scenes = {scene.name: recordings.rows(scene.name) for scene in recordings.scenes}
    except RecordingError as error:
        if not (out / MANIFEST_FILE).exists():
            raise
        manifest = read_manifest(out, "it is not overwritten: put a copy back, move it away or choose another --out")
        scenes = sound_scenes(out, manifest)
        damage = str(error).split(";")[0]
    else:
        damage = None
    if manifest.parameters.get("configuration") != configuration or manifest.imported:
        raise ConfigurationError(
            f"{out} holds a recording of another configuration, version or set of experts: choose another --out"
        )
    lost = tuple(scene.name for scene in manifest.scenes if scene.name not in scenes)
    if damage is not None:
        with writing(out):
            aside = set_aside(out)
        logger.warning(
            "%s: %d of %d scenes are sound and kept; recording anew: %s (damaged files: %s)",
            damage, len(scenes), len(manifest.scenes), ", ".join(lost) or "none", aside,
        )  # fmt: skip
    return Finished(_parts(out, manifest, scenes), lost)


def _parts(out: Path, manifest: Manifest, scenes: Mapping[str, Columns]) -> dict[str, Part]:
    try:
        timings, _, _ = read_columns((out / TIMINGS_FILE).read_bytes())
    except (OSError, RecordingError):
        timings = {}
    if set(timings) != set(TIMING_COLUMNS):  # they are never hashed, and no scene is worth less without
        timings = {name: np.array([], dtype) for name, dtype in TIMING_COLUMNS.items()}
    inputs, broken = (_table(manifest.parameters.get(key)) for key in ("inputs", "broken_images"))
    return {
        scene.name: Part(
            scene,
            str(inputs.get(scene.name)),
            scenes[scene.name],
            {name: timings[name][timings["scene"] == scene.name] for name in TIMING_COLUMNS},
            _table(broken.get(scene.name)),
        )
        for scene in manifest.scenes
        if scene.name in scenes
    }


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
