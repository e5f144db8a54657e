"""One file per saved policy: tensors and their description in a safetensors file, never pickled code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import PolicyError
from mixo_env.files import write_bytes

FILE = "policy.safetensors"
DESCRIPTION = "mixo"
"""The only metadata key, holding sorted JSON: with several keys the bytes of a safetensors file change between runs."""


def write(folder: Path, description: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> None:
    """Write ``folder/policy.safetensors`` atomically; equal input gives equal bytes.

    Raises:
        PolicyError: for tensors of anything but numbers.
        OutputError: when it cannot be written.
    """
    from safetensors.numpy import save

    for name, value in tensors.items():
        if np.asarray(value).dtype.kind not in "biuf":
            raise PolicyError(f"tensor {name!r}: expected numbers, got {np.asarray(value).dtype}: nothing is pickled")
    metadata = {DESCRIPTION: json.dumps(description, sort_keys=True)}
    data = save({name: np.ascontiguousarray(value) for name, value in tensors.items()}, metadata=metadata)
    write_bytes(folder / FILE, data)


def read(folder: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Description and tensors of a saved policy.

    Raises:
        PolicyError: when the file is missing, broken or not written by :func:`write`.
    """
    from safetensors import SafetensorError, safe_open

    path = folder / FILE
    if not path.is_file():
        raise PolicyError(f"expected a saved policy at {path}, found none: save one there first")
    try:
        with safe_open(path, framework="numpy") as file:
            description = json.loads(file.metadata()[DESCRIPTION])
            return description, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, TypeError, KeyError, ValueError) as error:
        raise PolicyError(f"{path} is not a saved policy ({error}): save it anew") from None
