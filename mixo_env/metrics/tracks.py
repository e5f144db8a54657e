"""Lost tracks: how often, for how many steps and how long in one go (docs/metrics.md, "Lost tracks")."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.metrics.pairs import IntArray, scene_offsets

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class LostTracks:
    """Lost tracks of one camera, or of one fused method.

    Attributes:
        counts: ``(scenes,)`` transitions from tracking to lost.
        steps: ``(scenes,)`` steps spent lost.
        longest_run: ``(scenes,)`` steps of the longest uninterrupted loss.
        mean, std: of ``counts`` over scenes; the standard deviation divides by the number of scenes (ddof 0).
    """

    counts: IntArray
    steps: IntArray
    longest_run: IntArray
    mean: float
    std: float


def count_lost_tracks(
    tracking: BoolArray,
    offsets: IntArray | None = None,
    *,
    lost: BoolArray | None = None,
    observed: BoolArray | None = None,
) -> LostTracks:
    """Count TRACKING -> LOST transitions per scene.

    For a camera pass ``tracking`` and ``lost`` (initialising is neither). A fused method loses track when no *camera*
    is tracking: pass ``tracking=any_camera_tracking`` alone. The inertial expert is never lost, so counting it would
    make the column 0 by construction. Initialising before the first track is no loss: a transition needs a track.

    Args:
        tracking: ``(N,)`` the state is TRACKING, scene after scene.
        offsets: ``(scenes + 1,)`` first row of each scene and the end; ``None``: one scene.
        lost: ``(N,)`` the state is LOST; ``None``: whenever not tracking.
        observed: ``(N,)`` the camera delivered an image; steps without one say nothing about the track and are
            skipped. ``None``: all.
    """
    offsets = scene_offsets(len(tracking), offsets)
    tracking = np.asarray(tracking, dtype=bool)
    lost = ~tracking if lost is None else np.asarray(lost, dtype=bool)
    seen = np.ones(len(tracking), dtype=bool) if observed is None else np.asarray(observed, dtype=bool)
    scenes = len(offsets) - 1
    counts, steps, longest = (np.zeros(scenes, dtype=np.int64) for _ in range(3))
    for scene, (first, stop) in enumerate(itertools.pairwise(offsets)):
        rows = np.flatnonzero(seen[first:stop]) + first
        here = lost[rows]
        counts[scene] = np.count_nonzero(tracking[rows][:-1] & here[1:])
        steps[scene] = np.count_nonzero(here)
        longest[scene] = longest_true_run(here)
    mean, std = (float(np.mean(counts)), float(np.std(counts))) if scenes else (np.nan, np.nan)
    return LostTracks(counts, steps, longest, mean, std)


def longest_true_run(flags: BoolArray) -> int:
    """Length of the longest uninterrupted stretch of true values in ``(N,)``."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int8), [0]]))
    runs = np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)
    return int(runs.max(initial=0))
