"""What the order in which cameras fire still costs: eq. 2 and LINEAR at the steps, and at the cameras' own windows.

Cameras fire up to 43 ms apart; what votes is carried to the common steps, which adds an error to every camera but the
one that fires last. Over its own window, against its own truth, no camera is carried. If shares and weights differ
much between the two, they speak of the clock and not of the cameras.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import FloatArray
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truth import exact_own_window_increments
from mixo_env.recordings.truths import with_truth

MOVING_MPS = 0.2
"""Slower steps say nothing about who is best."""


@dataclass(frozen=True)
class Told:
    """What one way of looking says about the cameras, on the same steps.

    Attributes:
        best_share: ``(cameras,)`` share of steps at which each is locally best (eq. 2).
        weights: ``(cameras,)`` constant weights of least squared error that add up to one.
        rms_deg: ``(cameras,)`` error of each.
        mixed_rms_deg: error of the mixture with these weights.
    """

    best_share: FloatArray
    weights: FloatArray
    rms_deg: FloatArray
    mixed_rms_deg: float


@dataclass(frozen=True)
class FiringOrder:
    """Both ways.

    Attributes:
        cameras: in column order.
        steps: moving ones in which every camera has both increments.
        at_steps: carried to the common steps: what policies mix.
        own_windows: as the cameras measured it.
    """

    cameras: tuple[str, ...]
    steps: int
    at_steps: Told
    own_windows: Told

    @property
    def cost_deg(self) -> FloatArray:
        """``(cameras,)`` RMS that carrying adds; 0 where the carried increments are no worse."""
        added = self.at_steps.rms_deg**2 - self.own_windows.rms_deg**2
        return np.sqrt(np.maximum(added, 0.0))


def firing_order(recordings: Recordings, truth: str) -> FiringOrder | None:
    """Compare both ways against one truth; ``None`` where no step has all cameras."""
    cameras = recordings.manifest.cameras
    if not cameras:
        return None
    judged = with_truth(recordings, truth)
    turn = judged["truth.yaw_increment_rad"]
    carried = np.stack([judged[f"{camera}.yaw_increment_rad"] - turn for camera in cameras], axis=1)
    own = np.stack([_own_error(judged, camera, truth) for camera in cameras], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        moving = np.nan_to_num(np.abs(judged["truth.distance_m"]) / judged["dt_s"]) >= MOVING_MPS
    steps = moving & np.isfinite(carried).all(axis=1) & np.isfinite(own).all(axis=1)
    if not steps.any():
        return None
    return FiringOrder(cameras, int(steps.sum()), *(_told(errors[steps]) for errors in (carried, own)))


def _own_error(recordings: Recordings, camera: str, truth: str) -> FloatArray:
    """``(rows,)`` yaw error of a camera over its own windows, against the truth at its own times."""
    if truth == "exact":
        scenes = [exact_own_window_increments(recordings.rows(i), camera) for i in range(len(recordings))]
        return recordings[f"{camera}.own_window_yaw_increment_rad"] - np.concatenate(scenes)
    own_truth = recordings[f"{camera}.own_window_truth_yaw_increment_rad"]
    return recordings[f"{camera}.own_window_yaw_increment_rad"] - own_truth


def _told(errors: FloatArray) -> Told:
    """From ``(steps, cameras)`` errors [rad]."""
    degrees = np.degrees(errors)
    weights = weights_of_one(degrees)
    return Told(
        best_share=best_shares(np.abs(errors), np.ones(len(errors), dtype=np.bool_)),
        weights=weights,
        rms_deg=np.sqrt(np.mean(degrees**2, axis=0)),
        mixed_rms_deg=float(np.sqrt(np.mean((degrees @ weights) ** 2))),
    )


def weights_of_one(errors: FloatArray) -> FloatArray:
    """Weights that add up to one and minimise the mean square of the mixed ``(steps, n)`` errors.

    Increments over different windows have no common truth, but weights of sum one mix errors as they mix increments.
    """
    last = errors[:, -1]
    first = np.linalg.lstsq(errors[:, :-1] - last[:, None], -last, rcond=None)[0]
    return np.append(first, 1.0 - first.sum()).astype(np.float64)


def best_shares(errors: FloatArray, steps: NDArray[np.bool_]) -> FloatArray:
    """Share of steps at which each camera is locally best (eq. 2); ties are split among those that tie.

    Args:
        errors: ``(rows, cameras)`` absolute; NaN takes no part.
        steps: ``(rows,)`` that count; those in which no camera has an error are left out.

    Returns:
        ``(cameras,)``, adding up to one; NaN without a step.
    """
    rows = errors[steps & np.isfinite(errors).any(axis=1)]
    if not len(rows):
        return np.full(errors.shape[1], np.nan)
    best = rows == np.nanmin(rows, axis=1, keepdims=True)
    return (best / best.sum(axis=1, keepdims=True)).mean(axis=0)
