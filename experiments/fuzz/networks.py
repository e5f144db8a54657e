"""Damage networks of Stable-Baselines3 at random, then load and play them: an action or one MixoError must come.

    python -m experiments.fuzz.networks --inputs 100000

Each input is a zip with bytes changed or cut, with other members, or a sound zip whose plain JSON or whose tensors have
other names, shapes, types and values; now and then with statistics of observations likewise. Warnings count as errors.
"""

from __future__ import annotations

import io
import json
import tempfile
import traceback
import warnings
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from safetensors.numpy import save

from experiments.fuzz.outcome import Outcome
from experiments.fuzz.policies import another, cut_or_changed
from experiments.fuzz.stores import VALUES
from mixo_env.envs.replay import Replay
from mixo_env.errors import MixoError
from mixo_env.policies.agent import QUANTITIES, Agent, Asking
from mixo_env.policies.networks import KINDS
from mixo_env.policies.policy import Observation
from mixo_env.policies.sb3 import Network, read_network
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings

HIDDEN = 3
TRACK = "CONSUMER"


@dataclass(frozen=True)
class Saved:
    """A network as SB3 keeps it: JSON values and tensors by name, and how it is asked."""

    data: dict[str, Any]
    tensors: dict[str, NDArray[Any]]
    asking: Asking


def networks(width: int, experts: int) -> list[Saved]:
    """A small network of every algorithm, with a choice and with numbers where it knows both.

    Args:
        width: of the observations.
        experts: to weight.
    """
    rng, found = np.random.default_rng(0), []
    for name, kind in KINDS.items():
        first, second = (f"{kind.hidden}{i}" for i in (0, 2))
        last = kind.head or f"{kind.hidden}4"
        shapes = {first: (HIDDEN, width), second: (HIDDEN, HIDDEN), last: (experts, HIDDEN)}
        tensors: dict[str, NDArray[Any]] = {}
        for layer, shape in shapes.items():
            tensors[f"{layer}.weight"] = rng.normal(size=shape).astype(np.float32)
            tensors[f"{layer}.bias"] = rng.normal(size=shape[0]).astype(np.float32)
        data = {"policy_class": {":type:": "x", ":serialized:": "gAQ="}, "use_sde": False, "gamma": 0.99}
        data["policy_kwargs"] = {":serialized:": "gAQ=", "activation_fn": "<class 'torch.nn.modules.activation.Tanh'>"}
        select, soft = Asking(weights="select"), Asking(weights="softmax")
        if name in ("PPO", "A2C", "DQN"):
            found.append(Saved(data, tensors, select))
        if name != "DQN":
            box = {"log_std": np.zeros(experts, np.float32)} if kind.head == "action_net" else {}
            found.append(Saved(data, tensors | box, soft))
    return found


def fuzz(recordings: Recordings, inputs: int, seed: int, folder: Path) -> Outcome:
    """Try ``inputs`` damaged zips.

    Args:
        recordings: to play them on; their first scene is used.
        inputs: how many.
        seed: of the damage.
        folder: for the files.
    """
    rng, outcome = np.random.default_rng(seed), Outcome()
    replay = Replay(recordings, track=TRACK)
    replay.reset(np.array([0]))
    observation = replay.observe()
    width = sum(observation[quantity.name].shape[1] for quantity in QUANTITIES["paper"])
    whole = networks(width, observation["yaw_rates"].shape[1])
    packed = [zipped(saved.data, saved.tensors) for saved in whole]
    path, statistics = folder / "net.zip", folder / "statistics.safetensors"
    for _ in range(inputs):
        at = int(rng.integers(len(whole)))
        broken = rng.random() < 0.4
        path.write_bytes(cut_or_changed(rng, packed[at]) if broken else zipped(*_exchanged(rng, whole[at])))
        network = Network()
        if rng.random() < 0.2:
            statistics.write_bytes(_statistics(rng, width))
            network = Network(statistics=statistics)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                outcome.counts[_played(path, network, whole[at].asking, observation)] += 1
        except MixoError as error:
            outcome.counts["refused"] += 1
            if not str(error).isprintable():
                outcome.faults.append((repr(path.read_bytes()[:300]), f"more than one plain line: {str(error)!r}"))
        except Exception:
            outcome.faults.append((repr(path.read_bytes()[:300]), traceback.format_exc()))
    return outcome


def zipped(data: Any, tensors: Any, members: tuple[str, ...] = ("data", "policy.pth")) -> bytes:
    """A zip as ``model.save`` writes it."""
    import torch

    state, out = io.BytesIO(), io.BytesIO()
    torch.save({name: torch.from_numpy(np.array(value)) for name, value in tensors.items()}, state)
    contents = {"data": json.dumps(data).encode(), "policy.pth": state.getvalue()}
    with zipfile.ZipFile(out, "w") as archive:
        for member in members:
            archive.writestr(member, contents[member])
    return out.getvalue()


def _played(path: Path, network: Network, asking: Asking, observation: Observation) -> str:
    act, how = read_network(path, network, asking)
    weights = Agent(act, "network", how).act(observation)
    if weights.shape != observation["yaw_rates"].shape or not np.isfinite(weights).all():
        raise AssertionError(f"weights {weights}")
    return "played"


def _exchanged(rng: np.random.Generator, saved: Saved) -> tuple[Any, dict[str, Any], tuple[str, ...]]:
    """Other JSON values, other tensors, or a member less."""
    data, tensors = json.loads(json.dumps(saved.data)), dict(saved.tensors)
    for _ in range(int(rng.integers(1, 3))):
        if rng.random() < 0.3:
            key = list(data)[int(rng.integers(len(data)))]
            data[key] = VALUES[int(rng.integers(len(VALUES)))]
            continue
        name = list(tensors)[int(rng.integers(len(tensors)))]
        value = another(rng, tensors.pop(name))
        if value is not None:
            tensors[name if rng.random() < 0.9 else f"{name}?"] = value
        if not tensors:
            break
    members = ("data", "policy.pth")
    whole: Any = VALUES[int(rng.integers(len(VALUES)))] if rng.random() < 0.03 else data
    return whole, tensors, members if rng.random() < 0.97 else members[int(rng.integers(2)) :][:1]


def _statistics(rng: np.random.Generator, width: int) -> bytes:
    """Those of ``VecNormalize``, sound or not."""
    values: dict[str, NDArray[Any]] = {"mean": np.zeros(width), "var": np.ones(width)}
    values |= {"clip": np.array(10.0), "epsilon": np.array(1e-8)}
    name = list(values)[int(rng.integers(len(values)))]
    value = another(rng, values.pop(name))
    if value is not None:
        values[name] = value
    data = save({key: np.asarray(entry) for key, entry in values.items()})
    return data if rng.random() < 0.8 else cut_or_changed(rng, data)


@dataclass(frozen=True)
class Fuzz:
    """Damage zips of Stable-Baselines3; exit code 1 if anything but an action or one line of error came."""

    inputs: int = 100_000
    """How many."""
    seed: int = 0
    """Of the damage."""

    def run(self) -> int:
        """Print counts and the first faults."""
        with tempfile.TemporaryDirectory() as folder:
            outcome = fuzz(load_recordings("mixocity"), self.inputs, self.seed, Path(folder))
        return outcome.report(self.inputs)


if __name__ == "__main__":
    raise SystemExit(tyro.cli(Fuzz).run())
