"""Figures on disk: JSON with five significant digits; what does not exist is null there and NaN here."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from mixo_env.errors import ConfigurationError
from mixo_env.files import write_json

DIGITS = 5


def save(path: Path, value: Any) -> None:
    """Write nested dicts and lists of numbers and texts."""
    write_json(path, _rounded(value))


def load(path: Path) -> Any:
    """Read them again.

    Raises:
        ConfigurationError: if there is no such file.
    """
    try:
        return _numbers(json.loads(path.read_text(encoding="utf-8")))
    except OSError:
        raise ConfigurationError(
            f"{path} does not exist: run `python -m docs._pages.data_sheet --images FOLDER` first"
        ) from None


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value


def _numbers(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _numbers(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_numbers(entry) for entry in value]
    return math.nan if value is None else value
