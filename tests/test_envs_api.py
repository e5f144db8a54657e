"""Every registered environment under every combination of options, seen as Gymnasium and Stable-Baselines3 see it."""

from __future__ import annotations

import itertools
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import mixo_env
from mixo_env.errors import ConfigurationError
from tests.synthetic import synthetic_recordings

RECORDINGS = synthetic_recordings(scenes=6, steps=25)
NAMES = [scene.name for scene in RECORDINGS.select(split="train").scenes]
IDS = list(mixo_env.ENVIRONMENTS)

CHOICES: dict[str, list[Any]] = {
    "observation": ["paper", "rich", "dict"],
    "weights": ["softmax", "simplex", "raw", "select"],
    "previous": ["fused", "inertial", "truth"],
    "lost": ["inertial", "mask"],
    "reward": ["squared", "abs", "improvement", "pose"],
}

ONE_BY_ONE: list[dict[str, Any]] = [{name: value} for name, values in CHOICES.items() for value in values[1:]] + [
    {},
    {"privileged": True, "observation": "dict"},
    {"privileged": True},
    {"track": "VISION"},
    {"track": "PAPER", "split": "all", "order": "fixed"},
    {"fold": 1, "conditions": ["day"]},
    {"experts": ["CAM_BACK", "CAM_FRONT"]},
    {"experts": ["INERTIAL_CONSUMER", "CAM_FRONT_LEFT"], "lost": "mask"},
    {"faults": [{"expert": "CAM_FRONT", "kind": "noisy"}, {"expert": "CAM_BACK", "kind": "dropped", "start_step": 9}]},
]


def make(env_id: str, **options: Any) -> gym.Env[Any, Any]:
    return gym.make(env_id, recordings=RECORDINGS, **options)


def make_vec(env_id: str, num_envs: int, **options: Any) -> VectorEnv[Any, Any, Any]:
    return gym.make_vec(env_id, num_envs, recordings=RECORDINGS, **options)


def allowed(env_id: str, weights: str | None) -> bool:
    return not ("Budget" in env_id and weights == "select")


def same(a: Any, b: Any) -> None:
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            same(a[key], b[key])
    elif isinstance(a, tuple) or (isinstance(a, np.ndarray) and a.dtype == object):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            same(x, y)
    else:
        np.testing.assert_array_equal(a, b)


WEIGHTED = [(env_id, weights) for env_id in IDS for weights in CHOICES["weights"] if allowed(env_id, weights)]
ALLOWED = [(env_id, options) for env_id in IDS for options in ONE_BY_ONE if allowed(env_id, options.get("weights"))]


@pytest.mark.parametrize("observation", CHOICES["observation"])
@pytest.mark.parametrize(("env_id", "weights"), WEIGHTED)
def test_both_checkers_pass_for_every_combination(env_id: str, observation: str, weights: str) -> None:
    others = [name for name in CHOICES if name not in ("observation", "weights")]
    for values in itertools.product(*(CHOICES[name] for name in others)):
        options = {"observation": observation, "weights": weights, **dict(zip(others, values, strict=True))}
        env = make(env_id, **options)
        check_env(env.unwrapped, skip_render_check=True)
        check_env_sb3(env, skip_render_check=True)


@pytest.mark.parametrize(("env_id", "options"), ALLOWED, ids=str)
def test_both_checkers_pass_for_the_other_options(env_id: str, options: dict[str, Any]) -> None:
    env = make(env_id, **options)
    check_env(env.unwrapped, skip_render_check=True)
    check_env_sb3(env, skip_render_check=True)


@pytest.mark.parametrize("observation", CHOICES["observation"])
@pytest.mark.parametrize("vector", [False, True])
def test_a_budget_leaves_no_room_to_select(observation: str, vector: bool) -> None:
    options = {"weights": "select", "observation": observation}
    with pytest.raises(ConfigurationError, match="weights='select' leaves no room for switches: use softmax, simplex"):
        make_vec("MixoOdometryBudget-v0", 2, **options) if vector else make("MixoOdometryBudget-v0", **options)


