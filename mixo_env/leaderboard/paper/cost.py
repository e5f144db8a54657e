"""Accuracy against cost: sets of cameras that stay on, and those that change.

They are played in ``MixoOdometryBudget-v0``, with LINEAR's weights fitted for every set of delivering cameras. The
greedy set grows by the camera that takes away most error on the training folds, or wakes only while the car turns; the
best set of a price is the one of all that earns most there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mixo_env.files import atomic_path
from mixo_env.leaderboard.held_out import hold_out
from mixo_env.leaderboard.paper.parts import NotHereError, Subject
from mixo_env.policies.budget import (
    BudgetPolicy,
    CameraSet,
    LinearByPattern,
    Played,
    best_set,
    greedy_order,
    play,
    play_sets,
)
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.presets import data_label
from mixo_env.recordings.truths import for_learning
from mixo_env.tables import Cell, Column, Table

TURNING_RADPS = (0.01, 0.03, 0.1)
"""Thresholds of the greedy policy that wakes cameras in turns."""
PRICES_PER_MS = (0.003, 0.01, 0.03)
"""Prices of a millisecond at which policies are compared; the middle one is the environment's default."""
MARKERS = {"trivial": "o", "greedy set": "s", "greedy while turning": "D", "best set": "x"}
"""Of the kinds drawn with a symbol of their own."""

Named = tuple[str, str, BudgetPolicy]
"""Kind, name and policy."""


class Division:
    """Scenes of one held-out fold, as they are fitted on and scored.

    Attributes:
        training: poses free of lag, as every policy learns from.
        test: exact poses where the recordings have them; rewards are in units of the training scenes' error.
        track: who votes.
        linear: LINEAR's weights for every set of delivering cameras.
    """

    def __init__(self, recordings: Recordings, fold: int, track: str) -> None:
        """Hold ``fold`` out."""
        self.training, test = (for_learning(part) for part in hold_out(recordings, fold))
        scale = self.training.manifest.reward_scale_rad
        self.test = test.replace(replace(test.manifest, reward_scale_rad=scale), {})
        self.track = track
        self.linear = LinearByPattern(self.training, track)

    @cached_property
    def sets(self) -> dict[tuple[str, ...], Played]:
        """Every constant set on the training scenes."""
        return play_sets(self.training, self.track, self.linear)


@dataclass(frozen=True)
class Point:
    """One policy, mean over all scenes of all folds.

    Attributes:
        kind, name: of the policy.
        cost_ms: of a step.
        yaw_rmse_deg: of a step's yaw increment.
        ate_m: absolute trajectory error.
        rewards: of a step, at PRICES_PER_MS.
    """

    kind: str
    name: str
    cost_ms: float
    yaw_rmse_deg: float
    ate_m: float
    rewards: tuple[float, ...]


def camera_sets(division: Division, turning_radps: Sequence[float] = TURNING_RADPS) -> Iterator[Named]:
    """What needs no network, fitted without the held-out fold."""
    linear, cameras = division.linear, division.linear.cameras
    for on in ((), *((camera,) for camera in cameras), cameras):
        name = {0: "no camera", len(cameras): "all cameras"}.get(len(on), "".join(on))
        yield "trivial", name, CameraSet(linear, on)
    order = greedy_order(division.sets)
    for count in range(1, len(order) + 1):
        yield "greedy set", f"best {count}", CameraSet(linear, order[:count])
    for rate in turning_radps:
        yield "greedy while turning", f"best 2 above {np.rad2deg(rate):.1f} deg/s", CameraSet(linear, order[:2], rate)
    for price in PRICES_PER_MS:
        yield "best set", at_price(price), CameraSet(linear, best_set(division.sets, price))


def at_price(price_per_ms: float) -> str:
    """Name of a policy made for a price."""
    return f"price {price_per_ms:g} per ms"


