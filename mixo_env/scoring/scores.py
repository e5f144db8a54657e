"""Score trajectories from files: every metric of docs/metrics.md for one method over one scene or many."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mixo_env.geometry import FloatArray
from mixo_env.metrics.absolute import AbsoluteErrors, absolute_errors, scene_absolute
from mixo_env.metrics.aggregate import (
    mean_of_length_means,
    per_length,
    pooled,
    rmse_over_length,
    share_above,
    statistics,
)
from mixo_env.metrics.alignment import align, align_one_of_many
from mixo_env.metrics.anatomy import error_anatomy
from mixo_env.metrics.association import MAX_DIFFERENCE_S, match
from mixo_env.metrics.increments import increment_score, increments
from mixo_env.metrics.pairs import IntArray, PairRule, find_end_pairs, find_kitti_pairs, find_pairs, path_length
from mixo_env.metrics.relative import RelativeSamples, relative_errors
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.formats import TrajectoryFiles
from mixo_env.trajectory.layout import pair_scenes
from mixo_env.trajectory.planar import PlanarPoses


@dataclass(frozen=True)
class Convention:
    """Everything that can change a score; printed and saved with it.

    Attributes:
        align: ``"none"``, ``"posyaw"``, ``"se3"`` or ``"sim3"``.
        align_poses: align on the first n poses; ``None``: all.
        max_difference_s: largest time difference of associated poses.
        pair_rule: which pieces the relative errors use.
    """

    align: str = "none"
    align_poses: int | None = None
    max_difference_s: float = MAX_DIFFERENCE_S
    pair_rule: PairRule = field(default_factory=PairRule)

    def as_numbers(self) -> dict[str, Any]:
        """All of it as plain values, and the sentence that says it."""
        return {**asdict(self), "sentence": self.sentence()}

    def sentence(self) -> str:
        """One line for captions."""
        return f"{self.alignment_words()}; {self.pair_words()}"

    def alignment_words(self) -> str:
        """What absolute errors depend on."""
        if self.align == "none":
            return "no alignment"
        poses = "all poses" if self.align_poses is None else f"the first {self.align_poses} poses"
        return f"{self.align} on {poses}"

    def pair_words(self) -> str:
        """What relative errors depend on."""
        rule = self.pair_rule
        if rule.pairs == "rpg":
            return f"rpg pairs (tolerance 0.2, dense starts, shifted), {rule.end_length} length"
        tolerance = "one local step" if rule.tolerance == "step" else f"{rule.tolerance:g} L"
        spacing = f"starts {rule.min_start_spacing_m:g} m apart" if rule.min_start_spacing_m else "dense starts"
        return f"true pairs, tolerance {tolerance}, {spacing}, {rule.end_length} length"


@dataclass(frozen=True)
class Matched:
    """The scenes of one method, poses matched, one scene after another.

    Attributes:
        name: of the method.
        scenes: names.
        truth, estimate: ``N`` matched poses each; the estimate as it was read.
        offsets: ``(scenes + 1,)`` first row of each scene and the end.
    """

    name: str
    scenes: tuple[str, ...]
    truth: Trajectory
    estimate: Trajectory
    offsets: IntArray


@dataclass(frozen=True)
class MethodScore:
    """All errors of one method.

    Attributes:
        matched: what was scored.
        aligned: ``N`` poses of the estimate after alignment.
        scales: ``(scenes,)`` s of the alignment.
        distance_m: ``(N,)`` true path travelled within the scene.
        absolute: errors of every pose.
        relative: errors of every piece.
        kitti: errors of the KITTI benchmark's pieces.
        end: error of each scene from end to end.
        unscaled: scenes where truth or estimate stands, so that sim3 has no scale: aligned by se3.
    """

    matched: Matched
    aligned: Trajectory
    scales: FloatArray
    distance_m: FloatArray
    absolute: AbsoluteErrors
    relative: RelativeSamples
    kitti: RelativeSamples
    end: RelativeSamples
    unscaled: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the method."""
        return self.matched.name

    def rows(self, scene: int) -> slice:
        """Rows of one scene."""
        return slice(int(self.matched.offsets[scene]), int(self.matched.offsets[scene + 1]))

    def as_numbers(self) -> dict[str, Any]:
        """All statistics as plain values; what does not exist (no sample, no times) is ``None``."""
        ate = scene_absolute(self.absolute, self.matched.offsets)
        numbers = {
            "poses": len(self.matched.truth),
            "path_m": self._path_m(),
            "aligned_without_scale": list(self.unscaled),
            "scenes": {name: self._scene(scene) for scene, name in enumerate(self.matched.scenes)},
            "ate_over_scenes": {
                "translation_m": asdict(statistics(ate.translation_m)),
                "rotation_deg": asdict(statistics(ate.rotation_deg)),
                "share_above_half_metre": share_above(ate.translation_m),
            },
            "rte": {
                "pooled": asdict(pooled(self.relative)),
                "pooled_statistics": _relative_statistics(self.relative),
                "mean_of_length_means": asdict(mean_of_length_means(self.relative)),
                "rmse_over_length": asdict(rmse_over_length(self.relative)),
                "per_length": [asdict(score) for score in per_length(self.relative)],
            },
            "kitti": {
                "t_rel_percent": pooled(self.kitti).translation_percent,
                "r_rel_deg_per_m": pooled(self.kitti).rotation_deg_per_m,
                "samples": len(self.kitti.scene),
                "per_length": [asdict(score) for score in per_length(self.kitti)],
            },
            "end_drift": asdict(pooled(self.end)),
            **self._planar(),
        }
        return _plain(numbers)

    def _path_m(self) -> float:
        return float(sum(self.distance_m[stop - 1] for stop in self.matched.offsets[1:]))

    def _scene(self, scene: int) -> dict[str, Any]:
        rows = self.rows(scene)
        relative = self.relative.scene == scene
        return {
            "poses": rows.stop - rows.start,
            "path_m": float(self.distance_m[rows.stop - 1]),
            "scale": None if self.matched.scenes[scene] in self.unscaled else float(self.scales[scene]),
            "ate": {
                "translation_m": asdict(statistics(self.absolute.translation_m[rows])),
                "rotation_deg": asdict(statistics(self.absolute.rotation_deg[rows])),
            },
            "end_error_m": float(self.absolute.translation_m[rows.stop - 1]),
            "rte": {
                "translation_percent": statistics(self.relative.translation_percent[relative]).mean,
                "rotation_deg_per_m": statistics(self.relative.rotation_deg_per_m[relative]).mean,
                "samples": int(np.count_nonzero(relative)),
            },
        }

    def _planar(self) -> dict[str, Any]:
        """Scores of what is seen from above: single yaw steps and error anatomy; rates need times."""
        truth, estimate, offsets = self.matched.truth, self.aligned, self.matched.offsets
        true_planar, planar = PlanarPoses(*truth.planar()), PlanarPoses(*estimate.planar())
        true_steps, step_offsets = increments(true_planar.yaw_rad, offsets)
        steps, _ = increments(planar.yaw_rad, offsets)
        times = truth.timestamps_s
        clock = np.arange(len(truth), dtype=np.float64) if times is None else times
        inside = np.ones(len(truth), dtype=bool)
        inside[offsets[:-1]] = False
        yaw = asdict(increment_score(true_steps, steps, np.diff(clock, prepend=0.0)[inside], step_offsets))
        anatomy = asdict(error_anatomy(true_planar, planar, clock, offsets))
        anatomy["bias_deg_per_s"] = {f"{window:g}": value for window, value in anatomy["bias_deg_per_s"].items()}
        del anatomy["all_lost_share"], anatomy["all_lost_energy"]  # files know no camera states
        if times is None:  # steps then count as equally long; rates have no unit
            yaw["yaw_rate_rmse_deg_per_s"] = None
            anatomy["bias_deg_per_s"] = None
        return {"yaw": yaw, "anatomy": anatomy}


