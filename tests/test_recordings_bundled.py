"""The recording that comes with the package."""

from __future__ import annotations

from importlib.resources import files

import numpy as np

from mixo_env.recordings.schema import SPLITS, TRACKS
from mixo_env.recordings.store import bundled_recordings, load_recordings


def test_mixocity_is_small_and_has_every_fold():
    assert "mixocity" in bundled_recordings()
    data = files("mixo_env.recordings") / "data" / "mixocity"
    assert sum(len(entry.read_bytes()) for entry in data.iterdir()) < 3_000_000
    recordings = load_recordings()
    assert len(recordings) >= 12
    assert len({scene.log for scene in recordings.scenes}) >= 4
    for split in ("train", "test"):
        assert len(recordings.select(split=split)) > 0
    folds = {str(fold) for fold in SPLITS["all"]}
    for track in TRACKS:
        assert folds <= set(recordings.manifest.linear_weights[track])
        assert recordings.manifest.reward_scale_rad[track] > 0


def test_mixocity_holds_no_path_of_the_machine_that_made_it():
    manifest = (files("mixo_env.recordings") / "data" / "mixocity" / "manifest.json").read_text()
    assert load_recordings("mixocity").manifest.parameters["skipped"] == {}
    assert "/home/" not in manifest
    assert "/tmp/" not in manifest


def test_mixocity_has_noise_free_truth():
    recordings = load_recordings()
    assert np.isfinite(recordings["exact.yaw_rad"]).all()
    written = np.hypot(
        recordings["exact.x_m"] - recordings["truth.x_m"], recordings["exact.y_m"] - recordings["truth.y_m"]
    )
    assert np.median(written) < 0.5
