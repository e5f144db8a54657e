"""One file per saved policy: tensors and their description in a safetensors file, never pickled code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import PolicyError, printable
from mixo_env.files import write_bytes

FILE = "policy.safetensors"
DESCRIPTION = "mixo"
"""The only metadata key, holding sorted JSON: with several keys the bytes of a safetensors file change between runs."""


def write(folder: Path, description: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> None:
    """Write ``folder/policy.safetensors`` atomically; equal input gives equal bytes.

    Raises:
        PolicyError: for tensors of anything but floating-point numbers.
        OutputError: when it cannot be written.
    """
    from safetensors.numpy import save

    for name, value in tensors.items():
        if np.asarray(value).dtype.kind != "f":
            raise PolicyError(
                f"tensor {name!r}: expected floating-point numbers, got {np.asarray(value).dtype}: give these"
            )
    metadata = {DESCRIPTION: json.dumps(description, sort_keys=True)}
    data = save({name: np.ascontiguousarray(value) for name, value in tensors.items()}, metadata=metadata)
    write_bytes(folder / FILE, data)


LARGEST, SMALLEST_DIVISOR = 1e6, 1e-9
"""Bounds of restored values: no network of them overflows a float32."""


class Description(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a file says of its tensors.

    Attributes:
        policy: name of the policy.
        experts: those it weights, in order.
        settings: keyword arguments of its class.
        fitted_on: hashes of the drives it was fitted on.
        kind: ``module:Class`` of a class that is not of this package; it is never imported because a file says so.
    """

    policy: str
    experts: tuple[str, ...]
    settings: dict[str, Any]
    fitted_on: frozenset[str]
    kind: str = ""


def read(folder: Path) -> tuple[Description, dict[str, NDArray[Any]]]:
    """Description and tensors of a saved policy; the tensors are floating-point numbers without a NaN.

    Raises:
        PolicyError: when the file is missing, broken or not written by :func:`write`.
    """
    from safetensors import SafetensorError, safe_open

    path = folder / FILE
    if not path.is_file():
        raise PolicyError(f"expected a saved policy at {path}, found none: save one there first")
    try:
        with safe_open(path, framework="numpy") as file:
            description = msgspec.json.decode(file.metadata()[DESCRIPTION], type=Description)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, TypeError, KeyError, ValueError, AttributeError, RecursionError) as error:
        raise PolicyError(f"{path} is not a saved policy ({printable(one_line(error))}): save it anew") from None
    for name, value in tensors.items():
        if value.dtype.kind != "f" or np.isnan(value).any():
            raise PolicyError(f"{path} is not a saved policy (tensor {name!r} holds no numbers or NaN): save it anew")
    return description, tensors


def one_line(error: Exception) -> str:
    """The beginning of an error's message, without line ends."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def finite(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """A restored tensor as it came.

    Raises:
        ValueError: if a value is beyond ``LARGEST``.
    """
    if not np.all(np.abs(values.astype(np.float64)) <= LARGEST):
        raise ValueError(f"tensor {name} holds values beyond {LARGEST:g}")
    return values


def positive(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """A restored tensor of divisors as it came.

    Raises:
        ValueError: if a value is beyond ``LARGEST`` or below ``SMALLEST_DIVISOR``.
    """
    if not np.all(finite(name, values).astype(np.float64) >= SMALLEST_DIVISOR):
        raise ValueError(f"tensor {name} must be {SMALLEST_DIVISOR:g} at least")
    return values


def check_inputs(policy: str, seen: NDArray[np.float32], mean: NDArray[Any]) -> NDArray[np.float32]:
    """What a policy sees, ``(batch, inputs)``, if it is as wide as what it was fitted on.

    Raises:
        PolicyError: if it is not.
    """
    if seen.shape[1] != len(mean):
        raise PolicyError(
            f"{policy} was fitted on {len(mean)} inputs a step, here are {seen.shape[1]}: fit it on such recordings"
        )
    return seen
