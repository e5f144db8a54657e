"""Networks of Stable-Baselines3: the same action as its own predict, and nothing in a zip is ever run."""

from __future__ import annotations

import base64
import io
import json
import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.policies.agent import Asking
from mixo_env.policies.sb3 import Network, read_network

WIDTH, EXPERTS = 7, 4


class Room(gym.Env[Any, Any]):
    """Spaces alone."""

    def __init__(self, discrete: bool) -> None:
        self.observation_space = gym.spaces.Box(-9, 9, (WIDTH,), np.float32)
        self.action_space = gym.spaces.Discrete(EXPERTS) if discrete else gym.spaces.Box(-1, 1, (EXPERTS,), np.float32)


def saved(tmp_path: Path, algorithm: str, discrete: bool, **kwargs: Any) -> tuple[Any, Path]:
    import stable_baselines3 as sb3

    options = {"buffer_size": 10} if algorithm in ("SAC", "TD3", "DQN") else {}
    kind = getattr(sb3, algorithm)
    policy = {"net_arch": [9, 5], **kwargs}
    model = kind("MlpPolicy", Room(discrete), policy_kwargs=policy, seed=3, device="cpu", **options)
    model.save(tmp_path / "net.zip")
    return model, tmp_path / "net.zip"


@pytest.mark.parametrize(
    ("algorithm", "discrete"),
    [("PPO", False), ("PPO", True), ("A2C", False), ("A2C", True), ("SAC", False), ("TD3", False), ("DQN", True)],
)
@pytest.mark.parametrize("activation", [None, "Tanh", "ReLU"])
def test_the_action_is_that_of_its_own_predict(
    tmp_path: Path, algorithm: str, discrete: bool, activation: str | None
) -> None:
    from torch import nn

    kwargs = {"activation_fn": getattr(nn, activation)} if activation else {}
    model, path = saved(tmp_path, algorithm, discrete, **kwargs)
    asking = Asking(weights="select" if discrete else "raw")
    act, how = read_network(path, Network(), asking)
    assert how.vectorised
    seen = np.random.default_rng(0).normal(0, 3, (50, WIDTH)).astype(np.float32)
    expected, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(act(seen), expected, atol=1e-5)
    with pytest.raises(ConfigurationError, match=r"weights: net\.zip needs"):
        read_network(path, Network(), Asking(weights="softmax" if discrete else "select"))


def test_statistics_do_what_vecnormalize_does(tmp_path: Path) -> None:
    from safetensors.numpy import save_file

    model, path = saved(tmp_path, "PPO", False)
    rng = np.random.default_rng(1)
    mean, var = rng.normal(0, 1, WIDTH), rng.uniform(0.1, 2, WIDTH)
    save_file({"mean": mean, "var": var}, tmp_path / "s.safetensors")
    act, _ = read_network(path, Network(statistics=tmp_path / "s.safetensors"), Asking())
    seen = rng.normal(0, 3, (9, WIDTH)).astype(np.float32)
    normal = np.clip((seen - mean) / np.sqrt(var + 1e-8), -10, 10).astype(np.float32)
    np.testing.assert_allclose(act(seen), model.predict(normal, deterministic=True)[0], atol=1e-5)
    (tmp_path / "s.pkl").write_bytes(pickle.dumps(Bomb(tmp_path / "ran")))
    with pytest.raises(PolicyError, match="is no safetensors file"):
        read_network(path, Network(statistics=tmp_path / "s.pkl"), Asking())
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "wrong",
    [
        *({"clip": np.ones(2)}, {"epsilon": np.ones((2, 2))}, {"clip": np.zeros(1)}, {"clip": np.array(np.nan)}),
        *({"var": -np.ones(WIDTH)}, {"var": np.full(WIDTH, np.nan)}, {"mean": np.full(WIDTH, 1e300)}),
    ],
)
def test_statistics_without_sense_are_one_line(tmp_path: Path, wrong: dict[str, Any]) -> None:
    from safetensors.numpy import save_file

    _, path = saved(tmp_path, "PPO", False)
    save_file({"mean": np.zeros(WIDTH), "var": np.ones(WIDTH)} | wrong, tmp_path / "s.safetensors")
    with pytest.raises(PolicyError, match=r"expected (one number each|finite numbers)"):
        read_network(path, Network(statistics=tmp_path / "s.safetensors"), Asking())


def test_weights_so_large_that_they_overflow_are_refused(tmp_path: Path) -> None:
    import torch

    model, path = saved(tmp_path, "PPO", False)
    state = model.policy.state_dict()
    state["action_net.weight"] = torch.full_like(state["action_net.weight"], 1e30)
    rewritten(path, pth=torch_bytes(state))
    with pytest.raises(PolicyError, match="layer action_net holds numbers that are not finite or beyond"):
        read_network(path, Network(), Asking())


