"""Does the order of rows hold in a city nobody has seen? Every city's own leaderboard against the reference's.

    python -m experiments.second_city --cities recordings-of-seed-7 recordings-of-seed-8

Each folder is a recording by `mixo record` of a city simulated with another seed. Kendall's tau is taken over the pairs
of rows that share no letter in the reference: what it cannot tell apart has no order that could be kept. A difference
of the confirmatory family is *repeated* in a city where it has the same sign with p < .05.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro

from mixo_env.errors import MixoError, PolicyError
from mixo_env.files import write_json
from mixo_env.leaderboard.board import Standings, build
from mixo_env.leaderboard.comparisons import LEVEL, Comparison
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.sentences import p_text, percent
from mixo_env.leaderboard.weights import shipped
from mixo_env.policies.registry import names
from mixo_env.recordings.store import load_recordings
from mixo_env.tables import Column, Table


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


def errors_of(standings: Standings) -> dict[str, float]:
    """Row without a dagger -> headline error [deg/m]."""
    return {row.name: row.headline.rotation_deg_per_m.mean for row in standings.rows if not row.run.privileged}


def standings_of(recordings: str | None) -> dict[str, Standings]:
    """The leaderboard by track, without agents; rows whose weights come with the package are not fitted again.

    Raises:
        PolicyError: with fewer than two folds: learned rows would come from the reference city.
    """
    loaded = load_recordings(recordings)
    if len({scene.fold for scene in loaded.scenes if scene.fold >= 0}) < 2:
        raise PolicyError(f"{recordings}: expected two folds or more, to learn in the city itself: record more drives")
    trial = Trial(weights=shipped())
    protocol = CrossValidation(loaded, trial)
    board = build(loaded, policies=[name for name in names(loaded) if not protocol.slow(name)], trial=trial)
    return {standings.track: standings for standings in board.standings}


@dataclass(frozen=True)
class Claim:
    """One difference of the confirmatory family in one track, in every city.

    Attributes:
        track: its name.
        first, second: rows; the difference is first - second, negative where the first is better.
        found: the same comparison, the reference's first.
    """

    track: str
    first: str
    second: str
    found: tuple[Comparison, ...]

    @property
    def repeated(self) -> tuple[bool, ...]:
        """Of every other city: the same sign as in the reference, with p below 5 %."""
        reference, *others = self.found
        return tuple(c.difference.mean * reference.difference.mean > 0.0 and c.p_value < LEVEL for c in others)

    @property
    def holds(self) -> bool:
        """Significant in the reference (after Holm) and repeated in every other city."""
        return self.found[0].p_holm < LEVEL and bool(self.repeated) and all(self.repeated)

    def sentence(self, cities: Sequence[str]) -> str:
        """What can be said about it, with the numbers of every city."""
        parts = [
            f"{city} {percent(c.share)} (p {p_text(c.p_value)}, Holm {p_text(c.p_holm)})"
            for city, c in zip(cities, self.found, strict=True)
        ]
        here = "significant" if self.found[0].p_holm < LEVEL else "not significant"
        again = [city for city, same in zip(cities[1:], self.repeated, strict=True) if same]
        verdict = f"{here} in {cities[0]}, repeated in {', '.join(again) or 'no other city'}"
        return f"{self.track}  {self.first} - {self.second}: {verdict}: " + "; ".join(parts)


def claims(cities: Sequence[Mapping[str, Standings]]) -> list[Claim]:
    """The confirmatory family of every track that all cities have, the reference's standings first."""
    found = []
    for track, standings in cities[0].items():
        for comparison in standings.comparisons.confirmatory:
            pair = (comparison.first, comparison.second)
            same = [
                next((c for c in other[track].comparisons.confirmatory if (c.first, c.second) == pair), None)
                for other in cities
            ]
            there = tuple(c for c in same if c is not None)
            if len(there) == len(cities):
                found.append(Claim(track, *pair, there))
    return found


@dataclass(frozen=True)
class SecondCity:
    """Compare the order of rows between cities, and say which differences hold in all of them.

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
        """Score every city; print tau by track, every row's error, and the confirmatory family."""
        cities = [standings_of(self.reference), *map(standings_of, self.cities)]
        names_of_cities = [Path(self.reference or "mixocity").name, *(Path(city).name for city in self.cities)]
        result: dict[str, Any] = {"tau": {}, "errors": {}, "confirmatory": []}
        for track, own in cities[0].items():
            errors = {city: errors_of(here[track]) for city, here in zip(names_of_cities, cities, strict=True)}
            result["errors"][track] = errors
            for city in names_of_cities[1:]:
                found = tau_of_lettered(errors_of(own), own.comparisons.letters, errors[city])
                result["tau"].setdefault(city, {})[track] = asdict(found)
                turned = "; ".join(f"{worse} before {better}" for better, worse in found.reversed)
                print(
                    f"{city}  {track:9s} tau {found.tau:+.2f} over {found.pairs} pairs that share no letter"
                    + (f"; reversed: {turned}" if turned else "")
                )
            print(_error_table(track, errors).text())
        for claim in claims(cities):
            print(claim.sentence(names_of_cities))
            result["confirmatory"].append(
                {
                    "track": claim.track,
                    "first": claim.first,
                    "second": claim.second,
                    "holds": claim.holds,
                    "repeated": claim.repeated,
                }
                | {"cities": [asdict(c) | {"share": c.share} for c in claim.found]}
            )
        if self.out:
            write_json(self.out, result)
        return 0


def _error_table(track: str, errors: Mapping[str, Mapping[str, float]]) -> Table:
    """Every row's headline error, best first in the reference."""
    first, *_ = errors.values()
    rows = [
        [row, *(own.get(row, float("nan")) for own in errors.values())] for row in sorted(first, key=lambda r: first[r])
    ]
    columns = (Column("policy"), *(Column(city, "deg/m", ".4f") for city in errors))
    return Table(f"{track}: RTE", columns, rows)


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(SecondCity, description=__doc__).run())
    except MixoError as error:
        sys.exit(f"second_city: {error}")
