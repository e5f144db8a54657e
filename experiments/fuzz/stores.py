"""Damage recordings at random, then open them and write over them: the same values or one MixoError must come.

    python -m experiments.fuzz.stores --inputs 5000

Each input has bytes of ``recordings.parquet`` or ``manifest.json`` changed, cut or repeated, or values of the manifest
exchanged with its hash made right again. Warnings count as errors: they would stand beside the one line.
"""

from __future__ import annotations

import json
import tempfile
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from experiments.fuzz.outcome import Outcome
from mixo_env.errors import MixoError
from mixo_env.recordings.collection import Column, Recordings
from mixo_env.recordings.manifest import HASH, MANIFEST_FILE, manifest_hash
from mixo_env.recordings.salvage import sound_scenes
from mixo_env.recordings.store import RECORDINGS_FILE, load_recordings, save_recordings

VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 4, 10**9, 2**63, -(2**70), 10**400, 0.5, 1e308, -0.0, "", "x", "\n", "\x1b[2J", "../x"),
    *([], [[]], {}, {"": 0}, [None], "scene-2001", "CAM_FRONT", "9" * 5000),
)


def fuzz(recordings: Recordings, inputs: int, seed: int, folder: Path) -> Outcome:
    """Try ``inputs`` damaged copies of a recording.

    Args:
        recordings: a small one.
        inputs: how many.
        seed: of the damage.
        folder: for the files.
    """
    rng = np.random.default_rng(seed)
    save_recordings(recordings, folder)
    whole = load_recordings(folder)
    rows, described = (folder / RECORDINGS_FILE).read_bytes(), (folder / MANIFEST_FILE).read_bytes()
    outcome = Outcome()
    for _ in range(inputs):
        kind = ("rows", "manifest", "values")[int(rng.integers(3))]
        new_rows = _damaged(rng, rows) if kind == "rows" else rows
        new_manifest = {"rows": described, "manifest": _damaged(rng, described), "values": _exchanged(rng, described)}[
            kind
        ]
        (folder / RECORDINGS_FILE).write_bytes(new_rows)
        (folder / MANIFEST_FILE).write_bytes(new_manifest)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                outcome.counts[f"{kind}: {_try(folder, whole)}"] += 1
            if ((folder / RECORDINGS_FILE).read_bytes(), (folder / MANIFEST_FILE).read_bytes()) != (
                new_rows,
                new_manifest,
            ):
                outcome.faults.append((kind, "what cannot be read was overwritten"))
        except Exception:
            outcome.faults.append((f"{kind}: {new_manifest[:200]!r}", traceback.format_exc()))
    return outcome


def _try(folder: Path, whole: Recordings) -> str:
    """What became of a damaged recording: it is whole, or it is refused whenever it is opened or written over."""
    try:
        opened = load_recordings(folder)
    except MixoError as error:
        _check_line(error)
        try:
            save_recordings(whole, folder)
        except MixoError as refusal:
            _check_line(refusal)
        else:
            raise AssertionError("it was overwritten") from None
        sound = sound_scenes(folder, whole.manifest)
        for name, columns in sound.items():
            for column, values in whole.rows(name).items():
                _check_same(column, columns[column], values)
        return "salvaged" if sound else "refused"
    for name in whole.column_names:
        _check_same(name, opened[name], whole[name])
    return "as good as whole"


def _check_same(name: str, got: Column, expected: Column) -> None:
    # The bytes first: comparing numbers costs more than reading the file.
    if got.tobytes() != expected.tobytes():
        np.testing.assert_array_equal(got, expected, err_msg=name)


def _check_line(error: MixoError) -> None:
    if not str(error).isprintable():
        raise AssertionError(f"more than one plain line: {str(error)!r}")


def _damaged(rng: np.random.Generator, data: bytes) -> bytes:
    i, j = sorted(int(at) for at in rng.integers(len(data) + 1, size=2))
    match int(rng.integers(5)):
        case 0:
            return data[:i]
        case 1:
            return data[:i] + data[j:]
        case 2:
            return data[:j] + data[i:]
        case 3:
            return data[:i] + rng.bytes(int(rng.integers(1, 9))) + data[i:]
    edited = bytearray(data)
    for at in rng.integers(len(data), size=int(rng.integers(1, 4))):
        edited[at] = int(rng.integers(256))
    return bytes(edited)


def _exchanged(rng: np.random.Generator, described: bytes) -> bytes:
    """One value of the manifest, at any depth, exchanged, dropped or renamed; its hash is right."""
    table = {key: value for key, value in json.loads(described).items() if key != HASH}
    place: Any = table
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = keys[int(rng.integers(len(keys)))]
        if not isinstance(place[key], dict | list) or not place[key] or rng.random() < 0.3:
            break
        place = place[key]
    match int(rng.integers(4)):
        case 0:
            del place[key]
        case 1 if isinstance(place, dict):
            place[f"{key}?"] = place.pop(key)
        case _:
            place[key] = VALUES[int(rng.integers(len(VALUES)))]
    try:
        table[HASH] = manifest_hash(table)
    except OverflowError:  # no program of ours could have written it
        table[HASH] = "0"
    return json.dumps(table).encode()


@dataclass(frozen=True)
class Fuzz:
    """Damage a recording at random; exit code 1 if anything but the same values or one line of error came."""

    recordings: str = "mixocity"
    """Folder or name of a bundled recording; two short scenes of it are used."""
    inputs: int = 5_000
    """How many."""
    seed: int = 0
    """Of the damage."""

    def run(self) -> int:
        """Print counts and the first faults."""
        whole = load_recordings(self.recordings)
        few = whole.select(scenes=[scene.name for scene in whole.scenes[:3]])
        with tempfile.TemporaryDirectory() as folder:
            outcome = fuzz(few, self.inputs, self.seed, Path(folder))
        return outcome.report(self.inputs)


if __name__ == "__main__":
    raise SystemExit(tyro.cli(Fuzz).run())
