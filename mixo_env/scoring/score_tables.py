"""Tables of scored trajectories: the headline, the errors by path length, and those by scene."""

from __future__ import annotations

from typing import Any

from mixo_env.tables import Column, Table

Numbers = dict[str, Any]
"""What ``mixo evaluate --json`` prints: ``convention`` and ``methods``."""


def headline(numbers: Numbers) -> Table:
    """One row a method. With several scenes the ATE is the mean of the scenes' RMSE."""
    columns = (
        Column("Method"),
        Column("Scenes", spec="d"),
        Column("Path", "m", ".1f"),
        Column("ATE", "m", ".4f"),
        Column("ATE", "deg", ".4f"),
        Column("RTE", "%", ".4f"),
        Column("RTE", "deg/m", ".5f"),
        Column("Samples", spec="d"),
        Column("t_rel", "%", ".4f"),
        Column("r_rel", "deg/m", ".5f"),
        Column("End drift", "%", ".4f"),
        Column("ATE > 0.5 m", "share", ".3f"),
    )
    rows = []
    for name, method in numbers["methods"].items():
        ate, pooled = method["ate_over_scenes"], method["rte"]["pooled"]
        rows.append(
            [
                name,
                len(method["scenes"]),
                method["path_m"],
                ate["translation_m"]["mean"],
                ate["rotation_deg"]["mean"],
                pooled["translation_percent"],
                pooled["rotation_deg_per_m"],
                pooled["samples"],
                method["kitti"]["t_rel_percent"],
                method["kitti"]["r_rel_deg_per_m"],
                method["end_drift"]["translation_percent"],
                ate["share_above_half_metre"],
            ]
        )
    lengths = ", ".join(f"{length:g}" for length in numbers["convention"]["pair_rule"]["lengths_m"])
    caption = f"Scores ({numbers['convention']['sentence']}; RTE pooled over {lengths} m)."
    return Table(caption, columns, rows)


def by_length(numbers: Numbers) -> Table:
    """Relative errors at every length, with the samples and scenes they rest on."""
    columns = (
        Column("Method"),
        Column("Length", "m", "g"),
        Column("Samples", spec="d"),
        Column("Scenes", spec="d"),
        Column("Mean", "m", ".4f"),
        Column("RMSE", "m", ".4f"),
        Column("Mean", "%", ".4f"),
        Column("Median", "%", ".4f"),
        Column("Mean", "deg", ".4f"),
        Column("Mean", "deg/m", ".5f"),
    )
    rows = [
        [
            name,
            score["length_m"],
            score["samples"],
            score["scenes"],
            score["translation_m"]["mean"],
            score["translation_m"]["rmse"],
            score["translation_percent"]["mean"],
            score["translation_percent"]["median"],
            score["rotation_deg"]["mean"],
            score["rotation_deg_per_m"]["mean"],
        ]
        for name, method in numbers["methods"].items()
        for score in method["rte"]["per_length"]
    ]
    return Table("Relative error by path length.", columns, rows)


def by_scene(numbers: Numbers) -> Table:
    """Absolute errors of every scene."""
    statistics = ("rmse", "mean", "median", "std", "max")
    columns = (
        Column("Method"),
        Column("Scene"),
        Column("Poses", spec="d"),
        Column("Path", "m", ".1f"),
        *(Column(f"ATE {statistic}", "m", ".4f") for statistic in statistics),
        Column("ATE rmse", "deg", ".4f"),
        Column("Scale", spec=".5f"),
    )
    rows = [
        [
            name,
            scene,
            values["poses"],
            values["path_m"],
            *(values["ate"]["translation_m"][statistic] for statistic in statistics),
            values["ate"]["rotation_deg"]["rmse"],
            values["scale"],
        ]
        for name, method in numbers["methods"].items()
        for scene, values in method["scenes"].items()
    ]
    return Table("Absolute error by scene.", columns, rows)


def several(numbers: Numbers) -> tuple[Table, ...]:
    """The tables a reader wants to see: those by scene only when there are few."""
    scenes = max(len(method["scenes"]) for method in numbers["methods"].values())
    return (
        (headline(numbers), by_scene(numbers), by_length(numbers))
        if scenes <= 10
        else (
            headline(numbers),
            by_length(numbers),
        )
    )
