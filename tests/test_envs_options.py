"""What the options of the environments mean: weights, rewards, scores, faults, pictures, images, documentation."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from docs._pages import environment_page
from mixo_env import fusion
from mixo_env.envs.actions import ActionRule
from mixo_env.envs.faults import Fault, inject, read_faults
from mixo_env.envs.observation import AWAKE, RICH
from mixo_env.envs.stepping import LARGEST_EXPONENT, half_turn, power_of_e
from mixo_env.errors import ConfigurationError, MixoError, RecordingError
from mixo_env.experts.expert import State
from mixo_env.metrics.absolute import absolute_errors_se2, scene_absolute
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import VehicleConstants
from mixo_env.trajectory.planar import PlanarPoses
from tests.synthetic import synthetic_recordings

RECORDINGS = synthetic_recordings(scenes=8, steps=40)
SIGMA = RECORDINGS.manifest.reward_scale_rad["CONSUMER"]


def make(env_id: str = "MixoOdometry-v0", **options: Any) -> Any:
    return gym.make(env_id, **{"recordings": RECORDINGS, **options}).unwrapped


def increments(scene: str, recordings: Recordings = RECORDINGS) -> np.ndarray:
    """``(steps, 5)`` with lost cameras replaced, and the truth."""
    rows = recordings.rows(scene)
    inertial = rows["INERTIAL_CONSUMER.yaw_increment_rad"]
    votes = [rows[f"{expert}.yaw_increment_rad"] for expert in recordings.voters("CONSUMER")]
    return np.stack([np.where(np.isfinite(v), v, inertial) for v in votes], axis=-1)[1:].astype(np.float64)


def test_no_logit_is_beyond_the_series() -> None:
    action = np.array([1.0, -1.0], np.float32)
    rule = ActionRule("softmax", 2, raw_scale=4.0)
    assert np.abs(rule.scale * action).max() <= LARGEST_EXPONENT
    numbers = rule.read(action, None)
    np.testing.assert_allclose(
        rule.weights(numbers, np.ones((1, 2), np.bool_))[0, 0], 1 / (1 + math.exp(-10.0)), rtol=1e-15
    )


def test_series_are_exact_to_the_last_bits() -> None:
    for x in np.linspace(-LARGEST_EXPONENT, LARGEST_EXPONENT, 4001):
        assert abs(power_of_e(x) / math.exp(x) - 1) < 1e-14
    for angle in np.concatenate([np.linspace(-0.6, 0.6, 200), [2.0, -3.0, 7.0]]):
        np.testing.assert_allclose(half_turn(angle), (np.cos(angle / 2), np.sin(angle / 2)), atol=2e-16, rtol=2e-16)


@pytest.mark.parametrize("weights", ["softmax", "simplex", "raw"])
def test_weights_are_those_of_the_paper_and_of_fusion(weights: Any) -> None:
    env = make(weights=weights)
    env.reset(options={"scene": "scene-2001"})
    rng = np.random.default_rng(0)
    for row in increments("scene-2001")[:-1]:
        action = rng.uniform(-1, 1, 5).astype(np.float32)
        rule = {
            "softmax": lambda a: fusion.softmax(5.0 * a),
            "simplex": fusion.project_to_simplex,
            "raw": lambda a: 4.0 * a,
        }[weights]
        expected = fusion.mix(rule(action.astype(np.float64)), row)
        np.testing.assert_allclose(env.step(action)[4]["yaw_increment_rad"], expected, atol=1e-8)


@pytest.mark.parametrize("env_options", [{"weights": "select"}, {"weights": "raw"}, {"weights": "simplex"}])
def test_one_expert_alone_is_reproduced_bit_for_bit(env_options: dict[str, Any]) -> None:
    env = make(**env_options)
    for j in range(5):
        env.reset(options={"scene": "scene-2002"})
        one = np.eye(5, dtype=np.float32)[j] * (0.25 if env_options["weights"] == "raw" else 1.0)
        action = j if env_options["weights"] == "select" else one
        seen = [env.step(action)[4]["yaw_increment_rad"] for _ in range(40)]
        np.testing.assert_array_equal(seen, increments("scene-2002")[:40, j])


def test_rewards_by_hand() -> None:
    truth = RECORDINGS.rows("scene-2003")["truth.yaw_increment_rad"][1:]
    outside = [s.name for s in RECORDINGS.scenes if s.fold != 3]
    linear = fusion.least_squares_weights(
        np.concatenate([increments(name) for name in outside]),
        np.concatenate([RECORDINGS.rows(name)["truth.yaw_increment_rad"][1:] for name in outside]),
    )
    for reward in ("squared", "abs", "improvement", "pose"):
        env = make(reward=reward, weights="select")
        env.reset(options={"scene": "scene-2003"})
        total = 0.0
        for k in range(40):
            _, value, _, truncated, info = env.step(k % 5)
            e = min(abs(increments("scene-2003")[k, k % 5] - truth[k]) / SIGMA, 10.0)
            reference = min(abs(increments("scene-2003")[k] @ linear - truth[k]) / SIGMA, 10.0)
            if reward == "pose":
                assert value == info["reward_position"] <= 0.0
            else:
                expected = {"squared": -(e**2), "abs": -e, "improvement": reference**2 - e**2}[reward]
                np.testing.assert_allclose(value, expected, rtol=1e-6, atol=1e-9)
            assert value == sum(v for key, v in info.items() if key.startswith("reward_"))
            total += value
            if truncated:
                break
        while not truncated:
            _, value, _, truncated, info = env.step(0)
            total += value
        if reward == "pose":  # the mean over the poses is minus the squared ATE
            poses = len(truth) + 1
            np.testing.assert_allclose(-total / poses, info["scores"]["ate_m"] ** 2, rtol=1e-9)


def test_errors_are_capped_at_ten_sigma() -> None:
    columns = {name: RECORDINGS[name].copy() for name in RECORDINGS.column_names}
    columns["CAM_FRONT.yaw_increment_rad"] += 1.0
    wild = Recordings(RECORDINGS.manifest, columns)
    for reward, least in (("squared", -100.0), ("abs", -10.0), ("pose", -100.0)):
        env = make(recordings=wild, reward=reward, weights="select")
        env.reset(options={"scene": "scene-2001"})
        rewards = [env.step(0)[1] for _ in range(30)]
        assert min(rewards) == least


def test_last_info_scores_the_scene() -> None:
    env = make()
    env.action_space.seed(0)
    env.reset(options={"scene": "scene-2001"})
    fused, truncated = [], False
    while not truncated:
        _, _, _, truncated, info = env.step(env.action_space.sample())
        fused.append(info["yaw_increment_rad"])
    rows = RECORDINGS.rows("scene-2001")
    truth = [rows[f"truth.{c}"] for c in ("x_m", "y_m", "yaw_rad")]
    estimate = fusion.dead_reckon(fused, rows["distance_m"][1:], start=tuple(float(t[0]) for t in truth))
    expected = scene_absolute(absolute_errors_se2(PlanarPoses(*truth), PlanarPoses(*estimate)))
    assert info["scores"]["scene"] == "scene-2001"
    np.testing.assert_allclose(info["scores"]["ate_m"], expected.translation_m[0], rtol=1e-9)
    np.testing.assert_allclose(info["scores"]["ate_deg"], expected.rotation_deg[0], rtol=1e-9)


def test_vehicle_constants_enter_the_path() -> None:
    from dataclasses import replace

    from mixo_env.recordings.schema import VehicleConstants

    manifest = replace(RECORDINGS.manifest, vehicles={"n099": VehicleConstants(1.1, 0.2)})
    env = make(recordings=Recordings(manifest, {n: RECORDINGS[n] for n in RECORDINGS.column_names}), render_mode="ansi")
    env.reset(options={"scene": "scene-2001"})
    fused = [env.step(np.zeros(5, np.float32))[4]["yaw_increment_rad"] for _ in range(30)]
    rows = RECORDINGS.rows("scene-2001")
    start = tuple(float(rows[f"truth.{c}"][0]) for c in ("x_m", "y_m", "yaw_rad"))
    x, y, yaw = fusion.dead_reckon(fused, 1.1 * rows["distance_m"][1:31], start=start, course_offset_rad=0.2)
    for ours, expected in zip(env.session.replay.trajectory(0), (x, y, yaw), strict=True):
        np.testing.assert_allclose(ours, expected, rtol=1e-7)
    state = env.session.replay.state[0]
    np.testing.assert_allclose([state["x_m"], state["y_m"]], [x[-1] - x[0], y[-1] - y[0]], rtol=1e-6)


def test_previous_yaw_rate_has_the_source_asked_for() -> None:
    rows = RECORDINGS.rows("scene-2002")
    dt = rows["dt_s"]
    for previous, column in (("inertial", "INERTIAL_CONSUMER.yaw_increment_rad"), ("truth", "truth.yaw_increment_rad")):
        env = make(previous=previous)
        first, _ = env.reset(options={"scene": "scene-2002"})
        np.testing.assert_allclose(first[0], rows["INERTIAL_CONSUMER.yaw_increment_rad"][1] / dt[1], rtol=1e-6)
        for k in range(1, 20):
            observation = env.step(np.zeros(5, np.float32))[0]
            np.testing.assert_allclose(observation[0], rows[column][k] / dt[k], rtol=1e-6)
    env = make()
    env.reset(options={"scene": "scene-2002"})
    for k in range(1, 20):
        observation, _, _, _, info = env.step(np.zeros(5, np.float32))
        np.testing.assert_allclose(observation[0], info["yaw_increment_rad"] / dt[k], rtol=1e-6)


def test_splits_and_folds() -> None:
    def folds(**options: Any) -> set[int]:
        return {scene.fold for scene in make(**options).session.recordings.scenes}

    assert folds() == {0, 1, 2}
    assert folds(split="test") == {3}
    assert folds(fold=1) == {0, 2, 3}
    assert folds(fold=1, split="test") == {1}
    assert folds(split="all") == {0, 1, 2, 3}


def test_vehicle_constants_never_come_from_the_held_out_fold() -> None:
    longer = {name: RECORDINGS[name].copy() for name in ("truth.x_m", "truth.y_m", "truth.distance_m")}
    for i, scene in enumerate(RECORDINGS.scenes):
        if scene.fold == 1:
            for values in longer.values():
                values[RECORDINGS.offsets[i] : RECORDINGS.offsets[i + 1]] *= 1.5
    changed = RECORDINGS.replace(columns=longer)

    def constants(recordings: Recordings, **options: Any) -> dict[str, VehicleConstants]:
        return dict(make(recordings=recordings, **options).session.recordings.manifest.vehicles)

    assert constants(changed, fold=1, split="test") == constants(RECORDINGS, fold=1, split="test")
    assert constants(changed, fold=0, split="test") != constants(RECORDINGS, fold=0, split="test")
    assert constants(RECORDINGS) == RECORDINGS.manifest.vehicles


def fault_of(kind: str, **fields: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Increments of CAM_FRONT before and after the fault, and the step lengths, of one scene."""
    name = "CAM_FRONT.yaw_increment_rad"
    faulty = inject(RECORDINGS, [Fault("CAM_FRONT", kind, **fields)])  # type: ignore[arg-type]
    before, after = RECORDINGS.rows("scene-2004"), faulty.rows("scene-2004")
    for column in RECORDINGS.column_names:
        if not column.startswith("CAM_FRONT."):
            np.testing.assert_array_equal(before[column], after[column])
    return before[name], after[name], before["dt_s"]


