"""A folder of results read again: what a report rests on, complete and of one piece, or one clear line."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from mixo_env.errors import ResultsError

AGAIN = "run `mixo benchmark` again"

FAILURES_FILE = "failures.json"
"""Errors of the rows in the failure suite; what comes with the package is of the bundled recordings."""


@dataclass(frozen=True)
class Results:
    """Plain values of the files that ``mixo benchmark`` wrote.

    Attributes:
        leaderboard, configuration, drives: of ``leaderboard.json``, ``configuration.json`` and ``drives.json``.
        failures: of ``failures.json``, of the failure suite: ``data_version`` of what its rows were fitted on,
            ``track``, ``scenes`` of every kind, ``privileged`` rows, and ``matrix``, row -> kind -> RTE [deg/m];
            ``None`` where it was not recorded.
    """

    leaderboard: dict[str, Any]
    configuration: dict[str, Any]
    drives: dict[str, Any]
    failures: dict[str, Any] | None


def read_results(folder: Path) -> Results:
    """Read a folder of results.

    Raises:
        ResultsError: when a file is missing or half-written, files are of different runs, a score is no number, a row
            was not scored on every scene, or there is no row at all.
    """
    found = Results(
        _read(folder / "leaderboard.json"),
        _read(folder / "configuration.json"),
        _read(folder / "drives.json"),
        _read(folder / FAILURES_FILE) if (folder / FAILURES_FILE).exists() else None,
    )
    try:
        _check(folder, found)
    except (KeyError, TypeError, AttributeError, StopIteration) as error:
        raise ResultsError(f"{folder}: expected results of this version of mixo ({error!r}): {AGAIN}") from None
    return found


def shipped_failures(data_version: str) -> dict[str, Any] | None:
    """The failure suite as it comes with the package, if its rows were fitted on recordings of this version."""
    found = _read(Path(str(files("mixo_env.leaderboard") / FAILURES_FILE)))
    return found if found["data_version"] == data_version else None


def _read(path: Path) -> dict[str, Any]:
    import msgspec

    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except OSError:
        raise ResultsError(f"{path}: expected a file that `mixo benchmark` writes, found none: {AGAIN}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ResultsError(f"{path}: expected whole JSON, got a damaged file ({error}): {AGAIN}") from None


def _check(folder: Path, results: Results) -> None:
    board, configuration = results.leaderboard, results.configuration
    for name, other in (("configuration.json", configuration), (FAILURES_FILE, results.failures)):
        if other is not None and other.get("data_version", board["data_version"]) != board["data_version"]:
            raise ResultsError(
                f"{folder}: leaderboard.json is of data version {board['data_version']}, {name} of "
                f"{other['data_version']}: expected one; {AGAIN}"
            )
    scenes = set(board["scenes"])
    if differ := scenes ^ set(configuration["scenes"]):
        raise ResultsError(
            f"{folder}: leaderboard.json and configuration.json do not name the same scenes ({len(differ)} differ, "
            f"{min(differ)} first): {AGAIN}"
        )
    if results.failures is not None and not all(isinstance(row, dict) for row in results.failures["matrix"].values()):
        raise ResultsError(f"{folder}/{FAILURES_FILE}: expected a matrix, row -> kind -> number: record it anew")
    if not any(table["rows"] or table["one_fold_rows"] for table in board["tracks"].values()):
        raise ResultsError(f"{folder}: expected at least one scored policy, found none: ask for one with --policies")
    for part in (board, board["night"]):
        for track, table in part["tracks"].items() if part else ():
            for row in table["rows"]:
                _check_row(f"{folder}: track {track}, {row['policy']}", row, len(part["scenes"]))


def _check_row(where: str, row: dict[str, Any], scenes: int) -> None:
    for truth, score in row["scores"].items():
        if score["scenes"] != scenes:
            raise ResultsError(f"{where}: scored on {score['scenes']} of {scenes} scenes, expected all: {AGAIN}")
        values = {"ate_m": score["ate_m"], "ate_deg": score["ate_deg"]}
        if score["samples"]:
            values |= {name: score[name]["mean"] for name in ("rotation_deg_per_m", "translation_percent")}
        if missing := [name for name, value in values.items() if not isinstance(value, (int, float))]:
            raise ResultsError(f"{where}: {missing[0]} against {truth} is no number: {AGAIN}")
