"""The report's first screen: who wins, by how much, is it significant, on which data, where does it fail, how again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from mixo_env.leaderboard.comparisons import LEVEL
from mixo_env.leaderboard.sentences import count_of, p_text, percent

Values = Mapping[str, Any]


def answers(results: Values, configuration: Values) -> list[tuple[str, str]]:
    """Question and answer, from the results' plain values (``leaderboard.json``, ``configuration.json``)."""
    tracks: Values = results["tracks"]
    several = len(tracks) > 1
    won = [(f"{name}: " if several else "") + _winner(table["rows"]) for name, table in tracks.items()]
    found = [(f"{name}: " if several else "") + _significance(table) for name, table in tracks.items()]
    failed = [(f"{name}: " if several else "") + _weak(table) for name, table in tracks.items()]
    return [
        ("Who wins, and by how much?", "\n".join(won)),
        ("Is it significant?", "\n".join(found)),
        ("On which data?", _data(results)),
        ("Where does it fail?", "\n".join(failed)),
        ("How do I reproduce it?", command(configuration)),
    ]


def error_of(row: Values) -> float | None:
    """Headline RTE [deg/m] of a row; ``None`` without a sample."""
    return next(iter(row["scores"].values()))["rotation_deg_per_m"]["mean"]


def best(rows: Sequence[Values]) -> Values | None:
    """The row of least headline error among those that may win: no truth read, a vote or several."""
    able = [row for row in rows if not row["privileged"] and not row["reference"] and error_of(row) is not None]
    return min(able, key=lambda row: error_of(row) or 0.0) if able else None


def command(configuration: Values) -> str:
    """The command that gives these results again; a folder is named without where it lay."""
    words = ["mixo", "benchmark"]
    recordings = configuration["recordings"]
    if recordings != "mixocity":
        words += ["--recordings", PurePath(recordings).name]
    for name in ("tracks", "policies"):
        asked = configuration["asked"][name]
        words += [f"--{name}", *asked] if asked else []
    for name, usual in (("seed", 0), ("seeds", 1), ("ground_truth", "poses")):
        if configuration[name] != usual:
            words += [f"--{name.replace('_', '-')}", str(configuration[name])]
    return shlex.join(words)


def _winner(rows: Sequence[Values]) -> str:
    row = best(rows)
    if row is None:
        return "no row can win: none was scored that has a vote and reads no truth."
    score = next(iter(row["scores"].values()))
    interval = score["rotation_deg_per_m"]
    ends = "" if interval["low"] is None else f" [{interval['low']:.4f}, {interval['high']:.4f}]"
    ahead = [
        f"{other['policy']} {error:.4f}"
        for other in rows
        if not other["privileged"]
        and other["reference"]
        and (error := error_of(other)) is not None
        and error < interval["mean"]
    ]
    text = f"{row['policy']} errs least, {interval['mean']:.4f}{ends} deg/m, ATE {score['ate_m']:.2f} m"
    against = [
        f"{percent(found['share'])} against {name}"
        for name, found in row["differences"].items()
        if found and found["share"] is not None
    ]
    unheard = f" Without a vote and ahead of it: {', '.join(ahead)}." if ahead else ""
    return f"{text}{'; ' if against else ''}{', '.join(against)}.{unheard}"


def _significance(table: Values) -> str:
    row = best(table["rows"])
    if row is None:
        return "nothing to compare."
    logs = count_of(table["comparisons"]["logs"], "drive")
    parts = [
        f"{'yes' if found['p_holm'] < LEVEL else 'no'} against {name} (p {p_text(found['p_holm'])} after Holm)"
        for name, found in row["differences"].items()
        if found
    ]
    alike = [
        other["policy"]
        for other in table["rows"]
        if other is not row and not other["privileged"] and set(other["letters"]) & set(row["letters"])
    ]
    told = f"; not told apart from {', '.join(alike)}" if alike else "; told apart from every other row"
    return f"{', '.join(parts) or 'LINEAR and MIXO are not among the rows'}{told}, over {logs}."


def _data(results: Values) -> str:
    night = results["night"]
    dark = f"; {count_of(len(night['scenes']), 'night scene')} apart" if night else ""
    sure = "" if results["logs"] >= 10 else " Too few drives for a ranking: this shows that everything works."
    return (
        f"{results['data_version']}: {count_of(len(results['scenes']), 'scene')} of "
        f"{count_of(results['logs'], 'drive')}, every row of the table on all{dark}; seed {results['seed']}.{sure}"
    )


def _weak(table: Values) -> str:
    """The group of scenes in which the winner errs most."""
    row = best(table["rows"])
    groups = [
        (group, error_of(own))
        for group in table["groups"]
        for own in group["rows"]
        if row and own["policy"] == row["policy"] and error_of(own) is not None
    ]
    if row is None or not groups:
        return "scenes have neither conditions nor situations to tell."
    group, error = max(groups, key=lambda one: one[1] or 0.0)
    lost = (row["anatomy"] or {}).get("all_lost_energy")
    share = "" if lost is None else f"; {100 * lost:.0f} % of its squared error where no camera tracks"
    overall = error_of(row) or float("nan")
    return (
        f"{row['policy']} errs most in {group['by']} {group['name'].replace('_', ' ')}: {error:.4f} deg/m, "
        f"{(error or 0.0) / overall:.1f} times its mean{share}."
    )
