"""What is left of a damaged recording: every scene whose own hash is right, wherever it stands in the file."""

from __future__ import annotations

import hashlib
import itertools
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mixo_env.recordings.collection import Column
from mixo_env.recordings.derived import completed, scene_rows
from mixo_env.recordings.schema import Manifest
from mixo_env.recordings.store import MANIFEST_FILE, NEXT_FILE, RECORDINGS_FILE, values_hash


def sound_scenes(folder: Path, manifest: Manifest) -> dict[str, dict[str, Column]]:
    """Columns of the scenes that can still be read and are those of the manifest, by name."""
    scene_of = {scene.values_hash: scene.name for scene in manifest.scenes}
    found: dict[str, dict[str, Column]] = {}
    for name in (RECORDINGS_FILE, NEXT_FILE):
        for columns in _scenes(folder / name, manifest):
            scene = scene_of.get(values_hash(columns))
            if scene is not None:
                found[scene] = columns
    return found


def set_aside(folder: Path) -> Path:
    """Copy the files of a damaged recording into a folder beside them, once: others may be able to read more."""
    files = [path for name in (RECORDINGS_FILE, NEXT_FILE, MANIFEST_FILE) if (path := folder / name).is_file()]
    digest = hashlib.blake2b(digest_size=4)
    for path in files:
        digest.update(path.read_bytes())
    aside = folder / f"damaged-{digest.hexdigest()}"
    aside.mkdir(exist_ok=True)
    for path in files:
        shutil.copyfile(path, aside / path.name)
    return aside


def _scenes(path: Path, manifest: Manifest) -> Iterator[dict[str, Column]]:
    """Columns of every scene in the row groups that can be read."""
    for group in _row_groups(path):
        try:
            columns = completed(group, manifest)
            end = np.cumsum(scene_rows(columns))
        except (KeyError, ValueError, TypeError):  # a column is missing, or is not of numbers
            continue
        for first, last in itertools.pairwise([0, *end.tolist()]):
            yield {name: values[first:last] for name, values in columns.items()}


def _row_groups(path: Path) -> list[dict[str, Column]]:
    """Columns of every row group that can be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    groups = []
    try:
        with pq.ParquetFile(pa.BufferReader(path.read_bytes())) as file:
            for i in range(file.num_row_groups):
                try:
                    table = file.read_row_group(i, use_threads=False)
                    groups.append({name: np.array(table.column(name).to_numpy()) for name in table.column_names})
                except Exception:  # the reader raises almost anything, depending on which byte is wrong
                    continue
    except Exception:  # no footer, no rows
        return groups
    return groups
