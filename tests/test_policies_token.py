"""TOKEN: equivariant, a consensus before it has learned, and a gate that survives experts that come, go and break."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch

from mixo_env.envs.replay import Replay
from mixo_env.errors import PolicyError
from mixo_env.policies import deepset, registry
from mixo_env.policies.blocks import AT_ONCE, in_rows, shape_of
from mixo_env.policies.calibration import Calibration, Past
from mixo_env.policies.consensus import consensus_weights
from mixo_env.policies.deepset import folded, heading_errors, packed, weigh
from mixo_env.policies.fitting import check, prepare
from mixo_env.policies.lessons import FAILURE, broken, lessons, spoil, watch
from mixo_env.policies.playing import collect, play
from mixo_env.policies.robust import believable
from mixo_env.policies.token_gate import Token
from mixo_env.policies.tokens import FREEDOM, SIGNALS, UNIT_RAD, WHOLE, Tokens, blank_memory, read, tokenise
from mixo_env.recordings.collection import Recordings
from tests.batches import assert_same_alone_and_among_many
from tests.synthetic import synthetic_recordings

TRACK = "VISION"


@pytest.fixture(scope="module")
def drives() -> Recordings:
    return synthetic_recordings()


@pytest.fixture(scope="module")
def fitted(drives: Recordings) -> Token:
    policy = Token(epochs=6, hidden=8)
    prepare(policy, drives, TRACK)
    return policy


def knowing(drives: Recordings) -> Token:
    """A gate that has learned nothing but how large the experts' errors are."""
    policy = Token(epochs=0)
    prepare(policy, drives, TRACK)
    return policy


def seen_at(drives: Recordings, policy: Token, step: int = 5):
    replayed = collect(drives, TRACK, policy)
    return {name: values[step : step + 3] for name, values in replayed.items()}


def network(seed: int, width: int = SIGNALS + WHOLE, hidden: int = 8) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shapes = ((width, hidden), (hidden, hidden), (2 * hidden, hidden), (hidden, 1))
    draw = [(rng.normal(size=s).astype(np.float32), rng.normal(size=s[1:]).astype(np.float32)) for s in shapes]
    return packed(tuple(draw))


def in_blocks(rows: np.ndarray) -> np.ndarray:
    """``(batch, ..)`` -> ``(blocks, .., scenes)``, the last scene again and again at the end."""
    blocks, scenes = shape_of(len(rows))
    filled = rows[np.minimum(np.arange(blocks * scenes), len(rows) - 1)]
    return np.ascontiguousarray(np.moveaxis(filled.reshape(blocks, scenes, *rows.shape[1:]), 1, -1))


def weighed(numbers: np.ndarray, told: tuple[np.ndarray, np.ndarray, np.ndarray], voting: np.ndarray) -> np.ndarray:
    """Weights where signals ``(batch, experts, SIGNALS)``, whole and consensus come in rows."""
    signals, whole, consensus = told
    return weigh(numbers, Tokens(in_blocks(signals.swapaxes(1, 2)), in_blocks(whole), in_blocks(consensus)), voting)


def told(rng: np.random.Generator, batch: int, experts: int):
    signals = rng.normal(size=(batch, experts, SIGNALS)).astype(np.float32)
    whole = rng.normal(size=(batch, WHOLE)).astype(np.float32)
    voting = rng.random((batch, experts)) < 0.7
    voting[:, 0] = True
    return signals, whole, rng.dirichlet(np.ones(experts), batch), voting


def test_weights_do_not_depend_on_the_order_of_the_experts() -> None:
    signals, whole, consensus, voting = told(np.random.default_rng(1), 7, 5)
    order = np.array([3, 0, 4, 2, 1])
    weights = weighed(network(0), (signals, whole, consensus), voting)
    turned = np.ascontiguousarray(signals[:, order]), whole, np.ascontiguousarray(consensus[:, order])
    np.testing.assert_allclose(weighed(network(0), turned, voting[:, order].copy()), weights[:, order], atol=1e-6)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert (weights[~voting] == 0.0).all()


