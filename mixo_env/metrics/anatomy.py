"""Error anatomy: which part of an error is scale, which is yaw, and what gating could gain (docs/metrics.md)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from mixo_env.geometry import MAD_TO_SIGMA, FloatArray, wrap_angle_rad
from mixo_env.metrics.pairs import IntArray, scene_offsets
from mixo_env.metrics.tracks import BoolArray
from mixo_env.trajectory.planar import PlanarPoses

BIAS_WINDOWS_S = (1.0, 5.0, 20.0)
OUTLIER_SIGMAS = 3.0


@dataclass(frozen=True)
class ErrorAnatomy:
    """Where the error of planar trajectories comes from, over all scenes.

    Attributes:
        along_track_rmse_m: position error along the true heading: scale, mostly.
        cross_track_rmse_m: position error across it: yaw, mostly. The squares of both add up to that of the error.
        bias_deg_per_s: window [s] -> RMS over windows of that length of (yaw error grown in it / its length). White
            noise falls with the root of the window, a bias stays.
        outlier_share: share of steps whose yaw-increment error is an outlier: more than 3 robust sigmas from the
            median, or beyond a given limit.
        outlier_energy: their share of the summed squared yaw-increment error: what rejecting them could gain.
        all_lost_share: share of steps with every camera lost; NaN when no states were given.
        all_lost_energy: their share of the summed squared yaw-increment error: no gate over cameras can gain it.
    """

    along_track_rmse_m: float
    cross_track_rmse_m: float
    bias_deg_per_s: dict[float, float]
    outlier_share: float
    outlier_energy: float
    all_lost_share: float
    all_lost_energy: float


def split_error(truth: PlanarPoses, estimate: PlanarPoses) -> tuple[FloatArray, FloatArray]:
    """Position error ``(N,)`` along (forward positive) and across (left positive) the true heading [m]."""
    dx, dy = estimate.x_m - truth.x_m, estimate.y_m - truth.y_m
    cos, sin = np.cos(truth.yaw_rad), np.sin(truth.yaw_rad)
    return cos * dx + sin * dy, cos * dy - sin * dx


def yaw_bias_deg_per_s(
    yaw_error_rad: FloatArray, time_s: FloatArray, window_s: float, offsets: IntArray | None = None
) -> float:
    """RMS over windows of the yaw error grown in a window divided by its length.

    Windows follow one another without overlap from the start of each scene; an incomplete last one is left out, but a
    scene shorter than the window counts as one window of its own length (a nuScenes scene lasts a little under 20 s).

    Args:
        yaw_error_rad: ``(N,)`` yaw error of poses, unwrapped.
        time_s: ``(N,)`` their times.
        window_s: window length.
        offsets: ``(scenes + 1,)`` first row of each scene and the end; ``None``: one scene.
    """
    offsets = scene_offsets(len(time_s), offsets)
    rates = []
    for first, stop in itertools.pairwise(offsets):
        if stop - first < 2:
            continue
        time, error = time_s[first:stop], yaw_error_rad[first:stop]
        windows = int((time[-1] - time[0]) / window_s + 1e-9)
        edges = time[0] + window_s * np.arange(windows + 1) if windows else time[[0, -1]]
        rates.append(np.diff(np.interp(edges, time, error)) / np.diff(edges))
    if not rates:
        return float("nan")
    return float(np.rad2deg(np.sqrt(np.mean(np.square(np.concatenate(rates))))))


def error_anatomy(
    truth: PlanarPoses,
    estimate: PlanarPoses,
    time_s: FloatArray,
    offsets: IntArray | None = None,
    all_lost: BoolArray | None = None,
    outlier_rad: float | None = None,
) -> ErrorAnatomy:
    """Take the errors of planar poses apart.

    Args:
        truth: ``N`` poses.
        estimate: the matching ``N`` poses.
        time_s: times, increasing within a scene.
        offsets: ``(scenes + 1,)`` first row of each scene and the end; ``None``: one scene.
        all_lost: ``(N,)`` no camera is TRACKING in the step that ends at this pose.
        outlier_rad: a step whose error is larger is an outlier, the same for every method; ``None``: by the spread of
            these errors.
    """
    offsets = scene_offsets(len(truth), offsets)
    along, across = split_error(truth, estimate)
    yaw_error = wrap_angle_rad(estimate.yaw_rad - truth.yaw_rad)
    step_end = np.ones(len(yaw_error), dtype=bool)
    step_end[offsets[:-1][np.diff(offsets) > 0]] = False
    step_error = wrap_angle_rad(np.diff(yaw_error, prepend=0.0))[step_end]
    # Growing errors may pass half a turn: add the wrapped steps up instead of unwrapping across scenes.
    grown = np.zeros(len(yaw_error))
    grown[step_end] = step_error
    grown = np.cumsum(grown)
    outlier = _outliers(step_error) if outlier_rad is None else np.abs(step_error) > outlier_rad
    lost = None if all_lost is None else np.asarray(all_lost, dtype=bool)[step_end]
    return ErrorAnatomy(
        along_track_rmse_m=_rms(along),
        cross_track_rmse_m=_rms(across),
        bias_deg_per_s={window: yaw_bias_deg_per_s(grown, time_s, window, offsets) for window in BIAS_WINDOWS_S},
        outlier_share=_share(outlier),
        outlier_energy=_energy(step_error, outlier),
        all_lost_share=float("nan") if lost is None else _share(lost),
        all_lost_energy=float("nan") if lost is None else _energy(step_error, lost),
    )


def _outliers(errors: FloatArray) -> BoolArray:
    """``(N,)`` more than 3 robust sigmas from the median."""
    if not len(errors):
        return np.zeros(0, dtype=bool)
    spread = np.abs(errors - np.median(errors))
    return spread > OUTLIER_SIGMAS * MAD_TO_SIGMA * np.median(spread)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def _share(chosen: BoolArray) -> float:
    return float(np.mean(chosen)) if len(chosen) else float("nan")


def _energy(values: FloatArray, chosen: BoolArray) -> float:
    total = float(np.sum(np.square(values)))
    return float(np.sum(np.square(values[chosen]))) / total if total > 0.0 else float("nan")
