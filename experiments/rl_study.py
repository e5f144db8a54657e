"""How agents of Stable-Baselines3 learn to weight experts: settings, algorithms, steps and seconds to LINEAR and MIXO.

    python -m experiments.rl_study

Every training is a file of its own in ``--folder``, written when it ended: interrupt the study whenever you like, and
the same command goes on where it stood.
"""

from __future__ import annotations

import itertools
import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from experiments.rl_training import CLONE, Field, Learner, Point, Training, train
from experiments.studies import print_study
from mixo_env.errors import ConfigurationError, ResultsError, printable, unknown
from mixo_env.files import atomic_path, writable_folder, write_json
from mixo_env.leaderboard.held_out import hold_out
from mixo_env.policies.fitting import prepare
from mixo_env.policies.gate import Mixo
from mixo_env.policies.linear import Linear
from mixo_env.policies.reinforcement import A2C, DQN, PPO, SAC, TD3, Recipe
from mixo_env.recordings.presets import data_label
from mixo_env.recordings.store import load_recordings
from mixo_env.tables import Cell, Column, Table

logger = logging.getLogger(__name__)


SHORT = 61_440
"""Steps of the short trainings: those that the table shows first, and all of the slow algorithms."""
TUNED = PPO.usual


def ppo(recipe: Recipe = TUNED, *, log_std: float | None = None, **settings: Any) -> Learner:
    """PPO that explores with another standard deviation at first, or with other settings."""
    network = recipe.network if log_std is None else {"log_std_init": log_std}
    return Learner("PPO", replace(recipe, settings=recipe.settings | settings, network=network))


NAIVE = Recipe(gamma=0.99, environments=1, standardised=False)
RECIPES: dict[str, Learner] = {
    "PPO": ppo(),
    "PPO, paper observation": ppo(replace(TUNED, observation="paper")),
    "PPO, log std 0": ppo(log_std=0.0),
    "PPO, gamma .99": ppo(replace(TUNED, gamma=0.99)),
    "PPO, reward abs": ppo(replace(TUNED, reward="abs")),
    "PPO, reward pose": ppo(replace(TUNED, reward="pose")),
    "PPO, defaults of SB3": Learner("PPO", NAIVE, SHORT),
    "PPO, defaults, gamma 0": Learner("PPO", replace(NAIVE, gamma=0.0), SHORT),
    "clone of the oracle": Learner(CLONE, TUNED),
    "A2C": Learner("A2C", A2C.usual),
    "SAC": Learner("SAC", SAC.usual, SHORT),
    "TD3": Learner("TD3", TD3.usual, SHORT),
    "DQN": Learner("DQN", DQN.usual, SHORT),
}
"""Rows of the study, the tuned PPO first."""

CANDIDATES: dict[str, Learner] = {
    "log std -.5": ppo(log_std=-0.5),
    "log std -1": ppo(log_std=-1.0),
    "log std -1.5": ppo(log_std=-1.5),
    "log std -1, reward abs": ppo(replace(TUNED, reward="abs")),
    "log std -1, rate 5e-4": ppo(learning_rate=5e-4),
    "log std -1, rate 2e-3": ppo(learning_rate=2e-3),
    "log std -.5, batch 2048": ppo(log_std=-0.5, batch_size=2048),
}
"""Among which PPO's settings are chosen, on folds that the study's table never scores."""


@dataclass(frozen=True)
class Key:
    """What a training depends on; it stands beside its result."""

    data: str
    learner: Learner
    track: str
    fold: int
    without: int | None
    steps: int
    every: int
    seed: int


@dataclass(frozen=True)
class Stored:
    """One file of the folder."""

    key: Key
    training: Training


