"""What a gate over tokens learns from: training scenes as arrays, also with experts that drop out and break."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.replay import Replay
from mixo_env.metrics.pairs import find_pairs, path_length
from mixo_env.policies.blocks import in_rows
from mixo_env.policies.playing import play
from mixo_env.policies.policy import Observation
from mixo_env.policies.robust import Mean
from mixo_env.policies.tokens import UNIT_RAD, Seen, blank_memory, tokenise
from mixo_env.recordings.collection import Recordings

FloatArray = NDArray[np.float64]
Piece = tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]

DROPOUT, FAILURE = 0.5, 0.5
"""Share of the spoilt scenes in which experts are missing throughout, and in which one breaks for a while."""

SMALLEST, LARGEST = 2.0, 1000.0
"""[UNIT_RAD] Errors of a broken expert, evenly in their logarithm: from what hardly matters to 17 degrees a step."""


class Pupil(Protocol):
    """A gate over tokens: what it sees of an observation becomes them."""

    def reset(self, batch: int) -> None:
        """``batch`` scenes start."""

    def see(self, observation: Observation) -> Seen:
        """Of one step of all scenes, after those before it."""
        ...


@dataclass(frozen=True)
class Lessons:
    """Scenes; all arrays begin with ``(scenes, steps)``.

    Attributes:
        signals, whole, consensus, voting: of :class:`~mixo_env.policies.tokens.Tokens`, and who votes.
        increment: ``(.., experts)`` in UNIT_RAD.
        truth: in UNIT_RAD.
        active: the scene lasts.
        beside: in UNIT_RAD, what a companion fuses, whose mean with the gate is judged; NaN: the gate is alone.
        pieces: of every scene the first pose, last pose and length [m] of its pieces of path.
    """

    signals: NDArray[np.float32]
    whole: NDArray[np.float32]
    consensus: NDArray[np.float32]
    voting: NDArray[np.bool_]
    increment: NDArray[np.float32]
    truth: NDArray[np.float32]
    active: NDArray[np.bool_]
    beside: NDArray[np.float32]
    pieces: tuple[Piece, ...]


def lessons(
    training: Recordings, track: str, pupil: Pupil, spoilt: int, seed: int, *, backwards: bool = False
) -> Lessons:
    """Training scenes, and ``spoilt`` times the same with experts that drop out or break.

    In every other of those nothing is known of the experts beforehand: so a gate learns to judge strangers.

    Args:
        training: with true increments.
        track: whose experts vote.
        pupil: who is to learn.
        spoilt: spoilt versions of each scene.
        seed: of what befalls them.
        backwards: also every scene in the opposite order of its steps, with the same turns and errors: what lasts,
            lasts as long, and what led to it is new.
    """
    rng = np.random.default_rng(seed)
    seen, truth, active = watch(training, track, pupil)
    versions, truths, paths = [seen], [truth], [pieces(training)]
    if backwards:
        last_first, truth_back, _ = watch(in_opposite_order(training), track, pupil)
        versions, truths, paths = [seen, last_first], [truth, truth_back], [paths[0], mirrored(paths[0], active)]
    versions += [spoil(seen, active, rng, strangers=k % 2 == 0) for k in range(spoilt)]
    told = [told_in_tokens(one) for one in versions]
    return Lessons(
        *(np.concatenate([parts[j] for parts in told]) for j in range(3)),
        voting=_scenes_first([one.voting for one in versions]),
        increment=_scenes_first([one.increment for one in versions]).astype(np.float32),
        truth=_scenes_first([*truths, *[truth] * spoilt]).astype(np.float32),
        active=_scenes_first([active] * len(versions)),
        beside=np.full((active.shape[1] * len(versions), len(active)), np.nan, np.float32),
        pieces=tuple(itertools.chain(*paths, *[paths[0]] * spoilt)),
    )


def in_opposite_order(recordings: Recordings) -> Recordings:
    """Every scene from its last step to its first; poses, which no longer follow from the steps, mean nothing."""
    bounds = itertools.pairwise(recordings.offsets.tolist())
    rows = np.concatenate([[first, *range(stop - 1, first, -1)] for first, stop in bounds])
    return recordings.replace(columns={name: recordings[name][rows] for name in recordings.column_names})


def mirrored(paths: tuple[Piece, ...], active: NDArray[np.bool_]) -> tuple[Piece, ...]:
    """The same pieces of path where the steps are in opposite order; ``active`` is ``(steps, scenes)``."""
    steps = np.count_nonzero(active, axis=0)
    return tuple((n - end, n - start, length) for n, (start, end, length) in zip(steps, paths, strict=True))


def watch(training: Recordings, track: str, pupil: Pupil) -> tuple[Seen, FloatArray, NDArray[np.bool_]]:
    """All scenes side by side: what is seen, with ``(steps, scenes)`` in front, true increments, and who still drives.

    Counts keep their four kinds in front. What is seen does not depend on the weights, but for the previous yaw rate,
    which is no part of a token.
    """
    anybody = Mean()
    anybody.start(training.voters(track))
    pupil.reset(len(training))
    steps, truth, active = [], [], []
    for driving, look, _ in play(anybody, Replay(training, track=track, privileged=True, keep_trajectories=False)):
        active.append(driving)
        steps.append(pupil.see(look))
        truth.append((look["truth_yaw_rate"] * look["dt"])[:, 0].astype(np.float64) / UNIT_RAD)
    counts = np.stack([step.counts for step in steps], axis=1)
    stacked = {name: np.stack([getattr(one, name) for one in steps]) for name in Seen._fields if name != "counts"}
    return Seen(**stacked, counts=counts), np.stack(truth), np.stack(active)


def spoil(seen: Seen, active: NDArray[np.bool_], rng: np.random.Generator, *, strangers: bool) -> Seen:
    """The same scenes with experts missing throughout, and with one that breaks for a while.

    With ``strangers`` nothing is known of any expert beforehand.
    """
    increment, stated, std = (x.copy() for x in (seen.increment, seen.stated, seen.std))
    voting = seen.voting.copy()
    if strangers:
        std[:] = np.inf
    experts = increment.shape[2]
    for scene in range(increment.shape[1]):
        if experts > 2 and rng.random() < DROPOUT:
            gone = rng.permutation(experts)[: rng.integers(1, experts - 1)]
            rest = voting[:, scene].copy()
            rest[:, gone] = False
            voting[:, scene] = np.where(rest.any(axis=1, keepdims=True), rest, voting[:, scene])
        if rng.random() < FAILURE:
            first, stop = np.sort(rng.integers(0, np.count_nonzero(active[:, scene]) + 1, 2))
            expert = rng.integers(experts)
            increment[first:stop, scene, expert] = broken(increment[first:stop, scene, expert], rng)
            if rng.random() < 0.5:
                stated[first:stop, scene, expert] = 0.0
    return seen._replace(increment=increment, stated=stated, std=std, voting=voting)


def broken(increment: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Increments ``(n,)`` of an expert that errs at random, by a constant or now and then, stands still, or scales."""
    size = np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST)))
    noise = rng.normal(0.0, size, len(increment))
    return (
        increment + noise,
        increment + rng.choice([-1.0, 1.0]) * size,
        increment + np.where(rng.random(len(increment)) < 0.1, noise, 0.0),
        np.zeros_like(increment),
        increment * rng.uniform(0.5, 1.5),
    )[rng.integers(5)]


