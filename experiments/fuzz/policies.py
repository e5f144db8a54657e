"""Damage saved policies at random, then load and play them: weights or one MixoError must come.

    python -m experiments.fuzz.policies --inputs 60000

Each input is a saved policy with bytes changed, or with its description or tensors exchanged: other shapes, types and
values in a file that is sound as such. Warnings count as errors: they would stand beside the one line.
"""

from __future__ import annotations

import json
import tempfile
import traceback
import warnings
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.numpy import save

from experiments.fuzz.outcome import Outcome
from experiments.fuzz.stores import VALUES
from mixo_env.envs.replay import Replay
from mixo_env.errors import MixoError
from mixo_env.policies import registry
from mixo_env.policies.fitting import prepare
from mixo_env.policies.gate import Mixo
from mixo_env.policies.policy import Policy
from mixo_env.policies.storage import DESCRIPTION, FILE
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings

NAMES = ("LINEAR", "HUBER", "MIXO", "MEAN", "INERTIAL")
TRACK = "PAPER"
NUMBERS = (0.0, -1.0, 1.0, 1e-30, 1e30, 1e300, np.inf, -np.inf, np.nan)
TYPES = ("<f2", "<f4", "<f8", "<i4", "<u1", "?")


def saved(recordings: Recordings, folder: Path, names: tuple[str, ...] = NAMES) -> dict[str, bytes]:
    """Small fitted policies as they are saved, by name."""
    files = {}
    for name in names:
        small = Mixo(epochs=1, min_updates=1, hidden=(4, 4))
        policy = small if name == "MIXO" else registry.create(name, recordings)
        prepare(policy, recordings, TRACK)
        policy.save(folder)
        files[name] = (folder / FILE).read_bytes()
    return files


def fuzz(recordings: Recordings, files: dict[str, bytes], inputs: int, seed: int, folder: Path) -> Outcome:
    """Try ``inputs`` damaged policies.

    Args:
        recordings: to play them on; its first scene is used.
        files: saved policies by name.
        inputs: how many.
        seed: of the damage.
        folder: for the file.
    """
    rng, outcome = np.random.default_rng(seed), Outcome()
    contents = {name: _contents(data, folder) for name, data in files.items()}
    replay = Replay(recordings, track=TRACK, privileged=True)
    replay.reset(np.array([0]))
    observation = replay.observe()
    for _ in range(inputs):
        name = list(files)[int(rng.integers(len(files)))]
        data = cut_or_changed(rng, files[name]) if rng.random() < 0.2 else _exchanged(rng, *contents[name])
        (folder / FILE).write_bytes(data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                policy = registry.load(folder)
                outcome.counts[_played(policy, observation)] += 1
        except MixoError as error:
            outcome.counts["refused"] += 1
            if not str(error).isprintable():
                outcome.faults.append((repr(data[:300]), f"more than one plain line: {str(error)!r}"))
        except Exception:
            outcome.faults.append((repr(data[:300]), traceback.format_exc()))
    return outcome


def _played(policy: Policy, observation: dict[str, NDArray[np.float32]]) -> str:
    """Look at one step; where the policy weights other experts it is refused before it is played."""
    if len(policy.experts) != observation["yaw_rates"].shape[1]:
        return "for other experts"
    weights = policy.act(observation)
    if weights.shape != observation["yaw_rates"].shape or not np.isfinite(weights).all():
        raise AssertionError(f"weights {weights}")
    return "played"


def _contents(data: bytes, folder: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    (folder / FILE).write_bytes(data)
    with safe_open(folder / FILE, framework="numpy") as file:
        return json.loads(file.metadata()[DESCRIPTION]), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118


def cut_or_changed(rng: np.random.Generator, data: bytes) -> bytes:
    """Bytes cut off, cut out or changed."""
    i, j = sorted(int(at) for at in rng.integers(len(data) + 1, size=2))
    match int(rng.integers(3)):
        case 0:
            return data[:i]
        case 1:
            return data[:i] + data[j:]
    edited = bytearray(data)
    for at in rng.integers(len(data), size=int(rng.integers(1, 4))):
        edited[at] = int(rng.integers(256))
    return bytes(edited)


def _exchanged(rng: np.random.Generator, description: dict[str, Any], tensors: dict[str, NDArray[Any]]) -> bytes:
    """A sound file of another description or other tensors."""
    description, tensors = json.loads(json.dumps(description)), dict(tensors)
    for _ in range(int(rng.integers(1, 3))):
        if tensors and rng.random() < 0.6:
            name = list(tensors)[int(rng.integers(len(tensors)))]
            value = another(rng, tensors.pop(name))
            if value is not None:
                tensors[name if rng.random() < 0.9 else f"{name}?"] = value
        else:
            _exchange_value(rng, description)
    return save(
        {name: np.asarray(value) for name, value in tensors.items()}, metadata={DESCRIPTION: json.dumps(description)}
    )


def another(rng: np.random.Generator, value: NDArray[Any]) -> NDArray[Any] | None:
    """A tensor of another shape, type or value; ``None`` for none at all."""
    match int(rng.integers(7)):
        case 0:
            return None
        case 1:
            return np.ascontiguousarray(value.T.copy())
        case 2:
            return np.resize(value, tuple(int(n) for n in rng.integers(0, 6, size=int(rng.integers(0, 4)))))
        case 3:
            with np.errstate(all="ignore"):
                return np.nan_to_num(value).astype(TYPES[int(rng.integers(len(TYPES)))])
        case 4 if value.size and value.dtype.kind == "f":
            changed = value.copy()
            with np.errstate(all="ignore"):
                changed.flat[int(rng.integers(value.size))] = NUMBERS[int(rng.integers(len(NUMBERS)))]
            return changed
        case 5:
            return value[..., None]
    with np.errstate(all="ignore"):
        return np.full(value.shape, NUMBERS[int(rng.integers(len(NUMBERS)))])


def _exchange_value(rng: np.random.Generator, description: dict[str, Any]) -> None:
    """One value of the description, at any depth, exchanged, dropped or renamed."""
    place: Any = description
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        if not keys:
            return
        key = keys[int(rng.integers(len(keys)))]
        if not isinstance(place[key], dict | list) or not place[key] or rng.random() < 0.3:
            break
        place = place[key]
    match int(rng.integers(4)):
        case 0:
            del place[key]
        case 1 if isinstance(place, dict):
            place[f"{key}?"] = place.pop(key)
        case _:
            # A copy: the next change may be made inside it, and end in a ring.
            place[key] = deepcopy(VALUES[int(rng.integers(len(VALUES)))])


@dataclass(frozen=True)
class Fuzz:
    """Damage saved policies at random; exit code 1 if anything but weights or one line of error came."""

    inputs: int = 60_000
    """How many."""
    seed: int = 0
    """Of the damage."""

    def run(self) -> int:
        """Print counts and the first faults."""
        whole = load_recordings("mixocity")
        few = whole.select(scenes=[scene.name for scene in whole.scenes[:3]])
        with tempfile.TemporaryDirectory() as folder:
            outcome = fuzz(few, saved(few, Path(folder)), self.inputs, self.seed, Path(folder))
        return outcome.report(self.inputs)


if __name__ == "__main__":
    raise SystemExit(tyro.cli(Fuzz).run())
