"""paper.md with every table, and paper-*.png beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from mixo_env.errors import ConfigurationError, PolicyError, RecordingError
from mixo_env.files import write_text
from mixo_env.leaderboard.board import Leaderboard
from mixo_env.leaderboard.paper import tables
from mixo_env.leaderboard.paper.cost import cost_table, draw_cost, points_of
from mixo_env.leaderboard.paper.figures import figure_3, figure_4, figure_5, figure_6, figure_7
from mixo_env.leaderboard.paper.parts import Subject, subject_of
from mixo_env.leaderboard.paper.weights import (
    by_manoeuvre,
    draw_by_manoeuvre,
    draw_over_time,
    gates_weights,
    preferences,
)
from mixo_env.recordings.collection import Recordings

NAME = "paper.md"
INTRODUCTION = """# The paper's tables and figures

Printed numbers are from Morra, Biondo, Poerio, Lamberti, *MIXO*, IEEE Transactions on Consumer Electronics 69(3), 2023.
They rest on other data than ours; what is not recorded here is a dash or a line that says so."""

FIGURES = {
    "paper-fig3.png": ("Figure 3", figure_3),
    "paper-fig4.png": ("Figure 4", figure_4),
    "paper-fig5.png": ("Figure 5", figure_5),
    "paper-fig6.png": ("Figure 6", figure_6),
    "paper-fig7.png": ("Figure 7", figure_7),
}
"""File -> heading and what draws it."""

OTHER_FIGURES = ("paper-manoeuvres.png", "paper-weights.png", "paper-cost.png")

TABLES: dict[str, Callable[[Subject], tables.Table]] = {
    "Table I": tables.table_1,
    "MIXO against the front camera": tables.gain,
    "LINEAR's weights": tables.linear_weights,
    "Table II as printed": lambda _: tables.table_2_printed(),
    "Table II": tables.table_2,
    "Equation 2": tables.equation_2,
    "RTE by length": tables.by_length,
    "Loose against tight coupling": tables.coupling,
}
"""Heading -> what makes the table."""


def write_paper(board: Leaderboard, recordings: Recordings, results: Path, folder: Path | None = None) -> Path:
    """Write all that the recordings allow; what they do not allow is one line each.

    Args:
        board: that was built of the recordings.
        recordings: as they were opened.
        results: folder to write into; figures of an earlier run there are removed first.
        folder: of the recordings, for their timings; ``None``: none are known.

    Returns:
        The page.

    Raises:
        OutputError: when a file cannot be written.
    """
    subject = subject_of(board, recordings, folder)
    for name in (*FIGURES, *OTHER_FIGURES):
        (results / name).unlink(missing_ok=True)
    blocks = [INTRODUCTION]
    for heading, make in TABLES.items():
        blocks += [f"## {heading}", _tried(lambda make=make: make(subject).markdown())]
    for name, (heading, draw) in FIGURES.items():
        blocks += [f"## {heading}", _tried(lambda draw=draw, name=name: _shown(draw(subject, results / name), name))]
    blocks += ["## Weights of the gates", _tried(lambda: "\n".join(_weights(subject, results)))]
    blocks += ["## Accuracy against cost", _tried(lambda: "\n".join(_cost(subject, results)))]
    write_text(results / NAME, "\n\n".join(block.rstrip("\n") for block in blocks) + "\n")
    return results / NAME


def _tried(make: Callable[[], str]) -> str:
    """What ``make`` gives, or one line that says why it cannot be made here."""
    try:
        return make()
    except (ConfigurationError, PolicyError, RecordingError) as error:  # one that cannot write ends the command
        return f"Not made: {error}."


def _shown(words: str, name: str) -> str:
    return f"{words.rstrip()}\n\n![{name.removesuffix('.png')}]({name})"


def _weights(subject: Subject, results: Path) -> Iterator[str]:
    weights = gates_weights(subject)
    found = preferences(subject, weights)
    yield by_manoeuvre(subject, found).markdown()
    manoeuvres, over_time, _ = OTHER_FIGURES
    draw_by_manoeuvre(found, results / manoeuvres)
    yield _shown("Mean weights by manoeuvre; framed: differs from straight by more than chance.", manoeuvres)
    draw_over_time(subject, weights, results / over_time)
    yield _shown("Weights over time, in the scene that turns most.", over_time)


def _cost(subject: Subject, results: Path) -> Iterator[str]:
    points = points_of(subject)
    yield cost_table(subject.recordings, subject.track, points).markdown()
    draw_cost(points, results / OTHER_FIGURES[-1])
    yield _shown("Accuracy against cost.", OTHER_FIGURES[-1])
