"""How well a number warns of an event: the ROC curve, its area with an interval over groups, and its false alarms."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.geometry import FloatArray
from mixo_env.metrics.bootstrap import RESAMPLES, Interval, draws, percentile_interval


def roc(signal: ArrayLike, event: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Every trade of false alarms for detections that a threshold on the signal can make.

    Args:
        signal: ``(n,)`` finite; the higher, the more it warns.
        event: ``(n,)`` whether it was right to warn.

    Returns:
        ``(m,)`` thresholds from infinity down, the share of quiet samples at or above each (false alarms), and the
        share of events there (detections). Samples of equal signal are told together.

    Raises:
        ConfigurationError: without an event, without a quiet sample, or for a signal that is not finite.
    """
    value, happened = _checked(signal, event)
    order = np.argsort(-value, kind="stable")
    value, happened = value[order], happened[order]
    last = np.append(np.diff(value) != 0.0, True)
    detected, alarmed = np.cumsum(happened)[last], np.cumsum(~happened)[last]
    thresholds = np.concatenate([[np.inf], value[last]])
    return (
        thresholds,
        np.concatenate([[0.0], alarmed / alarmed[-1]]),
        np.concatenate([[0.0], detected / detected[-1]]),
    )


def false_alarms(signal: ArrayLike, event: ArrayLike, detection: float) -> tuple[float, float]:
    """The highest threshold that finds at least the share ``detection`` of the events.

    Returns:
        Threshold, and the share of quiet samples at or above it.
    """
    thresholds, alarmed, detected = roc(signal, event)
    at = int(np.argmax(detected >= detection - 1e-12))
    return float(thresholds[at]), float(alarmed[at])


def area_under_roc(
    signal: ArrayLike,
    event: ArrayLike,
    groups: ArrayLike,
    *,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Interval:
    """Chance that the signal is higher in an event than in a quiet sample, ties counted half (Hanley, McNeil 1982).

    The interval is a percentile bootstrap that draws whole groups: with ``c[g, h]`` the pairs won by events of group g
    over quiet samples of group h, the area of groups drawn d times is ``d c d`` over the number of pairs drawn. Draws
    without an event or a quiet sample are left out.

    Args:
        signal: ``(n,)`` finite; the higher, the more it warns.
        event: ``(n,)``.
        groups: ``(n,)`` label of each sample's group, e.g. its log.
        confidence: share of resampled areas inside the interval.
        resamples: bootstrap draws.
        seed: of the draws.
    """
    value, happened = _checked(signal, event)
    names, group = np.unique(np.asarray(groups), return_inverse=True)
    won = _pairs_won(value, happened, group, len(names))
    events, quiet = (np.bincount(group[which], minlength=len(names)) for which in (happened, ~happened))
    mean = float(won.sum() / (events.sum() * quiet.sum()))
    if len(names) < 2:
        return Interval(mean, math.nan, math.nan, len(names), confidence)
    drawn = draws(len(names), resamples, seed)
    with np.errstate(divide="ignore", invalid="ignore"):
        areas = ((drawn @ won) * drawn).sum(axis=1) / ((drawn @ events) * (drawn @ quiet))
    return percentile_interval(mean, areas[~np.isnan(areas)], len(names), confidence)


def _pairs_won(value: FloatArray, happened: NDArray[np.bool_], group: NDArray[np.intp], groups: int) -> FloatArray:
    """``(groups, groups)`` pairs of an event of the first group and a quiet sample of the second that it exceeds."""
    risen, of = value[happened], group[happened]
    won = np.zeros((groups, groups))
    for h in range(groups):
        quiet = np.sort(value[~happened & (group == h)])
        above, with_ties = (np.searchsorted(quiet, risen, side=side) for side in ("left", "right"))
        won[:, h] = np.bincount(of, weights=0.5 * (above + with_ties), minlength=groups)
    return won


def _checked(signal: ArrayLike, event: ArrayLike) -> tuple[FloatArray, NDArray[np.bool_]]:
    value, happened = np.asarray(signal, dtype=np.float64), np.asarray(event, dtype=np.bool_)
    if value.shape != happened.shape or not np.isfinite(value).all():
        raise ConfigurationError(
            f"expected one finite value of the signal for each of {happened.size} samples: leave the others out"
        )
    if not happened.any() or happened.all():
        raise ConfigurationError(f"expected events and quiet samples, got {happened.sum()} events of {happened.size}")
    return value, happened
