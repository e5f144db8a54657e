"""The budget environment: what a switched camera may say, what it costs, and that the replay is what really happens."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import simplejpeg

from mixo_env.envs.budget import BudgetReplay
from mixo_env.envs.stepping import FIRST_EXPERT
from mixo_env.errors import ConfigurationError, RecordingError
from mixo_env.experts.expert import State
from mixo_env.experts.inertial import InertialOdometry
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.scene import CameraReel, CanBus, Scene, Signal
from mixo_env.nuscenes.selections import CAMERA_OFFSET_US
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import INERTIAL_EXPERTS, Manifest, SceneEntry
from mixo_env.recordings.steps import Experts, record_scene
from tests.corridor import calibration, picture
from tests.synthetic import synthetic_recordings

RECORDINGS = synthetic_recordings(scenes=4, steps=30)


def make(**options: Any) -> gym.Env[Any, Any]:
    return gym.make("MixoOdometryBudget-v0", recordings=RECORDINGS, observation="dict", **options).unwrapped


def action(weights: list[float], switches: list[float]) -> np.ndarray:
    return np.array([*weights, *switches], np.float32)


def test_a_woken_camera_delivers_one_step_late_and_pays_for_both_images() -> None:
    env = make()
    env.reset(options={"scene": "scene-2001"})
    plan = [[1, 1, 1, 1]] * 5 + [[0, 1, 1, 1]] * 3 + [[1, 1, 1, 1]] * 4 + [[0, 0, 0, 0]] * 3
    two_frame = RECORDINGS.rows("scene-2001")["CAM_FRONT.two_frame_yaw_increment_rad"]
    rows = RECORDINGS.rows("scene-2001")
    for step, on in enumerate(plan, start=1):
        observation, _, _, _, info = env.step(action([0.0] * 5, [1.0 if s else -1.0 for s in on]))
        assert info["cost_ms"] == 20.0 * sum(on)
        assert info["reward_cost"] == -0.01 * info["cost_ms"]
        np.testing.assert_array_equal(observation["awake"], on)
        row = step + 1  # the observation is about the next step
        delivers = on[0] and plan[step - 2][0] if step > 1 else on[0]
        assert observation["available"][0] == delivers
        dt = rows["dt_s"][row]
        inertial = rows["INERTIAL_CONSUMER.yaw_increment_rad"][row] / dt
        expected = two_frame[row] / dt if delivers else inertial
        np.testing.assert_allclose(observation["yaw_rates"][0], expected, rtol=1e-6)
        assert (observation["matches"][0] > 0) == bool(delivers and rows["CAM_FRONT.state"][row] != State.NO_IMAGE)
        if not delivers:
            assert observation["state"][0] == (State.INITIALISING if on[0] else State.NO_IMAGE)
            assert observation["inliers"][0] == observation["residual_px"][0] == observation["flow_px"][0] == 0
    assert observation["available"].tolist() == [0, 0, 0, 0, 1]
    assert np.all(observation["disagreement"] == 0)
    assert "yaw_rate_std" not in observation


def test_disagreement_counts_delivering_experts_only() -> None:
    env = make()
    env.reset(options={"scene": "scene-2002"})
    rng = np.random.default_rng(0)
    truncated = False
    while not truncated:
        observation, _, _, truncated, _ = env.step(rng.uniform(-1, 1, 9).astype(np.float32))
        said = observation["yaw_rates"][observation["available"] > 0]
        expected = observation["yaw_rates"] - np.median(said)
        np.testing.assert_allclose(observation["disagreement"], expected, atol=1e-6)


def test_the_last_action_costs_nothing() -> None:
    env = make(price_per_ms=1.0)
    env.reset(options={"scene": "scene-2001"})
    truncated = False
    while not truncated:
        _, reward, _, truncated, info = env.step(np.ones(9, np.float32))
        assert reward == info["reward_yaw"] + info["reward_cost"]
        assert info["cost_ms"] == (0.0 if truncated else 80.0)


def test_bad_prices_and_missing_costs_are_one_line() -> None:
    for price in (-1.0, math.nan, math.inf):
        with pytest.raises(ConfigurationError, match="price_per_ms"):
            make(price_per_ms=price)
    with pytest.raises(ConfigurationError, match="select"):
        make(weights="select")
    free = Recordings(
        replace(RECORDINGS.manifest, camera_cost_ms={}), {name: RECORDINGS[name] for name in RECORDINGS.column_names}
    )
    with pytest.raises(RecordingError, match="camera_cost_ms"):
        gym.make("MixoOdometryBudget-v0", recordings=free)


CAMERAS = {"CAM_FRONT": 0.0, "CAM_BACK": 180.0, "CAM_BACK_RIGHT": 250.0}
ROUNDS, START_US = 14, 1_600_000_000_000_000


def drive_in_the_corridor(folder: Path) -> Scene:
    """Three cameras on a gentle curve, fourteen firing rounds."""

    def pose(t_us: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        t = 1e-6 * (t_us - START_US)
        yaw = -0.1 + 0.15 * t
        return 40.0 * (np.sin(yaw) - np.sin(-0.1)), -40.0 * (np.cos(yaw) - np.cos(-0.1)), yaw

    reels = {}
    for camera, mounting in CAMERAS.items():
        stamps = START_US + np.arange(ROUNDS) * 100_000 + CAMERA_OFFSET_US[camera]
        mounted = calibration(mounting, channel=camera)
        x, y, yaw = pose(stamps)
        paths = tuple(folder / f"{camera}-{k}.jpg" for k in range(ROUNDS))
        for k, path in enumerate(paths):
            grey = picture(mounted, x[k], y[k], yaw[k], noise_seed=k)
            path.write_bytes(simplejpeg.encode_jpeg(grey[..., None], colorspace="GRAY", quality=95))
        reels[camera] = CameraReel(mounted, stamps, paths, np.zeros(ROUNDS, bool), x, y, yaw)
    times = np.arange(START_US - 200_000, START_US + 1_800_000, 20_000)
    wheels = Signal(times, np.full((len(times), 4), 6.0 / 0.305))
    gyro = Signal(times, np.full(len(times), 0.15))
    bus = CanBus(wheels, gyro, consumer_yaw_rate_radps=gyro)
    return Scene("scene-2001", "", "log-0", "n099", "corridor", ("day",), reels, bus)


def recorded(scene: Scene) -> Recordings:
    columns, _ = record_scene(scene, Experts(MonocularOdometry, InertialOdometry))
    rows = len(columns["step"])
    entry = SceneEntry(scene.name, scene.log, scene.vehicle, scene.location, scene.conditions, 0, rows)
    manifest = Manifest("test-0", tuple(CAMERAS), INERTIAL_EXPERTS, (), (entry,))
    return Recordings(manifest, columns)


def test_replay_equals_a_scene_recorded_with_cameras_really_switched(tmp_path: Path) -> None:
    scene = drive_in_the_corridor(tmp_path)
    closing = max(CAMERAS, key=lambda camera: CAMERA_OFFSET_US[camera])  # it closes the rounds: t_k must not move
    switched = [camera for camera in CAMERAS if camera != closing]
    on = np.random.default_rng(4).uniform(size=(ROUNDS, len(switched))) < 0.6
    on[:2] = True
    reels = dict(scene.cameras)
    for c, camera in enumerate(switched):
        reel = reels[camera]
        kept = np.flatnonzero(on[:, c])
        reels[camera] = replace(
            reel,
            timestamp_us=reel.timestamp_us[kept],
            image_paths=tuple(reel.image_paths[k] for k in kept),
            is_keyframe=reel.is_keyframe[kept],
            x_m=reel.x_m[kept],
            y_m=reel.y_m[kept],
            yaw_rad=reel.yaw_rad[kept],
        )
    truly = recorded(replace(scene, cameras=reels)).rows(0)
    everything = recorded(scene)
    replay = BudgetReplay(everything, track="CONSUMER")
    replay.reset([0])
    delivered = 0
    for k in range(1, len(everything.rows(0)["step"])):
        observation = replay.observe()
        assert truly["timestamp_us"][k] == everything.rows(0)["timestamp_us"][k]
        for camera in switched:
            j, c = replay.experts.index(camera), replay.cameras.index(camera)
            increment = truly[f"{camera}.two_frame_yaw_increment_rad"][k]
            assert observation["available"][0, j] == np.isfinite(increment)
            assert observation["awake"][0, c] == (truly[f"{camera}.state"][k] != State.NO_IMAGE)
            if np.isfinite(increment):
                delivered += 1
                assert replay.table[replay.state[0]["row"], FIRST_EXPERT + j] == increment
                for name in ("matches", "inliers", "residual_px", "flow_px"):
                    assert observation[name][0, c] == truly[f"{camera}.{name}"][k], name
        replay.step(np.full((1, len(replay.experts)), 0.2))
        if k + 1 < ROUNDS:
            choice = np.ones((1, len(replay.cameras)), np.float32)
            choice[0, [replay.cameras.index(camera) for camera in switched]] = on[k + 1]
            replay.switch(choice, np.ones(len(replay.cameras)))
    assert delivered >= 8
