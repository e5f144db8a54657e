"""Every observed quantity, row by row, against a literal reading of the recording's columns."""

from __future__ import annotations

from statistics import median
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from mixo_env.envs.observation import AWAKE, PAPER, RICH
from mixo_env.experts.expert import State
from mixo_env.recordings.collection import Recordings
from tests.synthetic import synthetic_recordings

CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")
INERTIAL = "INERTIAL_CONSUMER"
EXPERTS = (*CAMERAS, INERTIAL)
SCENE = "scene-2003"


def restless() -> Recordings:
    """Recordings in which no column repeats itself from row to row, so that a neighbouring row is never right."""
    recordings = synthetic_recordings(scenes=4, steps=30)
    rng = np.random.default_rng(5)
    rows = len(recordings["speed_mps"])
    changed: dict[str, np.ndarray] = {"speed_mps": rng.uniform(1.0, 9.0, rows).astype(np.float32)}
    changed["dt_s"] = np.where(recordings["step"] == 0, 0.0, rng.uniform(0.05, 0.15, rows))
    for camera in CAMERAS:
        for name, high in (
            ("matches", 900),
            ("inliers", 600),
            ("residual_px", 3),
            ("flow_px", 90),
            ("yaw_std_rad", 0.1),
        ):
            changed[f"{camera}.{name}"] = rng.uniform(0.001, high, rows).astype(np.float32)
    changed[f"{INERTIAL}.yaw_std_rad"] = rng.uniform(0.001, 0.1, rows).astype(np.float32)
    return recordings.replace(columns=changed)


RECORDINGS = restless()
TABLE = {name: values.astype(float).tolist() for name, values in RECORDINGS.rows(SCENE).items()}
LAST = len(TABLE["step"]) - 1


def is_missing(value: float) -> bool:
    return value != value


def voted(expert: str, k: int, increments: str) -> float:
    """What an expert votes at row k: its own increment, or the inertial one in its place [rad]."""
    name = f"{expert}.{increments}" if expert in CAMERAS else f"{expert}.yaw_increment_rad"
    return TABLE[f"{INERTIAL}.yaw_increment_rad"][k] if is_missing(TABLE[name][k]) else TABLE[name][k]


def expected(k: int) -> dict[str, list[float]]:
    """What is observed before the step that row ``k`` closes is fused, but for the previous yaw rate."""
    dt = TABLE["dt_s"][k]
    delivered = [not is_missing(TABLE[f"{expert}.yaw_increment_rad"][k]) for expert in EXPERTS]
    rates = [voted(expert, k, "yaw_increment_rad") / dt for expert in EXPERTS]
    middle = median(rate for rate, own in zip(rates, delivered, strict=True) if own)
    observed = {
        "speed": [TABLE["speed_mps"][k - 1]],
        "yaw_rates": rates,
        "dt": [dt],
        "available": [float(own) for own in delivered],
        "state": [TABLE[f"{camera}.state"][k] for camera in CAMERAS],
        "yaw_rate_std": [
            TABLE[f"{expert}.yaw_std_rad"][k] / dt if own else 0.0
            for expert, own in zip(EXPERTS, delivered, strict=True)
        ],
        "disagreement": [rate - middle for rate in rates],
    }
    for name in ("matches", "inliers", "residual_px", "flow_px"):
        observed[name] = [
            TABLE[f"{camera}.{name}"][k] if TABLE[f"{camera}.state"][k] == State.TRACKING else 0.0 for camera in CAMERAS
        ]
    return observed


def expected_with_switches(k: int, on: list[bool], before: list[bool]) -> dict[str, list[float]]:
    """The same in the budget environment: images of row k processed where ``on``, of row k - 1 where ``before``."""
    dt, inertial = TABLE["dt_s"][k], TABLE[f"{INERTIAL}.yaw_increment_rad"][k]
    observed: dict[str, list[float]] = {"speed": [TABLE["speed_mps"][k - 1]], "dt": [dt]}
    for name in ("matches", "inliers", "residual_px", "flow_px", "state", "awake", "available", "yaw_rates"):
        observed[name] = []
    for c, camera in enumerate(CAMERAS):
        own = TABLE[f"{camera}.two_frame_yaw_increment_rad"][k]
        delivers = on[c] and before[c]
        found = delivers and not is_missing(own)
        for name in ("matches", "inliers", "residual_px", "flow_px"):
            observed[name].append(TABLE[f"{camera}.{name}"][k] if found else 0.0)
        if not delivers:
            state = State.INITIALISING if on[c] else State.NO_IMAGE
        elif found:
            state = State.TRACKING
        else:
            state = State.NO_IMAGE if TABLE[f"{camera}.state"][k] == State.NO_IMAGE else State.LOST
        observed["state"].append(float(state))
        observed["awake"].append(float(on[c]))
        observed["available"].append(float(found))
        observed["yaw_rates"].append((own if found else inertial) / dt)
    observed["available"].append(1.0)
    observed["yaw_rates"].append(inertial / dt)
    said = [rate for rate, own in zip(observed["yaw_rates"], observed["available"], strict=True) if own]
    observed["disagreement"] = [rate - median(said) for rate in observed["yaw_rates"]]
    return observed


