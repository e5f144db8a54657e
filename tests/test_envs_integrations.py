"""The environments in the hands of other people's libraries."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.wrappers import vector as vector_wrappers

import mixo_env
from mixo_env.envs.wrappers import Standardise, standardise, transformed
from mixo_env.errors import ConfigurationError, PolicyError, RecordingError
from mixo_env.recordings.store import load_recordings
from tests.synthetic import synthetic_recordings

RECORDINGS = synthetic_recordings(scenes=6, steps=25)
IDS = list(mixo_env.ENVIRONMENTS)
ROOT = Path(__file__).parent.parent


def one_episode(env: gym.Env[Any, Any]) -> dict[str, Any]:
    observation, info = env.reset(seed=0)
    truncated = False
    while not truncated:
        assert observation in env.observation_space
        observation, _, _, truncated, info = env.step(env.action_space.sample())
    return info


@pytest.mark.parametrize("env_id", IDS)
def test_gymnasium_wrappers(env_id: str) -> None:
    env = wrappers.RecordEpisodeStatistics(gym.make(env_id, recordings=RECORDINGS, observation="dict"))
    info = one_episode(wrappers.NormalizeObservation(wrappers.FlattenObservation(env)))
    assert info["episode"]["l"] == len(RECORDINGS.rows(info["scores"]["scene"])["step"]) - 1
    batched = gym.make_vec(env_id, 3, recordings=RECORDINGS)
    batched = vector_wrappers.NormalizeObservation(vector_wrappers.RecordEpisodeStatistics(batched))
    batched.reset(seed=0)
    returns = []
    for _ in range(80):
        info = batched.step(batched.action_space.sample())[4]
        returns += info["episode"]["r"][info["_episode"]].tolist() if "episode" in info else []
    assert len(returns) >= 6


@pytest.mark.parametrize("env_id", IDS)
def test_stable_baselines3(env_id: str) -> None:
    from stable_baselines3 import PPO
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from mixo_env.envs.sb3 import MixoVecEnv

    env = VecNormalize(VecMonitor(MixoVecEnv(env_id, 4, recordings=RECORDINGS)), norm_reward=False)
    model = PPO("MlpPolicy", env, n_steps=32, batch_size=64, n_epochs=1, gamma=0.0, seed=0, device="cpu")
    model.learn(256)
    assert len(model.ep_info_buffer) >= 4
    mean, _ = evaluate_policy(model, env, n_eval_episodes=3)
    assert np.isfinite(mean)
    single = gym.make(env_id, recordings=RECORDINGS)
    PPO("MlpPolicy", single, n_steps=32, batch_size=32, n_epochs=1, seed=0, device="cpu").learn(64)


def test_sb3_adapter_tells_the_same_story_as_the_batched_environment() -> None:
    from mixo_env.envs.sb3 import MixoVecEnv

    env = MixoVecEnv("mixo_env:MixoOdometry-v0", 3, recordings=RECORDINGS, step_infos=True, render_mode="ansi")
    peer = gym.make_vec("MixoOdometry-v0", 3, recordings=RECORDINGS, autoreset_mode="SAME_STEP")
    env.seed(5)
    np.testing.assert_array_equal(env.reset(), peer.reset(seed=5)[0])
    ended = 0
    for _ in range(80):
        actions = peer.action_space.sample()
        observation, reward, done, infos = env.step(actions)
        theirs, their_reward, _, truncated, info = peer.step(actions)
        np.testing.assert_array_equal(observation, theirs)
        np.testing.assert_array_equal(reward, their_reward.astype(np.float32))
        np.testing.assert_array_equal(done, truncated)
        for i in range(3):
            assert ("terminal_observation" in infos[i]) == truncated[i]
            if truncated[i]:
                ended += 1
                np.testing.assert_array_equal(infos[i]["terminal_observation"], info["final_obs"][i])
                assert infos[i]["scores"]["ate_m"] == info["final_info"]["scores"]["ate_m"][i]
                assert infos[i]["TimeLimit.truncated"]
            where = info["final_info"] if truncated[i] else info
            assert infos[i]["yaw_error_rad"] == where["yaw_error_rad"][i]
    assert ended >= 6
    assert len(env.get_images()) == 3
    assert env.get_attr("num_envs", indices=[0, 2]) == [3, 3]
    assert env.env_is_wrapped(gym.Wrapper) == [False] * 3
    env.set_options({"scene": "scene-2003"})
    env.reset()
    assert [info["scene"] for info in env.reset_infos] == ["scene-2003"] * 3
    for wrong in ({"autoreset_mode": "NEXT_STEP"}, {"env_id": "CartPole-v1"}):
        with pytest.raises(ConfigurationError):
            MixoVecEnv(**wrong)  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="indices"):
        env.set_attr("render_mode", None, indices=[0])


def test_a_cleanrl_style_loop_learns_the_best_expert() -> None:
    """REINFORCE in one screen on a task with a known optimum: only CAM_FRONT says the truth."""
    import torch

    columns = {name: RECORDINGS[name] for name in RECORDINGS.column_names}
    columns["CAM_FRONT.yaw_increment_rad"] = columns["truth.yaw_increment_rad"].astype(np.float32)
    columns["CAM_BACK.yaw_increment_rad"] = columns["CAM_FRONT.yaw_increment_rad"] + np.float32(3e-3)
    told = type(RECORDINGS)(RECORDINGS.manifest, columns)
    envs = gym.make_vec(
        "MixoOdometry-v0", 32, recordings=told, experts=["CAM_BACK", "CAM_FRONT"], weights="select", track="VISION"
    )
    torch.manual_seed(0)
    logits = torch.zeros(2, requires_grad=True)
    optimiser = torch.optim.Adam([logits], lr=0.1)
    envs.reset(seed=0)
    for _ in range(100):
        distribution = torch.distributions.Categorical(logits=logits)
        actions = distribution.sample((32,))
        _, reward, _, _, _ = envs.step(actions.numpy())
        advantage = torch.as_tensor(reward - reward.mean(), dtype=torch.float32)
        loss = -(distribution.log_prob(actions) * advantage).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert torch.softmax(logits, 0)[1] > 0.95


def test_monitors_show_the_scores_of_every_scene(tmp_path: Path) -> None:
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecMonitor

    from mixo_env.envs.sb3 import MixoVecEnv

    scores = ("ate_m", "ate_deg", "yaw_rmse_deg")
    monitored = {"monitor_dir": str(tmp_path / "dummy"), "monitor_kwargs": {"info_keywords": scores}}
    dummy = make_vec_env(IDS[0], 2, env_kwargs={"recordings": RECORDINGS}, **monitored)
    ours = VecMonitor(MixoVecEnv(IDS[0], 2, recordings=RECORDINGS), str(tmp_path / "ours"), info_keywords=scores)
    for env in (dummy, ours):
        env.seed(0)
        env.reset()
        seen = []
        for _ in range(80):
            infos = env.step(np.stack([env.action_space.sample()] * 2))[3]
            seen += [info for info in infos if "episode" in info]
        assert len(seen) >= 4
        for info in seen:
            assert all(0 < info["episode"][name] == pytest.approx(info["scores"][name], abs=1e-5) for name in scores)
        env.close()
    logs = list(tmp_path.rglob("*monitor.csv"))
    assert len(logs) == 3
    assert all(log.read_text().splitlines()[1].endswith(",".join(scores)) for log in logs)


@pytest.mark.parametrize("observation", ["paper", "rich"])
def test_standardised_observations_have_frozen_training_statistics(observation: Any, tmp_path: Path) -> None:
    options = {"recordings": RECORDINGS, "observation": observation}
    train, test = (gym.make("MixoOdometry-v0", split=split, **options) for split in ("train", "test"))
    transform = standardise(train)
    assert isinstance(transform, Standardise)
    np.testing.assert_array_equal(transform.mean, standardise(test).mean)  # type: ignore[attr-defined]
    seen = transform(train.unwrapped.session.training_observations())  # type: ignore[attr-defined]
    np.testing.assert_allclose(seen.mean(axis=0), 0.0, atol=1e-3)
    assert np.abs(seen).max() <= 10.0
    one_episode(transformed(test, transform))
    transform.save(tmp_path / "statistics.json")
    again = Standardise.load(tmp_path / "statistics.json")
    np.testing.assert_array_equal(again.std, transform.std)
    (tmp_path / "statistics.json").write_text("{}")
    with pytest.raises(PolicyError, match="statistics"):
        Standardise.load(tmp_path / "statistics.json")


def test_transforms_need_a_flat_observation() -> None:
    env = gym.make("MixoOdometry-v0", recordings=RECORDINGS, observation="dict")
    with pytest.raises(ConfigurationError, match="flat"):
        standardise(env)


@pytest.mark.integration
@pytest.mark.filterwarnings("default")
def test_record_video(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    env = gym.make("MixoOdometry-v0", recordings=RECORDINGS, render_mode="rgb_array")
    env = wrappers.RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: True)
    one_episode(env)
    env.close()
    assert list(tmp_path.glob("*.mp4"))


@pytest.mark.integration
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("observation", ["paper", "dict"])
def test_minari_export(env_id: str, observation: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("minari")
    pytest.importorskip("h5py")
    from mixo_env.envs.episodes import write_minari
    from mixo_env.recordings.store import save_recordings

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    save_recordings(RECORDINGS, tmp_path / "recordings")
    env = gym.make(env_id, recordings=tmp_path / "recordings", order="fixed", observation=observation)
    dataset = write_minari(env, lambda observation: env.action_space.sample(), f"mixo/random-{observation}-v0")
    scenes = RECORDINGS.select(split="train").scenes
    assert dataset.total_episodes == len(scenes)
    assert dataset.total_steps == sum(scene.rows - 1 for scene in scenes)
    assert dataset.recover_environment().spec.id == env_id
    episode = next(iter(dataset))
    assert episode.truncations[-1]


@pytest.mark.integration
def test_the_example_writes_episodes_of_linear(tmp_path: Path) -> None:
    pytest.importorskip("minari")
    pytest.importorskip("h5py")
    script = [sys.executable, str(ROOT / "examples" / "minari_episodes.py")]
    place = os.environ | {"MINARI_DATASETS_PATH": str(tmp_path)}
    done = subprocess.run(script, cwd=tmp_path, env=place, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    scenes = load_recordings().select(split="train").scenes
    assert f"{len(scenes)} episodes, {sum(scene.rows - 1 for scene in scenes)} steps" in done.stdout


def test_a_reward_that_is_no_number_ends_training_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from stable_baselines3 import PPO

    from mixo_env.envs.sb3 import MixoVecEnv

    env = MixoVecEnv(num_envs=2, recordings=RECORDINGS)
    step = env.env.step

    def broken(actions: Any) -> Any:
        observation, reward, *rest = step(actions)
        reward[1] = np.nan
        return observation, reward, *rest

    monkeypatch.setattr(env.env, "step", broken)
    with pytest.raises(RecordingError, match=r"^scene-\d+: expected finite rewards, got NaN: [^\n]*$"):
        PPO("MlpPolicy", env, n_steps=8, batch_size=8, device="cpu").learn(16)


@pytest.mark.integration
@pytest.mark.parametrize(
    ("example", "steps", "says"),
    [
        ("cleanrl_ppo.py", 61_440, r"untrained: ([.\d]+) deg\nafter 61440 steps: ([.\d]+) deg"),
        ("vector_loop.py", 2_000_000, r"2000896 steps, ([.\d]+) M a second, mean reward -([.\d]+)"),
    ],
)
def test_examples_of_loops_of_ones_own(example: str, steps: int, says: str, tmp_path: Path) -> None:
    script = [sys.executable, str(ROOT / "examples" / example), str(steps)]
    done = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = re.fullmatch(says, done.stdout.strip())
    assert found, done.stdout
    if example == "cleanrl_ppo.py":
        assert float(found[2]) < 0.9 * float(found[1])


@pytest.mark.integration
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("observation", ["paper", "dict"])
def test_torchrl(env_id: str, observation: str) -> None:
    pytest.importorskip("torchrl")
    from torchrl.envs.libs.gym import GymEnv, GymWrapper
    from torchrl.envs.utils import check_env_specs

    env = GymEnv(f"mixo_env:{env_id}", recordings=RECORDINGS, observation=observation)
    check_env_specs(env)
    played = env.rollout(1000)["next"]
    assert played["truncated"].sum() == 1
    assert played["truncated"][-1]
    with pytest.raises(TypeError, match="unexpected keyword argument 'rawscale': did you mean 'raw_scale'"):
        GymEnv(f"mixo_env:{env_id}", recordings=RECORDINGS, rawscale=3.0)
    options: dict[str, Any] = {"recordings": RECORDINGS, "observation": observation, "autoreset_mode": "DISABLED"}
    batched = GymWrapper(gym.make_vec(env_id, 3, **options))
    played = batched.rollout(100, break_when_any_done=False)["next"]
    assert played.batch_size == (3, 100)
    assert played["truncated"].sum() >= 6


@pytest.mark.integration
@pytest.mark.parametrize("env_id", IDS)
def test_rl_zoo3(env_id: str, tmp_path: Path) -> None:
    pytest.importorskip("rl_zoo3")
    from mixo_env.recordings.store import save_recordings

    save_recordings(RECORDINGS, tmp_path / "recordings")
    command = [sys.executable, "-m", "rl_zoo3.train", "--algo", "ppo", "--env", env_id, "--gym-packages", "mixo_env"]
    command += ["--conf-file", str(ROOT / "experiments" / "rl_zoo3" / "ppo.yml"), "--log-folder", str(tmp_path)]
    recordings = f"recordings:'{tmp_path / 'recordings'}'"
    command += ["--n-timesteps", "4096", "--seed", "0", "--hyperparams", "n_envs:2", "n_epochs:1"]
    command += ["--env-kwargs", recordings, "--eval-env-kwargs", recordings, *zoo_evaluation(), "--eval-freq", "2048"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    assert list(tmp_path.rglob(f"{env_id}.zip"))
    with np.load(next(tmp_path.rglob("evaluations.npz"))) as evaluations:
        played = {RECORDINGS.rows(scene.name)["step"][-1] for scene in RECORDINGS.select(split="test").scenes}
        assert set(evaluations["ep_lengths"].ravel().tolist()) == played


def zoo_evaluation() -> list[str]:
    """Options of the evaluation environment that the zoo file tells its users to give."""
    words = (
        (ROOT / "experiments" / "rl_zoo3" / "ppo.yml").read_text().partition("--eval-env-kwargs ")[2].splitlines()[0]
    )
    return [word for word in shlex.split(words) if ":" in word]
