"""The leaderboard as tables: on the terminal and as Markdown."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from mixo_env.leaderboard.board import Leaderboard, Standings
from mixo_env.leaderboard.comparisons import REFERENCES, Comparisons
from mixo_env.leaderboard.conditions import Grouping
from mixo_env.leaderboard.rows import Row
from mixo_env.leaderboard.sentences import (
    LEGEND,
    conventions,
    count_of,
    distance_words,
    mean_std_text,
    notes,
    p_text,
    percent,
    title,
)
from mixo_env.metrics.bootstrap import Interval
from mixo_env.tables import Column, Table

DIFFERENCES = tuple(f"- {reference}" for reference in REFERENCES)
COLUMNS = (
    "policy",
    "RTE deg/m",
    "letters",
    *DIFFERENCES,
    "RTE %",
    "ATE m",
    "ATE deg",
    "lost/scene",
    "yaw deg",
    "> 0.5 m",
)
SCORES = ("policy", "RTE deg/m", "RTE %", "ATE m", "ATE deg", "yaw deg")
"""A row in short: errors without comparisons."""
WRITTEN_COLUMN = "written deg/m"
LEAST_COLUMNS = ("policy", "RTE deg/m", "letters", DIFFERENCES[0])
"""Shown however narrow the terminal is; long names of rows then wrap."""
PRIVILEGED = " †"
REFERENCE = " *"
WIDE = 190
"""Characters the full table takes on the terminal."""

Order = Literal["table", "deg/m", "%", "ate-m", "ate-deg", "yaw", "written"]
"""What the rows of every section are sorted by; ``table``: the order in which they are listed."""

_KEYS: dict[Order, Callable[[Row], float]] = {
    "table": lambda row: 0.0,
    "deg/m": lambda row: row.headline.rotation_deg_per_m.mean,
    "%": lambda row: row.headline.translation_percent.mean,
    "ate-m": lambda row: row.headline.ate_m,
    "ate-deg": lambda row: row.headline.ate_deg,
    "yaw": lambda row: row.headline.yaw_increment_rmse_deg,
    "written": lambda row: written(row).mean,
}


def written(row: Row) -> Interval:
    """RTE [deg/m] against the poses as the data set has them."""
    return (row.scores.get("written") or row.scores["truth"]).rotation_deg_per_m


def sections(rows: Sequence[Row], sort: Order = "table") -> list[list[Row]]:
    """Rows in groups: single experts, policies that fuse, privileged rows; sorted within each."""
    privileged = [row for row in rows if row.run.privileged]
    fused = [row for row in rows if not row.run.privileged and row.fused]
    single = [row for row in rows if not row.run.privileged and not row.fused]
    return [sorted(group, key=_KEYS[sort]) for group in (single, fused, privileged) if group]


def columns_of(board: Leaderboard) -> tuple[str, ...]:
    """All columns; raw poses have one of their own unless they are the headline."""
    return (*COLUMNS, WRITTEN_COLUMN) if len(board.truths) > 1 else COLUMNS


def cells(row: Row, comparisons: Comparisons) -> dict[str, str]:
    """Column -> text of one line of a table."""
    score = row.headline
    line = {
        "policy": row.name + (PRIVILEGED if row.run.privileged else "") + ("" if row.votes else REFERENCE),
        "RTE deg/m": _interval(score.rotation_deg_per_m, 4, True),
        "letters": comparisons.letters.get(row.name) or "-",
        "RTE %": _interval(score.translation_percent, 2, False),
        "ATE m": f"{score.ate_m:.2f}",
        "ATE deg": f"{score.ate_deg:.3f}",
        "lost/scene": mean_std_text(row, row.lost),
        "yaw deg": f"{score.yaw_increment_rmse_deg:.4f}",
        "> 0.5 m": f"{100.0 * score.high_ate_share:.0f} %",
        WRITTEN_COLUMN: _interval(written(row), 4, False),
    }
    for reference, column in zip(REFERENCES, DIFFERENCES, strict=True):
        found = comparisons.between(row.name, reference)
        line[column] = f"{percent(found.share)} ({p_text(found.p_holm)})" if found else "-"
    return line


def parts(
    board: Leaderboard, standings: Standings, by: Sequence[Grouping]
) -> list[tuple[str, Sequence[Row], Comparisons]]:
    """Caption, rows and comparisons of every table of one track that has rows."""
    found = [(title(standings, board.recordings.manifest), standings.rows, standings.comparisons)]
    distance = distance_words(board.recordings.manifest)
    one_fold = f"{standings.track}, learned policies on fold {standings.one_fold} alone{distance}"
    found.append((one_fold, standings.one_fold_rows, standings.one_fold_comparisons))
    for group in standings.groups:
        if group.by in by:
            scenes = count_of(int(group.rows[0].run.tested.sum()), "scene")
            name = group.name.replace("_", " ")
            found.append((f"{standings.track}, {group.by} {name}: {scenes}{distance}", group.rows, group.comparisons))
    if board.night and "condition" in by:
        night = next(other for other in board.night.standings if other.track == standings.track)
        size = f"{count_of(len(board.night.recordings), 'scene')} of {count_of(board.night.logs, 'log')}"
        found.append(
            (f"{standings.track}, night (out of distribution): {size}{distance}", night.rows, night.comparisons)
        )
    return [part for part in found if part[1]]


def to_markdown(board: Leaderboard, *, sort: Order = "table", by: Sequence[Grouping] = ()) -> str:
    """All tables with their conventions, and the one-fold comparison below each."""
    columns = columns_of(board)
    blocks = ["# MixoOdometry leaderboard", "\n".join(f"* {line}" for line in conventions(board)), LEGEND]
    for standings in board.standings:
        for i, (caption, rows, comparisons) in enumerate(parts(board, standings, by)):
            heading = f"{'###' if i else '##'} {caption}"
            blocks.append(_table(heading, sections(rows, sort), comparisons, columns).markdown())
        blocks += notes(standings)
    return "\n\n".join(blocks) + "\n"


def print_leaderboard(board: Leaderboard, *, sort: Order = "table", by: Sequence[Grouping] = ()) -> None:
    """The same on the terminal; a narrow one leaves out the last columns, which the files keep, but no interval."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDE
    shown = {standings.track: parts(board, standings, by) for standings in board.standings}
    every = [cells(row, comparisons) for some in shown.values() for _, rows, comparisons in some for row in rows]
    columns = fitting(columns_of(board), every, width)
    for standings in board.standings:
        for caption, rows, comparisons in shown[standings.track]:
            print(_table(caption, sections(rows, sort), comparisons, columns).text(width))
        for line in notes(standings):
            print(textwrap.fill(line, width))
        print()
    if left_out := [column for column in columns_of(board) if column not in columns]:
        print(textwrap.fill(f"For want of width without {', '.join(left_out)}: see leaderboard.md.", width))
    for line in (*conventions(board), LEGEND):
        print(textwrap.fill(line, width))