def test_who_does_not_vote_changes_nothing() -> None:
    signals, whole, consensus, _ = told(np.random.default_rng(2), 1, 4)
    voting = np.array([[True, True, False, True]])
    other = signals.copy()
    other[0, 2] = 100.0
    same = weighed(network(0), (other, whole, consensus), voting)
    np.testing.assert_array_equal(same, weighed(network(0), (signals, whole, consensus), voting))


@pytest.mark.parametrize("batch", [2, AT_ONCE - 1, AT_ONCE, 3 * AT_ONCE + 5])
def test_a_scene_is_weighed_as_if_it_were_alone(batch: int) -> None:
    signals, whole, consensus, voting = told(np.random.default_rng(3), batch, 5)
    together = weighed(network(1), (signals, whole, consensus), voting)
    for k in range(batch):
        one = slice(k, k + 1)
        alone = weighed(network(1), (signals[one], whole[one], consensus[one]), voting[one])
        np.testing.assert_array_equal(alone, together[one])


def test_no_network_makes_an_expert_that_the_consensus_dropped_count() -> None:
    signals, whole, _, _ = told(np.random.default_rng(4), 50, 3)
    signals[:, 2] = 1e4  # of an expert further off than any in training
    consensus = np.tile([0.5, 0.5 - 1e-6, 1e-6], (50, 1))
    everybody = np.ones((50, 3), bool)
    trust = [weighed(network(seed), (signals, whole, consensus), everybody)[:, 2].max() for seed in range(8)]
    assert max(trust) > 2e-6  # some of them would follow it
    assert max(trust) <= 1e-6 * np.exp(2 * deepset.MOST)


def test_the_compiled_network_is_that_of_torch_before_it_was_folded() -> None:
    torch.manual_seed(0)
    trainable = deepset._network(SIGNALS + WHOLE, 8)
    for layer in trainable:
        torch.nn.init.normal_(layer.weight, std=0.3)
    rng = np.random.default_rng(3)
    signals, whole, consensus, voting = told(rng, 6, 4)
    mean, std = rng.normal(size=SIGNALS + WHOLE), rng.uniform(0.5, 2.0, SIGNALS + WHOLE)
    x = np.concatenate([signals, np.broadcast_to(whole[:, None], (6, 4, WHOLE))], axis=-1)
    with torch.no_grad():
        added = deepset._forward(trainable, torch.tensor((x - mean) / std).float(), torch.tensor(voting)).numpy()
    expected = np.where(voting, consensus * np.exp(added), 0.0)
    trained = tuple((layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy()) for layer in trainable)
    weights = weighed(
        packed(folded(trained, mean.astype(np.float32), std.astype(np.float32))), (signals, whole, consensus), voting
    )
    np.testing.assert_allclose(weights, expected / expected.sum(axis=1, keepdims=True), atol=1e-5)


def test_an_untrained_gate_is_the_student_t_consensus(drives: Recordings) -> None:
    policy = Token(epochs=0)
    prepare(policy, drives, TRACK)
    policy.reset(3)
    look = seen_at(drives, policy)
    policy.reset(3)
    increment = look["yaw_rates"].astype(np.float64) * look["dt"]
    calibration = Calibration.fit(Past.read(drives, drives.voters(TRACK)))
    expected = consensus_weights(increment, calibration.std(look), believable(look), FREEDOM)
    np.testing.assert_allclose(policy.act(look), expected, atol=1e-6)


