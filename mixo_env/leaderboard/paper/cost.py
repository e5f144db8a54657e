"""Accuracy against cost: sets of cameras that stay on, and the greedy one that grows by the best gain per millisecond.

They are played in ``MixoOdometryBudget-v0``, with LINEAR's weights fitted for every set of delivering cameras.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mixo_env.files import atomic_path
from mixo_env.leaderboard.paper.parts import NotHereError, Subject
from mixo_env.policies.budget import BudgetPolicy, CameraSet, LinearByPattern, Played, greedy_order, play
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.presets import data_label
from mixo_env.tables import Column, Table

TURNING_RADPS = (0.01, 0.03, 0.1)
"""Thresholds of the greedy policy that wakes cameras in turns."""
MARKERS = {"trivial": "o", "greedy set": "s", "greedy while turning": "D", "PPO": "^"}


@dataclass(frozen=True)
class Point:
    """One policy, mean over all scenes of all folds.

    Attributes:
        kind, name: of the policy.
        cost_ms: of a step.
        yaw_rmse_deg: of a step's yaw increment.
        ate_m: absolute trajectory error.
    """

    kind: str
    name: str
    cost_ms: float
    yaw_rmse_deg: float
    ate_m: float


def camera_sets(
    recordings: Recordings, fold: int, track: str, turning_radps: Sequence[float] = TURNING_RADPS
) -> Iterator[tuple[str, str, BudgetPolicy]]:
    """Kind, name and policy of what needs no network, fitted without one fold."""
    training = recordings.select(folds=[scene.fold for scene in recordings.scenes if scene.fold not in (fold, -1)])
    linear = LinearByPattern(training, track)
    cameras = linear.cameras
    for on in ((), *((camera,) for camera in cameras), cameras):
        name = {0: "no camera", len(cameras): "all cameras"}.get(len(on), "".join(on))
        yield "trivial", name, CameraSet(linear, on)
    order = greedy_order(recordings, track, linear, fold)
    for count in range(1, len(order) + 1):
        yield "greedy set", f"best {count}", CameraSet(linear, order[:count])
    for rate in turning_radps:
        yield "greedy while turning", f"best 2 above {np.rad2deg(rate):.1f} deg/s", CameraSet(linear, order[:2], rate)


def averaged(kind: str, name: str, folds: Sequence[Played]) -> Point:
    """Mean over the scenes of every fold."""
    fields = ("cost_ms", "yaw_rmse_deg", "ate_m")
    return Point(kind, name, *(float(np.mean(np.concatenate([getattr(p, field) for p in folds]))) for field in fields))


def points_of(subject: Subject) -> list[Point]:
    """Every set of cameras, cross-validated.

    Raises:
        NotHereError: without cameras or with fewer than two folds.
        MixoError: when the budget environment refuses the recordings.
    """
    subject.cameras()
    recordings = subject.recordings
    folds = sorted({scene.fold for scene in recordings.scenes if scene.fold >= 0})
    if len(folds) < 2:
        raise NotHereError("these recordings have fewer than two folds (one log, or no fold at all)")
    parts: dict[tuple[str, str], list[Played]] = {}
    for fold in folds:
        for kind, name, policy in camera_sets(recordings, fold, subject.track):
            parts.setdefault((kind, name), []).append(play(policy, recordings, subject.track, fold=fold))
    return [averaged(*named, played) for named, played in parts.items()]


def cost_table(subject: Subject, points: Sequence[Point]) -> Table:
    """A line a policy."""
    rows = [[f"{one.kind}: {one.name}", one.cost_ms, one.yaw_rmse_deg, one.ate_m] for one in points]
    caption = (
        f"Accuracy against cost. {data_label(subject.recordings.manifest)}, track {subject.track}, image to image; "
        "milliseconds of image processing as the budget environment charges them, mean over the scenes of all folds."
    )
    columns = Column("cameras"), Column("cost", "ms/step", ".1f"), Column("yaw step", "deg", ".4f")
    return Table(caption, (*columns, Column("ATE", "m", ".3f")), rows)


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
            axis.plot(x, y, MARKERS[kind], color=drawn.get_color(), label=kind, zorder=3)
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
