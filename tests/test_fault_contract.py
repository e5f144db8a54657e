"""Every fault, of pictures and of what experts say: the observation changes, the truth does not, ``info`` tells."""

from dataclasses import replace
from typing import Any, get_args

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from mixo_env.envs.faults import FaultKind
from mixo_env.errors import RecordingError
from mixo_env.recordings.camera_faults import CAMERA_FAULTS
from mixo_env.recordings.collection import Recordings
from mixo_env.simulator.picture.faults import KINDS
from tests.synthetic import synthetic_recordings

RECORDINGS = synthetic_recordings(scenes=4, steps=30)
ENV = "mixo_env:MixoOdometry-v0"
START, ALL = 8, {"split": "all", "order": "fixed"}


def noted(kind: str, camera: str = "CAM_BACK") -> Recordings:
    """The recordings as of a folder whose second scene has a fault from 1 s to 2 s."""
    scene = RECORDINGS.scenes[1]
    begin_us = int(RECORDINGS.rows(scene.name)["timestamp_us"][0])
    note = {"kind": kind, "camera": camera, "begin_us": begin_us, "start_s": 1.0, "end_s": 2.0, "seed": 3}
    manifest = RECORDINGS.manifest
    return RECORDINGS.replace(replace(manifest, parameters={**manifest.parameters, CAMERA_FAULTS: {scene.name: note}}))


def played(scene: str, **options: Any) -> tuple[np.ndarray, np.ndarray, list[dict[str, Any]]]:
    """Observations, true increments and infos of one scene, each of the step to be decided."""
    env = gym.make(ENV, **{"recordings": RECORDINGS, **ALL, **options})
    observation, info = env.reset(options={"scene": scene})
    seen, infos, truth, ended = [observation], [info], [], False
    while not ended:
        observation, _, _, ended, info = env.step(np.zeros(5, np.float32))
        truth.append(info["yaw_increment_rad"] - info["yaw_error_rad"])
        seen.append(observation)
        infos.append(info)
    return np.stack(seen), np.array(truth), infos


@pytest.mark.parametrize("kind", get_args(FaultKind))
def test_a_fault_of_an_expert_changes_the_observation_not_the_truth_and_info_names_it(kind: str) -> None:
    scene = RECORDINGS.scenes[1].name
    fault = {"expert": "CAM_FRONT", "kind": kind, "start_step": START, "delay_steps": 2, "noise_radps": 0.5}
    sound, truth, quiet = played(scene, previous="inertial")
    seen, same, infos = played(scene, previous="inertial", faults=[fault])
    np.testing.assert_allclose(same, truth, atol=1e-15)
    assert (sound[: START - 1] == seen[: START - 1]).all()
    assert (sound[START - 1 :] != seen[START - 1 :]).any()
    # The n-th decision is about the step that ends in row n + 1.
    assert [info["faults"] for info in infos[: START - 1]] == [{"CAM_FRONT": ""}] * (START - 1)
    assert all(info["faults"] == {"CAM_FRONT": kind} for info in infos[START - 1 :])
    assert not any("faults" in info for info in quiet)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_of_pictures_is_named_while_it_lasts_in_its_scene_alone(kind: str) -> None:
    recordings, scene = noted(kind), RECORDINGS.scenes[1].name
    rows = RECORDINGS.rows(scene)
    since_s = (rows["timestamp_us"] - rows["timestamp_us"][0])[1:] / 1e6
    lasting = (since_s >= 1.0) & (since_s < 2.0)
    assert 5 < lasting.sum() < len(lasting) - 5
    infos = played(scene, recordings=recordings)[2]
    told = [info["faults"]["CAM_BACK"] for info in infos[:-1]]
    assert told == [kind if active else "" for active in lasting]
    assert {info["faults"]["CAM_BACK"] for info in played(RECORDINGS.scenes[0].name, recordings=recordings)[2]} == {""}


def test_two_faults_of_one_expert_are_both_named() -> None:
    faults = [{"expert": "CAM_BACK", "kind": "flipped", "start_step": 1}, {"expert": "CAM_FRONT", "kind": "noisy"}]
    infos = played(RECORDINGS.scenes[1].name, recordings=noted("dirty"), faults=faults)[2]
    assert {info["faults"]["CAM_BACK"] for info in infos} == {"flipped", "dirty, flipped"}
    assert {info["faults"]["CAM_FRONT"] for info in infos} == {"noisy"}


def test_experts_that_see_the_same_pictures_are_named_and_those_that_do_not_vote_are_not() -> None:
    infos = played(RECORDINGS.scenes[1].name, recordings=noted("black", "CAM_SIDE"))[2]
    assert not any("faults" in info for info in infos)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_batches_tell_faults_as_gymnasiums_own_batches_do(mode: AutoresetMode) -> None:
    faults = [{"expert": "CAM_FRONT", "kind": "stuck", "start_step": START}]
    recordings = noted("glare").select(scenes=[RECORDINGS.scenes[1].name])  # all play the same scene
    options = {"recordings": recordings, "faults": faults, **ALL}
    batched = gym.make_vec(ENV, 2, autoreset_mode=mode, **options)
    peer = SyncVectorEnv([lambda: gym.make(ENV, **options)] * 2, autoreset_mode=mode)
    np.testing.assert_equal(batched.reset(seed=0)[1], peer.reset(seed=0)[1])
    for _ in range(35):
        actions = batched.action_space.sample()
        ours, theirs = batched.step(actions)[4], peer.step(actions)[4]
        assert ours["faults"]["_CAM_BACK"].all()
        for name in ("faults", "_faults"):
            np.testing.assert_equal(ours[name], theirs[name])


def test_a_damaged_note_in_a_manifest_is_one_line() -> None:
    manifest = RECORDINGS.manifest
    for damaged in ({"scene-2002": {"kind": "black"}}, [1], {"scene-2002": 3}):
        recordings = RECORDINGS.replace(replace(manifest, parameters={**manifest.parameters, CAMERA_FAULTS: damaged}))
        with pytest.raises(RecordingError, match="camera_faults") as caught:
            gym.make(ENV, recordings=recordings)
        assert "\n" not in str(caught.value)
