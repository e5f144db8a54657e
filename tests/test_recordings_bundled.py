"""The recordings that come with the package."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest

from experiments.mixocity import DATA_VERSION, RETRAINED, full_size_scenes, planned_folds, row_scenes
from mixo_env.experts.families import family_expert
from mixo_env.leaderboard.paper.parts import folder_of, median_spent_ms
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.recordings.joint import JOINT
from mixo_env.recordings.schema import HEADLINE_TRACKS, INERTIAL_EXPERTS, SPLITS
from mixo_env.recordings.store import DEFAULT_RECORDINGS, bundled_recordings, read_manifest
from tests.bundle import bundled

DATA = files("mixo_env.recordings") / "data"

of_this_version = pytest.mark.skipif(
    read_manifest(DATA / DEFAULT_RECORDINGS, "").data_version != f"mixocity-{DATA_VERSION}",
    reason="bundled by an older definition",
)


def test_they_are_small():
    assert "mixocity" in bundled_recordings()
    names = bundled_recordings()
    assert sum(len(entry.read_bytes()) for name in names for entry in (DATA / name).iterdir()) < 32_000_000


@pytest.mark.parametrize("name", bundled_recordings())
def test_every_fold_is_fitted(name):
    recordings = bundled(name)
    for split in ("train", "test"):
        assert len(recordings.select(split=split)) > 0
    folds = {str(fold) for fold in SPLITS["all"]}
    for track in HEADLINE_TRACKS:
        assert folds <= set(recordings.manifest.linear_weights[track])
        assert recordings.manifest.reward_scale_rad[track] > 0


@pytest.mark.parametrize("name", bundled_recordings())
def test_they_hold_no_path_of_the_machine_that_made_them(name):
    manifest = (DATA / name / "manifest.json").read_text()
    assert bundled(name).manifest.parameters["skipped"] == {}
    assert "/home/" not in manifest
    assert "/tmp/" not in manifest
    assert "/root/" not in manifest


@pytest.mark.parametrize("name", bundled_recordings())
def test_they_have_noise_free_truth(name):
    recordings = bundled(name)
    assert np.isfinite(recordings["exact.yaw_rad"]).all()
    written = np.hypot(
        recordings["exact.x_m"] - recordings["truth.x_m"], recordings["exact.y_m"] - recordings["truth.y_m"]
    )
    assert np.median(written) < 0.5


@of_this_version
def test_mixocity_is_what_was_planned():
    recordings = bundled()
    assert {scene.name: scene.fold for scene in recordings.scenes} == planned_folds()
    assert (recordings.manifest.cameras, recordings.manifest.inertial) == (CAMERAS, INERTIAL_EXPERTS)
    assert set(recordings.manifest.variants) == {JOINT}
    for expert in INERTIAL_EXPERTS:
        assert np.isfinite(recordings[f"{expert}.yaw_increment_rad"]).sum() == len(recordings["step"]) - len(recordings)


@of_this_version
@pytest.mark.skipif("mixocity-rows" not in bundled_recordings(), reason="mixocity-rows is not bundled")
def test_mixocity_rows_are_scenes_of_mixocity_with_further_rows():
    whole, rows = bundled("mixocity").select(scenes=row_scenes()), bundled("mixocity-rows")
    assert [(scene.name, scene.fold) for scene in rows.scenes] == [(scene.name, scene.fold) for scene in whole.scenes]
    families = {family_expert(family, camera) for family in ("TUTORIAL", "LEARNED") for camera in CAMERAS}
    retrained = {f"{camera} w/ retrained vocabulary" for camera in RETRAINED}
    assert set(rows.manifest.variants) == {JOINT, *families, *retrained}
    for column in whole.column_names:
        np.testing.assert_array_equal(rows[column], whole[column], err_msg=column)


@of_this_version
def test_mixocity_paper_shows_the_same_drives_in_the_same_folds():
    small, large = bundled("mixocity"), bundled("mixocity-paper")
    assert {scene.name: scene.fold for scene in large.scenes} == {
        name: planned_folds()[name] for name in full_size_scenes()
    }
    assert large.manifest.parameters["monocular"]["features"] == 8000
    same = small.select(scenes=full_size_scenes())
    for column in ("timestamp_us", "truth.x_m", "exact.yaw_rad", "distance_m", "INERTIAL.yaw_increment_rad"):
        np.testing.assert_array_equal(large[column], same[column])


@of_this_version
def test_times_of_every_camera_and_of_the_solve_come_with_the_headline():
    spent = median_spent_ms(folder_of(None))
    assert set(spent) == {*CAMERAS, JOINT}
    assert all(0.1 < value < 83.3 for value in spent.values())
