"""How fast trajectories are scored: against evo's API, from memory and from text files; start of ``mixo evaluate``.

Run ``python -m experiments.speed.scoring``. Our time and evo's are CPU seconds of one thread in the same run, on
the same files: ATE and RTE at 8 lengths, translation and rotation, with statistics. Starts are dense and the tolerance
is 0.2, so that both look at the same pieces. evo is timed on a sample of the scenes, in its own process, and scaled up.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from experiments.peers.evo_client import evo_python, evo_scores
from mixo_env.geometry import FloatArray
from mixo_env.metrics.absolute import absolute_errors, absolute_errors_se2, scene_absolute
from mixo_env.metrics.aggregate import per_length
from mixo_env.metrics.association import match
from mixo_env.metrics.pairs import IntArray, PairRule, find_pairs, path_length
from mixo_env.metrics.relative import relative_errors, relative_samples_se2
from mixo_env.trajectory import Trajectory, read_trajectory, write_tum
from mixo_env.trajectory.planar import PlanarPoses

RULE = PairRule((10.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0, 200.0), tolerance=0.2, min_start_spacing_m=0.0)
RATE_HZ = 12.0

Planar = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class ScoringBenchmark:
    """Time ATE and RTE over many short scenes, and one start of the command."""

    scenes: int = 736
    """Scenes of the paper's selection."""
    poses: int = 240
    """Poses of a scene: 20 s at 12 Hz."""
    evo_scenes: int = 24
    """Scenes evo is timed on; 0 leaves it out."""
    repeats: int = 5
    """Timed runs; the median is printed, with the spread in brackets."""

    def run(self) -> int:
        """Measure and print."""
        truth, estimate = drives(self.scenes, self.poses)
        offsets = np.arange(0, self.scenes * self.poses + 1, self.poses)
        spatial = Trajectory.from_planar(*truth), Trajectory.from_planar(*estimate)
        print(f"{self.scenes} scenes x {self.poses} poses, ATE + RTE at {len(RULE.lengths_m)} lengths [CPU s]")
        from_memory = self._time("from memory, SE(3)", lambda: score_spatial(*spatial, offsets))
        planar = self._time("from memory, SE(2)", lambda: score_planar(truth, estimate, offsets))
        with tempfile.TemporaryDirectory() as folder:
            files = write_scenes(Path(folder), *spatial, offsets)
            reading = self._time("reading and matching text files", lambda: read_scenes(files))
            print(f"scoring is {from_memory / (reading + from_memory):.0%} of the time from text files")
            self._compare_with_evo(files, from_memory, planar)
            self._start(files[0])
        return 0

    def _time(self, name: str, work: Callable[[], object]) -> float:
        work()  # compile, warm caches
        times = []
        for _ in range(self.repeats):
            start = time.process_time()
            work()
            times.append(time.process_time() - start)
        print(f"  {name:34s} {statistics.median(times):8.3f}  [{min(times):.3f} to {max(times):.3f}]")
        return statistics.median(times)

    def _compare_with_evo(self, files: list[tuple[Path, Path]], from_memory: float, planar: float) -> None:
        python = evo_python() if self.evo_scenes else None
        if python is None:
            print("evo is left out or cannot be installed here")
            return
        sample = files[:: max(1, len(files) // self.evo_scenes)][: self.evo_scenes]
        measured = evo_scores(python, sample, RULE.lengths_m, details=False)["scoring_s"]
        evo = measured / len(sample) * self.scenes
        print(f"  {f'evo, from {len(sample)} scenes':34s} {evo:8.1f}")
        print(f"times as fast as evo: SE(3) {evo / from_memory:,.0f}, SE(2) {evo / planar:,.0f}")

    def _start(self, pair: tuple[Path, Path]) -> None:
        command = [sys.executable, "-m", "mixo_env.cli.main", "evaluate"]
        command += ["--groundtruth", str(pair[0]), "--estimate", str(pair[1])]
        wall, cpu = [], []
        for _ in range(self.repeats):
            start, used = time.perf_counter(), os.times()
            subprocess.run(command, check=True, capture_output=True)
            wall.append(time.perf_counter() - start)
            cpu.append(sum(os.times()[2:4]) - sum(used[2:4]))
        print(
            f"mixo evaluate, one pair, start to result: {statistics.median(wall):.2f} s of wall clock, "
            f"{statistics.median(cpu):.2f} s of CPU"
        )


def drives(scenes: int, poses: int, seed: int = 0) -> tuple[Planar, Planar]:
    """Planar poses of random drives and noisy estimates of them, scene after scene."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(poses) / RATE_HZ
    truths, estimates = [], []
    for _ in range(scenes):
        speed = np.abs(6.0 + 4.0 * np.sin(0.3 * time_s + rng.uniform(0, 6)))
        rate = 0.2 * np.sin(rng.uniform(0.2, 0.8) * time_s + rng.uniform(0, 6))
        truths.append(_integrate(rate, speed))
        noise = rng.normal(0, 0.01, poses)
        estimates.append(_integrate(rate + noise, speed * (1 + rng.normal(0, 0.01))))
    return _join(truths), _join(estimates)


def score_spatial(truth: Trajectory, estimate: Trajectory, offsets: IntArray) -> object:
    """ATE per scene and RTE statistics at every length."""
    pairs = find_pairs(path_length(truth.positions_m, offsets), RULE, offsets)
    absolute = scene_absolute(absolute_errors(truth, estimate), offsets)
    return absolute, per_length(relative_errors(truth, estimate, pairs))


def score_planar(truth: Planar, estimate: Planar, offsets: IntArray) -> object:
    """The same for planar poses."""
    both = PlanarPoses(*truth), PlanarPoses(*estimate)
    absolute = scene_absolute(absolute_errors_se2(*both), offsets)
    return absolute, per_length(relative_samples_se2(*both, RULE, offsets))


def write_scenes(folder: Path, truth: Trajectory, estimate: Trajectory, offsets: IntArray) -> list[tuple[Path, Path]]:
    """Two TUM files per scene."""
    files = []
    for scene, (first, stop) in enumerate(zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True)):
        times = np.arange(stop - first) / RATE_HZ
        pair = folder / f"{scene}-truth.txt", folder / f"{scene}-estimate.txt"
        for file, poses in zip(pair, (truth, estimate), strict=True):
            write_tum(file, Trajectory(poses.positions_m[first:stop], poses.quaternions_wxyz[first:stop], times))
        files.append(pair)
    return files


def read_scenes(files: list[tuple[Path, Path]]) -> list[tuple[Trajectory, Trajectory]]:
    """Read and match every pair."""
    return [match(read_trajectory(truth), read_trajectory(estimate)) for truth, estimate in files]


def _integrate(rate: FloatArray, speed: FloatArray) -> Planar:
    yaw = np.cumsum(rate) / RATE_HZ
    return np.cumsum(speed * np.cos(yaw)) / RATE_HZ, np.cumsum(speed * np.sin(yaw)) / RATE_HZ, yaw


def _join(scenes: list[Planar]) -> Planar:
    x, y, yaw = (np.concatenate(parts) for parts in zip(*scenes, strict=True))
    return x, y, yaw


if __name__ == "__main__":
    import tyro

    sys.exit(tyro.cli(ScoringBenchmark).run())
