"""Scores trajectories with evo's API; run by the interpreter of evo's own environment, never imported here.

Reads a job from standard input and writes a result to standard output, both JSON.

Job: ``{"pairs": [[truth, estimate], ...], "lengths": [...], "align": "none" | "se3" | "sim3" | "origin",
"details": bool}`` with TUM files whose times agree. Result: ``{"scoring_s": CPU seconds without reading,
"total_s": with reading, "scores": [...]}``; scores only with details.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

import copy
import json
import sys
import time

from evo.core import filters, metrics
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface

RELATIONS = {
    "translation": metrics.PoseRelation.translation_part,
    "rotation": metrics.PoseRelation.rotation_angle_deg,
}


def aligned(truth: PoseTrajectory3D, estimate: PoseTrajectory3D, align: str) -> PoseTrajectory3D:
    """A copy of the estimate, aligned on all poses, or on the first."""
    if align == "none":
        return estimate
    result = copy.deepcopy(estimate)
    if align == "origin":
        result.align_origin(truth)
    else:
        result.align(truth, correct_scale=align == "sim3")
    return result


def scores(truth: PoseTrajectory3D, estimate: PoseTrajectory3D, lengths: list[float]) -> dict:
    """Absolute errors, and relative ones at every length with the reference tool's tolerance and dense starts."""
    result: dict = {"absolute": {}, "relative": {}}
    for name, relation in RELATIONS.items():
        absolute = metrics.APE(relation)
        absolute.process_data((truth, estimate))
        result["absolute"][name] = absolute.get_all_statistics()
        for length in lengths:
            relative = metrics.RPE(
                relation, length, metrics.Unit.meters, rel_delta_tol=0.2, all_pairs=True, pairs_from_reference=True
            )
            try:
                relative.process_data((truth, estimate))
            except filters.FilterException:  # no pair of that length
                continue
            entry = {**relative.get_all_statistics(), "count": len(relative.error)}
            result["relative"].setdefault(str(length), {})[name] = entry
    return result


def main() -> None:
    """Do the job on standard input."""
    job = json.load(sys.stdin)
    started = time.process_time()
    pairs = [[file_interface.read_tum_trajectory_file(path) for path in pair] for pair in job["pairs"]]
    read = time.process_time()
    found = [scores(truth, aligned(truth, estimate, job["align"]), job["lengths"]) for truth, estimate in pairs]
    finished = time.process_time()
    result: dict = {"scoring_s": finished - read, "total_s": finished - started}
    if job["details"]:
        result["scores"] = found
    json.dump(result, sys.stdout)


main()
