"""Columns that follow from others: left out of the file, the same when it is opened, and never guessed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from mixo_env.errors import RecordingError
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.derived import completed, derivable, scene_rows, stored
from mixo_env.recordings.store import load_recordings, read_columns, save_recordings, write_columns
from tests.bundle import bundled
from tests.synthetic import synthetic_recordings


def columns_of(recordings: Recordings) -> dict[str, np.ndarray]:
    return {name: recordings[name] for name in recordings.column_names}


def test_everything_that_follows_is_left_out_of_a_recording_and_comes_back_to_the_bit():
    some = bundled().select(scenes=[scene.name for scene in bundled().scenes[:3]])
    kept = stored(columns_of(some), some.manifest)
    cameras = {f"{camera}.yaw_increment_rad" for camera in some.manifest.cameras}
    assert cameras | {"time_s", "dt_s", "truth.distance_m"} <= set(columns_of(some)) - set(kept)
    whole = completed(kept, some.manifest)
    for name in some.column_names:
        assert whole[name].dtype == some[name].dtype
        np.testing.assert_array_equal(whole[name], some[name], err_msg=name)


@pytest.mark.parametrize(
    "column", ["time_s", "dt_s", "truth.distance_m", "CAM_BACK.own_window_s", "CAM_BACK.yaw_std_rad"]
)
def test_a_column_that_differs_in_one_bit_is_stored(tmp_path, column):
    some = bundled().select(scenes=[scene.name for scene in bundled().scenes[:2]])
    other = some[column].copy()
    row = np.flatnonzero(np.isfinite(other) & (other != 0.0))[-1]
    other[row] = np.nextafter(other[row], np.inf, dtype=other.dtype)
    some = some.replace(columns={column: other})
    save_recordings(some, tmp_path)
    assert column in pq.read_schema(tmp_path / "recordings.parquet").names
    np.testing.assert_array_equal(load_recordings(tmp_path)[column], other)


def test_a_file_with_all_columns_is_read_as_well(tmp_path):
    some = synthetic_recordings(scenes=3)
    save_recordings(some, tmp_path)
    before = load_recordings(tmp_path)
    write_columns(tmp_path / "recordings.parquet", columns_of(before), [len(before["step"])])
    after = load_recordings(tmp_path)
    for name in before.column_names:
        np.testing.assert_array_equal(after[name], before[name])


def test_by_hand_a_camera_that_misses_a_round():
    """Images at 90, 190 and 410 ms of rounds that close at 100, 200, 300 and 420 ms; then a second scene."""
    manifest = replace(bundled().manifest, cameras=("CAM_BACK",), variants={}, inertial=())
    nan = np.nan
    table = {
        "step": np.array([0, 1, 2, 3, 0, 1], np.int32),
        "timestamp_us": np.array([100, 200, 300, 420, 50, 150]) * 1000,
        "truth.x_m": np.array([0.0, 3.0, 3.0, 0.0, 7.0, 7.0]),
        "truth.y_m": np.array([0.0, 4.0, 4.0, 0.0, 0.0, 2.0]),
        "truth.yaw_rad": np.full(6, np.arctan2(4.0, 3.0)),
        "CAM_BACK.image_time_offset_s": np.array([-0.01, -0.01, nan, -0.01, nan, 0.0], np.float32),
        "CAM_BACK.own_window_yaw_increment_rad": np.array([nan, 0.1, nan, 0.22, nan, 0.1], np.float32),
        "CAM_BACK.own_window_yaw_std_rad": np.array([nan, 0.01, nan, 0.01, nan, 0.01], np.float32),
    }
    whole = completed(table, manifest)
    assert scene_rows(table) == [4, 2]
    np.testing.assert_allclose(whole["time_s"], [0.0, 0.1, 0.2, 0.32, 0.0, 0.1])
    np.testing.assert_allclose(whole["dt_s"], [0.0, 0.1, 0.1, 0.12, 0.0, 0.1])
    np.testing.assert_allclose(whole["truth.distance_m"], [nan, 5.0, 0.0, -5.0, nan, 2.0])
    np.testing.assert_allclose(whole["CAM_BACK.own_window_s"], [nan, 0.1, nan, 0.22, nan, nan], rtol=1e-6)
    # The first window says 1 rad/s: held over both tails of 10 ms it adds and takes off the same.
    np.testing.assert_allclose(whole["CAM_BACK.yaw_increment_rad"], [nan, 0.1, nan, nan, nan, nan], rtol=1e-6)
    assert set(whole) - set(table) == derivable(manifest)


def test_large_recordings_have_few_row_groups_of_whole_scenes(tmp_path):
    save_recordings(synthetic_recordings(scenes=90, steps=30), tmp_path)
    metadata = pq.ParquetFile(tmp_path / "recordings.parquet").metadata
    groups = [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)]
    assert len(groups) <= 45
    ends = np.cumsum([scene.rows for scene in load_recordings(tmp_path).scenes])
    assert set(np.cumsum(groups)) <= set(ends)


def test_a_file_whose_first_row_is_no_start_is_refused(tmp_path):
    save_recordings(synthetic_recordings(scenes=3), tmp_path)
    columns, _, _ = read_columns((tmp_path / "recordings.parquet").read_bytes())
    columns["step"][0] = 1
    write_columns(tmp_path / "recordings.parquet", columns, [len(columns["step"])])
    with pytest.raises(RecordingError, match="expected 3 scenes"):
        load_recordings(tmp_path)
