"""The leaderboard as text: on the terminal, as Markdown, as JSON and as one CSV line per scene."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import FloatArray
from mixo_env.leaderboard.board import ONE_FOLD, RANKING_LOGS, Leaderboard, Row, Table
from mixo_env.metrics.bootstrap import Interval
from mixo_env.metrics.relative import RelativeSamples
from mixo_env.metrics.tracks import LostTracks
from mixo_env.recordings.schema import TRACKS
from mixo_env.tables import Column, csv_cell
from mixo_env.tables import Table as TextTable

COLUMNS = ("policy", "RTE %", "RTE deg/m", "ATE m", "ATE deg", "lost/scene", "yaw deg", "> 0.5 m")
EXACT_COLUMNS = ("exact %", "exact deg/m")
NARROW_COLUMNS = COLUMNS[:6]
PRIVILEGED = " †"
REFERENCE = " *"
WIDE = 156
"""Characters the full table takes on the terminal."""

LEGEND = (
    "Lower is better. RTE: pooled relative error, with its 95 % interval; ATE: mean over scenes; lost: tracks lost per "
    "scene, mean ± standard deviation (a fused method loses track when no camera tracks; -: no track to lose); yaw: "
    "RMSE of one step's increment; > 0.5 m: share of scenes with a larger ATE. † reads ground truth; * has no vote in "
    "this track."
)


def conventions(board: Leaderboard) -> list[str]:
    """Everything needed to read the numbers, one sentence a line."""
    protocol, recordings = board.protocol, board.recordings
    pieces = board.courses["truth"].pieces().items()
    samples = ", ".join(f"{length:g} m {count} ({scenes})" for length, (count, scenes) in pieces)
    if protocol.foreign:
        folds = (
            "Fewer than two folds: learned policies were fitted on the bundled recordings, wheel scale and course "
            "offset are nominal."
        )
    else:
        folds = (
            f"{len(protocol.folds)} folds by log: learned policies, wheel scale and course offset are fitted on the "
            "other folds."
        )
        if any(table.one_fold is not None for table in board.tables):
            folds += f" {', '.join(ONE_FOLD)} is fitted once and tested on fold {protocol.folds[-1]}."
    size = f"{_count(len(recordings), 'scene')} of {_count(board.logs, 'log')}"
    intervals = f"Intervals: bootstrap over {board.logs} logs." if board.logs > 1 else "Intervals: none, one log."
    lines = [
        f"Data {recordings.manifest.data_version}: {size}"
        + (f", {_count(protocol.left_out, 'scene')} outside the folds left out" if protocol.left_out else "")
        + f"; seed {protocol.seed}.",
        "Alignment: none, the first pose is the truth's. Truth: the written poses"
        + ("; exact: the simulator's noise-free ones." if "exact" in board.courses else "."),
        f"RTE: mean over all pieces of path, starts 1 m apart; pieces (scenes) per length: {samples}.",
        f"{intervals} {folds}",
    ]
    instantly = {row.run.name: row for row in board.tables[0].rows if not row.fused and row.lost_instantly}
    if instantly:
        counts = ", ".join(f"{name} {_mean_std_text(row, row.lost_instantly)}" for name, row in instantly.items())
        lines.append(f"Lost per scene if cameras tracked again with the first good pair of images: {counts}.")
    if board.logs < RANKING_LOGS:
        lines.append(f"{size}: enough to see that everything works, claims no ranking (takes {RANKING_LOGS} logs).")
    return lines


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def title(table: Table) -> str:
    """What votes in this track."""
    inertial = TRACKS[table.track]
    votes = f"the cameras and {inertial} vote" if inertial else "the cameras vote, inertial gives distance and bridges"
    return f"Track {table.track}: {votes}"


def notes(table: Table) -> list[str]:
    """LINEAR's weights and what was left out."""
    lines = []
    if weights := table.linear_weights():
        experts = next(iter(weights.values()))
        mean = {expert: float(np.mean([fold[expert] for fold in weights.values()])) for expert in experts}
        parts = ", ".join(f"{expert} {weight:.3f}" for expert, weight in mean.items())
        lines.append(
            f"LINEAR weights{', mean over folds' if len(weights) > 1 else ''}: {parts}; sum {sum(mean.values()):.3f}."
        )
    lines += [f"{name} left out: {why}." for name, why in table.left_out.items()]
    return lines


