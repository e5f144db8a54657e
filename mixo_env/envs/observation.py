"""What a policy sees: the quantities, their order, units and bounds, and the table of their recorded values.

The order makes every flat observation a prefix of a longer one: ``"paper"`` is x_k of eq. 3 followed by the experts'
yaw rates, ``"rich"`` goes on from there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mixo_env.envs.tables import Votes
from mixo_env.experts.expert import State
from mixo_env.recordings.collection import Recordings

Width = Literal["one", "camera", "expert"]


@dataclass(frozen=True)
class Quantity:
    """One named part of an observation: one number, one per camera or one per voting expert."""

    name: str
    per: Width
    low: float
    high: float
    unit: str
    meaning: str


PAPER = (
    Quantity("previous_yaw_rate", "one", -np.pi, np.pi, "rad/s", "yaw rate over the previous step, see `previous`"),
    Quantity("speed", "one", -60.0, 60.0, "m/s", "longitudinal speed at the end of the previous step"),
    Quantity("matches", "camera", 0.0, 10_000.0, "count", "matched features, 0 unless the camera is tracking"),
    Quantity("yaw_rates", "expert", -np.pi, np.pi, "rad/s", "yaw rate over this step, substituted if lost"),
)
"""x_k of eq. 3 and what the experts say."""

RICH = (
    *PAPER,
    Quantity("dt", "one", 0.0, 1.0, "s", "duration of this step"),
    Quantity("available", "expert", 0.0, 1.0, "0 or 1", "the expert delivered an increment of its own"),
    Quantity(
        "inliers",
        "camera",
        0.0,
        10_000.0,
        "count",
        "estimate: share of matches solved with that agree with motion, times all",
    ),
    Quantity("residual_px", "camera", 0.0, 100.0, "px", "median reprojection residual of the inliers"),
    Quantity("flow_px", "camera", 0.0, 2_000.0, "px", "median displacement of the matches"),
    Quantity("state", "camera", 0.0, 3.0, "code", "0 initialising, 1 tracking, 2 lost, 3 no image"),
    Quantity("yaw_rate_std", "expert", 0.0, np.pi, "rad/s", "the expert's own standard deviation"),
    Quantity("disagreement", "expert", -2 * np.pi, 2 * np.pi, "rad/s", "yaw rate minus the median of those available"),
)
"""Everything a deployed system knows."""

AWAKE = Quantity("awake", "camera", 0.0, 1.0, "0 or 1", "the image that closes this step was processed")
"""Only in budget environments."""

PRIVILEGED = Quantity("truth_yaw_rate", "one", -np.pi, np.pi, "rad/s", "ground truth: privileged, only when asked for")


class Layout:
    """Where each quantity stands in a flat observation.

    Attributes:
        quantities: in order.
        slices: name -> columns.
        width: number of columns.
        low, high: ``(width,)`` float32 bounds.
    """

    def __init__(self, quantities: tuple[Quantity, ...], cameras: int, experts: int) -> None:
        """Lay the quantities out one after another."""
        widths = {"one": 1, "camera": cameras, "expert": experts}
        stops = np.cumsum([widths[quantity.per] for quantity in quantities]).tolist()
        self.quantities = quantities
        self.slices = {q.name: slice(a, b) for q, a, b in zip(quantities, [0, *stops], stops, strict=False)}
        self.width = stops[-1]
        self.low = np.concatenate([np.full(widths[q.per], q.low, np.float32) for q in quantities])
        self.high = np.concatenate([np.full(widths[q.per], q.high, np.float32) for q in quantities])

    def clip(self, values: NDArray[np.float64]) -> NDArray[np.float32]:
        """Values ``(..., width)`` rounded to float32 inside the bounds; what is missing (NaN) becomes 0."""
        return np.clip(np.nan_to_num(values, nan=0.0).astype(np.float32), self.low, self.high)

    def split(self, flat: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
        """``(..., width)`` -> name -> ``(..., width of the quantity)``, as arrays of their own."""
        return {name: flat[..., columns].copy() for name, columns in self.slices.items()}

    def box(self) -> spaces.Box:
        """Space of the flat observation."""
        return spaces.Box(self.low, self.high, dtype=np.float32)

    def dict(self) -> spaces.Dict:
        """Space of the named observation, one level deep."""
        return spaces.Dict(
            {name: spaces.Box(self.low[c], self.high[c], dtype=np.float32) for name, c in self.slices.items()}
        )


def tabulate(
    layout: Layout,
    recordings: Recordings,
    steps: NDArray[np.intp],
    votes: Votes,
    experts: tuple[str, ...],
    cameras: tuple[str, ...],
    state: NDArray[np.int8],
    previous_yaw_rate: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Recorded part of every observation.

    Args:
        layout: of the result.
        recordings: the source of every column.
        steps: ``(rows,)`` rows of the recordings that are steps.
        votes: of those rows.
        experts: the voters, in the order of the weights.
        cameras: those of them whose matches and states are observed.
        state: ``(rows, cameras)`` their State; what a camera says about its matches counts only while TRACKING.
        previous_yaw_rate: ``(rows,)`` [rad/s].

    Returns:
        ``(rows, layout.width)`` float32, clipped to the bounds.
    """

    def column(expert: str, name: str) -> NDArray[np.float64]:
        full = f"{expert}.{name}"
        return recordings[full][steps].astype(np.float64) if full in recordings else np.full(len(steps), np.nan)

    def stack(names: tuple[str, ...], name: str) -> NDArray[np.float64]:
        return np.stack([column(expert, name) for expert in names], axis=-1) if names else np.zeros((len(steps), 0))

    dt = recordings["dt_s"][steps][:, None]
    rates = votes.increments_rad / dt
    tracking = state == State.TRACKING
    values = {
        "previous_yaw_rate": previous_yaw_rate[:, None],
        "speed": recordings["speed_mps"][steps - 1].astype(np.float64)[:, None],
        "yaw_rates": rates,
        "dt": dt,
        "available": votes.available.astype(np.float64),
        "state": state,
        "yaw_rate_std": np.where(votes.available, stack(experts, "yaw_std_rad"), 0.0) / dt,
        "disagreement": rates - median_of_available(rates, votes.available)[:, None],
        "awake": np.ones(state.shape),
        "truth_yaw_rate": recordings["truth.yaw_increment_rad"][steps][:, None] / dt,
    }
    values |= {q: np.where(tracking, stack(cameras, q), 0.0) for q in ("matches", "inliers", "residual_px", "flow_px")}
    return layout.clip(np.concatenate([values[name] for name in layout.slices], axis=-1))


def median_of_available(rates: NDArray[np.float64], available: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Median ``(rows,)`` over the experts that delivered; substitutes count only where nobody did."""
    counted = available | ~available.any(axis=-1, keepdims=True)
    return np.nanmedian(np.where(counted, rates, np.nan), axis=-1)
