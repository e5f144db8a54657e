"""Every row's way through the scenes, small enough for a page: paths, weights over time, lost marks."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.replay import Replay
from mixo_env.experts.expert import State
from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.board import Leaderboard, Standings
from mixo_env.leaderboard.conditions import condition_of
from mixo_env.leaderboard.crossvalidation import Run
from mixo_env.leaderboard.evaluation import poses
from mixo_env.policies.playing import play
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.variants import as_variant

POINTS = 40
"""Of a path at most: a scene lasts 20 s, so a point stands for half a second."""

MOST_NUMBERS = 700_000
"""On the page: of too many scenes, the most winding ones of every log come first."""


def drives_json(board: Leaderboard) -> dict[str, Any]:
    """Paths, weights and lost marks of as many scenes as a page bears.

    Lengths are whole centimetres (paths of rows: their distance from the true one), weights whole per cent.
    """
    recordings, truth = board.recordings, board.truths[board.headline]
    rows = max(1, sum(len(standings.rows) for standings in board.standings))
    numbers = rows * POINTS * (2 + len(recordings.experts))  # of one scene at most: a path and weights a row
    scenes = _winding_first(board)[: max(1, MOST_NUMBERS // numbers)]
    chosen = recordings.select(scenes=[recordings.scenes[i].name for i in sorted(scenes)])
    scenes, turned = sorted(scenes), _turned_rad(board)
    steps = [_thinned(*truth.offsets[i : i + 2]) for i in scenes]
    cameras = [c for c in recordings.manifest.cameras or recordings.manifest.imported if f"{c}.state" in recordings]
    return {
        "scenes": [
            {
                "name": recordings.scenes[i].name,
                "log": recordings.scenes[i].log,
                "condition": condition_of(recordings.scenes[i]),
                "turned_deg": round(float(np.degrees(turned[i]))),
                "time_s": np.round(recordings["time_s"][at] - recordings["time_s"][at[0]], 2).tolist(),
                "x_cm": _centimetres(truth.poses.x_m[at] - truth.poses.x_m[at[0]]),
                "y_cm": _centimetres(truth.poses.y_m[at] - truth.poses.y_m[at[0]]),
                "lost": {c: np.flatnonzero(_lost(recordings, c, at)).tolist() for c in cameras},
            }
            for i, at in zip(scenes, steps, strict=True)
        ],
        "left_out": len(recordings) - len(scenes),
        "tracks": {standings.track: _track(board, standings, chosen, scenes, steps) for standings in board.standings},
    }


def _track(
    board: Leaderboard, standings: Standings, chosen: Recordings, scenes: Sequence[int], steps: Sequence[NDArray[Any]]
) -> dict[str, Any]:
    """Row -> its ways and weights, scene by scene; ``None`` for a scene on which it was not tested."""
    truth, found = board.truths[board.headline], {}
    once = {row.name: row for row in (*standings.one_fold_rows, *standings.rows)}
    for row in once.values():
        way = poses(row.run.travel, truth.poses, truth.offsets)
        experts, weights = weights_of(row.run, chosen, standings.track) if row.fused else ((), {})
        found[row.name] = {
            "experts": list(experts),
            "scenes": [
                {
                    "dx_cm": _centimetres(way.x_m[at] - truth.poses.x_m[at]),
                    "dy_cm": _centimetres(way.y_m[at] - truth.poses.y_m[at]),
                    "weights": _per_cent(weights[k], at - truth.offsets[i]) if k in weights else None,
                }
                if row.run.tested[i]
                else None
                for k, (i, at) in enumerate(zip(scenes, steps, strict=True))
            ],
        }
    return found


def weights_of(run: Run, chosen: Recordings, track: str) -> tuple[Sequence[str], dict[int, FloatArray]]:
    """Experts, and scene of ``chosen`` -> ``(steps, experts)`` weights that a row gave them, played again.

    None for a privileged row, and for a scene of ``chosen`` on which it was not tested.
    """
    found: dict[int, FloatArray] = {}
    experts: Sequence[str] = ()
    if run.privileged:
        return experts, found
    recordings = as_variant(chosen, run.name)
    for fold, policy in run.policies.items():
        here = [k for k, scene in enumerate(recordings.scenes) if fold < 0 or scene.fold == fold]
        if not here:
            continue
        part = recordings.select(scenes=[recordings.scenes[k].name for k in here])
        replay = Replay(part, track=track, experts=policy.experts)
        given = [np.array(weights, dtype=np.float64) for _, _, weights in play(policy, replay)]
        experts, weights = policy.experts, np.stack(given, axis=1)
        for k, of_scene, scene in zip(here, weights, part.scenes, strict=True):
            found[k] = of_scene[: scene.rows - 1]
    return experts, found


def _winding_first(board: Leaderboard) -> list[int]:
    """All scenes: the most winding of every log, then the next of every log, and so on."""
    entries = board.recordings.scenes
    place: dict[str, int] = {}
    order = []
    for i in np.argsort(_turned_rad(board), kind="stable")[::-1].tolist():
        place[entries[i].log] = place.get(entries[i].log, -1) + 1
        order.append((place[entries[i].log], i))
    return [i for _, i in sorted(order, key=lambda one: one[0])]


def _turned_rad(board: Leaderboard) -> FloatArray:
    """``(scenes,)`` how far apart the headings of a scene lie."""
    truth = board.truths[board.headline]
    return np.array([np.ptp(truth.poses.yaw_rad[first:stop]) for first, stop in itertools.pairwise(truth.offsets)])


def _thinned(first: int, stop: int) -> NDArray[np.int64]:
    """Rows of one scene that are drawn: evenly spread, both ends among them."""
    return np.unique(np.linspace(first, stop - 1, min(POINTS, stop - first)).round().astype(np.int64))


def _lost(recordings: Recordings, camera: str, at: NDArray[np.int64]) -> NDArray[np.bool_]:
    """``(len(at),)`` the camera was lost in a step since the point before."""
    lost = np.concatenate([[0], np.cumsum(recordings[f"{camera}.state"] == State.LOST)])
    return np.diff(lost[at + 1], prepend=lost[at[0] + 1]) > 0


def _centimetres(values_m: FloatArray) -> list[int]:
    return np.nan_to_num(100.0 * values_m).round().astype(np.int64).tolist()


def _per_cent(weights: FloatArray, steps: NDArray[np.int64]) -> list[list[int]]:
    """One list an expert; the first pose, which no step led to, shows the first step's."""
    at = np.clip(steps - 1, 0, len(weights) - 1)
    return np.nan_to_num(100.0 * weights[at].T).round().astype(np.int64).tolist()
