"""Does the order of methods depend on how many difficulties are staged? The leaderboard at several shares of them.

    python -m experiments.situation_shares --workers 2

A scene is simulated from its number and its own situation, so choosing scenes of a large recording by their situation
gives what simulating with other shares would give, and nothing has to be rendered. Every variant is a set of the same
size: *plain* scenes (ordinary or standing, in a city of usual texture) and *staged* ones. The data sheet tells which is
which, and reads the result.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments import stored_figures as stored
from mixo_env.errors import ConfigurationError, MixoError
from mixo_env.leaderboard.board import Standings, build
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings

FloatArray = NDArray[np.float64]

PLAIN = ("ordinary", "standing")
"""Situations that are no difficulty of the paper: standing belongs to realistic motion."""

SCORES = ("translation_percent", "rotation_deg_per_m", "yaw_increment_rmse_deg")

Scores = dict[str, dict[str, dict[str, float]]]
"""Track -> score -> row -> value."""


@dataclass(frozen=True)
class Choice:
    """The scenes of one variant in one draw.

    Attributes:
        factor: of the staged share.
        draw: number of the random order the scenes are taken in.
        plain, staged: names.
    """

    factor: float
    draw: int
    plain: tuple[str, ...]
    staged: tuple[str, ...]


def staged_scenes(sheet: Mapping[str, Any]) -> dict[str, bool]:
    """Scene -> whether something is staged in it: a situation that is not in ``PLAIN``, or a city of low texture."""
    bare = {name for log in sheet["logs"] if log["low_texture"] for name in log["scenes"]}
    return {name: situation not in PLAIN or name in bare for name, situation in sheet["situations"].items()}


def choose(is_staged: Mapping[str, bool], factors: Sequence[float], draws: int, seed: int) -> list[Choice]:
    """Sets of the same, largest possible size with the staged share times each factor.

    Within a draw the sets are nested: a larger factor replaces plain scenes with further staged ones.

    Args:
        is_staged: of every scene there is.
        factors: of the share of staged ones; 1 must be among them.
        draws: random orders.
        seed: of all draws.

    Raises:
        ConfigurationError: if a factor asks for more than all scenes, if 1 is missing, or if a kind of scene is.
    """
    plain, staged = ([name for name, is_one in is_staged.items() if is_one == kind] for kind in (False, True))
    if not plain or not staged:
        raise ConfigurationError(f"{len(plain)} plain and {len(staged)} staged scenes: the study needs both")
    share = len(staged) / len(is_staged)
    if 1.0 not in factors or max(factors) * share >= 1.0 or min(factors) < 0.0:
        raise ConfigurationError(
            f"factors must include 1 and lie between 0 and {1 / share:.2f} ({share:.0%} of the scenes are staged), "
            f"got {', '.join(f'{factor:g}' for factor in factors)}"
        )
    size = int(
        min(
            min(len(plain) / (1.0 - factor * share), len(staged) / (factor * share) if factor else np.inf)
            for factor in factors
        )
    )
    choices = []
    for draw in range(draws):
        rng = np.random.default_rng([seed, draw])
        first, second = ([kind[k] for k in rng.permutation(len(kind))] for kind in (plain, staged))
        for factor in factors:
            number = min(round(factor * share * size), len(staged))
            choices.append(Choice(factor, draw, tuple(first[: size - number]), tuple(second[:number])))
    return choices


def table_scores(standings: Standings) -> dict[str, dict[str, float]]:
    """Score -> unprivileged row -> value."""
    rows = {row.name: row.headline for row in standings.rows if not row.run.privileged}
    return {
        "translation_percent": {name: score.translation_percent.mean for name, score in rows.items()},
        "rotation_deg_per_m": {name: score.rotation_deg_per_m.mean for name, score in rows.items()},
        "yaw_increment_rmse_deg": {name: score.yaw_increment_rmse_deg for name, score in rows.items()},
    }


def leaderboard_scores(recordings: Recordings, choice: Choice) -> Scores:
    """The leaderboard of one variant: learned policies are fitted anew, agents left out for their time."""
    chosen = {*choice.plain, *choice.staged}
    scenes = recordings.select(scenes=[scene.name for scene in recordings.scenes if scene.name in chosen])
    return {standings.track: table_scores(standings) for standings in build(scenes).standings}


def kept_scores(recordings: Recordings, choice: Choice, folder: Path) -> Scores:
    """The scores of one variant, read if an interrupted run of the study has left them in ``folder``.

    The name of the file is a hash of the scenes' values and of the choice, not of the code: whoever changes a policy
    empties the folder.
    """
    values = {scene.name: scene.values_hash for scene in recordings.scenes}
    key = json.dumps([sorted(choice.plain), sorted(choice.staged), values], sort_keys=True)
    path = folder / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        stored.save(path, leaderboard_scores(recordings, choice))
    return cast("Scores", stored.load(path))


def kendall_tau(first: FloatArray, second: FloatArray) -> float:
    """Tau-b of two lists of scores ``(rows,)``: 1 for the same order, -1 for the reverse; ties count for neither."""
    one, two = (np.sign(scores[:, None] - scores[None, :]) for scores in (first, second))
    return float((one * two).sum() / np.sqrt((one**2).sum() * (two**2).sum()))


def ranks(scores: FloatArray) -> FloatArray:
    """``(rows,)`` from 1 for the lowest score; those that tie share their mean rank."""
    less, equal = (compare(scores[None, :], scores[:, None]).sum(axis=1) for compare in (np.less, np.equal))
    return 0.5 + less + 0.5 * equal


def compare_orders(results: Mapping[tuple[float, int], Scores]) -> dict[str, Any]:
    """Mean ranks and taus by track, score and factor (as text).

    ``tau``: between each factor and 1 in the same draw, mean and lowest over the draws. ``chance``: between factor 1 in
    different draws, which differ by nothing but the luck of the draw.

    Args:
        results: scores by factor and draw.
    """
    factors = list(dict.fromkeys(factor for factor, _ in results))
    draws = sorted({draw for _, draw in results})
    found: dict[str, Any] = {"scores": {}, "ranks": {}, "tau": {}, "chance": {}}
    for track in results[1.0, draws[0]]:
        for part in found.values():
            part[track] = {}
        for score in SCORES:
            rows = list(results[1.0, draws[0]][track][score])
            values = {key: np.array([result[track][score][row] for row in rows]) for key, result in results.items()}

            def mean(by_draw: list[FloatArray], rows: list[str] = rows) -> dict[str, float]:
                return dict(zip(rows, np.mean(by_draw, axis=0).tolist(), strict=True))

            taus = {f: [kendall_tau(values[f, draw], values[1.0, draw]) for draw in draws] for f in factors}
            chance = [kendall_tau(values[1.0, a], values[1.0, b]) for a in draws for b in draws if a < b]
            found["scores"][track][score] = {f"{f:g}": mean([values[f, draw] for draw in draws]) for f in factors}
            found["ranks"][track][score] = {f"{f:g}": mean([ranks(values[f, draw]) for draw in draws]) for f in factors}
            found["tau"][track][score] = {f"{f:g}": _mean_and_lowest(tau) for f, tau in taus.items()}
            found["chance"][track][score] = _mean_and_lowest(chance)
    return found


def _mean_and_lowest(taus: Sequence[float]) -> dict[str, float]:
    return {"mean": float(np.mean(taus)), "lowest": float(min(taus))} if taus else {"mean": np.nan, "lowest": np.nan}


@dataclass(frozen=True)
class SituationStudy:
    """Re-run the leaderboard with more and fewer staged situations.

    Worked examples:

      python -m experiments.situation_shares --workers 2
      python -m experiments.situation_shares --factors 0 1 --draws 1          a quick look
    """

    recordings: str | None = None
    """Folder written by `mixo record`, or the name of a bundled recording. None: mixocity."""
    sheet: Path = Path("docs/mixocity.json")
    """Measured figures of its data sheet: they say what was staged."""
    factors: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0)
    """Of the staged share; 1 is the reference."""
    draws: int = 3
    """Random choices of scenes; at least two show what chance does."""
    seed: int = 0
    """Of the draws."""
    workers: int = 1
    """Processes; the result does not depend on it."""
    out: Path = Path("docs/situation-shares.json")
    """File to write."""
    unfinished: Path = Path("results/situation-shares")
    """Folder of the variants that are done: an interrupted study goes on from there; removed at the end."""

    def run(self) -> int:
        """Choose, score, compare."""
        from joblib import Parallel, delayed

        recordings = load_recordings(self.recordings)
        known = staged_scenes(stored.load(self.sheet))
        inside = [scene.name for scene in recordings.scenes if scene.fold >= 0]
        if missing := [name for name in inside if name not in known]:
            raise ConfigurationError(f"{self.sheet} says nothing about {missing[0]}: write the data sheet first")
        choices = choose({name: known[name] for name in inside}, self.factors, self.draws, self.seed)
        tasks = (delayed(kept_scores)(recordings, choice, self.unfinished) for choice in choices)
        scores = cast("list[Scores]", Parallel(n_jobs=self.workers, verbose=10)(tasks))
        result = compare_orders({(c.factor, c.draw): score for c, score in zip(choices, scores, strict=True)})
        result |= {
            "data_version": recordings.manifest.data_version,
            "values_hashes": [scene.values_hash for scene in recordings.scenes],
            "draws": self.draws,
            "seed": self.seed,
            "scenes": len(choices[0].plain) + len(choices[0].staged),
            "of_scenes": len(inside),
            "staged": {f"{choice.factor:g}": len(choice.staged) for choice in choices},
        }
        stored.save(self.out, result)
        shutil.rmtree(self.unfinished, ignore_errors=True)
        for track, by_score in result["tau"].items():
            for score, taus in by_score.items():
                shown = "  ".join(f"x {factor}: {tau['mean']:+.2f}" for factor, tau in taus.items())
                print(f"{track:9s} {score:24s} {shown}  chance: {result['chance'][track][score]['mean']:+.2f}")
        print(f"wrote {self.out}")
        return 0


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(SituationStudy, description=__doc__).run())
    except MixoError as error:
        sys.exit(f"situation_shares: {error}")
