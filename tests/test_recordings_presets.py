"""The preset of a recording: every table names it."""

from __future__ import annotations

from dataclasses import asdict, replace

from mixo_env.experts.monocular.config import PRESETS
from mixo_env.recordings.presets import OWN_SETTINGS, data_label, preset_of, recorded_preset
from tests.bundle import bundled


def test_a_preset_is_known_by_its_settings_whatever_its_vocabulary() -> None:
    for name, preset in PRESETS.items():
        assert preset_of(asdict(preset)) == name
        assert preset_of(asdict(replace(preset, vocabulary="words.npy"))) == name
    assert preset_of(asdict(replace(PRESETS["fast"], features=900))) == OWN_SETTINGS
    assert preset_of({}) == OWN_SETTINGS


def test_both_bundled_recordings_name_their_preset() -> None:
    assert data_label(bundled("mixocity").manifest).endswith(" (preset fast)")
    assert data_label(bundled("mixocity-paper").manifest).endswith(" (preset paper)")


def test_recordings_without_cameras_or_settings_have_no_preset() -> None:
    manifest = bundled("mixocity").manifest
    for bare in (replace(manifest, cameras=()), replace(manifest, parameters={"import": {}})):
        assert recorded_preset(bare) is None
        assert data_label(bare) == manifest.data_version