def test_tokens_by_hand() -> None:
    """Three experts of scale 1 at 0, 0 and 3 units: the consensus is near 0, and memory begins there."""
    look = {
        "yaw_rates": np.array([[0.0, 0.0, 3 * UNIT_RAD / 0.1]], np.float32),
        "available": np.ones((1, 3), np.float32),
        "dt": np.array([[0.1]], np.float32),
        "speed": np.array([[10.0]], np.float32),
        "yaw_rate_std": np.array([[0.0, 2 * UNIT_RAD / 0.1, 0.0]], np.float32),
        **{name: np.array([[100.0]], np.float32) for name in ("matches", "inliers", "residual_px", "flow_px")},
    }
    ones = np.full(3, UNIT_RAD)
    memory = blank_memory(1, 3)
    seen = read(look, Calibration(ones, np.array([np.inf, 0.5, np.inf])))
    np.testing.assert_allclose(seen.std, [[1.0, 1.0, 1.0]], rtol=1e-6)
    tokens = tokenise(seen, memory)
    signals, whole, consensus = (in_rows(part, 1)[0] for part in tokens)
    centre = float(consensus @ seen.increment[0])
    weight = 3.0 / (2.0 + (np.array([0.0, 0.0, 3.0]) - centre) ** 2)
    np.testing.assert_allclose(consensus, weight / weight.sum(), atol=1e-4)
    off = np.array([0.0, 0.0, 3.0]) - centre
    np.testing.assert_allclose(signals[0], np.arcsinh(off), atol=1e-5)
    np.testing.assert_allclose(signals[6:8].T, [[0, 0], [np.log(2.0), 1], [0, 0]], atol=1e-5)
    np.testing.assert_allclose(signals[12], [1.0, 0.0, 0.0])  # the first experts count matches
    np.testing.assert_allclose(whole[[0, 3, 4]], [1.0, 0.75, -0.5 * np.log(3.0)], atol=1e-6)
    last, size, lean = memory[0, :, :, 0]
    np.testing.assert_allclose(last, off, atol=1e-9)
    np.testing.assert_allclose(size, 1.0 + 0.02 * (np.abs(off) - 1.0))
    np.testing.assert_allclose(lean, 0.1 * off)


def test_the_loss_is_what_the_table_counts() -> None:
    """One scene, errors of 1 in the first two of four steps: heading errors 0 1 2 2 2."""
    error = torch.tensor([[1.0, 1.0, 0.0, 0.0]])
    pieces = [(torch.tensor([0, 1]), torch.tensor([2, 4]), torch.tensor([10.0, 20.0]))]
    relative, absolute = heading_errors(error, torch.ones(1, 4, dtype=torch.bool), pieces)
    assert float(relative) == pytest.approx(0.5 * (2 / 10 + 1 / 20))
    heading = np.array([1.0, 2.0, 2.0, 2.0])
    assert float(absolute) == pytest.approx(heading.std(), abs=1e-5)


def test_training_lowers_what_it_is_to_lower(drives: Recordings) -> None:
    """In left turns CAM_FRONT, the best expert, is off: that is in the tokens, and not in the consensus."""
    truth = drives["truth.yaw_increment_rad"]
    turned = drives["CAM_FRONT.yaw_increment_rad"] + np.float32(8 * UNIT_RAD) * (truth > 0.0)
    lying = drives.replace(columns={"CAM_FRONT.yaw_increment_rad": turned})
    drift = []
    for epochs in (0, 60):
        policy = Token(epochs=epochs, learning_rate=0.02, spoilt=0)
        prepare(policy, lying, TRACK)
        replay = Replay(lying, track=TRACK)
        list(play(policy, replay))
        steps = [truth[a + 1 : b] for a, b in pairwise(lying.offsets)]
        off = [np.cumsum(replay.history[: len(turns), i] - turns) for i, turns in enumerate(steps)]
        drift.append(np.mean([np.abs(error).mean() for error in off]))
    assert drift[1] < 0.8 * drift[0]


def test_spoilt_scenes_leave_a_vote_and_are_strangers_where_asked(drives: Recordings) -> None:
    seen, _, active = watch(drives, TRACK, knowing(drives))
    changed = spoil(seen, active, np.random.default_rng(0), strangers=True)
    assert changed.voting.any(axis=2).all()
    assert np.isinf(changed.std).all()
    assert np.isfinite(seen.std).all()  # the original is left alone
    differ = (changed.increment != seen.increment).any(axis=(0, 2))
    assert 0 < np.count_nonzero(differ) < len(differ) or FAILURE in (0, 1)
    assert (changed.voting <= seen.voting).all()


def test_every_kind_of_failure_happens() -> None:
    steady, rng = np.full(50, 2.0), np.random.default_rng(0)
    kinds = set()
    for _ in range(100):
        x = broken(steady, rng)
        kinds.add("still" if not x.any() else "same" if np.ptp(x) == 0.0 else "some" if (x == 2.0).any() else "all")
    assert kinds == {"still", "same", "some", "all"}


