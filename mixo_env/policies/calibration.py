"""How large an expert's errors are: its own standard deviation times a factor, a constant where it states none."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled, inlined
from mixo_env.geometry import MAD_TO_SIGMA
from mixo_env.policies.policy import Observation
from mixo_env.policies.robust import SMALLEST_SCALE_RAD
from mixo_env.policies.storage import LARGEST
from mixo_env.recordings.collection import Recordings

FloatArray = NDArray[np.float64]

WINDOW_S = 2.0
"""Long enough for the noise of poses to fade, short enough for many windows without a loss."""

FEWEST = 30
"""Windows that tell more than single steps do."""


@dataclass(frozen=True)
class Past:
    """What experts did on training scenes; NaN where an expert delivered nothing.

    Attributes:
        error_rad: ``(rows, experts)`` own increment minus truth.
        stated_rad: ``(rows, experts)`` standard deviation of the increment as stated by the expert.
        truth_rad: ``(rows,)`` true increment.
        dt_s: ``(rows,)``.
        offsets: ``(scenes + 1,)`` rows of the scenes.
    """

    error_rad: FloatArray
    stated_rad: FloatArray
    truth_rad: FloatArray
    dt_s: FloatArray
    offsets: NDArray[np.int64]

    @classmethod
    def read(cls, training: Recordings, experts: tuple[str, ...]) -> Past:
        """Gather it from training scenes."""
        truth = training["truth.yaw_increment_rad"].astype(np.float64)

        def column(name: str) -> FloatArray:
            return training[name].astype(np.float64) if name in training else np.full(len(truth), np.nan)

        error = np.stack([column(f"{e}.yaw_increment_rad") - truth for e in experts], axis=-1)
        stated = np.stack([column(f"{e}.yaw_std_rad") for e in experts], axis=-1)
        stated[~(stated > 0.0)] = np.nan
        return cls(error, stated, truth, training["dt_s"].astype(np.float64), training.offsets)


@dataclass(frozen=True)
class Calibration:
    """Standard deviations of the experts' errors, ``(experts,)`` each; infinite for one that was never seen.

    Attributes:
        std_rad: of an increment that comes without a statement of its own.
        factor: of the standard deviation that an expert states.
    """

    std_rad: FloatArray
    factor: FloatArray

    @classmethod
    def fit(cls, past: Past) -> Calibration:
        """1.4826 x the median size of summed errors over what independent ones would sum to.

        Sums over ``WINDOW_S``: one step tells mostly the noise of the true poses, which cancels from step to step,
        while the errors of an expert lean to one side for a while; and heading is made of sums.
        """
        return cls.over(past, max(1, round(WINDOW_S / float(np.nanmedian(past.dt_s)))))

    @classmethod
    def over(cls, past: Past, steps: int) -> Calibration:
        """The same of sums over ``steps`` steps; 1 for a policy that has a model of what stays."""
        constant = np.where(np.isfinite(past.error_rad), 1.0, np.nan)
        return cls(
            np.maximum(_summed(past, constant, steps), SMALLEST_SCALE_RAD),
            np.maximum(_summed(past, past.stated_rad, steps), SMALLEST_SCALE_RAD),
        )

    def std(self, observation: Observation) -> FloatArray:
        """Standard deviations ``(batch, experts)`` of the coming increments [rad], never below 1e-6."""
        stated = observation["yaw_rate_std"]
        std = np.empty(stated.shape)
        _scale(stated, observation["dt"], self.std_rad, self.factor, std)
        return std

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Both arrays."""
        return {"std_rad": self.std_rad, "factor": self.factor}

    @staticmethod
    def shapes(experts: int) -> dict[str, tuple[int, ...]]:
        """Of :meth:`tensors`."""
        return {"std_rad": (experts,), "factor": (experts,)}

    @classmethod
    def restore(cls, tensors: Mapping[str, NDArray[Any]]) -> Calibration:
        """From :meth:`tensors`.

        Raises:
            ValueError: for values that :meth:`fit` cannot give.
        """
        for name in ("std_rad", "factor"):
            values = tensors[name]
            if np.any(values < SMALLEST_SCALE_RAD) or np.any(values[np.isfinite(values)] > LARGEST):
                raise ValueError(f"expected {name} from {SMALLEST_SCALE_RAD:g} to {LARGEST:g}, or infinite")
        return cls(tensors["std_rad"].astype(np.float64), tensors["factor"].astype(np.float64))


def _summed(past: Past, std: FloatArray, steps: int) -> FloatArray:
    """Size ``(experts,)`` of errors summed over ``steps`` steps, over the root of their summed variances.

    An expert with fewer than ``FEWEST`` such windows is judged by single steps.
    """
    with np.errstate(invalid="ignore"):
        alone = robust_std(past.error_rad / std)
        told = np.isfinite(std)
        error = window_sums(np.where(told, past.error_rad, np.nan), past.offsets, steps)
        ratio = error / np.sqrt(window_sums(std**2, past.offsets, steps))
    return np.where(np.isfinite(ratio).sum(axis=0) < FEWEST, alone, robust_std(ratio))


def window_sums(values: FloatArray, offsets: NDArray[np.int64], steps: int) -> FloatArray:
    """Sums over all ``steps`` consecutive steps of a scene.

    Args:
        values: ``(rows, n)``; row 0 of a scene is no step.
        offsets: ``(scenes + 1,)`` rows of the scenes.
        steps: 1 or more.

    Returns:
        ``(windows, n)``; NaN where one of the steps is.
    """
    told = np.isfinite(values)
    parts = np.where(told, values, 0.0), 1.0 * told
    total, known = (np.concatenate([np.zeros((1, part.shape[1])), np.cumsum(part, axis=0)]) for part in parts)
    starts = [np.arange(first + 1, stop - steps + 1) for first, stop in itertools.pairwise(offsets)]
    at = np.concatenate([np.zeros(0, np.int64), *starts])
    return np.where(known[at + steps] - known[at] == steps, total[at + steps] - total[at], np.nan)


@compiled
def _scale(
    stated: NDArray[np.float32], dt: NDArray[np.float32], std_rad: FloatArray, factor: FloatArray, std: FloatArray
) -> None:
    for b in range(len(stated)):
        scale_row(stated[b], dt[b, 0], std_rad, factor, std[b])


@inlined
def scale_row(stated: NDArray[np.float32], dt: float, std_rad: FloatArray, factor: FloatArray, std: FloatArray) -> None:
    """Write :meth:`Calibration.std` of one scene; all ``(experts,)``."""
    for e in range(len(std_rad)):
        told = (stated[e] > 0.0) & (factor[e] < np.inf)
        std[e] = max(factor[e] * stated[e] * dt, SMALLEST_SCALE_RAD) if told else std_rad[e]


def robust_std(values: FloatArray) -> FloatArray:
    """1.4826 x the median of ``|values|`` ``(rows, n)`` over the finite rows; infinite without any."""
    size = np.abs(values)
    told = np.isfinite(size)
    some = told.any(axis=0)
    result = np.full(size.shape[1], np.inf)
    if some.any():
        result[some] = MAD_TO_SIGMA * np.nanmedian(np.where(told, size, np.nan)[:, some], axis=0)
    return result
