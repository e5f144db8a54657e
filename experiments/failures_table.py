"""The table of the failure suite: every row fitted on the headline, played on every kind, against exact truth."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mixo_env.errors import ConfigurationError, PolicyError
from mixo_env.files import atomic_path, write_json, write_text
from mixo_env.leaderboard.comparisons import Comparison
from mixo_env.leaderboard.crossvalidation import UNFOLDED, CrossValidation, Run, Trial
from mixo_env.leaderboard.evaluation import Truth, rollout
from mixo_env.leaderboard.results import FAILURES_FILE
from mixo_env.leaderboard.rows import Scorer
from mixo_env.leaderboard.weights import shipped
from mixo_env.metrics.bootstrap import holm
from mixo_env.policies.policy import Policy
from mixo_env.policies.registry import names
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import with_truth
from mixo_env.recordings.variants import as_variant
from mixo_env.tables import Column, Table

TRACK = "VISION"
"""The track of the table that comes with the package."""

REFERENCES = ("CAM_FRONT", "LINEAR", "HUBER")
"""Every row is compared with these, on the scenes of one kind."""

_DARK = 2.2
"""Beyond this ratio, or its inverse, the colour is so dark that figures in it are white."""

INSTANT = "w/o inertial initialization"


@dataclass(frozen=True)
class Scored:
    """One kind of failure.

    Attributes:
        errors: row -> RTE [deg/m]; of rows that read the truth, too.
        compared: row - reference, for every row that does not read the truth.
        p_holm: (row, reference) -> corrected over all of this kind.
        best_camera: in hindsight, and its error.
        scenes: number of them.
        privileged: rows that read the truth or the future.
    """

    errors: dict[str, float]
    compared: dict[tuple[str, str], Comparison]
    p_holm: dict[tuple[str, str], float]
    best_camera: tuple[str, float]
    scenes: int
    privileged: frozenset[str]

    def marked(self, row: str) -> str:
        """Name of a row, with the mark of privileged ones."""
        return row + (" †" if row in self.privileged else "")

    def ratio(self, row: str) -> float:
        """Error of a row over that of the camera that was best in hindsight."""
        return self.errors[row] / self.best_camera[1] if self.best_camera[1] else float("nan")


def check_experts(suite: Recordings, headline: Recordings, name: str, track: str = TRACK) -> None:
    """Refuse a kind recorded by other experts than the policies were fitted on.

    A setting that one of the two does not tell is a difference: its experts knew nothing of it.

    Raises:
        PolicyError: one line that names the first difference.
    """
    if suite.voters(track) != headline.voters(track):
        raise PolicyError(
            f"{name}: {', '.join(suite.voters(track))} vote here, policies were fitted on "
            f"{', '.join(headline.voters(track))}: record the suite with the headline's experts"
        )
    for group in ("monocular", "inertial"):
        here, there = (json.loads(json.dumps(r.manifest.parameters.get(group, {}))) for r in (suite, headline))
        for key in sorted(set(here) | set(there)):
            if here.get(key) != there.get(key):
                raise PolicyError(
                    f"{name}: recorded with {group} {key} {here.get(key, 'unknown')}, policies were fitted on "
                    f"{there.get(key, 'experts that have none')}: record the suite with the headline's experts"
                )


def fitted(chosen: Sequence[str], suite: Recordings, headline: Recordings, track: str) -> dict[str, Policy]:
    """Rows in the order of the tables, fitted on the headline's scenes by day and in rain, and on nothing else."""
    division = CrossValidation(suite, Trial(weights=shipped()), bundled=lambda: headline)
    usual = [name for name in names(suite) if INSTANT not in name and not division.expensive(name)]
    return {name: division.fitted(name, track, UNFOLDED, 0) for name in chosen or usual}


def score(policies: Mapping[str, Policy], suite: Recordings, track: str = TRACK) -> Scored:
    """Play every row on one kind, and compare."""
    scenes = with_truth(CrossValidation(suite).recordings, "exact")
    scorer, everything = Scorer(scenes, {"exact": Truth(scenes)}, floor=0.0, seed=0), np.ones(len(scenes), np.bool_)
    rows = []
    for name, policy in policies.items():
        travel = rollout(policy, as_variant(scenes, name), track, privileged=policy.privileged)
        run = Run(name, policy.privileged, policy.learns, {"exact": (travel,)}, everything, {})
        rows.append(scorer.row(track, run))
    errors = {row.name: float(row.headline.rotation_deg_per_m.mean) for row in rows}
    comparisons = scorer.compare(rows)
    compared = {
        (row.name, other): found
        for row in rows
        for other in REFERENCES
        if (found := comparisons.between(row.name, other)) is not None
    }
    cameras = {name: errors[name] for name in scenes.manifest.cameras if name in errors}
    best = min(cameras, key=lambda name: cameras[name], default="")
    p_holm = holm({pair: found.p_value for pair, found in compared.items()})
    privileged = frozenset(name for name, policy in policies.items() if policy.privileged)
    return Scored(errors, compared, p_holm, (best, cameras.get(best, float("nan"))), len(scenes), privileged)