@dataclass(frozen=True)
class RLStudy:
    """Train agents with several seeds; print and draw what they reach on a held-out fold."""

    recordings: Path | None = None
    """Folder of recordings; default: the bundled ones."""
    recipes: tuple[str, ...] = ("PPO", "PPO, log std 0", "PPO, gamma .99")
    """Which agents."""
    tracks: tuple[str, ...] = ("CONSUMER", "VISION")
    """Who votes."""
    folds: tuple[int, ...] = (3,)
    """Each is held out in turn."""
    without: int | None = None
    """A fold left out altogether: choose settings with it, then score them on it."""
    seeds: int = 3
    """Trainings of every agent."""
    steps: int = 245_760
    """Of the environment in each; the rate of learning is constant, so shorter trainings are its beginning."""
    every: int = 12_288
    """Steps between evaluations."""
    folder: Path = Path("results/rl_study")
    """Finished trainings; they are not repeated."""
    out: Path | None = None
    """Figure to write."""

    def run(self) -> Table:
        """Train what is missing, then print."""
        self._check()
        writable_folder(self.folder)
        fields = {place: self._field(*place) for place in itertools.product(self.tracks, self.folds)}
        found: dict[tuple[str, str], list[Training]] = {}
        goals: dict[str, list[Goals]] = {}
        for (track, fold), field in fields.items():
            goals.setdefault(track, []).append(goals_of(field))
            for name, seed in itertools.product(self.recipes, range(self.seeds)):
                found.setdefault((track, name), []).append(self._trained(name, field, fold, seed))
        if self.out:
            draw(found, goals, self.out)
        data = data_label(fields[self.tracks[0], self.folds[0]].test.manifest)
        return table(found, goals, f"{data}, held-out folds {self.folds}, {self.seeds} seeds")

    def _check(self) -> None:
        for name in self.recipes:
            if name not in RECIPES | CANDIDATES:
                raise ConfigurationError(unknown("agent", name, RECIPES | CANDIDATES))
        for name in ("seeds", "steps", "every"):
            if getattr(self, name) < 1:
                raise ConfigurationError(f"{name}: expected 1 or more, got {getattr(self, name)}: leave it out")
        if not (self.tracks and self.folds and self.recipes):
            raise ConfigurationError("expected at least one track, fold and agent, got none: name one")

    def _field(self, track: str, fold: int) -> Field:
        recordings = load_recordings(self.recordings)
        folds = sorted({scene.fold for scene in recordings.scenes} - {-1, self.without})
        return Field(*hold_out(recordings.select(folds=folds), fold), track)

    def _trained(self, name: str, field: Field, fold: int, seed: int) -> Training:
        """From the folder, else now."""
        learner, data = (RECIPES | CANDIDATES)[name], data_label(field.test.manifest)
        steps = min(self.steps, learner.most_steps)
        key = Key(data, learner, field.track, fold, self.without, steps, self.every, seed)
        words = re.sub(r"[^a-z0-9]+", "-", f"{name} {field.track} fold {fold}".lower().replace("-", "minus "))
        rest = "" if self.without is None else f"-without-{self.without}"
        path = self.folder / f"{words}{rest}-seed-{seed}.json"
        if path.exists():
            return read(path, key)
        training = train(learner, field, steps, self.every, seed)
        write_json(path, Stored(key, training))
        last = training.curve[-1]
        logger.info("%s: yaw %.4f deg, RTE %.4f deg/m, %.0f s", path.stem, *last.errors, last.seconds)
        return training


def read(path: Path, key: Key) -> Training:
    """A finished training.

    Raises:
        ResultsError: when it is broken, or of other data or settings.
    """
    try:
        stored = msgspec.json.decode(path.read_bytes(), type=Stored)
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} is no finished training ({printable(str(error))}): delete it") from None
    if stored.key != msgspec.convert(msgspec.to_builtins(key), Key):
        names = [field.name for field in fields(key) if getattr(stored.key, field.name) != getattr(key, field.name)]
        raise ResultsError(f"{path} was trained with other {', '.join(names)}: choose another --folder, or delete it")
    return stored.training


@dataclass(frozen=True)
class Goals:
    """Yaw RMSE [deg] and RTE [deg/m] of the policies to be reached."""

    linear: tuple[float, float]
    mixo: tuple[float, float]


def goals_of(field: Field) -> Goals:
    """LINEAR, and the mean of MIXO over three seeds."""
    linear, gates = Linear(), [Mixo() for _ in range(3)]
    prepare(linear, field.training, field.track)
    for seed, gate in enumerate(gates):
        prepare(gate, field.training, field.track, seed=seed)
    yaw, rte = np.mean([field.errors(gate) for gate in gates], axis=0)
    return Goals(field.errors(linear), (float(yaw), float(rte)))


def reached(training: Training, goal: tuple[float, float], measure: int) -> Point | None:
    """The first evaluation of a training that is as good as ``goal`` in yaw RMSE (0) or RTE (1)."""
    return next((point for point in training.curve if point.errors[measure] <= goal[measure]), None)


