"""What the report says first: who may win, and who is ahead without a vote."""

from __future__ import annotations

from typing import Any

from mixo_env.leaderboard.answers import _winner


def row(name: str, deg_per_m: float | None, *, privileged: bool = False, reference: bool = False) -> dict[str, Any]:
    score = {"rotation_deg_per_m": {"mean": deg_per_m, "low": None, "high": None}, "ate_m": 0.3}
    return {
        "policy": name,
        "privileged": privileged,
        "reference": reference,
        "scores": {"exact": score},
        "differences": {},
    }


def test_who_has_no_vote_cannot_win_but_is_named_where_it_is_ahead() -> None:
    rows = [
        row("ORACLE", 0.001, privileged=True),
        row("JOINT", 0.0017, reference=True),
        row("TANDEM", 0.0022),
        row("INERTIAL", 0.0079, reference=True),
        row("SHORT", None, reference=True),
    ]
    assert _winner(rows) == "TANDEM errs least, 0.0022 deg/m, ATE 0.30 m. Without a vote and ahead of it: JOINT 0.0017."


def test_nobody_ahead_nobody_named() -> None:
    assert _winner([row("LINEAR", 0.002), row("INERTIAL", 0.0079, reference=True)]).endswith("ATE 0.30 m.")