def test_faults_by_hand() -> None:
    before, after, dt = fault_of("flipped", start_step=10)
    np.testing.assert_array_equal(after[:10], before[:10])
    np.testing.assert_array_equal(after[10:], -before[10:])

    before, after, dt = fault_of("stuck", start_step=10)
    said = np.flatnonzero(np.isfinite(before[:10]))[-1]
    held = np.where(np.isfinite(before[10:]), before[said] / dt[said] * dt[10:], np.nan)
    np.testing.assert_allclose(after[10:], held, rtol=1e-6)
    before, after, dt = fault_of("stuck")
    assert np.nansum(np.abs(after)) == 0.0

    before, after, dt = fault_of("delayed", delay_steps=3, start_step=10)
    np.testing.assert_array_equal(after[10:], before[7:-3])

    before, after, dt = fault_of("noisy", noise_radps=0.5)
    noise = (after - before)[1:] / dt[1:]
    assert 0.3 < np.nanstd(noise) < 0.7
    np.testing.assert_array_equal(after, fault_of("noisy", noise_radps=0.5)[1])

    before, after, dt = fault_of("dropped", start_step=10)
    assert np.isnan(after[10:]).all()


def test_a_dropped_camera_is_lost_and_the_others_are_not() -> None:
    env = make(observation="dict", faults=[{"expert": "CAM_BACK", "kind": "dropped", "start_step": 8}])
    env.reset(options={"scene": "scene-2001"})
    for k in range(1, 20):
        observation = env.step(np.zeros(5, np.float32))[0]
        if k + 1 >= 8:
            assert observation["available"][2] == 0
            assert observation["matches"][2] == 0
            assert observation["state"][2] == State.LOST
            assert observation["yaw_rates"][2] == observation["yaw_rates"][4]