def sections(table: Table) -> list[list[Row]]:
    """Rows in groups: single experts, policies that fuse, privileged rows."""
    privileged = [row for row in table.rows if row.run.privileged]
    fused = [row for row in table.rows if not row.run.privileged and row.fused]
    single = [row for row in table.rows if not row.run.privileged and not row.fused]
    return [group for group in (single, fused, privileged) if group]


def cells(row: Row, *, intervals: bool = True) -> dict[str, str]:
    """Column -> text of one line of a table."""
    score = row.scores["truth"]
    line = {
        "policy": row.run.name + (PRIVILEGED if row.run.privileged else "") + ("" if row.votes else REFERENCE),
        "RTE %": _interval(score.translation_percent, 2, intervals),
        "RTE deg/m": _interval(score.rotation_deg_per_m, 4, intervals),
        "ATE m": f"{score.ate_m:.2f}",
        "ATE deg": f"{score.ate_deg:.3f}",
        "lost/scene": _mean_std_text(row, row.lost),
        "yaw deg": f"{score.yaw_increment_rmse_deg:.4f}",
        "> 0.5 m": f"{100.0 * score.high_ate_share:.0f} %",
    }
    if exact := row.scores.get("exact"):
        line["exact %"] = _interval(exact.translation_percent, 2, False)
        line["exact deg/m"] = _interval(exact.rotation_deg_per_m, 4, False)
    return line


def to_markdown(board: Leaderboard) -> str:
    """All tables with their conventions, and the one-fold comparison below each."""
    columns = COLUMNS + (EXACT_COLUMNS if "exact" in board.courses else ())
    parts = ["# MixoOdometry leaderboard", "\n".join(f"* {line}" for line in conventions(board)), LEGEND]
    for table in board.tables:
        if table.rows:
            rows = [row for group in sections(table) for row in group]
            parts.append(_markdown_table(f"## {title(table)}", rows, columns))
        if table.one_fold_rows:
            parts.append(_markdown_table(f"### {_one_fold_title(table)}", table.one_fold_rows, columns))
        parts += notes(table)
    return "\n\n".join(parts) + "\n"


def print_leaderboard(board: Leaderboard) -> None:
    """The same on the terminal; a narrow one leaves out intervals and the last columns, which the files keep."""
    from rich.console import Console

    console = Console(highlight=False, width=None if sys.stdout.isatty() else WIDE)
    wide = console.width >= WIDE
    columns = COLUMNS + (EXACT_COLUMNS if "exact" in board.courses else ()) if wide else NARROW_COLUMNS
    for table in board.tables:
        if table.rows:
            console.print(_rich_table(title(table), sections(table), columns, wide))
        if table.one_fold_rows:
            console.print(_rich_table(_one_fold_title(table), [list(table.one_fold_rows)], columns, wide))
        for line in notes(table):
            console.print(line)
        console.print()
    for line in (*conventions(board), LEGEND):
        console.print(line)