@pytest.mark.parametrize(("env_id", "options"), ALLOWED, ids=str)
def test_batched_equals_single_step_for_step(env_id: str, options: dict[str, Any]) -> None:
    names = [s.name for s in RECORDINGS.select(split=options.get("split", "train")).scenes][
        : 3 if "fold" not in options else 1
    ]
    batched = make_vec(env_id, len(names), autoreset_mode="DISABLED", **options)
    singles = [make(env_id, **options) for _ in names]
    observation, _ = batched.reset(seed=0, options={"scene": names})
    for i, (env, name) in enumerate(zip(singles, names, strict=True)):
        same(env.reset(options={"scene": name})[0], row(observation, i))
    batched.action_space.seed(1)
    running = np.ones(len(names), bool)
    while running.any():
        actions = batched.action_space.sample()
        observation, reward, terminated, truncated, info = batched.step(actions)
        assert not terminated.any()
        for i in np.flatnonzero(running):
            one, r, _, end, facts = singles[i].step(actions[i])
            same(one, row(observation, i))
            assert r == reward[i]
            assert end == truncated[i]
            same(facts, row_of_info(info, i))
        if truncated.any():  # the others go on; the finished ones restart, unobserved
            running &= ~truncated
            batched.reset(options={"reset_mask": truncated, "scene": [names[i] for i in np.flatnonzero(truncated)]})


def row(observation: Any, i: int) -> Any:
    return {k: v[i] for k, v in observation.items()} if isinstance(observation, dict) else observation[i]


def row_of_info(info: dict[str, Any], i: int) -> dict[str, Any]:
    facts = {}
    for key, value in info.items():
        if not key.startswith("_") and info[f"_{key}"][i]:
            facts[key] = row_of_info(value, i) if isinstance(value, dict) else value[i]
    return facts


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("observation", ["paper", "dict"])
def test_autoreset_equals_gymnasiums_own(env_id: str, mode: AutoresetMode, observation: str) -> None:
    options = {"recordings": RECORDINGS.select(scenes=NAMES[:1]), "split": "all", "observation": observation}
    batched = gym.make_vec(env_id, 3, autoreset_mode=mode, **options)
    peer = SyncVectorEnv([lambda: gym.make(env_id, **options)] * 3, autoreset_mode=mode)
    batched.action_space.seed(3)
    same(batched.reset(seed=0), peer.reset(seed=0))
    for _ in range(100):
        actions = batched.action_space.sample()
        same(batched.step(actions), peer.step(actions))


@pytest.mark.parametrize("env_id", IDS)
def test_one_environment_draws_the_same_scenes_in_both_versions(env_id: str) -> None:
    single, batched = make(env_id), make_vec(env_id, 1)
    _, one = single.reset(seed=11)
    _, many = batched.reset(seed=11)
    action = single.action_space.sample()
    for _ in range(5):
        assert one["scene"] == many["scene"][0]
        end = False
        while not end:
            end = single.step(action)[3]
            batched.step(action[None])
        _, one = single.reset()
        many = batched.step(action[None])[4]


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_seeding_is_reproducible_across_autoreset(env_id: str, mode: str) -> None:
    runs = []
    for _ in range(2):
        env = make_vec(env_id, 3, autoreset_mode=mode)
        env.action_space.seed(5)
        runs.append([env.reset(seed=7), *(env.step(env.action_space.sample()) for _ in range(150))])
    for a, b in zip(*runs, strict=True):
        for x, y in zip(a, b, strict=True):
            same(x, y)


@pytest.mark.parametrize("env_id", IDS)
def test_fixed_order_plays_every_scene_once_before_any_twice(env_id: str) -> None:
    env = make_vec(env_id, 2, order="fixed", split="all")
    _, info = env.reset(seed=0)
    begun = [name for name in info["scene"] if name]
    while len(begun) < 2 * len(RECORDINGS):
        info = env.step(env.action_space.sample())[4]
        begun += [name for name in info.get("scene", []) if name]
    names = [scene.name for scene in RECORDINGS.scenes]
    assert begun[: 2 * len(names)] == names * 2
    single = make(env_id, order="fixed", split="all")
    assert [single.reset(seed=None if i else 3)[1]["scene"] for i in range(8)] == (names * 2)[:8]
    assert single.reset(seed=3)[1]["scene"] == names[0]


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("observation", ["paper", "dict"])
def test_every_call_returns_fresh_arrays(env_id: str, observation: str) -> None:
    env = make_vec(env_id, 2, observation=observation, autoreset_mode="SAME_STEP")
    first, _ = env.reset(seed=0)
    kept = [first]
    for _ in range(60):
        kept.append(env.step(env.action_space.sample())[0])
    for a, b in itertools.pairwise(kept):
        for x, y in zip(arrays(a), arrays(b), strict=True):
            assert not np.shares_memory(x, y)


