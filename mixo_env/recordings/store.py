"""Recordings on disk: one Parquet file, and ``manifest.json`` beside it.

A row group holds one scene, in large recordings a few: opening many groups takes longer than reading them. Columns that
follow from others (:mod:`mixo_env.recordings.derived`) are not stored.

What is read is checked against the manifest: schema version, columns, row counts and a hash of every scene's column
values, so a truncated or edited file is one clear error and never a wrong score.

Both files change together. New rows are written to ``recordings.next.parquet``; the rename of the new manifest makes
them the recording; then they take their place. Whoever opens a folder that was left between the two renames finds the
rows that fit the manifest under the other name.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np

from mixo_env.errors import RecordingError, printable, unknown
from mixo_env.files import atomic_path, write_bytes
from mixo_env.recordings.collection import Column, Recordings
from mixo_env.recordings.derived import canonical, completed, derivable, scene_rows, stored
from mixo_env.recordings.folder import claimed, writing
from mixo_env.recordings.manifest import LARGEST_MANIFEST, MANIFEST_FILE, decode_manifest, encode_manifest
from mixo_env.recordings.pose_lag import as_written
from mixo_env.recordings.schema import Manifest
from mixo_env.recordings.schema import columns as schema_columns

DEFAULT_RECORDINGS = "mixocity"
"""The recording that comes with the package."""

RECORDINGS_FILE = "recordings.parquet"
NEXT_FILE = "recordings.next.parquet"
TIMINGS_FILE = "timings.parquet"

GROUPS = 40
"""At most about so many row groups: damage costs a fortieth of a recording at most, or one scene of a small one."""


def values_hash(columns: Mapping[str, Column]) -> str:
    """Hash of names, types and values (every NaN counts as the same), whatever the order of the columns."""
    return values_hashes(columns, [len(values) for values in columns.values()][:1])[0]


def values_hashes(columns: Mapping[str, Column], rows: Sequence[int]) -> list[str]:
    """As :func:`values_hash`, of scenes of so many rows that stand one after another."""
    digests = [hashlib.blake2b(digest_size=16) for _ in rows]
    ends = list(itertools.accumulate(rows, initial=0))
    for name in sorted(columns):
        values = np.ascontiguousarray(canonical(columns[name]))
        said = f"{name}:{values.dtype.name}"
        for digest, first, end in zip(digests, ends, ends[1:], strict=False):
            digest.update(f"{said}:{end - first};".encode())
            digest.update(values[first:end].data)
    return [digest.hexdigest() for digest in digests]


def write_columns(
    path: Path, columns: Mapping[str, Column], rows: Sequence[int], metadata: Mapping[str, str] | None = None
) -> None:
    """Write columns to a Parquet file, atomically, with one row group for each entry of ``rows``."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: pa.array(canonical(values)) for name, values in columns.items()})
    table = table.replace_schema_metadata(dict(metadata or {}))
    # Byte planes of floats compress well; dictionaries of floats do not, and they merge values that compare equal.
    floats = {name: "BYTE_STREAM_SPLIT" for name, values in columns.items() if values.dtype.kind == "f"}
    options = {"compression": "zstd", "compression_level": 9, "use_dictionary": False, "write_statistics": False}
    with (
        atomic_path(path) as temporary,
        pq.ParquetWriter(temporary, table.schema, column_encoding=floats or None, **options) as writer,
    ):
        start = 0
        for count in rows:
            writer.write_table(table.slice(start, count), row_group_size=max(count, 1))
            start += count


