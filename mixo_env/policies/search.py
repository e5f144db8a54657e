"""The paper's grid search for the gate (section IV-B), by successive halving, and what its winner is worth.

Every setting is judged by cross-validation over the folds. With halving, all settings go through the first tenth of
their schedule, a fifth of them through three tenths, a fifth of these to its end; a setting that goes on starts again
from the same first weights, so nothing but errors has to be kept. The best of one run are much alike: the finalists are
trained again with other seeds, and those that cannot be told from the best are a set, whose smallest network is named.
What choosing costs is told by nesting: for every fold the choice is made again on pairs of the other folds.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.policies.gate import gate_input
from mixo_env.policies.gates import FloatArray, Lesson, Setting
from mixo_env.policies.linear import Linear
from mixo_env.policies.playing import collect
from mixo_env.policies.policy import Observation
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import for_learning

PAPER = Setting(16, 16, 0.1, 0.1, 0.02, 0.05)
"""The optimum that the paper prints."""

HALVING = ((0.1, 1.0), (0.3, 0.2), (1.0, 0.04))
"""Share of the schedule, and share of the settings that goes through it."""

EXHAUSTIVE = ((1.0, 1.0),)

BATCH = 1024
"""Samples of an update, as in the gate's own training."""

TOGETHER = 100
"""Settings of one piece of work: what is lost when a run is killed."""


@dataclass(frozen=True)
class Grid:
    """The values that are combined; the paper's by default: 10,000 settings."""

    n1: tuple[int, ...] = (8, 16, 32, 64, 128)
    """Units of the first hidden layer."""
    n2: tuple[int, ...] = (8, 16, 32, 64, 128)
    """Units of the second."""
    d1: tuple[float, ...] = (0.0, 0.1, 0.2, 0.4)
    """Dropout after the first."""
    d2: tuple[float, ...] = (0.0, 0.1, 0.2, 0.4)
    """Dropout after the second."""
    eta0: tuple[float, ...] = (0.001, 0.005, 0.01, 0.02, 0.05)
    """Learning rate at the start."""
    alpha: tuple[float, ...] = (0.001, 0.01, 0.05, 0.1, 0.5)
    """What it has fallen to at the end, as a share."""

    def __post_init__(self) -> None:
        for name, low, high in (("n1", 1, 1024), ("n2", 1, 1024), ("d1", 0, 0.9), ("d2", 0, 0.9)):
            if not all(low <= value <= high for value in getattr(self, name)):
                raise ConfigurationError(f"{name} must lie between {low} and {high}: change {getattr(self, name)}")
        for name in ("eta0", "alpha"):
            if not all(0.0 < value <= 1.0 for value in getattr(self, name)):
                raise ConfigurationError(f"{name} must be above 0 and at most 1: change {getattr(self, name)}")
        if not self.settings():
            raise ConfigurationError("a grid needs at least one value of everything: n1, n2, d1, d2, eta0, alpha")

    def settings(self) -> tuple[Setting, ...]:
        """All combinations, in the order of the fields."""
        values = (self.n1, self.n2, self.d1, self.d2, self.eta0, self.alpha)
        return tuple(Setting(*point) for point in itertools.product(*values))


@dataclass(frozen=True)
class Piece:
    """Some gates trained on some folds and judged on others: one call of :func:`~.gates.errors_after`.

    Attributes:
        settings: of equal layer sizes.
        held_out: folds that judge; all others teach.
        updates: of the schedule.
        seed: of everything random.
    """

    settings: tuple[Setting, ...]
    held_out: tuple[int, ...]
    updates: int
    seed: int


Compute = Callable[[Sequence[Piece]], list[FloatArray]]
"""Errors ``(held-out folds, settings)`` of every piece [deg/s]."""


@dataclass(frozen=True)
class Judged:
    """What a search knows of its settings.

    Attributes:
        settings: all of the grid.
        stages: ``(stages, settings)`` mean error over the folds [deg/s] after each stage; NaN: did not get there.
        cost: updates spent, as a share of those of the exhaustive grid.
    """

    settings: tuple[Setting, ...]
    stages: FloatArray
    cost: float

    @property
    def order(self) -> NDArray[np.int64]:
        """The settings that were trained to the end, best first."""
        last = self.stages[-1]
        return np.argsort(np.where(np.isnan(last), np.inf, last), kind="stable")[: int(np.isfinite(last).sum())]


@dataclass(frozen=True)
class Final:
    """The finalists trained anew.

    Attributes:
        settings: best of the grid first.
        errors: ``(seeds, folds, settings)`` [deg/s].
        pairs: ``(folds, settings)``: mean error on the *other* folds of gates that saw neither those nor this one.
    """

    settings: tuple[Setting, ...]
    errors: FloatArray
    pairs: FloatArray

    @property
    def best(self) -> int:
        """Of the smallest mean error."""
        return int(self.errors.mean(axis=(0, 1)).argmin())

    @property
    def alike(self) -> tuple[int, ...]:
        """Those within one standard error of the best, paired by seed and fold."""
        lost = (self.errors - self.errors[..., [self.best]]).reshape(-1, len(self.settings))
        spread = lost.std(axis=0, ddof=1) / math.sqrt(len(lost)) if len(lost) > 1 else np.zeros(lost.shape[1])
        return tuple(np.flatnonzero(lost.mean(axis=0) <= spread).tolist())

    @property
    def smallest(self) -> int:
        """Of those alike, the one with the fewest units; the better one of two of a size."""
        mean = self.errors.mean(axis=(0, 1))
        return min(self.alike, key=lambda i: (self.settings[i].n1 * self.settings[i].n2, float(mean[i])))

    @property
    def nested(self) -> tuple[NDArray[np.int64], FloatArray]:
        """For every fold the setting chosen without it ``(folds,)``, and that one's error there, seeds averaged."""
        chosen = self.pairs.argmin(axis=1)
        return chosen, self.errors.mean(axis=0)[np.arange(len(chosen)), chosen]


