"""The section on the staged situations: does the order of methods depend on how many there are?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from docs._pages.data_sheet.comparison import number
from mixo_env.tables import Column, Table

HEAD = """## No thumb on the scale

Situations are staged on purpose, so their shares could decide who wins. `python -m experiments.situation_shares` runs
the leaderboard anew with their share at 0, halved, as it is, and doubled."""

SCORES = {"translation_percent": "RTE %", "rotation_deg_per_m": "RTE deg/m", "yaw_increment_rmse_deg": "yaw deg"}

REFERENCE = "1"


def shares_section(study: Mapping[str, Any] | None) -> str:
    """Markdown; says so when the study has not been run."""
    if study is None:
        return f"{HEAD} It has not been run on this version yet."
    staged = ", ".join(f"{number(count, 0)} at x {factor}" for factor, count in study["staged"].items())
    setting = (
        f"A scene is simulated from its number and its own situation, so choosing among the {study['of_scenes']} "
        f"scenes inside the folds gives what simulating with other shares would give (but for blank walls, which the "
        f"other scenes of their log see as well). All variants have {study['scenes']} scenes, of which staged (every "
        f"situation but ordinary and standing, and all scenes in cities of low texture): {staged}. Learned policies "
        "are fitted anew every time; agents trained by reinforcement are left out for their time. Rain stays as it is. "
        f"{study['draws']} random draws."
    )
    return "\n\n".join(
        [
            HEAD,
            setting,
            "Kendall's tau between the order of the unprivileged rows and their order at x 1 in the same draw: 1 is "
            "the same order, 0 no relation, -1 the reverse; mean over the draws (lowest). *Chance*: between x 1 and "
            "x 1 in different draws, which differ by nothing but the luck of the draw.",
            _taus(study),
            _verdict(study),
            "Lowest mean rank by RTE deg/m:\n\n" + _firsts(study, "rotation_deg_per_m"),
            "Mean rank (mean score) in the CONSUMER track by RTE deg/m:",
            _ranks(study, "CONSUMER", "rotation_deg_per_m"),
            "How many drives it takes to tell rows apart, and what twenty chosen scenes tell: "
            "[metrics.md](metrics.md#how-many-drives-tell-rows-apart).",
        ]
    )


def _others(study: Mapping[str, Any]) -> list[str]:
    return [factor for factor in study["staged"] if factor != REFERENCE]


def _taus(study: Mapping[str, Any]) -> str:
    rows = [
        [
            track,
            SCORES[score],
            *(_mean_and_lowest(taus[factor]) for factor in _others(study)),
            _mean_and_lowest(study["chance"][track][score]),
        ]
        for track, scores in study["tau"].items()
        for score, taus in scores.items()
    ]
    headings = ["track", "order by", *(f"x {factor}" for factor in _others(study)), "chance"]
    return Table("", tuple(map(Column, headings)), rows).markdown().strip()


def _mean_and_lowest(tau: Mapping[str, float]) -> str:
    return f"{number(tau['mean'], 2)} ({number(tau['lowest'], 2)})"


def _verdict(study: Mapping[str, Any]) -> str:
    """What the table says, in one sentence a factor."""
    lines = []
    for factor in _others(study):
        pairs = [
            (taus[factor]["mean"], study["chance"][track][score]["lowest"])
            for track, scores in study["tau"].items()
            for score, taus in scores.items()
        ]
        beyond = sum(tau < chance for tau, chance in pairs)
        lowest = number(min(tau for tau, _ in pairs), 2)
        lines.append(
            f"* x {factor}: in {len(pairs) - beyond} of {len(pairs)} orders the change is within what chance does "
            f"(mean tau not below the lowest of chance), in {beyond} beyond it; lowest mean tau {lowest}."
        )
    return "\n".join(lines)


def _firsts(study: Mapping[str, Any], score: str) -> str:
    """Who leads at every factor."""
    lines = []
    for track, ranks in study["ranks"].items():
        leaders = (f"x {factor} {min(rows, key=rows.__getitem__)}" for factor, rows in ranks[score].items())
        lines.append(f"* {track}: {', '.join(leaders)}")
    return "\n".join(lines)


def _ranks(study: Mapping[str, Any], track: str, score: str) -> str:
    ranks, values = study["ranks"][track][score], study["scores"][track][score]
    factors = list(study["staged"])
    order = sorted(ranks[REFERENCE], key=lambda row: ranks[REFERENCE][row])
    rows = [
        [row, *(f"{number(ranks[factor][row], 1)} ({number(values[factor][row], 4)})" for factor in factors)]
        for row in order
    ]
    headings = ["policy", *(f"x {factor}" for factor in factors)]
    return Table("", tuple(map(Column, headings)), rows).markdown().strip()
