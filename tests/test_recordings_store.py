"""Recordings on disk: round trips, and every way of damaging them."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mixo_env.errors import RecordingError
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.schema import columns
from mixo_env.recordings.store import (
    load_recordings,
    read_columns,
    save_recordings,
    values_hash,
    write_columns,
)
from tests.damage import edit_manifest
from tests.synthetic import synthetic_recordings


@pytest.fixture
def folder(tmp_path):
    save_recordings(synthetic_recordings(scenes=3, steps=20), tmp_path / "run")
    return tmp_path / "run"


def test_round_trip_is_exact(tmp_path):
    before = with_fits(synthetic_recordings(scenes=5))
    save_recordings(before, tmp_path / "a")
    after = load_recordings(tmp_path / "a")
    for name, dtype in columns(
        *(getattr(before.manifest, kind) for kind in ("cameras", "inertial", "imported"))
    ).items():
        assert after[name].dtype == dtype == before[name].dtype
        np.testing.assert_array_equal(after[name], before[name])
    hashed = tuple(replace(s, values_hash=h.values_hash) for s, h in zip(before.scenes, after.scenes, strict=True))
    assert after.manifest == replace(before.manifest, scenes=hashed)
    assert len({scene.values_hash for scene in after.scenes}) == 5
    assert pq.ParquetFile(tmp_path / "a" / "recordings.parquet").num_row_groups == 5


def test_saving_what_was_loaded_writes_the_same_bytes(folder, tmp_path):
    save_recordings(load_recordings(folder), tmp_path / "again")
    for name in ("recordings.parquet", "manifest.json"):
        assert (folder / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


@settings(max_examples=30, deadline=None)
@given(
    floats=arrays.arrays(np.float32, st.integers(1, 40), elements=st.floats(width=32)),
    doubles=st.floats(),
    split=st.integers(0, 40),
)
def test_columns_keep_every_bit(tmp_path_factory, floats, doubles, split):
    path = tmp_path_factory.getbasetemp() / "columns.parquet"
    n, first = len(floats), min(split, len(floats))
    table = {
        "f": floats,
        "d": np.full(n, doubles),
        "b": floats > 0,
        "i": np.arange(n, dtype=np.int8),
        "t": 1_533_151_603_547_590 + np.arange(n),
    }
    write_columns(path, table, [first, n - first], {"key": "value"})
    back, rows, metadata = read_columns(path.read_bytes())
    assert rows == [first, n - first]
    assert metadata == {"key": "value"}
    assert values_hash(back) == values_hash(table)
    for name, values in table.items():
        assert back[name].dtype == values.dtype
        np.testing.assert_array_equal(back[name], values)
        assert back[name].flags.writeable


def test_hash_sees_values_names_and_types_but_not_the_sign_of_nan():
    a = {"x": np.array([1.0, np.nan], np.float32)}
    assert values_hash(a) == values_hash({"x": np.array([1.0, -np.nan], np.float32)})
    assert values_hash({"x": a["x"], "y": a["x"]}) == values_hash({"y": a["x"], "x": a["x"]})
    others = [{"y": a["x"]}, {"x": a["x"].astype(np.float64)}, {"x": np.array([1.0, 2.0], np.float32)}]
    assert len({values_hash(other) for other in [a, *others]}) == 4


def broken(folder, match):
    with pytest.raises(RecordingError, match=match) as caught:
        load_recordings(folder)
    message = str(caught.value)
    assert "\n" not in message
    assert f"mixo record ROOT --out {folder}" in message


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_truncated_file(folder, share):
    path = folder / "recordings.parquet"
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    broken(folder, "truncated or damaged")


def test_any_edited_byte_is_noticed_or_harmless(folder):
    path = folder / "recordings.parquet"
    data = path.read_bytes()
    reference = load_recordings(folder)
    for position in np.random.default_rng(0).integers(0, len(data), 60):
        path.write_bytes(data[:position] + bytes([data[position] ^ 0x5A]) + data[position + 1 :])
        try:
            loaded = load_recordings(folder)
        except RecordingError as error:
            assert str(folder) in str(error)  # noqa: PT017
        else:
            for name in reference.column_names:
                np.testing.assert_array_equal(loaded[name], reference[name])


def test_edited_value_names_the_scene(folder):
    table = pq.read_table(folder / "recordings.parquet")
    i = table.column_names.index("CAM_BACK.matches")
    matches = table.column(i).to_numpy().copy()
    matches[30] += 1.0
    rows = pq.ParquetFile(folder / "recordings.parquet").metadata
    table = table.set_column(i, "CAM_BACK.matches", pa.array(matches))
    groups = [rows.row_group(k).num_rows for k in range(3)]
    write_columns(folder / "recordings.parquet", {n: table.column(n).to_numpy() for n in table.column_names}, groups)
    broken(folder, "values of scene-2002 differ")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda table: table.drop(["CAM_FRONT.state"]), "missing columns: CAM_FRONT.state"),
        (lambda table: table.append_column("novel", table.column(0)), "unexpected columns: novel"),
        (lambda table: table.set_column(0, "step", table.column(0).cast(pa.int64())), "wrongly typed columns: step"),
        (lambda table: table.slice(1), "expected 3 scenes"),
    ],
)
def test_other_columns_or_rows(folder, change, match):
    pq.write_table(change(pq.read_table(folder / "recordings.parquet")), folder / "recordings.parquet")
    broken(folder, match)


@pytest.mark.parametrize(
    ("edit", "match"),
    [
        (lambda m: m | {"schema_version": 99}, "expected schema version 2, got 99"),
        (lambda m: {k: v for k, v in m.items() if k != "schema_version"}, "expected schema version 2, got None"),
        (lambda m: m | {"scenes": 3}, r"manifest.json is damaged \(Expected `array`"),
        (lambda m: {k: v for k, v in m.items() if k != "cameras"}, "manifest.json is damaged .*cameras"),
        (lambda m: m | {"scenes": m["scenes"][::-1]}, "expected 3 scenes|differ"),
        (lambda m: [m], "expected schema version"),
    ],
)
def test_other_manifest(folder, edit, match):
    edit_manifest(folder, edit)
    broken(folder, match)


def test_a_manifest_edited_by_hand(folder):
    path = folder / "manifest.json"
    path.write_text(path.read_text().replace('"wheel_scale": 1.0', '"wheel_scale": 1.1'))
    broken(folder, "it was edited")


def test_the_layout_of_a_manifest_does_not_matter(folder):
    before, path = load_recordings(folder).manifest, folder / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()), sort_keys=True))
    assert load_recordings(folder).manifest == before


def test_manifest_that_is_no_json(folder):
    (folder / "manifest.json").write_text("{")
    broken(folder, "manifest.json is damaged")


def test_missing_files(folder, tmp_path):
    (folder / "recordings.parquet").unlink()
    broken(folder, "expected recordings.parquet beside manifest.json")
    broken(tmp_path / "nothing", "expected a folder with manifest.json")


def test_unknown_name_lists_the_bundled_recordings():
    with pytest.raises(RecordingError, match="no folder 'mixocty' and unknown recording 'mixocty'"):
        load_recordings("mixocty")
    with pytest.raises(RecordingError, match=r"no folder 'mixocity'; .* pass its name as a string"):
        load_recordings(Path("mixocity"))


def test_other_columns_are_not_saved(tmp_path):
    recordings = synthetic_recordings(scenes=1)
    table = {name: recordings[name] for name in recordings.column_names[1:]}
    with pytest.raises(RecordingError, match="cannot save: missing columns: step"):
        save_recordings(Recordings(recordings.manifest, table), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_an_old_file_without_own_windows_is_one_line_that_says_what_to_do(folder):
    data, rows, _ = read_columns((folder / "recordings.parquet").read_bytes())
    old = {name: values for name, values in data.items() if ".own_window" not in name}
    write_columns(folder / "recordings.parquet", old, rows)
    with pytest.raises(RecordingError) as error:
        load_recordings(folder)
    said = str(error.value)
    assert "missing columns: CAM_FRONT.own_window_yaw_increment_rad, " in said
    assert "record anew with `mixo record" in said
    assert "\n" not in said
    assert len(said) < 300 + len(str(folder))


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads the Linux way")
def test_reading_starts_no_threads(tmp_path):
    """Arrow's threads abort a process that ends while they are still starting."""
    save_recordings(synthetic_recordings(scenes=2), tmp_path)
    code = (
        "import os, sys, pyarrow.parquet\n"
        "from mixo_env.recordings.store import load_recordings\n"
        "before = len(os.listdir('/proc/self/task'))\n"
        "load_recordings(sys.argv[1])\n"
        "assert len(os.listdir('/proc/self/task')) == before"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True)