def told_in_tokens(seen: Seen) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Signals, whole and consensus of all steps, ``(scenes, steps, ...)``."""
    steps, scenes, experts = seen.increment.shape
    memory = blank_memory(scenes, experts)
    told = [tokenise(seen_at(seen, t), memory) for t in range(steps)]
    parts = ([in_rows(step[j], scenes) for step in told] for j in range(3))
    signals, whole, consensus = (np.stack(part, axis=1).astype(np.float32) for part in parts)
    return np.ascontiguousarray(signals.swapaxes(2, 3)), whole, consensus


def seen_at(seen: Seen, step: int) -> Seen:
    """One step of all scenes."""
    one = {name: getattr(seen, name)[step] for name in Seen._fields if name != "counts"}
    return Seen(**one, counts=seen.counts[:, step])


def pieces(training: Recordings) -> tuple[Piece, ...]:
    """Pieces of path of every scene, as the relative error has them; poses count from 0 in each scene."""
    offsets = training.offsets
    path = path_length(np.stack([training["truth.x_m"], training["truth.y_m"]], axis=1), offsets)
    found = find_pairs(path, None, offsets)
    bounds = np.searchsorted(found.scene, np.arange(len(offsets)))
    return tuple(
        (found.start[a:b] - first, found.end[a:b] - first, found.length_m[a:b])
        for a, b, first in zip(bounds[:-1], bounds[1:], offsets[:-1], strict=True)
    )


def _scenes_first(arrays: list[NDArray]) -> NDArray:
    """``(steps, scenes, ...)`` of several versions -> ``(scenes of all, steps, ...)``."""
    return np.concatenate([np.moveaxis(array, 0, 1) for array in arrays])