def arrays(observation: Any) -> list[np.ndarray]:
    return list(observation.values()) if isinstance(observation, dict) else [observation]


@pytest.mark.parametrize("env_id", IDS)
def test_pickling_in_the_middle_of_a_scene(env_id: str) -> None:
    for env in (make(env_id).unwrapped, make_vec(env_id, 3)):
        env.reset(seed=1)
        action = env.action_space.sample()
        for _ in range(10):
            env.step(action)
        twin = pickle.loads(pickle.dumps(env))
        for _ in range(60):
            ours, theirs = env.step(action), twin.step(action)
            for x, y in zip(ours, theirs, strict=True):
                same(x, y)
            if isinstance(env, gym.Env) and ours[3]:
                same(env.reset(), twin.reset())


@pytest.mark.parametrize("env_id", IDS)
def test_spec_survives_json(env_id: str, tmp_path: Any) -> None:
    from mixo_env.recordings.store import save_recordings

    save_recordings(RECORDINGS, tmp_path)
    fault = {"expert": "CAM_FRONT", "kind": "stuck"}
    env = gym.make(env_id, recordings=str(tmp_path), experts=["CAM_FRONT", "CAM_BACK"], faults=[fault])
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    same(env.reset(seed=2)[0], again.reset(seed=2)[0])


@pytest.mark.parametrize("env_id", IDS)
def test_importing_the_package_by_id_is_enough(env_id: str) -> None:
    assert gym.make(f"mixo_env:{env_id}", recordings=RECORDINGS).spec.id == env_id


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("observation", ["paper", "rich", "dict"])
def test_ground_truth_reaches_no_observation(env_id: str, observation: str) -> None:
    columns = {name: RECORDINGS[name].copy() for name in RECORDINGS.column_names}
    rng = np.random.default_rng(0)
    for name, values in columns.items():
        if name.startswith(("truth.", "exact.")) or "_truth_" in name:
            values[:] = rng.normal(size=len(values))
    lies = type(RECORDINGS)(RECORDINGS.manifest, columns)
    for options in ({"previous": "fused"}, {"previous": "inertial", "lost": "mask"}):
        envs = [
            gym.make_vec(env_id, 4, recordings=recordings, observation=observation, order="fixed", **options)
            for recordings in (RECORDINGS, lies)
        ]
        outcomes = [env.reset(seed=0)[0] for env in envs]
        rewards = []
        for _ in range(80):
            same(*outcomes)
            action = envs[0].action_space.sample()
            steps = [env.step(action) for env in envs]
            outcomes, rewards = [step[0] for step in steps], [step[1] for step in steps]
        assert (rewards[0] != rewards[1]).any(), "the lie must at least change the reward"