def read_columns(data: bytes) -> tuple[dict[str, Column], list[int], dict[str, str]]:
    """Columns, rows of each row group and metadata of the bytes of a Parquet file.

    Raises:
        RecordingError: if they are truncated or damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(pa.BufferReader(data)) as file:
            rows = [file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)]
            # A process that ends while Arrow's threads are still starting is aborted now and then.
            table = file.read(use_threads=False)
        metadata = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
        columns = {name: np.array(table.column(name).to_numpy()) for name in table.column_names}
    except Exception as error:  # the reader raises almost anything, depending on which byte is wrong
        why = printable(" ".join(str(error).split())[:200])
        raise RecordingError(f"truncated or damaged ({why})") from None
    return columns, rows, metadata


def save_recordings(recordings: Recordings, folder: str | Path) -> None:
    """Write a recording into a folder, in place of the one it may hold.

    Poses are saved as they were written, whatever lag was removed from them.

    Raises:
        RecordingError: for columns other than those of the schema, or if the folder holds a recording that cannot be
            read: that is never overwritten.
        ConfigurationError: if nothing can be written there, or another process is writing.
    """
    encoded = _encoded(recordings)
    with claimed(folder) as home:
        settled(home)
        _write(*encoded, home)


def write_recordings(recordings: Recordings, folder: Path) -> None:
    """As :func:`save_recordings`, in a folder that is claimed and settled."""
    _write(*_encoded(recordings), folder)


def settled(folder: Path) -> Recordings | None:
    """What a claimed folder holds, tidied up after a run that was stopped; ``None`` if it holds no recording.

    Raises:
        RecordingError: if it holds one that cannot be read.
        OutputError: if it cannot be tidied up.
    """
    with writing(folder):
        return _settled(folder)


def _settled(folder: Path) -> Recordings | None:
    for stale in folder.glob(".part-*"):
        stale.unlink(missing_ok=True)
    if not (folder / MANIFEST_FILE).exists():
        if (folder / RECORDINGS_FILE).exists():
            raise RecordingError(
                f"{folder} holds {RECORDINGS_FILE} without its {MANIFEST_FILE}: put that back, or choose another --out"
            )
        (folder / NEXT_FILE).unlink(missing_ok=True)  # of a first run that was stopped: its manifest never came
        return None
    recordings, name = _open(
        folder, str(folder), "it is not overwritten: mend it, move it away or choose another --out"
    )
    if name == NEXT_FILE:
        (folder / NEXT_FILE).replace(folder / RECORDINGS_FILE)
    (folder / NEXT_FILE).unlink(missing_ok=True)
    return recordings


def _encoded(recordings: Recordings) -> tuple[dict[str, Column], Manifest, bytes]:
    """Columns in file order, the manifest with the scenes' value hashes, and its file's content."""
    recordings = as_written(recordings)
    _check_columns(
        {name: recordings[name].dtype.name for name in recordings.column_names}, recordings.manifest, "cannot save"
    )
    columns = {name: recordings[name] for name in schema_columns(*_experts(recordings.manifest))}
    hashes = values_hashes(columns, [scene.rows for scene in recordings.scenes])
    entries = tuple(replace(scene, values_hash=h) for scene, h in zip(recordings.scenes, hashes, strict=True))
    manifest = replace(recordings.manifest, scenes=entries)
    return stored(columns, manifest), manifest, encode_manifest(manifest)


def _write(columns: Mapping[str, Column], manifest: Manifest, described: bytes, folder: Path) -> None:
    write_columns(folder / NEXT_FILE, columns, _groups([scene.rows for scene in manifest.scenes]))
    write_bytes(folder / MANIFEST_FILE, described)
    with writing(folder):
        (folder / NEXT_FILE).replace(folder / RECORDINGS_FILE)


def _groups(rows: Sequence[int]) -> list[int]:
    """Rows of each row group, from those of each scene."""
    groups: list[int] = []
    for count in rows:
        if not groups or groups[-1] * GROUPS >= sum(rows):
            groups.append(0)
        groups[-1] += count
    return groups


def bundled_recordings() -> tuple[str, ...]:
    """Names of the recordings that come with the package."""
    data = files("mixo_env.recordings") / "data"
    if not data.is_dir():
        return ()
    return tuple(sorted(entry.name for entry in data.iterdir() if (entry / MANIFEST_FILE).is_file()))


def load_recordings(path_or_name: str | Path | None = None) -> Recordings:
    """Open a recording.

    Args:
        path_or_name: a folder, or the name of a bundled recording; ``None`` is the bundled ``"mixocity"``.

    Raises:
        RecordingError: if it is missing, damaged, edited, or of another schema version.
    """
    name = DEFAULT_RECORDINGS if path_or_name is None else path_or_name
    if isinstance(name, str) and name in bundled_recordings():
        folder = files("mixo_env.recordings") / "data" / name
        return _open(folder, f"bundled recording {name!r}", "reinstall mixo-env")[0]
    if not Path(name).exists() and len(Path(name).parts) == 1:
        if str(name) in bundled_recordings():
            raise RecordingError(f"no folder {str(name)!r}; for the bundled recording pass its name as a string")
        raise RecordingError(f"no folder {str(name)!r} and {unknown('recording', str(name), bundled_recordings())}")
    return _open(Path(name), str(name), f"record anew with `mixo record ROOT --out {name}`")[0]


def _open(folder: Traversable, label: str, cure: str) -> tuple[Recordings, str]:
    """A recording, and the name of the file that its rows are in."""
    while True:
        described = _manifest_bytes(folder, label, cure)
        manifest = _decoded(described, label, cure)
        problems = []
        # A writer may rename the second to the first meanwhile, hence the first once more.
        for name in (RECORDINGS_FILE, NEXT_FILE, RECORDINGS_FILE):
            try:
                return _verified(manifest, folder / name, label, cure), name
            except RecordingError as error:
                problems.append(error)
        if _manifest_bytes(folder, label, cure) == described:
            raise problems[0] from None


def read_manifest(folder: Traversable, cure: str) -> Manifest:
    """The manifest of a folder alone; :class:`RecordingError` ends in ``cure``."""
    return _decoded(_manifest_bytes(folder, str(folder), cure), str(folder), cure)


def _manifest_bytes(folder: Traversable, label: str, cure: str) -> bytes:
    try:
        with (folder / MANIFEST_FILE).open("rb") as file:
            return file.read(LARGEST_MANIFEST + 1)
    except OSError:
        raise RecordingError(f"{label}: expected a folder with {MANIFEST_FILE}, found none; {cure}") from None


def _decoded(described: bytes, label: str, cure: str) -> Manifest:
    try:
        return decode_manifest(described)
    except RecordingError as error:
        raise RecordingError(f"{label}: {error}; {cure}") from None


def _verified(manifest: Manifest, path: Traversable, label: str, cure: str) -> Recordings:
    """The rows of a file, if they are those of the manifest."""
    try:
        columns, _, _ = read_columns(path.read_bytes())
    except OSError:
        raise RecordingError(f"{label}: expected {RECORDINGS_FILE} beside {MANIFEST_FILE}; {cure}") from None
    except RecordingError as error:
        raise RecordingError(f"{label}: {RECORDINGS_FILE} is {error}; {cure}") from None
    dtypes = {name: values.dtype.name for name, values in columns.items()}
    layout = schema_columns(*_experts(manifest))
    left_out = {name: layout[name] for name in derivable(manifest) if name not in dtypes}
    _check_columns(dtypes | left_out, manifest, label, cure)
    rows, expected = scene_rows(columns), [scene.rows for scene in manifest.scenes]
    if rows != expected:
        raise RecordingError(
            f"{label}: expected {len(expected)} scenes of {sum(expected)} rows in {RECORDINGS_FILE}, "
            f"got {len(rows)} of {sum(rows)} (or another order); {cure}"
        )
    columns = completed(columns, manifest)
    for scene, found in zip(manifest.scenes, values_hashes(columns, rows), strict=True):
        if found != scene.values_hash:
            raise RecordingError(f"{label}: the values of {scene.name} differ from the manifest's hash; {cure}")
    return Recordings(manifest, {name: columns[name] for name in layout})


def _check_columns(dtypes: Mapping[str, str], manifest: Manifest, label: str, cure: str = "") -> None:
    expected = schema_columns(*_experts(manifest))
    missing = [name for name in expected if name not in dtypes]
    extra = [name for name in dtypes if name not in expected]
    wrong = [f"{name} ({dtype})" for name, dtype in dtypes.items() if dtype != expected.get(name, dtype)]
    for problem, names in (("missing", missing), ("unexpected", extra), ("wrongly typed", wrong)):
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            raise RecordingError(f"{label}: {problem} columns: {', '.join(names[:3])}{more}" + (cure and f"; {cure}"))


def _experts(manifest: Manifest) -> tuple[tuple[str, ...], ...]:
    return manifest.cameras, manifest.inertial, manifest.imported, tuple(manifest.variants)