def judge(
    settings: Sequence[Setting],
    folds: Sequence[int],
    updates: int,
    compute: Compute,
    stages: Sequence[tuple[float, float]] = HALVING,
    least: int = 20,
) -> Judged:
    """Go through the stages, each with the best of the one before.

    Args:
        settings: of the grid.
        folds: each is held out once.
        updates: of the whole schedule.
        compute: does the pieces.
        stages: share of the schedule and share of the settings; the last one is the whole schedule.
        least: settings that go on, however small the grid.
    """
    table = np.full((len(stages), len(settings)), np.nan)
    going = np.arange(len(settings))
    spent = 0
    for row, (schedule, kept) in enumerate(stages):
        if row:
            best = np.argsort(table[row - 1][going], kind="stable")
            going = np.sort(going[best[: max(least, math.ceil(kept * len(settings)))]])
        steps = math.ceil(schedule * updates)
        groups = list(_groups([settings[int(i)] for i in going]))
        pieces = [
            Piece(tuple(settings[int(going[k])] for k in group), (fold,), steps, seed=0)
            for group in groups
            for fold in folds
        ]
        errors = iter(compute(pieces))
        for group in groups:
            table[row, going[group]] = np.mean([next(errors)[0] for _ in folds], axis=0)
        spent += steps * len(going)
    return Judged(tuple(settings), table, spent / (updates * len(settings)))


def finals(
    judged: Judged, folds: Sequence[int], updates: int, compute: Compute, count: int = 20, seeds: int = 3
) -> Final:
    """Train the best again: with further seeds on every fold, and on pairs of folds for the nested choice.

    Args:
        judged: the grid.
        folds: three or more.
        updates: of the whole schedule.
        compute: does the pieces.
        count: of finalists.
        seeds: trainings of each; none is that of the grid.
    """
    chosen = tuple(judged.settings[i] for i in judged.order[:count])
    groups = list(_groups(chosen))
    ways = [((fold,), seed) for seed in range(1, seeds + 1) for fold in folds]
    ways += [(pair, 1) for pair in itertools.combinations(folds, 2)]
    pieces = [Piece(tuple(chosen[k] for k in group), held, updates, seed) for group in groups for held, seed in ways]
    found = iter(compute(pieces))
    table = {way: np.zeros((len(way[0]), len(chosen))) for way in ways}
    for group in groups:
        for way in ways:
            table[way][:, group] = next(found)
    errors = np.stack([[table[(fold,), seed][0] for fold in folds] for seed in range(1, seeds + 1)])
    pairs = np.stack(
        [
            np.mean([e for (held, _), value in table.items() for e in _others(fold, held, value)], axis=0)
            for fold in folds
        ]
    )
    return Final(chosen, errors, pairs)


def _others(fold: int, held: tuple[int, ...], errors: FloatArray) -> Iterator[FloatArray]:
    """Errors on the other fold of a pair that holds ``fold``."""
    if len(held) == 2 and fold in held:
        yield errors[1 - held.index(fold)]


def _groups(settings: Sequence[Setting]) -> Iterator[list[int]]:
    """Positions of settings of equal sizes, the largest networks first, at most ``TOGETHER`` at once."""
    by_size: dict[tuple[int, int], list[int]] = {}
    for i, setting in enumerate(settings):
        by_size.setdefault(setting.sizes, []).append(i)
    for _, group in sorted(by_size.items(), key=lambda item: -item[0][0] * item[0][1]):
        for first in range(0, len(group), TOGETHER):
            yield group[first : first + TOGETHER]


def lessons(recordings: Recordings, track: str, held_out: Sequence[int]) -> tuple[Lesson, list[Lesson], list[float]]:
    """What gates see, with LINEAR's yaw rate as the previous one, as in :class:`~mixo_env.policies.gate.Mixo`.

    Args:
        recordings: scenes in folds.
        track: who votes.
        held_out: folds that judge; all others teach and set mean and standard deviation of the inputs.

    Returns:
        What they learn from, one lesson per held-out fold, and LINEAR's error there [deg/s].

    Raises:
        ConfigurationError: where no fold is left to learn from.
    """
    present = {scene.fold for scene in recordings.scenes if scene.fold >= 0}
    if not present - set(held_out):
        raise ConfigurationError(
            f"folds {sorted(present)} leave none to learn from without {sorted(held_out)}: record more drives"
        )
    training = for_learning(recordings.select(folds=sorted(present - set(held_out))))
    linear = Linear()
    linear.fit(training, track)
    seen = collect(training, track, linear)
    mean, std = gate_input(seen).mean(axis=0), gate_input(seen).std(axis=0)
    std[std == 0.0] = 1.0

    def lesson(look: Observation) -> Lesson:
        return Lesson(
            np.ascontiguousarray(((gate_input(look) - mean) / std).T),
            np.ascontiguousarray(np.degrees(look["yaw_rates"]).T),
            np.degrees(look["truth_yaw_rate"][:, 0]),
        )

    others = [lesson(collect(for_learning(recordings.select(folds=[fold])), track, linear)) for fold in held_out]
    errors = [float(np.sqrt(np.mean((linear.weights @ one.rates - one.truth) ** 2))) for one in others]
    return lesson(seen), others, errors


def updates_of(training: Lesson, batch: int = BATCH, epochs: int = 10, least: int = 400) -> int:
    """Length of the schedule of :class:`~mixo_env.policies.gate.Mixo` with its own defaults."""
    batches = -(-len(training.truth) // batch)
    return batches * max(epochs, -(-least // batches))
