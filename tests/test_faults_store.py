"""Named faults of a recording on disk: each is one line, and nothing that is there is overwritten."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from mixo_env.cli.main import main
from mixo_env.errors import RecordingError
from mixo_env.recordings.folds import MOST_FOLDS
from mixo_env.recordings.store import load_recordings, save_recordings, write_columns
from tests.damage import edit_manifest
from tests.synthetic import synthetic_recordings

Damage = Callable[[Path], object]


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sound") / "run"
    save_recordings(synthetic_recordings(scenes=3, steps=20), folder)
    return folder


def rows_file(change: Callable[[bytes], bytes]) -> Damage:
    def damage(folder: Path) -> None:
        path = folder / "recordings.parquet"
        path.write_bytes(change(path.read_bytes()))

    return damage


def cut(share: float) -> Damage:
    return rows_file(lambda data: data[: int(share * len(data))])


def flipped(share: float, bit: int) -> Damage:
    def change(data: bytes) -> bytes:
        edited = bytearray(data)
        edited[min(int(share * len(data)), len(data) - 1)] ^= 1 << bit
        return bytes(edited)

    return rows_file(change)


def manifest_file(change: Callable[[bytes], bytes]) -> Damage:
    def damage(folder: Path) -> None:
        path = folder / "manifest.json"
        path.write_bytes(change(path.read_bytes()))

    return damage


def field(value: Any, *keys: str | int) -> Damage:
    """A value of the manifest exchanged, its hash right."""

    def edit(manifest: Any) -> Any:
        place = manifest
        for key in keys[:-1]:
            place = place[key]
        place[keys[-1]] = value
        return manifest

    return lambda folder: edit_manifest(folder, edit)


def without(*keys: str | int) -> Damage:
    def edit(manifest: Any) -> Any:
        place = manifest
        for key in keys[:-1]:
            place = place[key]
        del place[keys[-1]]
        return manifest

    return lambda folder: edit_manifest(folder, edit)


def rewritten(change: Callable[[dict[str, np.ndarray]], object]) -> Damage:
    """A valid Parquet file with other values."""

    def damage(folder: Path) -> None:
        path = folder / "recordings.parquet"
        groups = pq.ParquetFile(path).metadata
        rows = [groups.row_group(i).num_rows for i in range(groups.num_row_groups)]
        table = pq.read_table(path)
        columns = {name: table.column(name).to_numpy().copy() for name in table.column_names}
        change(columns)
        write_columns(path, columns, rows)

    return damage


def in_the_way(name: str) -> Damage:
    def damage(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).mkdir()

    return damage


def linked(name: str, target: str) -> Damage:
    def damage(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).symlink_to(target)

    return damage


def other_rows(folder: Path) -> None:
    save_recordings(synthetic_recordings(seed=1, scenes=3, steps=20), folder.parent / "other")
    shutil.copy(folder.parent / "other" / "recordings.parquet", folder)


def other_manifest(folder: Path) -> None:
    save_recordings(synthetic_recordings(seed=1, scenes=3, steps=20), folder.parent / "other")
    shutil.copy(folder.parent / "other" / "manifest.json", folder)


def swapped(folder: Path) -> None:
    manifest, rows = folder / "manifest.json", folder / "recordings.parquet"
    described = manifest.read_bytes()
    manifest.write_bytes(rows.read_bytes())
    rows.write_bytes(described)


FAULTS: dict[str, Damage] = {
    **{f"rows cut at {share}": cut(share) for share in (0, 1e-4, 0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.97, 0.999)},
    **{f"bit flipped at {share}": flipped(share, i % 8) for i, share in enumerate((0.05, 0.1, 0.2, 0.3, 0.4, 1.0))},
    "rows: zeros": rows_file(lambda data: bytes(len(data))),
    "rows: appended to": rows_file(lambda data: data + b"more"),
    "rows: shifted": rows_file(lambda data: data[:4] + data),
    "rows: text": rows_file(lambda data: b"<html>404</html>"),
    "rows: a value": rewritten(lambda columns: columns["CAM_BACK.matches"].__setitem__(5, 1.0)),
    "rows: truth is NaN": rewritten(lambda columns: columns["truth.x_m"].fill(np.nan)),
    "rows: two columns exchanged": rewritten(
        lambda columns: columns.update({"truth.x_m": columns["truth.y_m"], "truth.y_m": columns["truth.x_m"]})
    ),
    "rows: a column gone": rewritten(lambda columns: columns.pop("step")),
    "rows: a column of another type": rewritten(
        lambda columns: columns.update(step=columns["step"].astype(np.float64))
    ),
    "rows: gone": lambda folder: (folder / "recordings.parquet").unlink(),
    "rows: a folder": in_the_way("recordings.parquet"),
    "rows: a link to nowhere": linked("recordings.parquet", "nowhere"),
    "rows: a link to itself": linked("recordings.parquet", "recordings.parquet"),
    "rows: of another recording": other_rows,
    "manifest: gone": lambda folder: (folder / "manifest.json").unlink(),
    "manifest: a folder": in_the_way("manifest.json"),
    "manifest: a link to nowhere": linked("manifest.json", "nowhere"),
    "manifest: a link to itself": linked("manifest.json", "manifest.json"),
    "manifest: of another recording": other_manifest,
    "manifest and rows exchanged": swapped,
    "manifest: empty": manifest_file(lambda data: b""),
    "manifest: cut": manifest_file(lambda data: data[: len(data) // 2]),
    "manifest: not UTF-8": manifest_file(lambda data: data.replace(b"n099", b"n\xdf99")),
    "manifest: UTF-16": manifest_file(lambda data: data.decode().encode("utf-16")),
    "manifest: a digit": manifest_file(lambda data: data.replace(b'"fold": 0', b'"fold": 1')),
    "manifest: deep": manifest_file(lambda data: b'{"a":' * 100_000),
    "manifest: a list": manifest_file(lambda data: b"[]"),
    "manifest: null": manifest_file(lambda data: b"null"),
    "manifest: NaN": manifest_file(lambda data: data.replace(b"0.001", b"NaN")),
    "manifest: without its hash": manifest_file(
        lambda data: json.dumps({k: v for k, v in json.loads(data).items() if k != "hash"}).encode()
    ),
    "manifest: huge": manifest_file(lambda data: b'{"a": "' + bytes(70 << 20)),
    "no schema version": without("schema_version"),
    "schema version of tomorrow": field(999, "schema_version"),
    "schema version is text": field("1\n2", "schema_version"),
    "scenes are a number": field(3, "scenes"),
    "no scenes": field([], "scenes"),
    "a scene is null": field(None, "scenes", 1),
    "a scene too few": without("scenes", 1),
    "two scenes of one name": field("scene-2001", "scenes", 1, "name"),
    "two scenes but for capitals": field("Scene-2001", "scenes", 1, "name"),
    "a scene without a name": field("", "scenes", 0, "name"),
    "a scene that is a path": field("../../scene", "scenes", 0, "name"),
    "a scene of two lines": field("scene\n1", "scenes", 0, "name"),
    "a scene that colours the terminal": field("\x1b[31mscene", "scenes", 0, "name"),
    "fold -2": field(-2, "scenes", 0, "fold"),
    "a fold too many": field(MOST_FOLDS, "scenes", 0, "fold"),
    "fold is 0.5": field(0.5, "scenes", 0, "fold"),
    "fold is text": field("0", "scenes", 0, "fold"),
    "rows 0": field(0, "scenes", 0, "rows"),
    "rows -1": field(-1, "scenes", 0, "rows"),
    "rows one too many": field(22, "scenes", 0, "rows"),
    "rows absurd": field(10**15, "scenes", 0, "rows"),
    "rows beyond 64 bits": field(2**63, "scenes", 0, "rows"),
    "conditions are text": field("day", "scenes", 0, "conditions"),
    "hash of other values": field("0" * 32, "scenes", 0, "values_hash"),
    "an unknown field": field(1, "novel"),
    "an unknown field of a scene": field(1, "scenes", 0, "novel"),
    "an unknown field of a vehicle": field(1, "vehicles", "n099", "novel"),
    "no cameras field": without("cameras"),
    "a camera twice": field(["CAM_FRONT", "CAM_FRONT"], "cameras"),
    "an expert twice": field(["CAM_FRONT"], "imported"),
    "a camera more": field(["CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT", "CAM_5"], "cameras"),
    "an inertial grade that does not exist": field(["INERTIAL", "GYRO"], "inertial"),
    "a variant of no camera": field({"X": "CAM_SIDE"}, "variants"),
    "a wheel scale of null": field(None, "vehicles", "n099", "wheel_scale"),
    "a wheel scale of 0": field(0.0, "vehicles", "n099", "wheel_scale"),
    "a wheel scale beyond floats": field(10**400, "vehicles", "n099", "wheel_scale"),
    "a reward scale below 0": field(-1.0, "reward_scale_rad", "PAPER"),
    "a reward scale of no track": field(1.0, "reward_scale_rad", "MARS"),
    "a weight of no expert": field({"PAPER": {"none": {"X": 1.0}}}, "linear_weights"),
    "weights without a fold that cannot be": field({"PAPER": {str(MOST_FOLDS): {"CAM_BACK": 1.0}}}, "linear_weights"),
    "a weight is text": field({"PAPER": {"none": {"CAM_BACK": "1"}}}, "linear_weights"),
    "a cost of no camera": field({"CAM_SIDE": 25.0}, "camera_cost_ms"),
    "a cost below 0": field(-25.0, "camera_cost_ms", "CAM_FRONT"),
    "parameters are a list": field([], "parameters"),
}


@pytest.fixture(params=FAULTS)
def damaged(request, sound, tmp_path) -> Path:
    folder = tmp_path / "run"
    shutil.copytree(sound, folder)
    FAULTS[request.param](folder)
    return folder


def content(folder: Path) -> dict[str, Any]:
    return {p.name: p.readlink() if p.is_symlink() else p.is_dir() or p.read_bytes() for p in folder.iterdir()}


def test_a_fault_is_one_line_and_nothing_is_overwritten(damaged, capsys):
    before = content(damaged)
    with pytest.raises(RecordingError) as caught:
        load_recordings(damaged)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 700
    assert str(caught.value).isprintable()
    with pytest.raises(RecordingError) as caught:
        save_recordings(synthetic_recordings(scenes=1), damaged)
    assert any(word in str(caught.value) for word in ("not overwritten", "put that back"))
    assert str(caught.value).isprintable()
    assert content(damaged) == before
    assert main(["import", str(damaged), "--expert", "X=none", "--out", str(damaged)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert content(damaged) == before
