"""What can be told of an odometry without the truth: signals that may warn of a large error, and one number of all."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mixo_env.policies.calibration import Calibration, Past
from mixo_env.policies.consensus import SAFE, find_consensus
from mixo_env.recordings.collection import Recordings

FloatArray = NDArray[np.float64]

FORGETTING = 0.1
"""Share of the newest step in what disagreed lately: a memory of about a second."""
COMBINED = "combined"
FLOORS = {
    "few matches": 1.0,
    "few inliers": 0.01,
    "residual": 0.01,
    "flow": 0.1,
    "stated deviation": 1e-5,
    "jump": 1e-4,
    "two images": 1e-5,
    "disagreement": 1e-5,
    "disagreement, lately": 1e-5,
}
"""Signal -> what is added to its size before the logarithm is taken, in its own unit (features, share, px, rad)."""


def signals(training: Recordings, recordings: Recordings, experts: tuple[str, ...]) -> dict[str, dict[str, FloatArray]]:
    """What can be told without the truth: expert -> signal -> ``(rows,)``, the higher the more suspicious.

    Every signal is known when the step is over. The consensus is that of the *other* experts (STUDENT-T, nu = 5).

    Args:
        training: scenes that tell how large the experts' errors usually are.
        recordings: scenes whose signals are wanted.
        experts: those that are compared.
    """
    calibration = Calibration.fit(Past.read(training, experts))
    dt_s = recordings["dt_s"]
    increments = np.stack([recordings[f"{e}.yaw_increment_rad"].astype(np.float64) for e in experts], axis=1)
    stated = np.stack([recordings[f"{e}.yaw_std_rad"].astype(np.float64) for e in experts], axis=1)
    usual = np.where(np.isfinite(calibration.factor * stated), calibration.factor * stated, calibration.std_rad)
    result: dict[str, dict[str, FloatArray]] = {}
    for i, expert in enumerate(experts):

        def column(name: str, expert: str = expert) -> FloatArray:
            full = f"{expert}.{name}"
            return recordings[full].astype(np.float64) if full in recordings else np.full(len(dt_s), np.nan)

        matches = column("matches")
        apart = np.abs(increments[:, i] - of_the_others(increments, usual, i))
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = increments[:, i] / dt_s
            inliers = column("inliers") / matches
        result[expert] = {
            "few matches": -matches,
            "few inliers": -inliers,
            "residual": column("residual_px"),
            "flow": column("flow_px"),
            "stated deviation": stated[:, i],
            "jump": np.abs(_change(rate, recordings.offsets)),
            "two images": np.abs(increments[:, i] - column("two_frame_yaw_increment_rad")),
            "disagreement": apart,
            "disagreement, lately": lately(apart, recordings.offsets),
        }
    return result


def of_the_others(increments: FloatArray, std: FloatArray, expert: int) -> FloatArray:
    """Consensus ``(rows,)`` of all experts but one; NaN where none of them gives anything.

    Args:
        increments: ``(rows, experts)`` [rad], NaN where there is none.
        std: ``(rows, experts)`` usual size of their errors [rad].
        expert: the one left out.
    """
    counts = np.isfinite(increments) & np.isfinite(std)
    counts[:, expert] = False
    weights = np.zeros(increments.shape)
    values = np.nan_to_num(increments)
    find_consensus(values, np.where(np.isfinite(std), std, np.inf), counts, SAFE, weights)
    return np.where(counts.any(axis=1), np.sum(weights * values, axis=1), np.nan)


def lately(apart: FloatArray, offsets: NDArray[np.int64]) -> FloatArray:
    """Exponentially forgetting mean ``(rows,)`` of what is known; a scene begins with its first value."""
    result = np.full(len(apart), np.nan)
    for first, stop in itertools.pairwise(offsets.tolist()):
        mean = np.nan
        for k in range(first, stop):
            if np.isfinite(apart[k]):
                mean = apart[k] if np.isnan(mean) else mean + FORGETTING * (apart[k] - mean)
            result[k] = mean
    return result


def fit_combined(known: Mapping[str, FloatArray], error_rad: FloatArray) -> Mapping[str, tuple[float, float, float]]:
    """Least squares of the logarithm of the error on those of all signals that the expert has.

    Returns:
        Signal -> weight, and mean and deviation of its logarithm; nothing without a step to learn from.
    """
    names = [name for name, values in known.items() if np.isfinite(values).any()]
    logs = {name: _log(name, known[name]) for name in names}
    size = np.log(np.abs(error_rad) + FLOORS["disagreement"])
    rows = np.isfinite(size) & np.all([np.isfinite(logs[name]) for name in names], axis=0)
    if rows.sum() <= len(names):
        return {}
    mean, std = ({name: float(of(logs[name][rows])) for name in names} for of in (np.mean, np.std))
    x = np.stack([(logs[name][rows] - mean[name]) / max(std[name], 1e-9) for name in names], axis=1)
    weights = np.linalg.lstsq(x, size[rows] - size[rows].mean(), rcond=None)[0]
    return {name: (float(w), mean[name], max(std[name], 1e-9)) for name, w in zip(names, weights, strict=True)}


def combined(told: Mapping[str, FloatArray], weights: Mapping[str, tuple[float, float, float]]) -> FloatArray:
    """One number of all signals ``(rows,)``, as fitted; a missing one counts as usual."""
    total = np.zeros(len(next(iter(told.values()))))
    for name, (weight, mean, std) in weights.items():
        total += weight * np.nan_to_num((_log(name, told[name]) - mean) / std)
    return total if weights else np.full(len(total), np.nan)


def _change(values: FloatArray, offsets: NDArray[np.int64]) -> FloatArray:
    change = np.diff(values, prepend=np.nan)
    change[offsets[:-1]] = np.nan
    return change


def _log(name: str, values: FloatArray) -> FloatArray:
    return np.log(np.abs(values) + FLOORS[name])