def cross_validated(
    recordings: Recordings, track: str, policies: Callable[[Division], Iterable[Named]] = camera_sets
) -> list[Point]:
    """Every policy, fitted and played fold by fold.

    Raises:
        NotHereError: with fewer than two folds.
        MixoError: when the budget environment refuses the recordings.
    """
    folds = sorted({scene.fold for scene in recordings.scenes if scene.fold >= 0})
    if len(folds) < 2:
        raise NotHereError("these recordings have fewer than two folds (one log, or no fold at all)")
    parts: dict[tuple[str, str], list[Played]] = {}
    for fold in folds:
        division = Division(recordings, fold, track)
        for kind, name, policy in policies(division):
            parts.setdefault((kind, name), []).append(play(policy, division.test, track, split="all"))
    return [_averaged(*named, played) for named, played in parts.items()]


def _averaged(kind: str, name: str, folds: Sequence[Played]) -> Point:
    """Mean over the scenes of every fold."""
    fields = ("cost_ms", "yaw_rmse_deg", "ate_m", "yaw_reward")
    whole = Played(**{field: np.concatenate([getattr(part, field) for part in folds]) for field in fields})
    cost_ms, yaw_rmse_deg, ate_m = (float(getattr(whole, field).mean()) for field in fields[:3])
    return Point(kind, name, cost_ms, yaw_rmse_deg, ate_m, tuple(map(whole.reward, PRICES_PER_MS)))


def points_of(subject: Subject) -> list[Point]:
    """Every set of cameras, cross-validated.

    Raises:
        NotHereError: without cameras or with fewer than two folds.
        MixoError: when the budget environment refuses the recordings.
    """
    subject.cameras()
    return cross_validated(subject.recordings, subject.track)


def cost_table(recordings: Recordings, track: str, points: Sequence[Point]) -> Table:
    """A line a policy."""
    rows: list[list[Cell]] = [
        [f"{one.kind}: {one.name}", one.cost_ms, one.yaw_rmse_deg, one.ate_m, *one.rewards] for one in points
    ]
    caption = (
        f"Accuracy against cost. {data_label(recordings.manifest)}, track {track}, image to image; milliseconds of "
        "image processing as the budget environment charges them, reward of a step at three prices of a millisecond, "
        "mean over the scenes of all folds."
    )
    columns = Column("cameras"), Column("cost", "ms/step", ".1f"), Column("yaw step", "deg", ".4f")
    earned = [Column(f"at {price:g}", "", ".3f") for price in PRICES_PER_MS]
    return Table(caption, (*columns, Column("ATE", "m", ".3f"), *earned), rows)


def draw_cost(points: Sequence[Point], path: Path) -> None:
    """Yaw error and ATE over milliseconds."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(1, 2)
    for axis, field, label in zip(
        axes, ("yaw_rmse_deg", "ate_m"), ("yaw increment RMSE [deg]", "ATE [m]"), strict=True
    ):
        for kind in dict.fromkeys(one.kind for one in points):
            mine = sorted((one for one in points if one.kind == kind), key=lambda one: one.cost_ms)
            line = "none" if kind == "trivial" else "-"
            x, y = [one.cost_ms for one in mine], [getattr(one, field) for one in mine]
            (drawn,) = axis.plot(x, y, linestyle=line, zorder=1)
            axis.plot(x, y, MARKERS.get(kind, "^"), color=drawn.get_color(), label=kind, zorder=3)
            if kind == "trivial":
                _name(axis, mine, field)
        axis.set(xlabel="image processing [ms per step]", ylabel=label)
        axis.margins(x=0.12)
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110, format=path.suffix[1:], metadata={"Software": None})


def _name(axis: Any, points: Sequence[Point], field: str) -> None:
    for one in points:
        text = one.name.replace("CAM_", "").lower().replace("_", " ")
        last = one.cost_ms == max(other.cost_ms for other in points)
        place: dict[str, Any] = {"xytext": (-4, 6), "ha": "right"} if last else {"xytext": (5, 4)}
        # On white, above lines and below markers: a line of another kind may pass behind a name.
        place |= {"bbox": {"facecolor": "white", "edgecolor": "none", "pad": 0.5}, "zorder": 2}
        axis.annotate(text, (one.cost_ms, getattr(one, field)), textcoords="offset points", fontsize=8, **place)
