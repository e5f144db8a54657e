"""Every number of the leaderboard as plain values: JSON, and one CSV line per scene."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mixo_env.leaderboard.anatomy import OUTLIER_SIGMAS
from mixo_env.leaderboard.board import Leaderboard, Standings
from mixo_env.leaderboard.comparisons import REFERENCES, Comparison, Comparisons
from mixo_env.leaderboard.evaluation import scene_means
from mixo_env.leaderboard.firing_order import firing_order
from mixo_env.leaderboard.rows import Row
from mixo_env.leaderboard.sentences import conventions, lost_mean_std
from mixo_env.recordings.presets import recorded_preset
from mixo_env.recordings.schema import TRUE_DISTANCE
from mixo_env.tables import csv_cell


def to_json(board: Leaderboard) -> dict[str, Any]:
    """Every number of the tables, full precision."""
    recordings, protocol = board.recordings, board.protocol
    manifest = recordings.manifest
    order = firing_order(recordings, board.headline)
    return {
        "data_version": manifest.data_version,
        "preset": recorded_preset(manifest),
        "distance": {"from": manifest.distance, "privileged": manifest.distance == TRUE_DISTANCE},
        "scenes": [scene.name for scene in recordings.scenes],
        "logs": board.logs,
        "folds": list(protocol.folds),
        "seed": protocol.trial.seed,
        "seeds": protocol.trial.seeds,
        "ground_truth": protocol.trial.ground_truth,
        "headline": board.headline,
        "noise_floor_deg_per_m": board.noise_floor,
        "conventions": conventions(board),
        "firing_order": order and _plain(asdict(order) | {"cost_deg": order.cost_deg}),
        "lengths": [
            {"length_m": length, "samples": samples, "scenes": scenes}
            for length, (samples, scenes) in board.truths[board.headline].pieces().items()
        ],
        "outlier_sigmas": OUTLIER_SIGMAS,
        "tracks": {standings.track: _table_json(standings) for standings in board.standings},
        "night": board.night and to_json(board.night),
    }


def _table_json(standings: Standings) -> dict[str, Any]:
    part, of_part = standings.one_fold_rows, standings.one_fold_comparisons
    return {
        "rows": [_row_json(row, standings.comparisons, standings.rows) for row in standings.rows],
        "comparisons": _comparisons_json(standings.comparisons),
        "one_fold": standings.one_fold,
        "one_fold_rows": [_row_json(row, of_part, part) for row in part],
        "one_fold_comparisons": _comparisons_json(of_part),
        "groups": [
            {
                "by": group.by,
                "name": group.name,
                "rows": [_row_json(row, group.comparisons, group.rows) for row in group.rows],
                "logs": group.comparisons.logs,
                "letters": dict(group.comparisons.letters),
            }
            for group in standings.groups
        ],
        "linear_weights": {str(fold): weights for fold, weights in standings.linear_weights().items()},
        "left_out": standings.left_out,
    }


def to_csv(board: Leaderboard) -> str:
    """One line per track, policy, truth and tested scene."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        [
            *("track", "policy", "privileged", "truth", "scene", "log", "fold"),
            *(
                "ate_m",
                "ate_deg",
                "rte_percent",
                "rte_deg_per_m",
                "rte_samples",
                "yaw_increment_rmse_deg",
                "lost_tracks",
            ),
        ]
    )
    entries = board.recordings.scenes
    for standings in board.standings:
        tested_in_part = [row for row in standings.one_fold_rows if row.name not in {r.name for r in standings.rows}]
        for row in (*standings.rows, *tested_in_part):
            for truth, errors in row.errors.items():
                translation, rotation, samples = scene_means(errors.relative, len(entries))
                for i in np.flatnonzero(row.run.tested):
                    numbers = (
                        errors.absolute.translation_m[i],
                        errors.absolute.rotation_deg[i],
                        translation[i],
                        rotation[i],
                        samples[i],
                        np.sqrt(errors.squared_yaw_increment_deg2[i] / errors.steps[i]),
                        row.lost.counts[i] if row.lost else "",
                    )
                    names = (standings.track, row.name, int(row.run.privileged), truth, entries[i].name, entries[i].log)
                    writer.writerow([*map(csv_cell, names), entries[i].fold, *numbers])
    return text.getvalue()


def _row_json(row: Row, comparisons: Comparisons, rows: Sequence[Row]) -> dict[str, Any]:
    found = {reference: comparisons.between(row.name, reference) for reference in REFERENCES}
    lost, instantly = (lost_mean_std(row, lost) for lost in (row.lost, row.lost_instantly))
    return {
        "policy": row.name,
        "privileged": row.run.privileged,
        "reference": not row.votes,
        "fused": row.fused,
        "letters": comparisons.letters.get(row.name, ""),
        "differences": {name: one and comparison_json(one) for name, one in found.items()},
        "lost_per_scene": lost and {"mean": lost[0], "std": lost[1]},
        "lost_per_scene_instantly": instantly and {"mean": instantly[0], "std": instantly[1]},
        "scores": {truth: asdict(score) for truth, score in row.scores.items()},
        "interquartile_mean_deg_per_m": row.interquartile_mean(),
        "probability_of_improvement": {
            other.name: row.improvement_on(other) for other in rows if other.name in REFERENCES and other is not row
        },
        "lengths": [asdict(length) for length in row.lengths],
        "anatomy": row.anatomy and asdict(row.anatomy),
    }


def comparison_json(found: Comparison) -> dict[str, Any]:
    """Every number of a paired difference."""
    return asdict(found) | {"share": found.share}


def _comparisons_json(comparisons: Comparisons) -> dict[str, Any]:
    return {
        "logs": comparisons.logs,
        "confirmatory": [comparison_json(found) for found in comparisons.confirmatory],
        "exploratory": [comparison_json(found) for found in comparisons.exploratory],
        "letters": dict(comparisons.letters),
    }


def _plain(value: Any) -> Any:
    """Arrays as lists, in nested dictionaries."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value