def to_json(board: Leaderboard) -> dict[str, Any]:
    """Every number of the tables as plain values, full precision."""
    recordings = board.recordings
    return {
        "data_version": recordings.manifest.data_version,
        "scenes": [scene.name for scene in recordings.scenes],
        "logs": board.logs,
        "folds": list(board.protocol.folds),
        "seed": board.protocol.seed,
        "conventions": conventions(board),
        "lengths": [
            {"length_m": length, "samples": samples, "scenes": scenes}
            for length, (samples, scenes) in board.courses["truth"].pieces().items()
        ],
        "tracks": {
            table.track: {
                "rows": [_row_json(row) for row in table.rows],
                "one_fold": table.one_fold,
                "one_fold_rows": [_row_json(row) for row in table.one_fold_rows],
                "linear_weights": {str(fold): weights for fold, weights in table.linear_weights().items()},
                "left_out": table.left_out,
            }
            for table in board.tables
        },
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
    for table in board.tables:
        tested_in_part = [row for row in table.one_fold_rows if row.run.name not in {r.run.name for r in table.rows}]
        for row in (*table.rows, *tested_in_part):
            for truth, errors in row.errors.items():
                translation, rotation, samples = _scene_means(errors.relative, len(entries))
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
                    names = (table.track, row.run.name, int(row.run.privileged), truth)
                    texts = map(csv_cell, (*names, entries[i].name, entries[i].log))
                    writer.writerow([*texts, entries[i].fold, *numbers])
    return text.getvalue()


def _scene_means(samples: RelativeSamples, scenes: int) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Mean RTE [%] and [deg/m] of each scene ``(scenes,)``, NaN without a sample, and their number."""
    counts = np.bincount(samples.scene, minlength=scenes)
    sums = (
        np.bincount(samples.scene, weights=values, minlength=scenes)
        for values in (samples.translation_percent, samples.rotation_deg_per_m)
    )
    translation, rotation = (np.where(counts > 0, total / np.maximum(counts, 1), np.nan) for total in sums)
    return translation, rotation, counts


def _row_json(row: Row) -> dict[str, Any]:
    lost, instantly = (_lost_mean_std(row, lost) for lost in (row.lost, row.lost_instantly))
    return {
        "policy": row.run.name,
        "privileged": row.run.privileged,
        "reference": not row.votes,
        "lost_per_scene": lost and {"mean": lost[0], "std": lost[1]},
        "lost_per_scene_instantly": instantly and {"mean": instantly[0], "std": instantly[1]},
        "scores": {truth: asdict(score) for truth, score in row.scores.items()},
    }


def _interval(value: Interval, digits: int, with_ends: bool) -> str:
    if np.isnan(value.mean):
        return "-"  # no scene is long enough for a sample
    ends = f" [{value.low:.{digits}f}, {value.high:.{digits}f}]" if with_ends and np.isfinite(value.low) else ""
    return f"{value.mean:.{digits}f}{ends}"


def _mean_std_text(row: Row, lost: LostTracks | None) -> str:
    mean_std = _lost_mean_std(row, lost)
    return "-" if mean_std is None else f"{mean_std[0]:.2f} ± {mean_std[1]:.2f}"


def _lost_mean_std(row: Row, lost: LostTracks | None) -> tuple[float, float] | None:
    if lost is None:
        return None
    counts = lost.counts[row.run.tested]
    return float(counts.mean()), float(counts.std())


def _one_fold_title(table: Table) -> str:
    return f"{table.track}, learned policies on fold {table.one_fold} alone"


def _markdown_table(caption: str, rows: Sequence[Row], columns: Sequence[str]) -> str:
    texts = [cells(row) for row in rows]
    headings = tuple(Column(column) for column in columns)
    return TextTable(caption, headings, [[text[column] for column in columns] for text in texts]).markdown()


def _rich_table(title: str, groups: Sequence[Sequence[Row]], columns: Sequence[str], intervals: bool) -> Any:
    from rich import box
    from rich.table import Table as RichTable

    table = RichTable(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 0, 0, 1))
    for column in columns:
        table.add_column(column, justify="left" if column == "policy" else "right", no_wrap=True)
    for group in groups:
        for row in group:
            texts = cells(row, intervals=intervals)
            table.add_row(*(texts[column] for column in columns), end_section=row is group[-1])
    return table