def scores_table(standings: Standings) -> Table:
    """The errors of every row of a track, without the conventions and comparisons of the whole leaderboard."""
    return _table(f"Track {standings.track}", sections(standings.rows), standings.comparisons, SCORES)


def fitting(columns: Sequence[str], lines: Sequence[Mapping[str, str]], width: int) -> tuple[str, ...]:
    """As many of the columns, from the left, as ``width`` characters hold of these lines."""
    wanted = [max(len(text) for text in (column, *(line[column] for line in lines))) + 2 for column in columns]
    ends = np.cumsum(wanted)
    fit = int((ends <= width).sum())
    return tuple(columns[: max(fit, len(LEAST_COLUMNS))])


def _interval(value: Interval, digits: int, with_ends: bool) -> str:
    if np.isnan(value.mean):
        return "-"  # no scene is long enough for a sample
    ends = f" [{value.low:.{digits}f}, {value.high:.{digits}f}]" if with_ends and np.isfinite(value.low) else ""
    return f"{value.mean:.{digits}f}{ends}"


def _table(caption: str, groups: Sequence[Sequence[Row]], comparisons: Comparisons, columns: Sequence[str]) -> Table:
    texts = [cells(row, comparisons) for group in groups for row in group]
    lines = [[text[column] for column in columns] for text in texts]
    return Table(caption, tuple(map(Column, columns)), lines, tuple(np.cumsum([len(group) for group in groups[:-1]])))