def agree(observation: dict[str, np.ndarray], wanted: dict[str, list[float]], k: int) -> None:
    for name, values in wanted.items():
        if name in observation:
            np.testing.assert_allclose(observation[name], values, rtol=2e-6, atol=1e-6, err_msg=f"{name} in row {k}")


def named(observation: Any, quantities: tuple[Any, ...]) -> dict[str, np.ndarray]:
    """A flat observation cut up by the documented widths."""
    if isinstance(observation, dict):
        return observation
    widths = {"one": 1, "camera": len(CAMERAS), "expert": len(EXPERTS)}
    cuts = np.cumsum([widths[quantity.per] for quantity in quantities])
    assert cuts[-1] == len(observation)
    return dict(zip([q.name for q in quantities], np.split(observation, cuts[:-1]), strict=True))


@pytest.mark.parametrize(("form", "quantities"), [("paper", PAPER), ("rich", RICH), ("dict", RICH)])
def test_every_quantity_comes_from_its_column_and_its_row(form: str, quantities: tuple[Any, ...]) -> None:
    env = gym.make("MixoOdometry-v0", recordings=RECORDINGS, observation=form, split="all")
    observation, _ = env.reset(options={"scene": SCENE})
    dt, previous = TABLE["dt_s"], TABLE[f"{INERTIAL}.yaw_increment_rad"][1] / TABLE["dt_s"][1]
    for k in range(1, LAST + 1):
        seen = named(observation, quantities)
        assert list(seen) == [quantity.name for quantity in quantities]
        agree(seen, {"previous_yaw_rate": [previous], **expected(k)}, k)
        observation, _, _, truncated, info = env.step(env.action_space.sample())
        previous = info["yaw_increment_rad"] / dt[k]
        assert truncated == (k == LAST)
    agree(named(observation, quantities), {"previous_yaw_rate": [previous], **expected(LAST)}, LAST)


@pytest.mark.parametrize("form", ["paper", "rich", "dict"])
def test_every_quantity_of_the_budget_comes_from_its_column_and_its_row(form: str) -> None:
    quantities = (*(PAPER if form == "paper" else [q for q in RICH if q.name != "yaw_rate_std"]), AWAKE)
    env = gym.make("MixoOdometryBudget-v0", recordings=RECORDINGS, observation=form, split="all")
    observation, _ = env.reset(options={"scene": SCENE})
    rng = np.random.default_rng(2)
    before = on = [True] * len(CAMERAS)
    previous = TABLE[f"{INERTIAL}.yaw_increment_rad"][1] / TABLE["dt_s"][1]
    for k in range(1, LAST + 1):
        seen = named(observation, quantities)
        assert list(seen) == [quantity.name for quantity in quantities]
        agree(seen, {"previous_yaw_rate": [previous], **expected_with_switches(k, on, before)}, k)
        before, on = on, (rng.uniform(size=len(CAMERAS)) < 0.6).tolist()
        action = np.array([*rng.uniform(-1, 1, len(EXPERTS)), *(1.0 if s else -1.0 for s in on)], np.float32)
        observation, _, _, _, info = env.step(action)
        previous = info["yaw_increment_rad"] / TABLE["dt_s"][k]


@pytest.mark.parametrize("env_id", ["MixoOdometry-v0", "MixoOdometryBudget-v0"])
def test_the_privileged_truth_is_that_of_the_coming_step(env_id: str) -> None:
    env = gym.make(env_id, recordings=RECORDINGS, observation="dict", split="all", privileged=True)
    observation, _ = env.reset(options={"scene": SCENE})
    for k in range(1, LAST):
        truth = TABLE["truth.yaw_increment_rad"][k] / TABLE["dt_s"][k]
        np.testing.assert_allclose(observation["truth_yaw_rate"], [truth], rtol=1e-6)
        observation = env.step(env.action_space.sample())[0]
