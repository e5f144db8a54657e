"""Which preset of the odometry a recording was made with: `paper` is more accurate than `fast`, so every table says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from mixo_env.experts.monocular.config import PRESETS
from mixo_env.recordings.schema import Manifest

OWN_SETTINGS = "own settings"
"""Of an odometry that no preset describes."""


def preset_of(settings: Mapping[str, Any]) -> str:
    """Name of the preset with these settings of ``MonocularConfig``, whatever the vocabulary; else OWN_SETTINGS."""
    named = {name: asdict(preset) | {"vocabulary": settings.get("vocabulary")} for name, preset in PRESETS.items()}
    # A setting that came later is not known of an older recording.
    known = [name for name, preset in named.items() if settings and settings.items() <= preset.items()]
    return known[0] if known else OWN_SETTINGS


def recorded_preset(manifest: Manifest) -> str | None:
    """Of the cameras' odometry; None where no images were looked at: imports, inertial experts alone."""
    settings = manifest.parameters.get("monocular")
    return preset_of(settings) if manifest.cameras and isinstance(settings, dict) else None


def data_label(manifest: Manifest) -> str:
    """What tables call the data: version and preset, as in ``mixocity-0.6 (preset fast)``."""
    preset = recorded_preset(manifest)
    if preset is None:
        return manifest.data_version
    return f"{manifest.data_version} ({preset if preset == OWN_SETTINGS else f'preset {preset}'})"
