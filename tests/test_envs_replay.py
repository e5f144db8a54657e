from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from mixo_env.envs.replay import Replay
from mixo_env.errors import ConfigurationError
from mixo_env.fusion import dead_reckon
from mixo_env.metrics.absolute import absolute_errors_se2, scene_absolute
from mixo_env.recordings.schema import HEADLINE_TRACKS, TRACKS
from mixo_env.trajectory.planar import PlanarPoses
from tests.synthetic import synthetic_recordings

RECORDINGS = synthetic_recordings(scenes=4, steps=40)


def play(replay: Replay, weights: np.ndarray, scenes: list[int]) -> None:
    replay.reset(scenes)
    while not replay.done.all():
        replay.step(np.broadcast_to(weights, (len(scenes), len(replay.experts))).copy())


@pytest.mark.parametrize("track", HEADLINE_TRACKS)
def test_one_expert_alone_is_reproduced_bit_for_bit(track: str) -> None:
    replay = Replay(RECORDINGS, track=track)
    for j, expert in enumerate(replay.experts):
        play(replay, np.eye(len(replay.experts))[j], [0, 1, 2, 3])
        for scene in range(4):
            rows = RECORDINGS.rows(scene)
            own = rows[f"{expert}.yaw_increment_rad"][1:].astype(float)
            substitute = rows[f"{TRACKS[track] or 'INERTIAL'}.yaw_increment_rad"][1:].astype(float)
            increments = np.where(np.isfinite(own), own, substitute)
            np.testing.assert_array_equal(replay.history[: len(own), scene], increments)


def test_poses_equal_dead_reckoning() -> None:
    replay = Replay(RECORDINGS, track="CONSUMER")
    play(replay, np.full(5, 0.2), [2, 0])
    for entry, scene in enumerate((2, 0)):
        rows = RECORDINGS.rows(scene)
        start = tuple(float(rows[f"truth.{c}"][0]) for c in ("x_m", "y_m", "yaw_rad"))
        increments = replay.history[: len(rows["step"]) - 1, entry]
        x, y, yaw = dead_reckon(increments, rows["distance_m"][1:], start=start)
        for ours, expected in zip(replay.trajectory(entry), (x, y, yaw), strict=True):
            np.testing.assert_array_equal(ours, expected)
        state = replay.state[entry]
        assert state["yaw_rad"] == np.cumsum(increments)[-1]
        np.testing.assert_allclose([state["x_m"], state["y_m"]], [x[-1] - x[0], y[-1] - y[0]], atol=1e-9)
        truth = [rows[f"truth.{c}"] for c in ("x_m", "y_m", "yaw_rad")]
        ate = scene_absolute(absolute_errors_se2(PlanarPoses(*truth), PlanarPoses(x, y, yaw)))
        scores = {name: values[entry] for name, values in replay.scores().items()}
        np.testing.assert_allclose([scores["ate_m"], scores["ate_deg"]], [ate.translation_m[0], ate.rotation_deg[0]])
        rmse = np.sqrt(np.mean((increments - rows["truth.yaw_increment_rad"][1:]) ** 2))
        np.testing.assert_allclose(scores["yaw_rmse_deg"], np.rad2deg(rmse))


def test_a_scene_does_not_depend_on_its_neighbours_in_the_batch() -> None:
    rng = np.random.default_rng(0)
    weights = rng.random((80, 5))
    alone, together = Replay(RECORDINGS, track="PAPER"), Replay(RECORDINGS, track="PAPER")
    alone.reset([3])
    together.reset([1, 3, 0])
    while not alone.done.all():
        for name, value in alone.observe().items():
            np.testing.assert_array_equal(together.observe()[name][1], value[0], err_msg=name)
        w = weights[alone.state[0]["step"]]
        alone.step(w[None])
        together.step(np.stack([w * 0.5, w, -w]))
    assert together.state[1]["yaw_rad"] == alone.state[0]["yaw_rad"]


def test_no_missing_number_reaches_an_observation() -> None:
    replay = Replay(RECORDINGS, track="VISION", privileged=True)
    replay.reset([0, 1])
    seen_missing = False
    while not replay.done.all():
        observation = replay.observe()
        flat = replay.observe_flat()
        assert np.isfinite(flat).all()
        assert (flat >= replay.layout.low).all()
        assert (flat <= replay.layout.high).all()
        seen_missing |= bool((observation["available"] == 0).any())
        assert (observation["matches"][observation["state"] != 1] == 0).all()
        replay.step(np.full((2, 4), 0.25))
    assert seen_missing


def test_masked_experts_do_not_vote() -> None:
    replay = Replay(RECORDINGS, track="CONSUMER", lost="mask")
    replay.reset([0])
    while not replay.done.all():
        row = int(replay.state[0]["row"])
        votes = replay.votes.available[row]
        expected = replay.votes.increments_rad[row][votes].mean()
        replay.step(np.ones((1, 5)), shares=True)
        np.testing.assert_allclose(replay.state[0]["increment_rad"], expected, atol=1e-15)


def test_without_any_vote_the_inertial_increment_bridges() -> None:
    cameras = ("CAM_FRONT", "CAM_BACK")
    replay = Replay(RECORDINGS, track="VISION", experts=cameras, lost="mask")
    replay.reset([0])  # all cameras initialise in the first rows
    replay.step(np.ones((1, 2)))
    assert replay.state[0]["increment_rad"] == RECORDINGS.rows(0)["INERTIAL.yaw_increment_rad"][1]


@pytest.mark.parametrize("option", [{"previous": "fuzed"}, {"lost": "masked"}, {"experts": ["CAM_FRUNT"]}])
def test_unknown_options_name_the_nearest(option: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError, match="did you mean"):
        Replay(RECORDINGS, track="PAPER", **option)  # type: ignore[arg-type]


def test_trajectories_that_were_not_kept_are_refused_in_words() -> None:
    env = gym.make("MixoOdometry-v0", recordings=synthetic_recordings(scenes=2))
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(env.action_space.shape or (), np.float32))
    with pytest.raises(ConfigurationError, match="render_mode='rgb_array'"):
        env.unwrapped.session.replay.trajectory(0)  # type: ignore[attr-defined]
