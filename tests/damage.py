"""Ways of editing a recording on disk that keep the hash of its manifest right."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mixo_env.recordings.manifest import HASH, manifest_hash


def edit_manifest(folder: Path, edit: Callable[[Any], Any]) -> None:
    """Replace ``manifest.json`` by what ``edit`` makes of its values, sealed as if a program had written it."""
    path = folder / "manifest.json"
    table = edit({key: value for key, value in json.loads(path.read_text()).items() if key != HASH})
    if isinstance(table, dict):
        table = table | {HASH: manifest_hash(table)}
    path.write_text(json.dumps(table))