def write_tables(
    recorded: Mapping[str, Recordings],
    headline: Recordings,
    out: Path,
    chosen: Sequence[str] = (),
    track: str = TRACK,
) -> dict[str, Scored]:
    """Score every kind; write failures.json, failures.md and failures.png.

    Raises:
        PolicyError: for a kind that other experts recorded than the headline.
        ConfigurationError: when all scenes of a kind are too short for a score.
        OutputError: when a file cannot be written.
    """
    for name, suite in recorded.items():
        check_experts(suite, headline, name, track)
    policies = fitted(chosen, next(iter(recorded.values())), headline, track)
    scored = {name: score(policies, suite, track) for name, suite in recorded.items()}
    for name, of in scored.items():
        if not np.isfinite(list(of.errors.values())).all():
            raise ConfigurationError(
                f"{name}: no scene of {of.scenes} is as long as the shortest path that is scored: make --seconds longer"
            )
    write_json(
        out / FAILURES_FILE,
        {
            "data_version": headline.manifest.data_version,
            "track": track,
            "scenes": {name: of.scenes for name, of in scored.items()},
            "privileged": [row for row, policy in policies.items() if policy.privileged],
            "matrix": {row: {name: of.errors[row] for name, of in scored.items()} for row in policies},
        },
    )
    write_text(out / "failures.md", markdown(scored, headline.manifest.data_version, track))
    draw(scored, out / "failures.png")
    return scored


def markdown(scored: Mapping[str, Scored], fitted_on: str, track: str) -> str:
    """Errors, ratios and paired differences."""
    first = next(iter(scored.values()))
    rows = list(first.errors)
    errors = Table(
        f"RTE in deg/m by exact truth, track {track}; rows were fitted on {fitted_on} only; † reads the truth or the "
        "future",
        (Column("policy"), *(Column(name, "deg/m", ".4f") for name in scored)),
        [[first.marked(row), *(of.errors[row] for of in scored.values())] for row in rows],
    )
    best = "; ".join(f"{name}: {of.best_camera[0]}" for name, of in scored.items())
    ratios = Table(
        f"The same over the error of the camera that was best in hindsight ({best})",
        (Column("policy"), *(Column(name, "x", ".2f") for name in scored)),
        [[first.marked(row), *(of.ratio(row) for of in scored.values())] for row in rows],
    )
    differences = [
        Table(
            f"{name}, {of.scenes} scenes, a log each: row - reference, 95 % by bootstrap over logs, p after Holm over "
            f"all {len(of.compared)} differences of this table",
            (Column("row"), Column("reference"), Column("difference"), Column("95 %"), Column("share"), Column("p")),
            [
                [
                    row,
                    other,
                    f"{found.difference.mean:+.5f}",
                    f"{found.difference.low:+.5f} to {found.difference.high:+.5f}",
                    f"{100.0 * found.share:+.1f} %",
                    f"{of.p_holm[row, other]:.3f}",
                ]
                for (row, other), found in of.compared.items()
            ],
        )
        for name, of in scored.items()
    ]
    return "# Failure suite\n\n" + "\n".join(table.markdown() for table in (errors, ratios, *differences))


def draw(scored: Mapping[str, Scored], path: Path) -> None:
    """Rows by kinds: error over that of the hindsight-best camera, on a logarithmic scale of colour."""
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    first = next(iter(scored.values()))
    rows = list(first.errors)
    ratios = np.array([[of.ratio(row) for of in scored.values()] for row in rows])
    figure = Figure(figsize=(3.5 + 0.6 * len(scored), 1.8 + 0.28 * len(rows)), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(ratios, norm=LogNorm(0.25, 4.0), cmap="RdBu_r", aspect="auto")
    axes.set_xticks(range(len(scored)), [name.replace("_", " ") for name in scored], rotation=60, ha="right")
    axes.set_yticks(range(len(rows)), [first.marked(row) for row in rows])
    for (i, j), ratio in np.ndenumerate(ratios):
        dark = ratio > _DARK or ratio < 1.0 / _DARK
        axes.text(j, i, f"{ratio:.2f}", ha="center", va="center", fontsize=7, color="white" if dark else "black")
    axes.set_title("RTE over that of the camera best in hindsight; † reads the truth or the future")
    ticks = (0.25, 0.5, 1.0, 2.0, 4.0)
    figure.colorbar(image, ax=axes, label="ratio", ticks=ticks, format="%g").minorticks_off()
    with atomic_path(path) as part:
        figure.savefig(part, format="png", dpi=110, metadata={"Software": None})