@pytest.mark.parametrize(
    "fault",
    [
        {"expert": "CAM_FRONT", "kind": "noisy", "noise_radps": -1},
        {"expert": "CAM_FRONT", "kind": "delayed", "delay_steps": 0},
        {"expert": "CAM_FRONT", "kind": "stuck", "start_step": 0},
        {"expert": "CAM_FRONT"},
    ],
)
def test_bad_faults(fault: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError):
        read_faults([fault])


@pytest.mark.parametrize("column", ["dt_s", "distance_m", "truth.yaw_increment_rad"])
def test_recordings_with_holes_are_one_line(column: str) -> None:
    columns = {name: RECORDINGS[name].copy() for name in RECORDINGS.column_names}
    columns[column][5] = np.nan
    with pytest.raises(RecordingError) as caught:
        make(recordings=Recordings(RECORDINGS.manifest, columns))
    assert "\n" not in str(caught.value)


def test_recordings_that_cannot_be_read_are_one_line(tmp_path: Path) -> None:
    from mixo_env.recordings.store import save_recordings

    save_recordings(RECORDINGS, tmp_path)
    parquet, manifest = tmp_path / "recordings.parquet", tmp_path / "manifest.json"
    make(recordings=tmp_path)
    good, described = parquet.read_bytes(), manifest.read_text()
    edited = bytearray(good)
    edited[len(edited) // 2] ^= 1
    for content in (good[: len(good) // 2], bytes(edited)):
        parquet.write_bytes(content)
        with pytest.raises(RecordingError) as caught:
            make(recordings=tmp_path)
        assert "\n" not in str(caught.value)
    parquet.write_bytes(good)
    manifest.write_text(json.dumps(json.loads(described) | {"schema_version": 999}))
    with pytest.raises(RecordingError, match="999"):
        make(recordings=tmp_path)
    with pytest.raises(MixoError):
        make(recordings=tmp_path / "nowhere")


def test_memory_stays_constant() -> None:
    env = gym.make_vec("MixoOdometry-v0", 256, recordings=RECORDINGS)
    env.reset(seed=0)
    action = env.action_space.sample()

    def play(steps: int) -> int:
        for _ in range(steps):
            env.step(action)
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    before = play(100)
    after = play(600)
    tracemalloc.stop()
    assert after - before < 20_000


def test_the_page_is_up_to_date_and_the_docstrings_hold_the_tables() -> None:
    assert environment_page.PAGE.read_text(encoding="utf-8") == environment_page.page(), (
        "run python -m docs._pages.environment_page"
    )
    page = environment_page.page()
    assert environment_page.observation_table(RICH) in page
    assert environment_page.observation_table((AWAKE,)) in page
    for heading in ("Description", "Action space", "Observation space", "Reward", "Episode end", "Arguments"):
        assert page.count(f"### {heading}\n") == 2
    from dataclasses import fields

    from mixo_env.envs.budget import BudgetSettings

    for field in fields(BudgetSettings):
        assert f"`{field.name}`" in page, f"{field.name} is not documented"


def test_the_documented_example_runs() -> None:
    text = environment_page.page()
    code = text.split("```python\n")[1].split("```")[0]
    code = code.replace('"mixo_env:MixoOdometry-v0"', '"mixo_env:MixoOdometry-v0", recordings=recordings')
    prepared = "from tests.synthetic import synthetic_recordings\nrecordings = synthetic_recordings(steps=30)\n" + code
    done = subprocess.run(
        [sys.executable, "-c", prepared], capture_output=True, text=True, cwd=Path(__file__).parent.parent
    )
    assert "ate_m" in done.stdout, done.stderr