def _when(trainings: Sequence[Training], goals: Sequence[tuple[float, float]], measure: int) -> str:
    """Steps and seconds until a goal is reached: the median of those seeds that did, and how many."""
    points = [reached(training, goal, measure) for training, goal in zip(trainings, goals, strict=True)]
    there = [point for point in points if point]
    if not there:
        return "not reached"
    steps, seconds = (float(np.median([getattr(p, name) for p in there])) for name in ("steps", "seconds"))
    return f"{steps / 1000:.0f} k, {seconds:.1f} s ({len(there)} of {len(points)})"


def at(training: Training, steps: int) -> Point:
    """The first evaluation after ``steps``, else the last."""
    return next((point for point in training.curve if point.steps >= steps), training.curve[-1])


def table(found: Mapping[tuple[str, str], list[Training]], goals: Mapping[str, list[Goals]], caption: str) -> Table:
    """Errors after the short and the whole training, and when LINEAR and MIXO were reached."""
    columns = [Column(name) for name in ("track", "agent")]
    columns += [
        Column(f"{name} {when}", unit, ".4f")
        for when in (f"{SHORT // 1000} k", "end")
        for name, unit in (("yaw", "deg"), ("RTE", "deg/m"))
    ]
    columns += [Column("steps"), Column("time", "s", ".0f"), Column("environment", "%", ".1f")]
    columns += [Column(f"{who}'s {what}") for who in ("LINEAR", "MIXO") for what in ("yaw", "RTE")]
    rows: list[list[Cell]] = []
    for track, all_goals in goals.items():
        for who in ("linear", "mixo"):
            mean = np.mean([getattr(goal, who) for goal in all_goals], axis=0)
            rows.append([track, who.upper(), None, None, *map(float, mean), *[None] * 7])
        for (_, name), trainings in ((key, value) for key, value in found.items() if key[0] == track):
            each = [goal for goal in all_goals for _ in range(len(trainings) // len(all_goals))]
            early, late = (np.mean([at(t, steps).errors for t in trainings], axis=0) for steps in (SHORT, 10**12))
            ends = [t.curve[-1] for t in trainings]
            seconds, share = np.mean([p.seconds for p in ends]), 100 * np.mean([t.environment_share for t in trainings])
            whens = [_when(trainings, [getattr(g, who) for g in each], m) for who in ("linear", "mixo") for m in (0, 1)]
            numbers = [*map(float, (*early, *late))]
            rows.append([track, name, *numbers, ends[0].steps, float(seconds), float(share), *whens])
    return Table(caption, tuple(columns), rows)


def draw(found: Mapping[tuple[str, str], list[Training]], goals: Mapping[str, list[Goals]], out: Path) -> None:
    """Curves of every agent: the mean, and every seed and fold as a thin line."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, grid = plt.subplots(len(goals), 2, figsize=(10, 3.6 * len(goals)), layout="constrained", squeeze=False)
    for axes, (track, all_goals) in zip(grid, goals.items(), strict=True):
        for measure, axis in enumerate(axes):
            for (_, name), trainings in ((key, value) for key, value in found.items() if key[0] == track):
                shortest = min(len(t.curve) for t in trainings)
                values = np.array([[p.errors[measure] for p in t.curve[:shortest]] for t in trainings])
                steps = [max(p.steps, 1) / 1000 for p in trainings[0].curve[:shortest]]
                (line,) = axis.plot(steps, values.mean(axis=0), linewidth=2, label=name)
                axis.plot(steps, values.T, linewidth=0.7, alpha=0.5, color=line.get_color())
            for who, style in (("linear", "--"), ("mixo", ":")):
                goal = float(np.mean([getattr(g, who)[measure] for g in all_goals]))
                axis.axhline(goal, color="black", linestyle=style, linewidth=1, label=who.upper())
                axis.set_ylim(0.6 * goal, 4 * goal)
            axis.set(xlabel="steps of the environment [thousands]", ylabel=("yaw RMSE [deg]", "RTE [deg/m]")[measure])
            axis.set(title=f"{track}, held out", yscale="log")
            axis.grid(alpha=0.3, which="both")
    grid[0, 0].legend(fontsize=8)
    with atomic_path(out) as temporary:
        figure.savefig(temporary, dpi=110, format=out.suffix[1:])
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; see :class:`RLStudy`."""
    return print_study(RLStudy, arguments)


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    raise SystemExit(main())