@pytest.mark.parametrize("env_id", IDS)
def test_privileged_information_only_by_name(env_id: str) -> None:
    assert "truth_yaw_rate" not in make(env_id, observation="dict").observation_space.spaces
    assert "truth_yaw_rate" in make(env_id, observation="dict", privileged=True).observation_space.spaces


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize(
    ("options", "near"),
    [
        ({"observatoin": "paper"}, "observation"),
        ({"observation": "papre"}, "paper"),
        ({"weights": "softmaxx"}, "softmax"),
        ({"split": "tset"}, "test"),
        ({"track": "CONSUMMER"}, "CONSUMER"),
        ({"previous": "fusd"}, "fused"),
        ({"lost": "inertail"}, "inertial"),
        ({"reward": "sqared"}, "squared"),
        ({"order": "fxed"}, "fixed"),
        ({"experts": ["CAM_FRONT", "CAM_BCK"]}, "CAM_BACK"),
        ({"faults": [{"expert": "CAM_FRONT", "kind": "stuk"}]}, "stuck"),
        ({"faults": [{"expert": "CAM_FRUNT", "kind": "stuck"}]}, "CAM_FRONT"),
        ({"faults": [{"expert": "CAM_FRONT", "kindd": "stuck"}]}, "kind"),
        ({"render_mode": "rgb_aray"}, "rgb_array"),
    ],
    ids=str,
)
def test_unknown_options_name_the_nearest(env_id: str, options: dict[str, Any], near: str) -> None:
    entry_points = [gym.spec(env_id).entry_point, gym.spec(env_id).vector_entry_point]
    for entry_point in entry_points:
        env_class = gym.envs.registration.load_env_creator(entry_point)
        with pytest.raises(ConfigurationError, match=f"did you mean '{near}'") as caught:
            env_class(recordings=RECORDINGS, **options)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize(
    "options",
    [
        {"fold": 7},
        {"experts": ["CAM_FRONT"]},
        {"experts": "CAM_FRONT"},
        {"experts": ["CAM_FRONT", "CAM_FRONT"]},
        {"experts": ["CAM_FRONT", "INERTIAL"]},
        {"conditions": ["snow"]},
        {"raw_scale": -1.0},
        {"weights": "raw", "raw_scale": float("nan")},
        {"observation": "pixels"},
        {"split": "ood"},
        {"faults": [{"kind": "stuck"}]},
    ],
    ids=str,
)
def test_contradictions_are_one_line(env_id: str, options: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError) as caught:
        make(env_id, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("env_id", IDS)
@pytest.mark.parametrize("vector", [False, True])
def test_bad_actions_are_one_line_and_change_nothing(env_id: str, vector: bool) -> None:
    env = make_vec(env_id, 2) if vector else make(env_id)
    env.reset(seed=0)
    good = env.action_space.sample()
    bad: list[Any] = [good[..., :-1], good.astype(complex), good.astype(int), good.astype(bool), "left", None, {}]
    for number in (np.nan, np.inf, -np.inf, 1.5, -1.01):
        bad.append(good.copy())
        bad[-1].flat[-1] = number
    twin = pickle.loads(pickle.dumps(env.unwrapped))
    for action in bad:
        with pytest.raises(ConfigurationError, match=r"action: expected .*, got ") as caught:
            env.step(action)
        assert "\n" not in str(caught.value)
    for x, y in zip(env.step(good), twin.step(good), strict=True):
        same(x, y)


@pytest.mark.parametrize("action", [5, -1, 1.0, True, [1], np.array([0, 1])], ids=str)
def test_bad_choices(action: Any) -> None:
    env = make("MixoOdometry-v0", weights="select")
    env.reset(seed=0)
    with pytest.raises(ConfigurationError, match="action: expected"):
        env.step(action)


@pytest.mark.parametrize("env_id", IDS)
def test_bad_reset_options(env_id: str) -> None:
    env, batched = make(env_id), make_vec(env_id, 3)
    for options in ({"scene": "scene-0001"}, {"scen": NAMES[0]}, {"scene": [NAMES[0]] * 2}):
        with pytest.raises(ConfigurationError):
            env.reset(options=options)
        with pytest.raises(ConfigurationError):
            batched.reset(options=options)
    for mask in ([True] * 3, np.ones(2, bool), np.ones(3), np.zeros(3, bool)):
        with pytest.raises(ConfigurationError, match="reset_mask"):
            batched.reset(options={"reset_mask": mask})


@pytest.mark.parametrize("env_id", IDS)
def test_no_step_after_the_end_without_a_reset(env_id: str) -> None:
    env, batched = make(env_id).unwrapped, make_vec(env_id, 2, autoreset_mode="DISABLED")
    for one in (env, batched):
        with pytest.raises(ConfigurationError, match="reset"):
            one.step(one.action_space.sample())
        one.reset(seed=0)
        while not np.any(one.step(one.action_space.sample())[3]):
            pass
        with pytest.raises(ConfigurationError, match="reset"):
            one.step(one.action_space.sample())


@pytest.mark.parametrize("mode", [mode.name for mode in AutoresetMode])
def test_no_step_before_the_first_reset(mode: str) -> None:
    env = make_vec("MixoOdometry-v0", 2, autoreset_mode=mode)
    with pytest.raises(ConfigurationError, match="reset"):
        env.step(env.action_space.sample())


@pytest.mark.parametrize("num_envs", [0, -1, 1.5, "many"])
def test_bad_number_of_environments(num_envs: Any) -> None:
    with pytest.raises(ConfigurationError, match="num_envs"):
        make_vec("MixoOdometry-v0", num_envs)
