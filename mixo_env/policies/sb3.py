"""Networks of Stable-Baselines3 read from their zip without unpickling anything: JSON, and tensors alone.

The zip's ``data`` holds plain JSON values beside pickled ones (``:serialized:``), which are never touched: all that is
read of them is nothing. What plain JSON does not say (algorithm, activation) is an option.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, PolicyError, printable
from mixo_env.policies.agent import Asking
from mixo_env.policies.networks import KINDS, Activation, Algorithm, Kind, Layers, deterministic_action, layer_names
from mixo_env.policies.storage import LARGEST

LARGEST_BYTES = 64 * 2**20
"""A member that unpacks to more is refused before it is unpacked; nets of this task have some 100 kB."""

LARGEST_STATISTIC = 1e12
"""Mean, variance and clip of an observation beyond this would overflow the network."""


@dataclass(frozen=True)
class Network:
    """What the zip does not say.

    Attributes:
        algorithm: ``None``: told from the names of the tensors (PPO and A2C have the same network).
        activation: ``None``: the default of the algorithm.
        statistics: safetensors file with ``mean`` and ``var`` ``(width,)`` of ``VecNormalize``, and optionally
            ``clip`` and ``epsilon`` (10 and 1e-8).
    """

    algorithm: Algorithm | None = None
    activation: Activation | None = None
    statistics: Path | None = None


def read_network(path: Path, network: Network, asking: Asking) -> tuple[Callable[[Any], Any], Asking]:
    """The deterministic action of a saved network, what ``model.predict(..., deterministic=True)`` gives.

    Returns:
        Function ``(scenes, width)`` -> actions, and how it is asked.

    Raises:
        PolicyError: for anything but a plain zip with a dense network of a known algorithm.
    """
    data, tensors = _members(path)
    kind = KINDS[_algorithm(path, network, tensors)]
    if data.get("use_sde"):
        raise PolicyError(f"{path}: expected a network without state-dependent exploration, got use_sde: train without")
    if asking.observation == "dict":
        raise ConfigurationError("observation: a network takes flat observations, got 'dict': choose paper or rich")
    if kind.head == "action_net":
        kind = replace(kind, discrete="log_std" not in tensors)  # a Box has a standard deviation
    if kind.discrete != (asking.weights == "select"):
        wanted = "select" if kind.discrete else "softmax, simplex or raw"
        raise ConfigurationError(f"weights: {path.name} needs {wanted}, got {asking.weights}: choose that")
    layers = _layers(path, kind, tensors)
    normalise = _statistics(network.statistics, layers[0][0].shape[1])
    activation = network.activation or _activation(path, kind, data)

    def act(seen: NDArray[np.float32]) -> Any:
        if seen.shape[1] != layers[0][0].shape[1]:
            raise PolicyError(f"expected observations of {layers[0][0].shape[1]} numbers, got {seen.shape[1]}")
        return deterministic_action(kind, layers, normalise(seen), activation)

    return act, replace(asking, vectorised=True)


def _members(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[np.float32]]]:
    """Plain JSON values and tensors of the zip."""
    import torch

    try:
        with zipfile.ZipFile(path) as archive:
            data = json.loads(_unpacked(path, archive, "data"))
            packed = _unpacked(path, archive, "policy.pth")
        with zipfile.ZipFile(io.BytesIO(packed)) as inner:
            if sum(member.file_size for member in inner.infolist()) > LARGEST_BYTES:
                raise PolicyError(f"{path}: policy.pth unpacks to more than {LARGEST_BYTES} bytes: not such a network")
        state = torch.load(io.BytesIO(packed), map_location="cpu", weights_only=True)
        if not isinstance(data, dict) or not isinstance(state, dict):
            raise PolicyError(f"{path}: expected JSON and tensors by name, got something else: save the model anew")
        tensors = {}
        for name, value in state.items():
            if (
                not isinstance(value, torch.Tensor)
                or value.numel() * 4 > LARGEST_BYTES
                or not value.is_floating_point()
            ):
                raise PolicyError(f"{path}: {str(name)!r} is no tensor of a small network: save the model anew")
            tensors[str(name)] = value.detach().to(torch.float32).numpy().copy()
    except PolicyError:
        raise
    except Exception as error:  # zipfile, json and torch have many; none of them may end in a traceback
        reason = printable(" ".join(str(error).split())[:200])
        raise PolicyError(
            f"{path} is not a plain zip of Stable-Baselines3 ({type(error).__name__}: {reason})"
        ) from None
    return data, tensors


def _unpacked(path: Path, archive: zipfile.ZipFile, member: str) -> bytes:
    if member not in archive.namelist():
        raise PolicyError(f"{path}: expected a member {member!r}, found none: give what `model.save` wrote")
    if archive.getinfo(member).file_size > LARGEST_BYTES:
        raise PolicyError(f"{path}: {member} unpacks to more than {LARGEST_BYTES} bytes: not such a network")
    with archive.open(member) as file:
        return file.read(LARGEST_BYTES)


def _algorithm(path: Path, network: Network, tensors: dict[str, NDArray[np.float32]]) -> str:
    if network.algorithm is not None:
        if network.algorithm not in KINDS:
            raise ConfigurationError(f"algorithm: expected one of {', '.join(KINDS)}, got {network.algorithm!r}")
        return network.algorithm
    for name, kind in KINDS.items():
        head = f"{kind.head}.weight" if kind.head else f"{kind.hidden}0.weight"
        if head in tensors:
            return name
    raise PolicyError(f"{path}: expected a network of {', '.join(KINDS)} with MlpPolicy, found none of their tensors")


def _activation(path: Path, kind: Kind, data: dict[str, Any]) -> Activation:
    """As the plain text beside the pickled ``policy_kwargs`` has it, else SB3's default."""
    kwargs = data.get("policy_kwargs")
    if not isinstance(kwargs, dict) or "activation_fn" not in kwargs:
        return kind.activation
    endings: dict[Activation, str] = {"tanh": ".Tanh'>", "relu": ".ReLU'>"}
    for name, ending in endings.items():
        if str(kwargs["activation_fn"]).endswith(ending):
            return name
    raise PolicyError(f"{path}: expected tanh or relu between layers, got another activation: give it as an option")


