"""Options are checked by type and choice; what environments share is read once and cannot be written."""

from __future__ import annotations

import json
import os
import pickle
import tracemalloc
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit

from docs._pages import environment_page
from mixo_env import ENVIRONMENTS
from mixo_env.envs import opening, settings
from mixo_env.envs.budget import BudgetSettings
from mixo_env.envs.faults import Fault, FaultKind
from mixo_env.envs.options import hints
from mixo_env.envs.replay import Replay
from mixo_env.errors import ConfigurationError, UnknownOption
from mixo_env.recordings.manifest import decode_manifest, encode_manifest
from mixo_env.recordings.schema import SPLITS, TRACKS
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings
from tests.test_envs_api import same

RECORDINGS = synthetic_recordings(scenes=6, steps=25)
IDS = list(ENVIRONMENTS)


def make(env_id: str = "MixoOdometry-v0", **options: Any) -> Any:
    return gym.make(env_id, **{"recordings": RECORDINGS, **options}).unwrapped


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_recordings(RECORDINGS, tmp_path / "recordings")
    return tmp_path / "recordings"


WRONG_TYPES: list[tuple[dict[str, Any], str]] = [
    ({"privileged": "no"}, "privileged: expected True or False, got 'no' (str): the default is False"),
    ({"privileged": 1}, "privileged: expected True or False, got 1 (int): the default is False"),
    ({"raw_scale": "4"}, "raw_scale: expected a finite number, got '4' (str): the default is 4.0"),
    ({"raw_scale": True}, "raw_scale: expected a finite number, got True (bool): the default is 4.0"),
    ({"raw_scale": float("inf")}, "raw_scale: expected a finite number, got inf (float): the default is 4.0"),
    ({"dataroot": 3}, "dataroot: expected text or a path or None, got 3 (int): the default is None"),
    ({"recordings": 3}, "recordings: expected Recordings or text or a path or None, got 3 (int): the default is None"),
    ({"fold": "3"}, "fold: expected a whole number, got '3' (str): the default is 3"),
    ({"fold": True}, "fold: expected a whole number, got True (bool): the default is 3"),
    ({"fold": 2.0}, "fold: expected a whole number, got 2.0 (float): the default is 3"),
    ({"fold": 7}, "fold: expected one of (0, 1, 2, 3), got 7: it is the one held out"),
    ({"conditions": "day"}, "conditions: expected a list of (text) or None, got 'day' (str): the default is None"),
    ({"conditions": ["fog"]}, "unknown condition 'fog': Valid: day"),
    ({"experts": [1, 2]}, "experts: expected a list of (text) or None, got [1, 2] (list): the default is None"),
    (
        {"observation": None},
        "observation: expected 'paper' or 'rich' or 'dict' or 'pixels', got None (NoneType): the default is 'paper'",
    ),
    ({"order": ["fixed"]}, "order: expected 'random' or 'fixed', got ['fixed'] (list): the default is 'random'"),
    (
        {"faults": {"expert": "CAM_FRONT", "kind": "stuck"}},
        "faults: expected a list of (Fault or a mapping of names), got {'expert': 'CAM_FRONT', 'kind': 'stuck'} "
        "(dict): the default is ()",
    ),
    (
        {"faults": [{"expert": "CAM_FRONT", "kind": "stuck", "start_step": "2"}]},
        "start_step: expected a whole number, got '2' (str): the default is 1",
    ),
    (
        {"faults": [{"expert": 5, "kind": "stuck"}]},
        "expert: expected text, got 5 (int): it must be given",
    ),
    (
        {"faults": [{"expert": "CAM_FRONT", "kind": "noisy", "noise_radps": float("nan")}]},
        "noise_radps: expected a finite number, got nan (float): the default is 0.05",
    ),
    (
        {"faults": [{"expert": "CAM_FRONT", "kind": "lost"}]},
        "unknown kind option 'lost': did you mean 'stuck'? Valid: delayed, dropped, flipped, noisy, stuck",
    ),
]


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize(("options", "message"), WRONG_TYPES, ids=[str(options) for options, _ in WRONG_TYPES])
def test_a_wrong_type_or_choice_says_what_is_valid(env_id: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        make(env_id, **options)
    assert str(caught.value) == message
    assert not isinstance(caught.value, TypeError)


@pytest.mark.parametrize("price", ["0.1", None, True, float("nan")])
def test_a_price_is_a_number(price: Any) -> None:
    with pytest.raises(ConfigurationError, match="price_per_ms: expected a finite number, got"):
        make("MixoOdometryBudget-v0", price_per_ms=price)


def test_a_long_wrong_value_stays_one_short_line() -> None:
    with pytest.raises(ConfigurationError) as caught:
        make(experts=np.zeros((40, 40)))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("vector", [False, True])
def test_unknown_names_are_type_errors_too_in_pythons_own_words(env_id: str, vector: bool) -> None:
    with pytest.raises(UnknownOption, match="got an unexpected keyword argument 'frameskip'") as caught:
        gym.make_vec(env_id, 2, frameskip=1) if vector else gym.make(env_id, frameskip=1)
    assert isinstance(caught.value, TypeError)
    assert "raw_scale" in str(caught.value)


def test_good_types_pass() -> None:
    env = make(
        fold=np.int64(1), raw_scale=2, conditions=("day",), experts=("CAM_BACK", "CAM_FRONT"), faults=(), weights="raw"
    )
    assert env.session.rule.scale == 2.0


def test_choices_are_those_of_the_recordings() -> None:
    assert get_args(settings.Track) == tuple(TRACKS)
    assert get_args(settings.Split) == tuple(SPLITS)


def test_every_choice_stands_in_the_page() -> None:
    page = environment_page.page()
    for name, hint in hints(BudgetSettings).items():
        for choice in get_args(hint) if get_origin(hint) is Literal else ():
            assert f'`"{choice}"`' in page or f'{name}="{choice}"' in page, (name, choice)
    assert all(f'`"{kind}"`' in page for kind in get_args(FaultKind))
    assert all(f"`{field.name}`" in page for field in fields(Fault))
    assert all(f'`"{condition}"`' in page for condition in ("day", "night", "rain"))


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize(
    "options",
    [3, [("scene", "scene-2001")], {"scene": 3}, {"scene": [3]}, {"scene": b"scene-2001"}, {"scene": {}}],
    ids=str,
)
def test_bad_reset_options_are_one_line_and_change_nothing(env_id: str, options: Any) -> None:
    for env in (make(env_id), gym.make_vec(env_id, 1, recordings=RECORDINGS)):
        env.reset(seed=4)
        twin = pickle.loads(pickle.dumps(env))
        with pytest.raises(ConfigurationError) as caught:
            env.reset(seed=5, options=options)
        assert "\n" not in str(caught.value)
        action = env.action_space.sample()
        same(env.step(action), twin.step(action))
        same(env.reset(), twin.reset())


def test_a_scene_of_another_split_is_named_as_such(folder: Path) -> None:
    for recordings in (RECORDINGS, folder):
        with pytest.raises(ConfigurationError, match=r"'scene-2004' is in fold 3 and shows day: .*split='train'"):
            make(recordings=recordings).reset(options={"scene": "scene-2004"})
        with pytest.raises(ConfigurationError, match="unknown scene 'scene-2044': did you mean"):
            make(recordings=recordings).reset(options={"scene": "scene-2044"})


def test_a_folder_is_read_once_and_its_tables_are_shared(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads: list[Any] = []
    built: list[Any] = []
    load, build = opening.load_recordings, Replay.__init__

    def counting_load(source: Any) -> Any:
        reads.append(source)
        return load(source)

    def counting_build(self: Replay, *args: Any, **kwargs: Any) -> None:
        built.append(self)
        build(self, *args, **kwargs)

    monkeypatch.setattr(opening, "load_recordings", counting_load)
    monkeypatch.setattr(Replay, "__init__", counting_build)
    monkeypatch.chdir(folder.parent)
    first = make(recordings=folder)
    envs = [make(recordings=source) for source in (folder, folder, str(folder), "recordings", Path("recordings"))]
    evaluation = make(recordings=folder, split="test")
    assert len(reads) == 1
    assert len(built) <= 1 + 3 + 1  # the same folder, written in three ways; another split
    assert np.shares_memory(envs[0].session.replay.context, first.session.replay.context)
    assert envs[0].session.replay.state is not first.session.replay.state
    assert evaluation.session.replay.context.shape != first.session.replay.context.shape


def test_sixty_four_environments_take_hardly_more_memory_than_one(tmp_path: Path) -> None:
    save_recordings(synthetic_recordings(scenes=16, steps=200), tmp_path)  # tables of 1 MiB
    first = make(recordings=tmp_path, observation="rich")
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    envs = [make(recordings=tmp_path, observation="rich") for _ in range(63)]
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert len({id(env.session.replay.state) for env in (first, *envs)}) == 64
    assert grown < 4 * 2**20


def test_environments_that_share_tables_play_their_own_scenes(folder: Path) -> None:
    for env_id in IDS:
        one, other, alone = make(env_id, recordings=folder), make(env_id, recordings=folder), make(env_id)
        same(one.reset(seed=1), alone.reset(seed=1))
        other.reset(seed=2)
        for _ in range(20):
            action = one.action_space.sample()
            same(one.step(action), alone.step(action))
            other.step(-action)


def test_a_folder_that_changes_is_read_again(folder: Path) -> None:
    env = make(recordings=folder)
    before = env.session.recordings
    assert make(recordings=folder).session.recordings is before
    save_recordings(synthetic_recordings(1, scenes=6, steps=25), folder)
    after = make(recordings=folder).session.recordings
    assert (after["speed_mps"][:20] != before["speed_mps"][:20]).any()
    manifest = folder / "manifest.json"
    renamed = replace(decode_manifest(manifest.read_bytes()), data_version="synthetic-1")
    manifest.write_bytes(encode_manifest(renamed))
    os.utime(manifest, (1, 1))
    assert make(recordings=folder).session.recordings.manifest.data_version == "synthetic-1"


def test_what_is_shared_cannot_be_written(folder: Path) -> None:
    env = make(recordings=folder, reward="improvement")
    recordings = env.session.settings.all_recordings()
    for array in (*(recordings[name] for name in recordings.column_names), env.session.replay.table):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0
    mine = make()
    assert RECORDINGS["speed_mps"].flags.writeable, "recordings handed over in memory stay their owner's"
    assert mine.session.settings.key is None


def test_the_reward_writes_into_no_table() -> None:
    plain, improvement = make(), make(reward="improvement")
    table = improvement.session.replay.table.copy()
    assert (table != plain.session.replay.table).any()
    improvement.reset(seed=0)
    improvement.step(np.zeros(5, np.float32))
    np.testing.assert_array_equal(improvement.session.replay.table, table)


@pytest.mark.parametrize("env_id", IDS)
def test_a_refused_action_changes_nothing_that_is_drawn(env_id: str) -> None:
    env = make(env_id, render_mode="ansi")
    env.reset(seed=0)
    good = env.action_space.sample()
    env.step(good)
    drawn, weights = env.render(), env.session.weights.copy()
    with pytest.raises(ConfigurationError):
        env.step(np.full_like(good, 1.5))
    assert env.render() == drawn
    np.testing.assert_array_equal(env.session.weights, weights)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("wrong", [1.5, np.nan])
def test_a_refused_action_does_not_reset_the_scenes_that_have_ended(env_id: str, wrong: float) -> None:
    env = gym.make_vec(env_id, 2, recordings=RECORDINGS)
    env.reset(seed=0)
    good = env.action_space.sample()
    while not env.step(good)[3].any():
        pass
    twin = pickle.loads(pickle.dumps(env))
    for action in (np.full_like(good, wrong), good[:, :-1]):
        with pytest.raises(ConfigurationError, match="action"):
            env.step(action)
    same(env.step(good), twin.step(good))


@pytest.mark.parametrize("env_id", IDS)
def test_a_replay_reset_from_outside_leaves_no_stale_array(env_id: str) -> None:
    env = make(env_id, split="all")
    env.reset(seed=0)
    replay = env.session.replay
    with pytest.raises(ConfigurationError, match="expected 1 scenes, got 2"):
        replay.reset([0, 1])
    replay.reset([2])
    twin = make(env_id, split="all")
    twin.reset(options={"scene": RECORDINGS.scenes[2].name})
    action = env.action_space.sample()
    truncated = False
    while not truncated:
        ours, theirs = env.step(action), twin.step(action)
        same(ours, theirs)
        truncated = ours[3]
    assert ours[4]["scores"]["scene"] == RECORDINGS.scenes[2].name


@pytest.mark.parametrize("env_id", IDS)
def test_a_replay_reset_from_outside_leaves_no_weights_of_the_old_scene(env_id: str) -> None:
    env = make(env_id, split="all", render_mode="ansi")
    env.reset(seed=0)
    env.step(np.ones_like(env.action_space.sample()))
    assert env.session.weights.any()
    env.session.replay.reset([2])
    assert not env.session.weights.any()


@pytest.mark.parametrize("env_id", IDS)
def test_flat_scores_are_those_of_the_dictionary(env_id: str) -> None:
    env = make(env_id)
    env.reset(seed=0)
    truncated = False
    while not truncated:
        *_, truncated, info = env.step(env.action_space.sample())
        assert ("ate_m" in info) == truncated
    assert info["scores"] == {name: info[name] for name in ("ate_m", "ate_deg", "yaw_rmse_deg")} | {
        "scene": info["scores"]["scene"]
    }


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("limit", [7, 26, 1000])
def test_max_episode_steps_equals_gymnasiums_time_limit(env_id: str, mode: AutoresetMode, limit: int) -> None:
    options: dict[str, Any] = {"recordings": RECORDINGS.select(scenes=["scene-2001"]), "split": "all"}
    batched = gym.make_vec(env_id, 2, autoreset_mode=mode, max_episode_steps=limit, **options)
    peer = SyncVectorEnv([lambda: gym.make(env_id, max_episode_steps=limit, **options)] * 2, autoreset_mode=mode)
    assert any(isinstance(wrapper, TimeLimit) for wrapper in chain(peer.envs[0]))
    same(batched.reset(seed=0), peer.reset(seed=0))
    ended = 0
    for _ in range(70):
        actions = batched.action_space.sample()
        ours = batched.step(actions)
        same(ours, peer.step(actions))
        ended += ours[3].sum()
    assert ended >= 4


def chain(env: Any) -> list[Any]:
    return [env, *chain(env.env)] if isinstance(env, gym.Wrapper) else [env]


@pytest.mark.parametrize("limit", [0, -1, 2.5, "9", True])
def test_bad_limits_and_counts(limit: Any) -> None:
    with pytest.raises(ConfigurationError, match="max_episode_steps: expected a whole number >= 1"):
        gym.make_vec("MixoOdometry-v0", 2, recordings=RECORDINGS, max_episode_steps=limit)
    with pytest.raises(ConfigurationError, match="num_envs: expected a whole number >= 1"):
        gym.make_vec("MixoOdometry-v0", limit, recordings=RECORDINGS)
    with pytest.raises(ConfigurationError, match="autoreset_mode"):
        gym.make_vec("MixoOdometry-v0", 2, recordings=RECORDINGS, autoreset_mode=[limit])


@pytest.mark.parametrize("env_id", IDS)
def test_a_specification_with_paths_and_faults_survives_json(env_id: str, folder: Path) -> None:
    options: dict[str, Any] = {"recordings": folder, "faults": [Fault("CAM_FRONT", "stuck")], "experts": None}
    env = gym.make(env_id, **options)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    same(env.reset(seed=2), again.reset(seed=2))
    batched = gym.make_vec(env_id, 2, **options)
    assert json.loads(batched.spec.to_json())["kwargs"]["recordings"] == str(folder)
    assert options["recordings"] is folder