def read_matched(name: str, truth: Path, estimate: Path, convention: Convention, files: TrajectoryFiles) -> Matched:
    """Read and match every scene of one method.

    Args:
        name: of the method.
        truth: file or folder.
        estimate: file or folder of the same scenes.
        convention: its time limit is used.
        files: reads each file once, however many methods share it.
    """
    pairs = {}
    for scene, (truth_file, estimate_file) in pair_scenes(truth, estimate).items():
        poses = files.read(truth_file), files.read(estimate_file)
        pairs[scene] = match(*poses, convention.max_difference_s, (str(truth_file), str(estimate_file)))
    return join(name, pairs)


def join(name: str, pairs: Mapping[str, tuple[Trajectory, Trajectory]]) -> Matched:
    """One after another: the matched trajectories of scene name -> (truth, estimate)."""
    lengths = [len(truth) for truth, _ in pairs.values()]
    offsets = np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)])
    truths, estimates = zip(*pairs.values(), strict=True)
    return Matched(name, tuple(pairs), _concatenate(truths), _concatenate(estimates), offsets)


def score(matched: Matched, convention: Convention) -> MethodScore:
    """All errors of one method under one convention."""
    truth, offsets, rule = matched.truth, matched.offsets, convention.pair_rule
    aligned, scales, unscaled = [], [], []
    for first, stop in zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True):
        scene = matched.estimate[first:stop]
        poses = truth[first:stop], scene
        if len(matched.scenes) == 1:
            alignment = align(*poses, convention.align, convention.align_poses)
        else:
            alignment, fell_back = align_one_of_many(*poses, convention.align, convention.align_poses)
            unscaled += [matched.scenes[len(scales)]] * fell_back
        aligned.append(alignment.apply(scene))
        scales.append(alignment.scale)
    estimate = _concatenate(aligned)
    distance_m = path_length(truth.positions_m, offsets)
    # Scale is already in the aligned estimate, and nothing else of an alignment touches a relative error.
    relative = relative_errors(truth, estimate, find_pairs(distance_m, rule, offsets), end_length=rule.end_length)
    return MethodScore(
        matched=matched,
        aligned=estimate,
        scales=np.array(scales),
        distance_m=distance_m,
        absolute=absolute_errors(truth, estimate),
        relative=relative,
        kitti=relative_errors(truth, estimate, find_kitti_pairs(distance_m, offsets)),
        end=relative_errors(truth, estimate, find_end_pairs(distance_m, offsets)),
        unscaled=tuple(unscaled),
    )


def _concatenate(parts: list[Trajectory] | tuple[Trajectory, ...]) -> Trajectory:
    if len(parts) == 1:
        return parts[0]
    times = [part.timestamps_s for part in parts]
    return Trajectory(
        np.concatenate([part.positions_m for part in parts]),
        np.concatenate([part.quaternions_wxyz for part in parts]),
        None if any(time is None for time in times) else np.concatenate([t for t in times if t is not None]),
        all(part.camera_axes for part in parts),
        all(part.counted for part in parts),
    )


def _relative_statistics(samples: RelativeSamples) -> dict[str, Any]:
    return {
        "translation_m": asdict(statistics(samples.translation_m)),
        "translation_percent": asdict(statistics(samples.translation_percent)),
        "rotation_deg": asdict(statistics(samples.rotation_deg)),
        "rotation_deg_per_m": asdict(statistics(samples.rotation_deg_per_m)),
    }


def _plain(value: Any) -> Any:
    """JSON knows no NaN: what does not exist is null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value