def _layers(path: Path, kind: Kind, tensors: dict[str, NDArray[np.float32]]) -> Layers:
    """Dense layers in order, checked to fit each other."""
    if any(name.split(".")[0] == "features_extractor" for name in tensors):
        raise PolicyError(f"{path}: expected MlpPolicy on flat observations, got a features extractor: train without")
    layers: Layers = []
    for name in layer_names(kind, tensors):
        weight, bias = tensors.get(f"{name}.weight"), tensors.get(f"{name}.bias")
        fits = weight is not None and bias is not None and weight.ndim == 2 and bias.shape == weight.shape[:1]
        if weight is None or bias is None or not fits or (layers and weight.shape[1] != len(layers[-1][1])):
            raise PolicyError(f"{path}: layer {name} is missing or does not fit the one before: save the model anew")
        if not all((np.abs(values) <= LARGEST).all() for values in (weight, bias)):  # NaN is not less
            raise PolicyError(f"{path}: layer {name} holds numbers that are not finite or beyond {LARGEST:g}: train it")
        layers.append((weight, bias))
    if not layers:
        raise PolicyError(f"{path}: expected dense layers {kind.hidden}0 and on, found none: give the right algorithm")
    return layers


def _statistics(path: Path | None, width: int) -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
    """What ``VecNormalize`` does to observations."""
    if path is None:
        return lambda seen: seen
    from safetensors import SafetensorError
    from safetensors.numpy import load_file

    try:
        found = load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        raise PolicyError(f"{path} is no safetensors file ({error}): save mean and var with safetensors") from None
    mean, var = found.get("mean"), found.get("var")
    if mean is None or var is None or mean.shape != (width,) or var.shape != (width,):
        raise PolicyError(f"{path}: expected mean and var of {width} numbers each: save those of VecNormalize.obs_rms")
    clip, epsilon = found.get("clip", np.array(10.0)), found.get("epsilon", np.array(1e-8))
    if clip.size != 1 or epsilon.size != 1:
        raise PolicyError(f"{path}: expected one number each as clip and epsilon, got {clip.size} and {epsilon.size}")
    mean, var, most, least = (value.astype(np.float64) for value in (mean, var, clip.ravel(), epsilon.ravel()))
    sound = all((np.abs(value) < LARGEST_STATISTIC).all() for value in (mean, var, most, least))  # NaN is not less
    if not sound or most[0] <= 0 or (var + least <= 0).any():
        raise PolicyError(
            f"{path}: expected finite numbers, clip > 0 and var + epsilon > 0: save those of VecNormalize anew"
        )
    scale = np.sqrt(var + least)
    return lambda seen: np.clip((seen - mean) / scale, -most[0], most[0]).astype(np.float32)