def test_lessons_are_whole(drives: Recordings) -> None:
    given = lessons(drives, TRACK, knowing(drives), 2, 0)
    scenes = 3 * len(drives)
    assert (
        len(given.signals) == len(given.voting) == len(given.truth) == len(given.active) == len(given.pieces) == scenes
    )
    for start, end, length in given.pieces:
        assert (start < end).all()
        assert (end <= given.truth.shape[1]).all()
        assert (length > 0.0).all()
    again = lessons(drives, TRACK, knowing(drives), 2, 0)
    np.testing.assert_array_equal(given.signals, again.signals)


def test_a_scene_in_opposite_order_has_the_same_steps_from_its_end(drives: Recordings) -> None:
    given = lessons(drives, TRACK, knowing(drives), 1, 0, backwards=True)
    n = len(drives)
    assert len(given.truth) == len(given.pieces) == 3 * n
    for scene in range(n):
        steps = np.count_nonzero(given.active[scene])
        for values in (given.truth, given.increment, given.voting, given.active):
            np.testing.assert_array_equal(values[n + scene, :steps], values[scene, :steps][::-1])
        there, back = (np.cumsum(np.concatenate([[0.0], given.truth[k, :steps]])) for k in (scene, n + scene))
        (start, end, length), (later, earlier, same) = given.pieces[scene], given.pieces[n + scene]
        np.testing.assert_allclose(there[end] - there[start], back[earlier] - back[later], atol=1e-4)
        np.testing.assert_array_equal(length, same)
    plain = lessons(drives, TRACK, knowing(drives), 1, 0)
    for name in ("signals", "truth", "increment", "voting"):
        kept = np.delete(getattr(given, name), np.s_[n : 2 * n], axis=0)
        np.testing.assert_array_equal(kept, getattr(plain, name))


def test_a_saved_gate_gives_the_same_weights(drives: Recordings, fitted: Token, tmp_path) -> None:
    fitted.save(tmp_path)
    loaded = registry.load(tmp_path)
    assert isinstance(loaded, Token)
    look = seen_at(drives, fitted)
    for policy in (fitted, loaded):
        policy.reset(3)
    np.testing.assert_array_equal(loaded.act(look), fitted.act(look))


def test_a_scene_has_the_same_bits_alone_and_among_many(drives: Recordings, fitted: Token) -> None:
    assert_same_alone_and_among_many(fitted, drives, TRACK)


def test_it_plays_with_strangers(drives: Recordings, fitted: Token, tmp_path) -> None:
    """Other names, another number: what it learned names nobody; where it was fitted it is still refused."""
    fitted.save(tmp_path)
    stranger = Token.load(tmp_path)
    stranger.start(("x", "y", "z"))
    stranger.reset(2)
    look = {name: values[:2] for name, values in seen_at(drives, fitted).items()}
    few = {
        name: v[:, :3] if name in ("yaw_rates", "available", "yaw_rate_std") else v[:, :0] for name, v in look.items()
    }
    few |= {name: look[name] for name in ("dt", "speed")}
    weights = stranger.act(few)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    with pytest.raises(PolicyError, match="was fitted on the drive"):
        check(fitted, drives, TRACK)


def test_a_stranger_is_known_by_what_it_does(fitted: Token, drives: Recordings) -> None:
    """One of three strangers errs by 100 units for a while: its weight is gone, and comes back."""
    policy = Token(epochs=0)
    prepare(policy, drives, TRACK)
    policy.start(("x", "y", "z"))
    policy.reset(1)
    rng = np.random.default_rng(0)
    weight = []
    for step in range(150):
        noise = rng.normal(0.0, 1.0, 3) + np.array([0.0, 0.0, 100.0 * (step >= 50)])
        look = {
            "yaw_rates": (noise * UNIT_RAD / 0.1)[None].astype(np.float32),
            "available": np.ones((1, 3), np.float32),
            "dt": np.array([[0.1]], np.float32),
            "speed": np.array([[10.0]], np.float32),
            "yaw_rate_std": np.zeros((1, 3), np.float32),
            **{name: np.zeros((1, 0), np.float32) for name in ("matches", "inliers", "residual_px", "flow_px")},
        }
        weight.append(policy.act(look)[0, 2])
    assert np.mean(weight[30:50]) > 0.2
    assert np.mean(weight[60:]) < 0.02
