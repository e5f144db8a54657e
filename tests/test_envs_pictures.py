"""Pictures of an episode, what a step says in one line, and the images of a simulated folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from mixo_env.errors import RecordingError
from mixo_env.recordings.collection import Recordings
from tests.synthetic import synthetic_recordings

RECORDINGS = synthetic_recordings(scenes=8, steps=40)


def make(env_id: str = "MixoOdometry-v0", **options: Any) -> Any:
    return gym.make(env_id, **{"recordings": RECORDINGS, **options}).unwrapped


@pytest.mark.parametrize("env_id", ["MixoOdometry-v0", "MixoOdometryBudget-v0"])
@pytest.mark.parametrize("track", ["CONSUMER", "VISION"])
def test_pictures(env_id: str, track: str) -> None:
    env = make(env_id, render_mode="rgb_array", track=track)
    batched = gym.make_vec(env_id, 2, recordings=RECORDINGS, render_mode="rgb_array", track=track)
    env.reset(seed=0, options={"scene": "scene-2001"})
    batched.reset(seed=0, options={"scene": "scene-2001"})
    first = env.render()
    assert first.shape == (540, 960, 3)
    assert first.dtype == np.uint8
    truncated = False
    while not truncated:
        action = env.action_space.sample()
        truncated = env.step(action)[3]
        batched.step(np.stack([action] * 2))
    last = env.render()
    assert (first != last).any()
    for frame in batched.render():
        np.testing.assert_array_equal(frame, last)
    assert make(env_id).render() is None


def test_one_line_about_a_step() -> None:
    env = make(render_mode="ansi")
    env.reset(seed=0, options={"scene": "scene-2001"})
    env.step(np.array([1, 0, 0, 0, 0], np.float32))
    line = env.render()
    assert line.startswith("scene-2001 step 1/")
    assert "CAM_FRONT 0.97" in line
    assert "\n" not in line


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recordings]:
    """A simulated folder and recordings of it; the pictures show their own camera and time."""
    import simplejpeg

    from mixo_env.nuscenes.tables import open_dataset
    from mixo_env.recordings.record import RecordConfig, record
    from mixo_env.simulator.config import SimulationConfig
    from mixo_env.simulator.dataset import simulate
    from tests.recording_fakes import FAKES

    folder = tmp_path_factory.mktemp("simulated")
    simulate(SimulationConfig(scenes=2, scenes_per_log=1, seconds=4, images=False, width=320, height=180), folder)
    dataset = open_dataset(folder)
    for name in dataset.scene_names:
        for c, track in enumerate(dataset.load(name).cameras.values()):
            for k, path in enumerate(track.image_paths):
                path.parent.mkdir(parents=True, exist_ok=True)
                picture = np.full((180, 320, 3), (40 + 50 * c, 3 * k, 90), np.uint8)
                path.write_bytes(simplejpeg.encode_jpeg(picture, quality=95))
    return folder, record(dataset, RecordConfig(), folder / "recordings", experts=FAKES)


@pytest.mark.parametrize("env_id", ["MixoOdometry-v0", "MixoOdometryBudget-v0"])
def test_pixels(env_id: str, simulated: tuple[Path, Recordings]) -> None:
    from gymnasium.utils.env_checker import check_env
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_checker import check_env as check_env_sb3

    from mixo_env.envs.sb3 import MixoVecEnv

    root, recordings = simulated
    options: dict[str, Any] = {"recordings": recordings, "dataroot": str(root), "split": "all"}
    env = make(env_id, observation="pixels", **options)
    check_env(env, skip_render_check=True)
    check_env_sb3(env, skip_render_check=True)
    observation, info = env.reset(seed=0, options={"scene": "scene-2001"})
    for _ in range(5):
        for c, camera in enumerate(("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")):
            path = info["images"][camera]
            if path is None:
                assert not observation[camera].any()
                continue
            assert camera in path
            assert Path(path).is_file()
            stamp = int(Path(path).stem.split("__")[-1])
            row = env.session.replay.recording_row(0)
            rows = recordings.rows("scene-2001")
            expected = rows["timestamp_us"][row] + 1e6 * rows[f"{camera}.image_time_offset_s"][row]
            assert abs(stamp - expected) <= 1000
            assert abs(int(observation[camera][..., 0].mean()) - (40 + 50 * c)) <= 3
        observation, _, _, _, info = env.step(env.action_space.sample())
    batched = gym.make_vec(env_id, 2, observation="pixels", autoreset_mode="SAME_STEP", **options)
    batched.reset(seed=0)
    for _ in range(50):
        observation, *_, info = batched.step(batched.action_space.sample())
        assert observation in batched.observation_space
        assert info["_images"].all()
    vec = MixoVecEnv(env_id, 2, observation="pixels", **options)
    small = {"ortho_init": False, "features_extractor_kwargs": {"cnn_output_dim": 8}}
    PPO("MultiInputPolicy", vec, n_steps=4, batch_size=8, n_epochs=1, policy_kwargs=small, device="cpu").learn(8)
    drawn = make(env_id, render_mode="rgb_array", **options)
    drawn.reset(seed=0)
    assert drawn.render().shape == (540, 960, 3)


def test_a_folder_that_was_not_recorded_is_one_line(simulated: tuple[Path, Recordings]) -> None:
    root, recordings = simulated
    columns = {name: recordings[name].copy() for name in recordings.column_names}
    columns["timestamp_us"] += 30_000
    env = make(recordings=Recordings(recordings.manifest, columns), dataroot=str(root), split="all")
    with pytest.raises(RecordingError, match="dataroot"):
        env.reset(seed=0)