class Bomb:
    """Makes a folder when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)

    def __reduce__(self) -> tuple[Any, ...]:
        return (os.mkdir, (self.path,))


def rewritten(path: Path, **members: bytes | None) -> None:
    """The zip with other members; ``None`` leaves one out. ``pth`` stands for ``policy.pth``."""
    with zipfile.ZipFile(path) as archive:
        held = {name: archive.read(name) for name in archive.namelist()}
    for name, value in members.items():
        held[{"pth": "policy.pth"}.get(name, name)] = value  # type: ignore[assignment]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, value in held.items():
            if value is not None:
                archive.writestr(name, value)


def torch_bytes(value: Any) -> bytes:
    import torch

    out = io.BytesIO()
    torch.save(value, out)
    return out.getvalue()


def test_serialised_keys_of_the_json_are_never_unpickled(tmp_path: Path) -> None:
    _, path = saved(tmp_path, "PPO", False)
    evil = base64.b64encode(pickle.dumps(Bomb(tmp_path / "ran"))).decode()
    with zipfile.ZipFile(path) as archive:
        data = json.loads(archive.read("data"))
    data |= {key: {":type:": "x", ":serialized:": evil} for key in ("policy_class", "extra", "observation_space")}
    rewritten(path, data=json.dumps(data).encode())
    act, _ = read_network(path, Network(), Asking())
    assert act(np.zeros((1, WIDTH), np.float32)).shape == (1, EXPERTS)
    assert not (tmp_path / "ran").exists()


def hostile(tmp_path: Path, path: Path, way: str) -> None:
    import torch

    large = torch.zeros(1).expand(2**16, 2**16)
    ways: dict[str, dict[str, bytes | None]] = {
        "pickled code": {"pth": pickle.dumps(Bomb(tmp_path / "ran"))},
        "pickled code in torch's zip": {"pth": torch_bytes({"a": Bomb(tmp_path / "ran")})},
        "bomb": {"data": b" " * (65 * 2**20)},
        "bomb inside": {"pth": _zip(b"\0" * (65 * 2**20))},
        "huge shape": {"pth": torch_bytes({"mlp_extractor.policy_net.0.weight": large})},
        "no data": {"data": None},
        "no network": {"pth": None},
        "data is no JSON": {"data": b"{"},
        "deep JSON": {"data": b"[" * 10**6},
        "shapes": {
            "pth": torch_bytes(
                {
                    "mlp_extractor.policy_net.0.weight": torch.zeros(5, 7),
                    "mlp_extractor.policy_net.0.bias": torch.zeros(5),
                    "action_net.weight": torch.zeros(4, 6),
                    "action_net.bias": torch.zeros(4),
                    "log_std": torch.zeros(4),
                }
            )
        },
        "numbers": {"pth": torch_bytes({"action_net.weight": 3})},
        "other tensors": {"pth": torch_bytes({"a": torch.zeros(2)})},
    }
    if way == "no zip":
        path.write_bytes(b"PK nothing")
    elif way != "no file":
        rewritten(path, **ways[way])
    else:
        path.unlink()


def _zip(content: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data/0", content)
    return out.getvalue()


WAYS = (
    *("pickled code", "pickled code in torch's zip", "bomb", "bomb inside", "huge shape", "no data", "no network"),
    *("data is no JSON", "deep JSON", "shapes", "numbers", "other tensors", "no zip", "no file"),
)


@pytest.mark.parametrize("way", WAYS)
def test_hostile_and_broken_zips_are_one_line_and_run_nothing(tmp_path: Path, way: str) -> None:
    _, path = saved(tmp_path, "PPO", False)
    hostile(tmp_path, path, way)
    with pytest.raises(PolicyError) as error:
        read_network(path, Network(), Asking())
    assert str(error.value).isprintable()
    assert not (tmp_path / "ran").exists()


def altered(path: Path, **values: Any) -> None:
    """The same zip with other values in its JSON."""
    with zipfile.ZipFile(path) as archive:
        data = json.loads(archive.read("data"))
    rewritten(path, data=json.dumps(data | values).encode())


def test_a_network_of_another_kind_says_what_it_is(tmp_path: Path) -> None:
    import torch

    _, path = saved(tmp_path, "PPO", False)
    act, _ = read_network(path, Network(), Asking())
    with pytest.raises(PolicyError, match="expected observations of 7 numbers, got 6"):
        act(np.zeros((1, 6), np.float32))
    with pytest.raises(ConfigurationError, match="a network takes flat observations, got 'dict'"):
        read_network(path, Network(), Asking(observation="dict"))
    with pytest.raises(ConfigurationError, match=r"algorithm: expected one of .*, got 'TRPO'"):
        read_network(path, Network(algorithm="TRPO"), Asking())  # type: ignore[arg-type]
    with pytest.raises(PolicyError, match=r"expected dense layers .*, found none"):
        read_network(path, Network(algorithm="DQN"), Asking(weights="select"))
    altered(path, policy_kwargs={"activation_fn": "<class 'torch.nn.GELU'>"})
    with pytest.raises(PolicyError, match="expected tanh or relu between layers"):
        read_network(path, Network(), Asking())
    read_network(path, Network(activation="tanh"), Asking())
    altered(path, use_sde=True)
    with pytest.raises(PolicyError, match="got use_sde"):
        read_network(path, Network(), Asking())
    altered(path, use_sde=False)
    picture = {"features_extractor.cnn.0.weight": torch.zeros(1), "action_net.weight": torch.zeros(4, 5)}
    rewritten(path, pth=torch_bytes(picture))
    with pytest.raises(PolicyError, match="got a features extractor"):
        read_network(path, Network(), Asking(weights="select"))
    rewritten(path, pth=torch_bytes([1, 2]))
    with pytest.raises(PolicyError, match="expected JSON and tensors by name"):
        read_network(path, Network(), Asking())


def test_statistics_of_another_width_are_one_line(tmp_path: Path) -> None:
    from safetensors.numpy import save_file

    _, path = saved(tmp_path, "PPO", False)
    save_file({"mean": np.zeros(3), "var": np.ones(3)}, tmp_path / "norm.safetensors")
    with pytest.raises(PolicyError, match="expected mean and var of 7 numbers each"):
        read_network(path, Network(statistics=tmp_path / "norm.safetensors"), Asking())
