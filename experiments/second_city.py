"""Does the order of rows hold in a city nobody has seen? Every city's own leaderboard against the reference's.

    python -m experiments.second_city --cities recordings-of-seed-7 recordings-of-seed-8

Each folder is a recording by `mixo record` of a city simulated with another seed. Kendall's tau is taken over the pairs
of rows that share no letter in the reference: what it cannot tell apart has no order that could be kept.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from mixo_env.errors import MixoError, PolicyError
from mixo_env.files import write_json
from mixo_env.leaderboard.board import Table, build
from mixo_env.policies.registry import create, names
from mixo_env.recordings.store import load_recordings


@dataclass(frozen=True)
class Agreement:
    """How well one city keeps the order of another.

    Attributes:
        tau: (kept - reversed) / pairs; NaN without a pair.
        pairs: of rows that both have and that share no letter in the reference.
        reversed: those in the other order, the better row of the reference first.
    """

    tau: float
    pairs: int
    reversed: tuple[tuple[str, str], ...]


def tau_of_lettered(
    reference: Mapping[str, float], letters: Mapping[str, str], other: Mapping[str, float]
) -> Agreement:
    """Kendall's tau over the pairs of rows that share no letter.

    Args:
        reference: row -> error.
        letters: row -> letters in the reference; a row without any takes no part.
        other: row -> error elsewhere; a tie there counts for neither.
    """
    rows = [row for row in reference if row in other and letters.get(row)]
    kept, turned, pairs = 0, [], 0
    for first, second in itertools.combinations(sorted(rows, key=lambda row: reference[row]), 2):
        if set(letters[first]) & set(letters[second]):
            continue
        pairs += 1
        kept += other[first] < other[second]
        if other[first] > other[second]:
            turned.append((first, second))
    return Agreement((kept - len(turned)) / pairs if pairs else float("nan"), pairs, tuple(turned))


def errors_of(table: Table) -> dict[str, float]:
    """Row without a dagger -> headline error [deg/m]."""
    return {row.name: row.headline.rotation_deg_per_m.mean for row in table.rows if not row.run.privileged}


def tables_of(recordings: str | None) -> dict[str, Table]:
    """The leaderboard by track, without expensive policies.

    Raises:
        PolicyError: with fewer than two folds: learned rows would come from the reference city.
    """
    loaded = load_recordings(recordings)
    if len({scene.fold for scene in loaded.scenes if scene.fold >= 0}) < 2:
        raise PolicyError(f"{recordings}: expected two folds or more, to learn in the city itself: record more drives")
    board = build(loaded, policies=[name for name in names(loaded) if not create(name, loaded).expensive])
    return {table.track: table for table in board.tables}


@dataclass(frozen=True)
class SecondCity:
    """Compare the order of rows between cities.

    Worked examples:

      python -m experiments.second_city --cities city-7 city-8
    """

    cities: tuple[str, ...]
    """Folders with recordings of cities of other seeds."""
    reference: str | None = None
    """Folder, or the name of a bundled recording. None: mixocity."""
    out: Path | None = None
    """File for the result as JSON. None: it is only printed."""

    def run(self) -> int:
        """Score every city and print tau by track."""
        reference = tables_of(self.reference)
        result: dict[str, Any] = {}
        for city in self.cities:
            for track, table in tables_of(city).items():
                own = reference[track]
                found = tau_of_lettered(errors_of(own), own.comparisons.letters, errors_of(table))
                result.setdefault(city, {})[track] = {
                    "tau": found.tau,
                    "pairs": found.pairs,
                    "reversed": [list(pair) for pair in found.reversed],
                }
                print(f"{city}  {track:9s} tau {found.tau:+.2f} over {found.pairs} pairs that share no letter")
        if self.out:
            write_json(self.out, result)
        return 0


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(SecondCity, description=__doc__).run())
    except MixoError as error:
        sys.exit(f"second_city: {error}")
